//! The identity of a shard, and its share of the work.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

/// Maximum number of shards: more than any scheduler accepts in one array.
const MOST: usize = 1_000_000;

/// One of `of` nearly equal, consecutive parts of a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    of: usize,
}

impl Shard {
    /// The only shard of undivided work.
    pub const WHOLE: Self = Self { index: 0, of: 1 };

    /// Every shard of a division.
    pub fn all(of: usize) -> impl Iterator<Item = Self> {
        (0..of).map(move |index| Self { index, of })
    }

    /// The number of the shard, from 0.
    pub fn index(self) -> usize {
        self.index
    }

    /// Number of shards.
    pub fn of(self) -> usize {
        self.of
    }

    /// The indices of its items in a list of this length. Each item belongs to exactly one of the `of` shards.
    pub fn items(self, length: usize) -> Range<usize> {
        length * self.index / self.of..length * (self.index + 1) / self.of
    }

    /// Name of its files, without extension: `shard-2-of-8`.
    pub fn name(self) -> String {
        format!("shard-{}-of-{}", self.index, self.of)
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.split_once('/')
            .and_then(|(index, of)| {
                Some(Self {
                    index: index.parse().ok()?,
                    of: of.parse().ok()?,
                })
            })
            .filter(|shard| shard.index < shard.of && shard.of <= MOST)
            .ok_or_else(|| {
                format!("I/N is expected with I from 0 to N - 1, and N at most {MOST}, e.g. 0/4")
            })
    }
}

/// Parses a number of shards.
///
/// # Errors
/// A message with the permitted range.
pub fn parse_count(text: &str) -> Result<usize, String> {
    text.parse()
        .ok()
        .filter(|count| (1..=MOST).contains(count))
        .ok_or_else(|| format!("a number of shards from 1 to {MOST} is expected, e.g. 40"))
}

/// Ascending numbers in the form of `sbatch --array`: `0,3,7-9`.
///
/// ```
/// assert_eq!(shards::missing_list(&[0, 3, 7, 8, 9]), "0,3,7-9");
/// ```
pub fn missing_list(numbers: &[usize]) -> String {
    let runs = numbers.chunk_by(|one, next| one + 1 == *next);
    let texts: Vec<String> = runs
        .map(|run| match run {
            [first, .., last] => format!("{first}-{last}"),
            _ => run[0].to_string(),
        })
        .collect();
    texts.join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_are_read_as_part_of_whole() {
        assert_eq!("2/3".parse(), Ok(Shard { index: 2, of: 3 }));
        for wrong in ["3/3", "1", "a/b", "-1/2", "0/0", "0/1000001", "1/2/3", ""] {
            let refusal = wrong.parse::<Shard>().unwrap_err();
            assert!(refusal.contains("from 0 to N - 1"), "{wrong}");
        }
        assert!(parse_count("0").is_err() && parse_count("x").is_err());
        assert_eq!(parse_count("40"), Ok(40));
    }

    #[test]
    fn shards_cover_every_item_once() {
        for length in [0, 1, 7, 100] {
            for of in [1, 3, 8, 120] {
                let all: Vec<usize> = Shard::all(of)
                    .flat_map(|shard| shard.items(length))
                    .collect();
                assert_eq!(all, (0..length).collect::<Vec<_>>());
            }
        }
    }

    #[test]
    fn lists_have_the_form_of_a_slurm_array() {
        for (numbers, text) in [
            (&[][..], ""),
            (&[5], "5"),
            (&[0, 1], "0-1"),
            (&[0, 3, 7, 8, 9, 11], "0,3,7-9,11"),
        ] {
            assert_eq!(missing_list(numbers), text);
        }
    }
}
