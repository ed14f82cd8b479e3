//! Maps that are made after their frames were written.

use rusqlite::params;

use super::SessionWriter;
use super::rows::known_mapper;
use crate::row::pack_trace;
use crate::{LogbookError, MapRecord};

impl SessionWriter {
    /// Writes the trace of a map of a frame that was acknowledged without one; on disk when this returns.
    ///
    /// # Errors
    /// A frame that is not in this part, or not acknowledged, one that has its map, or a disk that refuses.
    pub fn late_map(&mut self, sequence: u64, map: &MapRecord) -> Result<(), LogbookError> {
        self.check_usable()?;
        let first = self.header.first_sequence;
        if !(first..=self.sequence).contains(&sequence) {
            return Err(LogbookError::NoSuchFrame {
                path: self.path.clone(),
                sequence,
                frames: (self.sequence + 1).saturating_sub(first),
                first,
            });
        }
        let before = self.mapper.clone();
        let mut store = || -> rusqlite::Result<()> {
            let transaction = self.connection.transaction()?;
            let mapper = known_mapper(&transaction, &mut self.mapper, map)?;
            transaction.execute(
                "INSERT INTO late_map (sequence, mapper, map_hash) VALUES (?1, ?2, ?3)",
                params![sequence as i64, mapper, pack_trace(map)],
            )?;
            transaction.commit()
        };
        let stored = store();
        stored.map_err(|source| {
            self.mapper = before;
            self.write_failed("write the hash of a map to", source)
        })
    }
}
