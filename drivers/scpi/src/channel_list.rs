//! Channel lists: `(@1001,1003:1010)`.

use std::fmt;
use std::str::FromStr;

use crate::ParseError;

/// One item of a channel list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ChannelEntry {
    /// One channel.
    One(u32),
    /// From one channel to another. Which channels lie between depends on the instrument.
    Range(u32, u32),
}

/// A channel list as written. Ranges are kept as ranges, because which channels they contain depends on the instrument.
///
/// ```
/// let list: scpi::ChannelList = "(@1001, 1003:1010)".parse()?;
/// assert_eq!(list.to_string(), "(@1001,1003:1010)");
/// # Ok::<(), scpi::ParseError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct ChannelList {
    entries: Vec<ChannelEntry>,
}

impl ChannelList {
    /// A list of single channels, without ranges.
    pub fn of(channels: impl IntoIterator<Item = u32>) -> Self {
        channels.into_iter().map(ChannelEntry::One).collect()
    }

    /// The items in the order written.
    pub fn entries(&self) -> &[ChannelEntry] {
        &self.entries
    }

    /// Whether this is the empty list `(@)`.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }
}

impl FromIterator<ChannelEntry> for ChannelList {
    fn from_iter<I: IntoIterator<Item = ChannelEntry>>(entries: I) -> Self {
        Self {
            entries: entries.into_iter().collect(),
        }
    }
}

impl fmt::Display for ChannelList {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("(@")?;
        for (k, entry) in self.entries.iter().enumerate() {
            if k > 0 {
                f.write_str(",")?;
            }
            match entry {
                ChannelEntry::One(channel) => write!(f, "{channel}")?,
                ChannelEntry::Range(first, last) => write!(f, "{first}:{last}")?,
            }
        }
        f.write_str(")")
    }
}

impl FromStr for ChannelList {
    type Err = ParseError;

    fn from_str(text: &str) -> Result<Self, ParseError> {
        let inside = text
            .trim()
            .strip_prefix('(')
            .and_then(|rest| rest.trim_start().strip_prefix('@'))
            .and_then(|rest| rest.strip_suffix(')'))
            .ok_or(ParseError::InvalidExpression)?;
        if inside.trim().is_empty() {
            return Ok(Self::default());
        }
        inside.split(',').map(entry).collect()
    }
}

fn entry(text: &str) -> Result<ChannelEntry, ParseError> {
    match text.split_once(':') {
        Some((first, last)) => Ok(ChannelEntry::Range(channel(first)?, channel(last)?)),
        None => channel(text).map(ChannelEntry::One),
    }
}

fn channel(text: &str) -> Result<u32, ParseError> {
    let digits = text.trim();
    // `u32::from_str` accepts a plus sign, which a channel number must not have.
    if digits.is_empty() || !digits.bytes().all(|b| b.is_ascii_digit()) {
        return Err(ParseError::InvalidExpression);
    }
    digits.parse().map_err(|_| ParseError::InvalidExpression)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_come_and_go_as_text() {
        for text in ["(@)", "(@1001)", "(@1001,1002)", "(@1001:1026,2911)"] {
            assert_eq!(text.parse::<ChannelList>().unwrap().to_string(), text);
        }
        assert!("(@)".parse::<ChannelList>().unwrap().is_empty());
        assert_eq!(ChannelList::of([1001, 1002]).to_string(), "(@1001,1002)");
    }

    #[test]
    fn what_is_no_list_is_refused() {
        for text in [
            "",
            "()",
            "(@",
            "@1001",
            "(@1001,)",
            "(@a)",
            "(@+1)",
            "(@1:2:3)",
            "(@1 2)",
            "(@99999999999)",
        ] {
            assert_eq!(
                text.parse::<ChannelList>(),
                Err(ParseError::InvalidExpression),
                "{text}"
            );
        }
    }
}
