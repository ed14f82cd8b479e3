//! Scans frame rows in physical order, because damage may have changed their numbers.

use super::SessionReader;
use crate::LogbookError;

/// Smallest size of a frame's row in bytes; bounds the number of rows in a file.
pub(crate) const SMALLEST: i64 = 20;

/// Maximum number of row numbers reported.
const MOST_REPORTED: usize = 5;

impl SessionReader {
    /// Sequence of the last frame; without frames, one less than the first sequence.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn last_sequence(&self) -> Result<u64, LogbookError> {
        let first = self.header.first_sequence;
        let none = first.saturating_sub(1);
        let whole = |last: Option<i64>| {
            let last = last.and_then(|last| u64::try_from(last).ok());
            last.filter(|last| *last >= first)
        };
        let last = self.last_row()?;
        if last.is_none() {
            return Ok(none);
        }
        match whole(last) {
            Some(last) => Ok(last),
            // Numbers below the first were never written: the physically last row is damaged, so the rows before it are
            // searched.
            None => self
                .scan("max(sequence)")
                .map(|last| whole(last).unwrap_or(none)),
        }
    }

    /// The number of the physically last row.
    pub(crate) fn last_row(&self) -> Result<Option<i64>, LogbookError> {
        self.one_number("SELECT max(sequence) FROM frame", [], "count the frames of")
    }

    /// Number of frame rows, including those that cannot be reached by their sequence.
    pub(crate) fn rows(&self) -> Result<u64, LogbookError> {
        self.scan("count(*)")
            .map(|rows| rows.unwrap_or(0).unsigned_abs())
    }

    /// Runs an aggregate over all rows, at most as many as fit in the file, since a forged file may loop.
    fn scan(&self, what: &str) -> Result<Option<i64>, LogbookError> {
        let sql = format!("SELECT {what} FROM (SELECT sequence FROM frame LIMIT ?1)");
        self.one_number(&sql, [self.most_rows()], "count the frames of")
    }

    /// Upper bound of the number of rows in the file.
    pub(super) fn most_rows(&self) -> i64 {
        self.bytes()
            .map_or(0, |bytes| (bytes / SMALLEST as u64) as i64)
    }

    /// Describes rows that exist but were not reached; `None` if all were.
    pub(crate) fn unmet(&self, rows: u64, met: u64) -> Option<String> {
        let unmet = rows.checked_sub(met).filter(|unmet| *unmet > 0)?;
        let numbers = match self.out_of_order() {
            Ok(numbers) if !numbers.is_empty() => {
                let numbers: Vec<String> = numbers.iter().map(i64::to_string).collect();
                format!("; frame numbers out of order: {}", numbers.join(", "))
            }
            _ => String::new(),
        };
        Some(format!(
            "{unmet} of {rows} rows of frames cannot be read in order{numbers}"
        ))
    }

    /// Some row numbers that are below the first frame's, or not above their predecessor.
    fn out_of_order(&self) -> rusqlite::Result<Vec<i64>> {
        let mut statement = self.ask().prepare("SELECT sequence FROM frame")?;
        let mut rows = statement.query([])?;
        let (mut before, mut found) = (self.header.first_sequence as i64 - 1, Vec::new());
        while let Some(row) = rows.next()? {
            let number = row.get(0)?;
            if number > before {
                before = number;
            } else {
                found.push(number);
                if found.len() == MOST_REPORTED {
                    break;
                }
            }
        }
        Ok(found)
    }
}
