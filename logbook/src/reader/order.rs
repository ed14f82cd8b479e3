//! Rows of frames as they lie in the file, whatever their numbers: damage may have put one where nobody looks for it.

use super::SessionReader;
use crate::LogbookError;

/// No row of a frame is smaller than so many bytes, so a file of some size has no more of them than that.
pub(crate) const SMALLEST: i64 = 20;

/// How many numbers are reported.
const MOST_REPORTED: usize = 5;

impl SessionReader {
    /// Sequence of the last frame; of a session without frames one less than its first will have.
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
            // None below the first was ever written: what lies last is damaged, and those before it are looked through.
            None => self
                .scan("max(sequence)")
                .map(|last| whole(last).unwrap_or(none)),
        }
    }

    /// The number of the row that lies last.
    pub(crate) fn last_row(&self) -> Result<Option<i64>, LogbookError> {
        self.frame_number("SELECT max(sequence) FROM frame", [])
    }

    /// Rows of frames, those that no number leads to among them.
    pub(crate) fn rows(&self) -> Result<u64, LogbookError> {
        self.scan("count(*)")
            .map(|rows| rows.unwrap_or(0).unsigned_abs())
    }

    /// Of all rows, one after the other; no more than the file has room for, where a forged one leads round in circles.
    fn scan(&self, what: &str) -> Result<Option<i64>, LogbookError> {
        let sql = format!("SELECT {what} FROM (SELECT sequence FROM frame LIMIT ?1)");
        self.frame_number(&sql, [self.most_rows()])
    }

    /// Rows that the file has room for.
    pub(super) fn most_rows(&self) -> i64 {
        self.bytes()
            .map_or(0, |bytes| (bytes / SMALLEST as u64) as i64)
    }

    fn frame_number(
        &self,
        sql: &str,
        values: impl rusqlite::Params,
    ) -> Result<Option<i64>, LogbookError> {
        self.ask()
            .query_row(sql, values, |row| row.get(0))
            .map_err(|source| LogbookError::reading(&self.path, "count the frames of", source))
    }

    /// What is to be said of rows that were not met although they are there; `None` where all were.
    pub(crate) fn unmet(&self, rows: u64, met: u64) -> Option<String> {
        let unmet = rows.checked_sub(met).filter(|unmet| *unmet > 0)?;
        let numbers = match self.out_of_order() {
            Ok(numbers) if !numbers.is_empty() => {
                let numbers: Vec<String> = numbers.iter().map(i64::to_string).collect();
                format!(
                    "; numbers that no frame has in their place: {}",
                    numbers.join(", ")
                )
            }
            _ => String::new(),
        };
        Some(format!(
            "{unmet} of {rows} rows of frames cannot be read in order{numbers}"
        ))
    }

    /// Numbers below the first frame's, or not above the one before; some of them.
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
