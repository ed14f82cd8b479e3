//! The error queue of SCPI-99 volume 2, section 21.8: first in first out; when full, the newest entry becomes -350.

use std::collections::VecDeque;
use std::fmt;
use std::str::FromStr;

use crate::{ParseError, ReplyError, quote, unquote};

/// One entry, in the form of the reply to `SYST:ERR?`: `-113,"Undefined header"`. Number 0 means that the queue is
/// empty.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ErrorEntry {
    /// The number: negative for errors of the standard, positive for errors of the instrument, 0 for none.
    pub code: i32,
    /// The text, without quotes.
    pub message: String,
}

impl ErrorEntry {
    /// Creates an entry from its number and its text without quotes.
    pub fn new(code: i32, message: impl Into<String>) -> Self {
        Self {
            code,
            message: message.into(),
        }
    }

    /// The entry that an empty queue returns.
    pub fn none() -> Self {
        Self::new(0, "No error")
    }
}

impl std::error::Error for ErrorEntry {}

impl From<ParseError> for ErrorEntry {
    fn from(refusal: ParseError) -> Self {
        Self::new(refusal.code(), refusal.text())
    }
}

impl fmt::Display for ErrorEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{}", self.code, quote(&self.message))
    }
}

impl FromStr for ErrorEntry {
    type Err = ReplyError;

    /// Parses the reply to `SYST:ERR?`, with or without a plus sign.
    fn from_str(text: &str) -> Result<Self, ReplyError> {
        let no_entry = || ReplyError::new(text, "an error entry such as 0,\"No error\"");
        let (code, message) = text.split_once(',').ok_or_else(no_entry)?;
        Ok(Self {
            code: code.trim().parse().map_err(|_| no_entry())?,
            message: unquote(message.trim()).ok_or_else(no_entry)?,
        })
    }
}

/// A bounded queue of errors.
///
/// ```
/// let mut queue = scpi::ErrorQueue::new(10);
/// queue.push(-113, "Undefined header");
/// assert_eq!(queue.pop().to_string(), "-113,\"Undefined header\"");
/// assert_eq!(queue.pop().to_string(), "0,\"No error\"");
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ErrorQueue {
    depth: usize,
    entries: VecDeque<ErrorEntry>,
    added: u64,
    latest: Option<ErrorEntry>,
}

impl ErrorQueue {
    /// An empty queue for `depth` entries, at least one.
    pub fn new(depth: usize) -> Self {
        Self {
            depth: depth.max(1),
            entries: VecDeque::new(),
            added: 0,
            latest: None,
        }
    }

    /// Adds an entry. When the queue is full its newest entry is replaced by -350.
    pub fn push(&mut self, code: i32, message: impl Into<String>) {
        let entry = ErrorEntry::new(code, message);
        self.added += 1;
        self.latest = Some(entry.clone());
        if self.entries.len() < self.depth {
            self.entries.push_back(entry);
        } else if let Some(newest) = self.entries.back_mut() {
            *newest = ParseError::QueueOverflow.into();
        }
    }

    /// Takes the oldest entry, or [`ErrorEntry::none`].
    pub fn pop(&mut self) -> ErrorEntry {
        self.entries.pop_front().unwrap_or_else(ErrorEntry::none)
    }

    /// Total number of entries added so far, including those added to a full queue. Reading it removes nothing.
    pub fn added(&self) -> u64 {
        self.added
    }

    /// The entry added last, even if the queue was full or the entry has been taken since. Reading it removes nothing.
    pub fn latest(&self) -> Option<&ErrorEntry> {
        self.latest.as_ref()
    }

    /// Number of entries in the queue.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether the queue is empty.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Removes all entries.
    pub fn clear(&mut self) {
        self.entries.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overflow_replaces_the_newest_and_keeps_the_oldest() {
        let mut queue = ErrorQueue::new(3);
        for code in [-101, -102, -103, -104, -108] {
            queue.push(code, "x");
        }
        assert_eq!(queue.len(), 3);
        assert_eq!(queue.added(), 5);
        assert_eq!(queue.latest().map(|entry| entry.code), Some(-108));
        let codes: Vec<i32> = (0..4).map(|_| queue.pop().code).collect();
        assert_eq!(codes, [-101, -102, -350, 0]);
    }

    #[test]
    fn entries_come_and_go_as_text() {
        for text in [
            "0,\"No error\"",
            "-113,\"Undefined header;it said \"\"X\"\"\"",
        ] {
            assert_eq!(text.parse::<ErrorEntry>().unwrap().to_string(), text);
        }
        assert_eq!("+0,\"No error\"".parse::<ErrorEntry>().unwrap().code, 0);
        assert!("1.0".parse::<ErrorEntry>().is_err());
        assert!("0,No error".parse::<ErrorEntry>().is_err());
    }
}
