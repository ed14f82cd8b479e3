//! Baseline, events and measuring settings of a session.

use std::time::Duration;

use chrono::DateTime;
use survey::{Amps, Baseline, Settings, Volts};

use super::SessionReader;
use crate::codec::Reference;
use crate::row::{baseline_checksum, event_checksum, settings_checksum};
use crate::{Event, LogbookError};

impl SessionReader {
    /// The baseline that the session recorded or was measured against.
    ///
    /// # Errors
    /// The file cannot be read, or its baseline is damaged.
    pub fn baseline(&self) -> Result<Option<Baseline>, LogbookError> {
        type Stored = (String, i64, i64, i64, bool, [Vec<u8>; 3]);
        let sql = "SELECT id, wall_ns, frames, settings, simulated, readings, deviation, checksum FROM baseline";
        let row = self.one_row(sql, [], "read the baseline of", |row| {
            let blobs = [row.get(5)?, row.get(6)?, row.get(7)?];
            let stored: Stored = (
                row.get(0)?,
                row.get(1)?,
                row.get(2)?,
                row.get(3)?,
                row.get(4)?,
                blobs,
            );
            Ok(stored)
        })?;
        let Some((id, wall, frames, settings, simulated, blobs)) = row else {
            return Ok(None);
        };
        let [readings, deviation, checksum] = blobs;
        let mut baseline = Baseline {
            id,
            readings: Vec::new(),
            deviation: Vec::new(),
            frames: frames as usize,
            wall: DateTime::from_timestamp_nanos(wall),
            settings: self.settings(settings)?,
            simulated,
        };
        let place = || "its baseline".to_owned();
        let own = baseline_checksum(
            self.header_checksum,
            &baseline,
            settings,
            wall,
            &readings,
            &deviation,
        );
        if checksum != own {
            return Err(self.damaged(place(), "its checksum does not agree"));
        }
        let unpack = |blob: &[u8]| {
            self.decode_one(blob, &Reference::NONE)
                .map_err(|cause| self.damaged(place(), cause.to_string()))
        };
        baseline.readings = unpack(&readings)?;
        baseline.deviation = unpack(&deviation)?
            .into_iter()
            .map(|deviation| deviation.volts().map(|volts| volts.0))
            .collect();
        Ok(Some(baseline))
    }

    /// The events, in order.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn events(&self) -> Result<Vec<Event>, LogbookError> {
        let (whole, damaged) = self.events_and_damaged()?;
        match damaged.first() {
            None => Ok(whole),
            Some(number) => {
                Err(self.damaged(format!("event {number}"), "its checksum does not agree"))
            }
        }
    }

    /// Events that match their checksums, and the numbers of those that do not.
    pub(crate) fn events_and_damaged(&self) -> Result<(Vec<Event>, Vec<i64>), LogbookError> {
        let mut damaged = Vec::new();
        let available = self.bytes()?;
        let mut read = || -> rusqlite::Result<Vec<Event>> {
            let (mut events, mut bytes) = (Vec::new(), 0);
            let mut statement = self
                .ask()
                .prepare_cached("SELECT id, at_ns, kind, text, checksum FROM event ORDER BY id")?;
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                let number = row.get(0)?;
                let (at, kind, text) = (
                    row.get(1)?,
                    row.get::<_, String>(2)?,
                    row.get::<_, String>(3)?,
                );
                bytes += (kind.len() + text.len()) as u64;
                if bytes > available {
                    // several rows claim the same pages: the size read into memory is limited
                    return Err(rusqlite::Error::IntegralValueOutOfRange(
                        3,
                        text.len() as i64,
                    ));
                }
                let event = Event {
                    at: DateTime::from_timestamp_nanos(at),
                    kind,
                    text,
                };
                let own =
                    event_checksum(self.header_checksum, number, at, &event.kind, &event.text);
                if row.get::<_, Vec<u8>>(4)? == own {
                    events.push(event);
                } else {
                    damaged.push(number);
                }
            }
            Ok(events)
        };
        let events = read()
            .map_err(|source| LogbookError::reading(&self.path, "read the events of", source))?;
        Ok((events, damaged))
    }

    /// One event by its number; `None` if it is missing or does not match its checksum.
    pub(crate) fn event(&self, number: i64) -> Result<Option<Event>, LogbookError> {
        let sql = "SELECT at_ns, kind, text, checksum FROM event WHERE id = ?1";
        let row = self.one_row(sql, [number], "read an event of", |row| {
            let at = row.get(0)?;
            let event = Event {
                at: DateTime::from_timestamp_nanos(at),
                kind: row.get(1)?,
                text: row.get(2)?,
            };
            Ok((event, at, row.get::<_, Vec<u8>>(3)?))
        })?;
        let Some((event, at, checksum)) = row else {
            return Ok(None);
        };
        if checksum == event_checksum(self.header_checksum, number, at, &event.kind, &event.text) {
            Ok(Some(event))
        } else {
            Err(self.damaged(format!("event {number}"), "its checksum does not agree"))
        }
    }

    /// The measuring settings of an id.
    pub(super) fn settings(&self, id: i64) -> Result<Settings, LogbookError> {
        let sql = "SELECT protocol_hash, current_a, range_v, nplc, settle_ns, wiring, precautions, checksum FROM settings
                   WHERE id = ?1";
        let row = self.one_row(sql, [id], "read the settings of", |row| {
            let precautions: String = row.get(6)?;
            let settings = Settings {
                protocol_hash: row.get(0)?,
                current: Amps(row.get(1)?),
                range: Volts(row.get(2)?),
                nplc: row.get(3)?,
                settle: Duration::from_nanos(row.get::<_, i64>(4)?.max(0) as u64),
                wiring: row.get(5)?,
                // the checksum detects damage
                precautions: serde_json::from_str(&precautions).unwrap_or_default(),
            };
            Ok((settings, row.get::<_, Vec<u8>>(7)?))
        })?;
        let place = || format!("settings {id}");
        let Some((settings, checksum)) = row else {
            return Err(self.damaged(place(), "they are not there"));
        };
        if checksum != settings_checksum(self.header_checksum, id, &settings) {
            return Err(self.damaged(place(), "their checksum does not agree"));
        }
        Ok(settings)
    }
}
