//! Lists of the catalogue: the parts of sites, machines and sessions.

use serde::Serialize;

use super::{Catalogue, CatalogueError, SessionName};
use crate::store::PartName;

/// A part in the catalogue.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ArchivedPart {
    /// Its name in the store.
    #[serde(flatten)]
    pub name: PartName,
    /// Size, bytes.
    pub bytes: u64,
    /// Sequence of its first frame.
    pub first_sequence: u64,
    /// Frames in it.
    pub frames: u64,
}

impl Catalogue {
    /// The parts of a session, in the order of their frames.
    ///
    /// # Errors
    /// The server refuses.
    pub async fn parts_of(&self, name: &SessionName) -> Result<Vec<ArchivedPart>, CatalogueError> {
        self.parts(Some(&name.site), Some(&name.daq), Some(&name.session))
            .await
    }

    /// The parts of a site, a machine and a session, session by session in the order of their frames. `None` selects
    /// everything that this role may see.
    ///
    /// # Errors
    /// The server refuses.
    pub async fn parts(
        &self,
        site: Option<&str>,
        daq: Option<&str>,
        session: Option<&str>,
    ) -> Result<Vec<ArchivedPart>, CatalogueError> {
        let query = "SELECT site, daq, session, part, encode(sha256, 'hex'), bytes, first_sequence, frames FROM tactus.part
            WHERE ($1::text IS NULL OR site = $1) AND ($2::text IS NULL OR daq = $2) AND ($3::text IS NULL OR session = $3)
            ORDER BY site, daq, session, first_sequence, started";
        let rows = self
            .within(self.client.query(query, &[&site, &daq, &session]))
            .await?;
        let number = |count: i64| u64::try_from(count).unwrap_or_default();
        let part = |row: &tokio_postgres::Row| ArchivedPart {
            name: PartName {
                site: row.get(0),
                daq: row.get(1),
                session: row.get(2),
                part: row.get(3),
                sha256: row.get(4),
            },
            bytes: number(row.get(5)),
            first_sequence: number(row.get(6)),
            frames: number(row.get(7)),
        };
        Ok(rows.iter().map(part).collect())
    }
}
