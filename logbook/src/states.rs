//! States that a later daemon continues from, in files next to the sessions. A state is replaced as a whole; a
//! damaged one is an error.

use std::path::{Path, PathBuf};

use outfile::Existing;
use sha2::{Digest, Sha256};

use crate::LogbookError;

/// The kinds of state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StateKind {
    /// A tracked baseline: for a baseline its latest state, for a session the state at its start.
    Tracking,
    /// The quantities of a session over time.
    Course,
}

impl StateKind {
    /// End of the name of the file.
    pub(crate) fn extension(self) -> &'static str {
        match self {
            Self::Tracking => "tracking",
            Self::Course => "course",
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Tracking => "the tracked baseline",
            Self::Course => "the quantities over time",
        }
    }

    fn path(self, dir: &Path, id: &str) -> PathBuf {
        dir.join(id).with_extension(self.extension())
    }
}

pub(crate) fn checksum(text: &str) -> String {
    survey::hex(&Sha256::digest(text))
}

/// Stores the state of this session or baseline and replaces an earlier one.
///
/// # Errors
/// A disk error; the earlier state is still there.
pub fn keep_state(dir: &Path, id: &str, kind: StateKind, state: &str) -> Result<(), LogbookError> {
    let path = kind.path(dir, id);
    let attempt = match kind {
        StateKind::Tracking => "keep the tracked baseline in",
        StateKind::Course => "keep the quantities over time in",
    };
    let text = format!("{}\n{state}\n", checksum(state));
    outfile::write(&path, Existing::Replace, text.as_bytes())
        .map_err(|refused| LogbookError::disk(&path, attempt, refused.into_io()))
}

/// The state of this session or baseline; `None` if there is none.
///
/// # Errors
/// A file that cannot be read or is damaged.
pub fn kept_state(dir: &Path, id: &str, kind: StateKind) -> Result<Option<String>, LogbookError> {
    let path = kind.path(dir, id);
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(absent) if absent.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(LogbookError::io(&path, "read", source)),
    };
    let text = std::str::from_utf8(&bytes).ok();
    let whole = text
        .and_then(|text| text.strip_suffix('\n'))
        .and_then(|text| text.split_once('\n'));
    match whole {
        Some((sum, state)) if sum == checksum(state) => Ok(Some(state.to_owned())),
        _ => Err(LogbookError::Damaged {
            path,
            place: kind.words().to_owned(),
            why: "its checksum does not agree".to_owned(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_is_replaced_whole_and_refused_if_damaged() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        let read = || kept_state(dir, "b1", StateKind::Tracking);
        assert_eq!(read().unwrap(), None);
        keep_state(dir, "b1", StateKind::Tracking, "{\"a\": 1}").unwrap();
        keep_state(dir, "b1", StateKind::Course, "7").unwrap();
        keep_state(dir, "b1", StateKind::Tracking, "{\"a\": 2}").unwrap();
        assert_eq!(read().unwrap().as_deref(), Some("{\"a\": 2}"));
        let file = dir.join("b1.tracking");
        let text = std::fs::read_to_string(&file).unwrap();
        for wrong in [
            text.replace('2', "3").into_bytes(),
            text.as_bytes()[..text.len() - 2].to_vec(),
            Vec::new(),
            vec![0xff; 100],
        ] {
            std::fs::write(&file, wrong).unwrap();
            let error = read().unwrap_err();
            assert!(matches!(error, LogbookError::Damaged { .. }), "{error:?}");
            let error = error.to_string();
            assert!(error.contains("b1.tracking"), "{error}");
        }
        let course = kept_state(dir, "b1", StateKind::Course).unwrap();
        assert_eq!(course.as_deref(), Some("7"));
    }
}
