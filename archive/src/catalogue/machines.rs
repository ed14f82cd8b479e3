//! The state of all machines according to the catalogue.

use chrono::{DateTime, Utc};
use serde::Serialize;
use tokio_postgres::Row;

use super::{Catalogue, CatalogueError};

/// A machine: its newest data, and its alarms.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Machine {
    /// Site.
    pub site: String,
    /// Machine.
    pub daq: String,
    /// Its newest session.
    pub session: Option<String>,
    /// Whether the voltages of its newest archived session are simulated.
    pub simulated: Option<bool>,
    /// Archived parts.
    pub parts: u64,
    /// Archived frames.
    pub frames: u64,
    /// Archived bytes.
    pub bytes: u64,
    /// Time of the last archived frame.
    pub last_frame: Option<DateTime<Utc>>,
    /// When its last part was archived, by the clock of the server.
    pub last_archived: Option<DateTime<Utc>>,
    /// The last minute with quantities.
    pub last_quantity: Option<DateTime<Utc>>,
    /// Time since data of it arrived, s; `None` if its clock is ahead and it has no part.
    pub silent_s: Option<f64>,
    /// How far its clock is ahead of the server's, s; `None` if it is not.
    pub clock_ahead_s: Option<f64>,
    /// Share of the frames with a reliable map, over the last ten minutes with quantities.
    pub known: Option<f64>,
    /// Its alarms that are active.
    pub alarms: Vec<String>,
    /// Those that cannot be judged.
    pub invalid_alarms: Vec<String>,
}

impl Catalogue {
    /// All machines that this role may see, by site and name.
    ///
    /// # Errors
    /// The server refuses.
    pub async fn machines(&self) -> Result<Vec<Machine>, CatalogueError> {
        let query = "SELECT site, daq, session, simulated, parts, frames, bytes, last_frame, last_archived, last_quantity,
                silent_s, clock_ahead_s, known, alarms, invalid_alarms
            FROM tactus.machine_state ORDER BY site, daq";
        // compiling this query takes longer than running it for a thousand machines
        self.within(self.client.batch_execute("SET jit = off"))
            .await?;
        let rows = self.within(self.client.query(query, &[])).await?;
        let count = |number: i64| u64::try_from(number).unwrap_or_default();
        let machine = |row: &Row| Machine {
            site: row.get(0),
            daq: row.get(1),
            session: row.get(2),
            simulated: row.get(3),
            parts: count(row.get(4)),
            frames: count(row.get(5)),
            bytes: count(row.get(6)),
            last_frame: row.get(7),
            last_archived: row.get(8),
            last_quantity: row.get(9),
            silent_s: row.get(10),
            clock_ahead_s: row.get(11),
            known: row.get(12),
            alarms: row.get(13),
            invalid_alarms: row.get(14),
        };
        Ok(rows.iter().map(machine).collect())
    }
}
