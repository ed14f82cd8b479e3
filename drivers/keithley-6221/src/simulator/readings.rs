//! Readings (none exist without a 2182A) and their format.

use super::Simulator6221;

/// Bytes free and used in the buffer.
pub(super) const FREE: &str = "2097152,0";

impl Simulator6221 {
    pub(super) fn read_elements(&self) -> String {
        let words: Vec<String> = self.elements.iter().map(ToString::to_string).collect();
        words.join(",")
    }
}
