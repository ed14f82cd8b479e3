//! The sessions of the catalogue: search by name, lists, and the data for reading one elsewhere.

use std::fmt;
use std::str::FromStr;

use chrono::{DateTime, Utc};
use serde::Serialize;
use tokio_postgres::Row;

use super::{Catalogue, CatalogueError};

/// The name that stands for the newest session.
const LAST: &str = "last";
/// Maximum number of names shown for an ambiguous one.
const SHOWN: i64 = 5;

/// A session as a person names it: `SITE/DAQ/SESSION` or `SESSION`, where SESSION is an id, the beginning of one, or
/// `last`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArchivedName {
    site: Option<String>,
    daq: Option<String>,
    session: String,
}

impl FromStr for ArchivedName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Vec<&str> = text.split('/').collect();
        let (site, daq, session) = match parts[..] {
            [session] => (None, None, session),
            [site, daq, session] => (Some(site), Some(daq), session),
            _ => (None, None, ""),
        };
        if session.is_empty() || site.is_some_and(str::is_empty) || daq.is_some_and(str::is_empty) {
            return Err(format!(
                "'{text}' is not a session of an archive: write SITE/DAQ/SESSION, or SESSION alone: an id, the beginning of one, or \
                 `last`"
            ));
        }
        Ok(Self {
            site: site.map(str::to_owned),
            daq: daq.map(str::to_owned),
            session: session.to_owned(),
        })
    }
}

impl fmt::Display for ArchivedName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.site, &self.daq) {
            (None, None) => f.write_str(&self.session),
            (site, daq) => {
                let any = |name: &Option<String>| name.clone().unwrap_or_else(|| "*".to_owned());
                write!(f, "{}/{}/{}", any(site), any(daq), self.session)
            }
        }
    }
}

impl ArchivedName {
    /// The same name, with this site and machine if it has none.
    pub fn within(mut self, site: Option<&str>, daq: Option<&str>) -> Self {
        self.site = self.site.or(site.map(str::to_owned));
        self.daq = self.daq.or(daq.map(str::to_owned));
        self
    }
}

/// The full name of a session: session ids are unique within a machine only.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SessionName {
    /// Site.
    pub site: String,
    /// Machine.
    pub daq: String,
    /// Session.
    pub session: String,
}

impl fmt::Display for SessionName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.site, self.daq, self.session)
    }
}

/// Which sessions are listed.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SessionFilter {
    /// Of this site; `None` for all sites that this role may see.
    pub site: Option<String>,
    /// Of this machine; `None` for all.
    pub daq: Option<String>,
    /// With a part that ended at this time or later.
    pub from: Option<DateTime<Utc>>,
    /// With a part that began before this time.
    pub to: Option<DateTime<Utc>>,
    /// Maximum number of sessions; the newest are listed.
    pub most: Option<u32>,
}

/// A session, summarised over its archived parts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ArchivedSession {
    /// Site.
    pub site: String,
    /// Machine.
    pub daq: String,
    /// Its id.
    pub id: String,
    /// `measurement` or `baseline`.
    pub kind: String,
    /// When it began.
    pub started: DateTime<Utc>,
    /// Time of the last archived frame.
    pub last_frame: Option<DateTime<Utc>>,
    /// Frames of all parts.
    pub frames: u64,
    /// Parts.
    pub parts: u64,
    /// Bytes of all parts.
    pub bytes: u64,
    /// Whether its voltages are simulated.
    pub simulated: bool,
    /// When the last archived part was closed.
    pub closed_at: DateTime<Utc>,
    /// Why it was closed.
    pub reason: String,
    /// Whether the session ended, and no part is missing.
    pub complete: bool,
    /// Number of electrodes.
    pub electrodes: u32,
    /// Readings of a frame.
    pub readings: u32,
    /// A note of the operator.
    pub note: String,
}

/// Why a name identifies no session.
#[derive(Debug)]
pub(crate) enum Unfound {
    /// No session has this name.
    None,
    /// Several sessions have it; some of them.
    Several(Vec<SessionName>),
}

fn name(row: &Row) -> SessionName {
    SessionName {
        site: row.get(0),
        daq: row.get(1),
        session: row.get(2),
    }
}

