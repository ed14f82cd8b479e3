//! The row of a session's header, with its closing.

use chrono::DateTime;
use rusqlite::Row;
use serde::{Deserialize, Serialize};

use super::checksums::{HeaderChecksum, closing_checksum};
use crate::{Closing, SessionHeader, SessionKind};

/// Number of rows of each table when a session was closed. Rows of most tables are numbered without a gap, so the
/// last number is the count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RowCounts {
    /// Sequence of the last frame; without frames, one less than the first sequence.
    pub(crate) last: u64,
    pub(crate) frames: u64,
    pub(crate) baselines: u64,
    pub(crate) events: u64,
    pub(crate) references: u64,
    pub(crate) stretches: u64,
    pub(crate) settings: u64,
    pub(crate) mappers: u64,
    pub(crate) late_maps: u64,
}

pub(crate) enum HeaderFault {
    Store(rusqlite::Error),
    Content(String),
}

impl From<rusqlite::Error> for HeaderFault {
    fn from(source: rusqlite::Error) -> Self {
        Self::Store(source)
    }
}

/// The closing entry in the header's row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum End {
    /// No entry: the session runs, or its writer was killed.
    Open,
    Closed(Closing, RowCounts),
    /// An entry that fails its checksum: the session was closed, but how is unknown.
    Damaged(Closing),
}

/// The columns of a header without those of its closing.
pub(crate) const HEADER_COLUMNS: &str = "id, kind, started_ns, simulated, build, seed, config_toml, config_hash, model_hash, \
     geometry_hash, protocol, instruments, modules, note, about, asked, continues, first_sequence, checksum";

pub(crate) fn header_row(
    row: &Row<'_>,
) -> Result<(SessionHeader, HeaderChecksum, End), HeaderFault> {
    let content = |what: &str, cause: &dyn std::fmt::Display| {
        HeaderFault::Content(format!("{what}: {cause}"))
    };
    let text = |name: &str| row.get::<_, String>(name);
    let kind = text("kind")?;
    let seed: Option<String> = row.get("seed")?;
    let header = SessionHeader {
        id: text("id")?,
        kind: SessionKind::parse(&kind).ok_or_else(|| content("kind", &kind))?,
        started: DateTime::from_timestamp_nanos(row.get("started_ns")?),
        instruments: serde_json::from_str(&text("instruments")?)
            .map_err(|cause| content("instruments", &cause))?,
        modules: serde_json::from_str(&text("modules")?)
            .map_err(|cause| content("modules", &cause))?,
        config_toml: text("config_toml")?,
        config_hash: text("config_hash")?,
        model_hash: row.get("model_hash")?,
        geometry_hash: row.get("geometry_hash")?,
        protocol: serde_json::from_str(&text("protocol")?)
            .map_err(|cause| content("protocol", &cause))?,
        build: text("build")?,
        seed: seed
            .map(|seed| seed.parse().map_err(|cause| content("seed", &cause)))
            .transpose()?,
        simulated: row.get("simulated")?,
        note: text("note")?,
        about: serde_json::from_str(&text("about")?).map_err(|cause| content("about", &cause))?,
        asked: text("asked")?,
        continues: row.get("continues")?,
        first_sequence: match u64::try_from(row.get::<_, i64>("first_sequence")?) {
            // readers start from the number before it
            Ok(0) => return Err(content("first sequence", &"it is 0, numbers begin at 1")),
            number => number.map_err(|cause| content("first sequence", &cause))?,
        },
    };
    let header_checksum =
        HeaderChecksum::of(&header).map_err(|cause| content("checksum", &cause))?;
    if row.get::<_, Vec<u8>>("checksum")? != header_checksum.bytes() {
        return Err(HeaderFault::Content("its checksum does not agree".into()));
    }
    let end = end(row, header_checksum);
    Ok((header, header_checksum, end))
}

fn end(row: &Row<'_>, header_checksum: HeaderChecksum) -> End {
    let read = || -> rusqlite::Result<_> {
        let at: Option<i64> = row.get("closed_ns")?;
        let texts: [Option<String>; 2] = [row.get("closed_reason")?, row.get("closed_tally")?];
        let checksum: Option<Vec<u8>> = row.get("closed_checksum")?;
        Ok((at, texts, checksum))
    };
    let whole = match read() {
        Ok((None, [None, None], None)) => return End::Open,
        Ok((Some(at), [Some(reason), Some(tally)], Some(checksum))) => {
            let agrees = checksum == closing_checksum(header_checksum, at, &reason, &tally);
            let tally = serde_json::from_str(&tally).ok().filter(|_| agrees);
            tally.map(|tally| {
                let at = DateTime::from_timestamp_nanos(at);
                End::Closed(Closing { at, reason }, tally)
            })
        }
        _ => None,
    };
    whole.unwrap_or_else(|| {
        let at = row.get("closed_ns").unwrap_or_default();
        End::Damaged(Closing {
            at: DateTime::from_timestamp_nanos(at),
            reason: "closed; the entry with the reason is damaged".into(),
        })
    })
}

#[cfg(test)]
mod tests {
    use rusqlite::params;
    use survey::Protocol;

    use super::*;
    use crate::{LogbookError, SessionReader, SessionWriter};

    #[test]
    fn a_header_whose_first_number_is_zero_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let protocol = Protocol::sheffield(8).unwrap();
        let header = SessionHeader::new("m1", DateTime::UNIX_EPOCH, protocol);
        let writer = SessionWriter::create(folder.path(), &header).unwrap();
        let path = writer.path().to_owned();
        writer.close(DateTime::UNIX_EPOCH, "done").unwrap();
        let forged = SessionHeader {
            first_sequence: 0,
            ..header
        };
        let checksum = HeaderChecksum::of(&forged).unwrap().bytes();
        let file = rusqlite::Connection::open(&path).unwrap();
        file.pragma_update(None, "ignore_check_constraints", true)
            .unwrap();
        let sql = "UPDATE session SET first_sequence = 0, checksum = ?1";
        file.execute(sql, params![checksum.as_slice()]).unwrap();
        drop(file);
        match SessionReader::open(&path).err() {
            Some(LogbookError::Damaged { place, why, .. }) => {
                assert_eq!(place, "its header");
                assert_eq!(why, "first sequence: it is 0, numbers begin at 1");
            }
            other => panic!("{other:?}"),
        }
    }
}
