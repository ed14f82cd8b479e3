//! Rows of quantities of a session, in a file next to it: one line for each minute, appended when the minute ends.
//!
//! They are derived from the frames and can be computed again. A line consists of the first 8 hexadecimal digits of
//! the SHA-256 of its JSON, a space, and the JSON. A line that does not match its checksum, such as a partly written
//! last line, is skipped and counted as damaged.

use std::path::{Path, PathBuf};

use crate::LogbookError;
use crate::files::lines::{append_line, open_for_lines};
use crate::states::checksum;

/// End of the name of the file.
pub(crate) const QUANTITIES: &str = "quantities";
/// Digits of the checksum.
const DIGITS: usize = 8;

/// The file with the quantities of a session.
pub fn quantities_file(dir: &Path, id: &str) -> PathBuf {
    dir.join(id).with_extension(QUANTITIES)
}

/// Appends a line of JSON to the rows of this session.
///
/// # Errors
/// A disk error.
pub fn append_quantities(dir: &Path, id: &str, json: &str) -> Result<(), LogbookError> {
    let path = quantities_file(dir, id);
    let line = format!("{} {json}", &checksum(json)[..DIGITS]);
    let append = open_for_lines(&path).and_then(|mut file| append_line(&mut file, line.as_bytes()));
    append.map_err(|source| LogbookError::disk(&path, "write the quantities to", source))
}

/// A line of quantities.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QuantityLine {
    /// Number of the line in the file, from 1. Lines are only appended, so it stays the same.
    pub number: u64,
    /// Its JSON.
    pub json: String,
}

/// The quantities of a session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QuantityLines {
    /// The intact lines, in the order of writing.
    pub lines: Vec<QuantityLine>,
    /// Number of damaged lines.
    pub damaged: usize,
}

/// The quantities of this session; `None` if there is no file.
///
/// # Errors
/// A file that cannot be read.
pub fn quantity_lines(dir: &Path, id: &str) -> Result<Option<QuantityLines>, LogbookError> {
    let path = quantities_file(dir, id);
    let text = match std::fs::read(&path) {
        Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
        Err(absent) if absent.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(LogbookError::disk(&path, "read the quantities of", source)),
    };
    let (mut lines, mut damaged) = (Vec::new(), 0);
    for (number, line) in (1..).zip(text.lines()) {
        match line.split_once(' ') {
            Some((sum, json)) if sum == &checksum(json)[..DIGITS] => lines.push(QuantityLine {
                number,
                json: json.to_owned(),
            }),
            _ => damaged += 1,
        }
    }
    Ok(Some(QuantityLines { lines, damaged }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_appended_and_damaged_ones_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        assert_eq!(quantity_lines(dir, "m1").unwrap(), None);
        append_quantities(dir, "m1", "{\"a\":1}").unwrap();
        append_quantities(dir, "m1", "{\"a\":2}").unwrap();
        let file = dir.join("m1.quantities");
        let whole = std::fs::read_to_string(&file).unwrap();
        // a power cut in the second line, then a third one
        std::fs::write(&file, &whole[..whole.len() - 3]).unwrap();
        append_quantities(dir, "m1", "{\"a\":3}").unwrap();
        let found = quantity_lines(dir, "m1").unwrap().unwrap();
        let lines: Vec<_> = found
            .lines
            .iter()
            .map(|line| (line.number, line.json.as_str()))
            .collect();
        assert_eq!(lines, [(1, "{\"a\":1}"), (3, "{\"a\":3}")]);
        assert_eq!(found.damaged, 1);
    }
}