impl Catalogue {
    /// The session of a name.
    pub(crate) async fn session_named(
        &self,
        wanted: &ArchivedName,
    ) -> Result<Result<SessionName, Unfound>, CatalogueError> {
        let ArchivedName { site, daq, session } = wanted;
        if session == LAST {
            let newest = "SELECT site, daq, session FROM tactus.part
                WHERE ($1::text IS NULL OR site = $1) AND ($2::text IS NULL OR daq = $2) ORDER BY started DESC LIMIT 1";
            let row = self
                .within(self.client.query_opt(newest, &[site, daq]))
                .await?;
            return Ok(row.as_ref().map(name).ok_or(Unfound::None));
        }
        let named = "SELECT site, daq, session FROM tactus.session
            WHERE ($1::text IS NULL OR site = $1) AND ($2::text IS NULL OR daq = $2) AND starts_with(session, $3)
            ORDER BY session <> $3, site, daq, session LIMIT $4";
        let rows = self
            .within(self.client.query(named, &[site, daq, session, &SHOWN]))
            .await?;
        let mut found: Vec<SessionName> = rows.iter().map(name).collect();
        // an exact match takes precedence over prefixes
        let whole = found
            .iter()
            .filter(|found| found.session == *session)
            .count();
        if whole > 0 {
            found.truncate(whole);
        }
        Ok(match found.pop() {
            None => Err(Unfound::None),
            Some(only) if found.is_empty() => Ok(only),
            Some(last) => {
                found.push(last);
                Err(Unfound::Several(found))
            }
        })
    }

    /// Sessions, the oldest first.
    ///
    /// # Errors
    /// The server refuses.
    pub async fn sessions(
        &self,
        filter: &SessionFilter,
    ) -> Result<Vec<ArchivedSession>, CatalogueError> {
        let query = "SELECT s.site, s.daq, s.session, s.kind, s.started, s.last, s.frames, s.parts, s.bytes, s.simulated,
                s.closed, s.closed_reason, s.complete, s.electrodes, s.readings, s.note
            FROM tactus.session_summary AS s
            WHERE ($1::text IS NULL OR s.site = $1) AND ($2::text IS NULL OR s.daq = $2)
                AND ($3::timestamptz IS NULL OR s.closed >= $3) AND ($4::timestamptz IS NULL OR s.started < $4)
            ORDER BY s.started DESC, s.site DESC, s.daq DESC, s.session DESC LIMIT $5";
        let SessionFilter {
            site,
            daq,
            from,
            to,
            most,
        } = filter;
        let most = most.map(i64::from);
        let rows = self
            .within(self.client.query(query, &[site, daq, from, to, &most]))
            .await?;
        let count = |number: i64| u64::try_from(number).unwrap_or_default();
        let small = |number: i32| u32::try_from(number).unwrap_or_default();
        let session = |row: &Row| ArchivedSession {
            site: row.get(0),
            daq: row.get(1),
            id: row.get(2),
            kind: row.get(3),
            started: row.get(4),
            last_frame: row.get(5),
            frames: count(row.get(6)),
            parts: count(row.get(7)),
            bytes: count(row.get(8)),
            simulated: row.get(9),
            closed_at: row.get(10),
            reason: row.get(11),
            complete: row.get(12),
            electrodes: small(row.get(13)),
            readings: small(row.get(14)),
            note: row.get(15),
        };
        Ok(rows.iter().rev().map(session).collect())
    }

    /// The stored rows of quantities of a session, unchanged, in order.
    pub(crate) async fn quantity_lines(
        &self,
        of: &SessionName,
    ) -> Result<Vec<String>, CatalogueError> {
        let query = "SELECT span::text FROM tactus.quantity WHERE site = $1 AND daq = $2 AND session = $3 ORDER BY line";
        let rows = self
            .within(self.client.query(query, &[&of.site, &of.daq, &of.session]))
            .await?;
        Ok(rows.iter().map(|row| row.get(0)).collect())
    }

    /// The tracked baseline at the start of a session; `None` if there was none.
    pub(crate) async fn tracking(
        &self,
        of: &SessionName,
    ) -> Result<Option<String>, CatalogueError> {
        let query =
            "SELECT state FROM tactus.tracking WHERE site = $1 AND daq = $2 AND session = $3";
        let row = self
            .within(
                self.client
                    .query_opt(query, &[&of.site, &of.daq, &of.session]),
            )
            .await?;
        Ok(row.map(|row| row.get(0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_one_part_or_three() {
        let name = |text: &str| text.parse::<ArchivedName>();
        assert_eq!(name("m1").unwrap().to_string(), "m1");
        assert_eq!(
            name("berlin/bed3/m1").unwrap().to_string(),
            "berlin/bed3/m1"
        );
        let within = name("m1").unwrap().within(Some("berlin"), None);
        assert_eq!(within.to_string(), "berlin/*/m1");
        for wrong in ["", "berlin/m1", "a/b/c/d", "//m1", "berlin/bed3/"] {
            let text = name(wrong).unwrap_err();
            assert!(text.contains("SITE/DAQ/SESSION"), "{wrong}: {text}");
        }
    }
}
