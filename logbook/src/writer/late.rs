//! Maps that are computed after their frames were written.

use rusqlite::params;

use super::SessionWriter;
use super::rows::known_mapper;
use crate::row::{late_map_checksum, pack_trace};
use crate::{LogbookError, MapRecord};

impl SessionWriter {
    /// Writes the record of a map whose frame was written without one; on disk when this returns.
    ///
    /// # Errors
    /// The frame is not in this part or not acknowledged, it has a map already, or a disk error.
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
        let (header_checksum, number) = (self.header_checksum, self.late_maps as i64 + 1);
        let mut store = || -> rusqlite::Result<()> {
            let transaction = self.connection.transaction()?;
            let mapper = known_mapper(&transaction, header_checksum, &mut self.mapper, map)?;
            let (sequence, trace) = (sequence as i64, pack_trace(map));
            let checksum = late_map_checksum(header_checksum, sequence, number, mapper, &trace);
            transaction.execute(
                "INSERT INTO late_map (sequence, number, mapper, map_hash, checksum) VALUES (?1, ?2, ?3, ?4, ?5)",
                params![sequence, number, mapper, trace, checksum],
            )?;
            transaction.commit()
        };
        match store() {
            Ok(()) => {
                self.late_maps += 1;
                Ok(())
            }
            Err(source) => {
                self.mapper = before;
                Err(self.write_failed("write the hash of a map to", source))
            }
        }
    }
}
