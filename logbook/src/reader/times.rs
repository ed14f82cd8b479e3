//! Times of frames, without their readings.

use std::collections::VecDeque;

use chrono::{DateTime, Utc};
use rusqlite::params;

use super::{SessionReader, microseconds, wall};
use crate::{LogbookError, Taken};

/// Number of times fetched at once.
const PAGE: u32 = 1024;

impl SessionReader {
    /// Number and wall time of each frame from `last` back to `first`. The checksums are not verified, because they
    /// include the readings: read the frame to be certain of its time.
    pub fn wall_times_back(
        &self,
        first: u64,
        last: u64,
    ) -> impl Iterator<Item = Result<(u64, DateTime<Utc>), LogbookError>> {
        let mut page = VecDeque::new();
        let mut next = Some(i64::try_from(last).unwrap_or(i64::MAX));
        std::iter::from_fn(move || {
            if page.is_empty()
                && let Some(from) = next.take()
            {
                match self.wall_times(first as i64, from) {
                    Ok(times) => page = times,
                    Err(error) => return Some(Err(error)),
                }
                // In a damaged file, rows out of order could be repeated for ever.
                let behind = page.back().map(|(sequence, _)| sequence - 1);
                next = behind.filter(|behind| *behind < from);
            }
            let (sequence, wall_us) = page.pop_front()?;
            Some(Ok((sequence as u64, wall(wall_us))))
        })
    }

    fn wall_times(&self, first: i64, last: i64) -> Result<VecDeque<(i64, i64)>, LogbookError> {
        let read = || {
            self.ask()
                .prepare_cached(
                    // as Stretch::times; the columns are stored before the readings, which are therefore not read
                    "SELECT frame.sequence, stretch.wall_us + tick_us + skew_us
                         + (frame.sequence - stretch.sequence) * period_us
                     FROM frame CROSS JOIN stretch ON stretch.id = frame.stretch
                     WHERE frame.sequence BETWEEN ?1 AND ?2 ORDER BY frame.sequence DESC LIMIT ?3",
                )?
                .query_map(params![first, last, PAGE], |row| {
                    Ok((row.get(0)?, row.get(1)?))
                })?
                .collect::<rusqlite::Result<_>>()
        };
        read().map_err(|source| LogbookError::reading(&self.path, "read the times of", source))
    }

    /// When the last frame was taken, even if its readings are damaged.
    pub(crate) fn last_taken(&self) -> Result<Option<Taken>, LogbookError> {
        self.taken(self.last_sequence()?)
    }

    /// When a frame was taken, even if its readings are damaged.
    pub(crate) fn taken(&self, sequence: u64) -> Result<Option<Taken>, LogbookError> {
        let Some(row) = self.row(sequence)? else {
            return Ok(None);
        };
        // Without its stretch the time is unknown.
        let Ok((stretch, _)) = self.stretch(sequence as i64, row.row.stretch) else {
            return Ok(None);
        };
        let (monotonic_us, wall_us) = stretch.times(&row.row);
        Ok(Some(Taken {
            wall: wall(wall_us),
            monotonic: microseconds(monotonic_us),
        }))
    }

    /// Numbers of the frames with which stretches begin, between two frames, ascending. The first frame of each process
    /// is one of them.
    pub(crate) fn stretch_starts(&self, first: u64, last: u64) -> Result<Vec<u64>, LogbookError> {
        let read = || {
            self.ask()
                .prepare(
                    "SELECT DISTINCT sequence FROM stretch WHERE sequence BETWEEN ?1 AND ?2
                     ORDER BY sequence LIMIT ?3",
                )?
                .query_map(
                    params![first as i64, last as i64, self.most_rows()],
                    |row| row.get::<_, i64>(0),
                )?
                .map(|sequence| sequence.map(i64::unsigned_abs))
                .collect::<rusqlite::Result<_>>()
        };
        read().map_err(|source| LogbookError::reading(&self.path, "read the stretches of", source))
    }
}
