//! States of a tracked baseline, in files beside the sessions: of a baseline the latest one, of a session the one that it began
//! with. A state is replaced as a whole; a damaged one is an error, never another state.

use std::path::{Path, PathBuf};

use outfile::Existing;
use sha2::{Digest, Sha256};

use crate::LogbookError;

/// End of the name of the file.
const TRACKING: &str = "tracking";

fn path(dir: &Path, id: &str) -> PathBuf {
    dir.join(id).with_extension(TRACKING)
}

pub(crate) fn checksum(text: &str) -> String {
    let digest = Sha256::digest(text);
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Keeps the state of this session or baseline, in place of an earlier one.
///
/// # Errors
/// A disk error; the earlier state is still there.
pub fn keep_tracking(dir: &Path, id: &str, state: &str) -> Result<(), LogbookError> {
    let path = path(dir, id);
    let text = format!("{}\n{state}\n", checksum(state));
    outfile::write(&path, Existing::Replace, text.as_bytes()).map_err(|refused| {
        LogbookError::disk(&path, "keep the tracked baseline in", refused.into_io())
    })
}

/// The state of this session or baseline; `None` if there is none.
///
/// # Errors
/// A file that cannot be read or is damaged.
pub fn tracking(dir: &Path, id: &str) -> Result<Option<String>, LogbookError> {
    let path = path(dir, id);
    let text = match std::fs::read_to_string(&path) {
        Ok(text) => text,
        Err(absent) if absent.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(source) => {
            return Err(LogbookError::disk(
                &path,
                "read the tracked baseline of",
                source,
            ));
        }
    };
    let whole = text
        .strip_suffix('\n')
        .and_then(|text| text.split_once('\n'));
    match whole {
        Some((sum, state)) if sum == checksum(state) => Ok(Some(state.to_owned())),
        _ => Err(LogbookError::Damaged {
            path,
            place: "the tracked baseline".to_owned(),
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
        assert_eq!(tracking(dir, "b1").unwrap(), None);
        keep_tracking(dir, "b1", "{\"a\": 1}").unwrap();
        keep_tracking(dir, "b1", "{\"a\": 2}").unwrap();
        assert_eq!(tracking(dir, "b1").unwrap().as_deref(), Some("{\"a\": 2}"));
        let file = dir.join("b1.tracking");
        let text = std::fs::read_to_string(&file).unwrap();
        for wrong in [
            text.replace('2', "3"),
            text[..text.len() - 2].to_owned(),
            String::new(),
        ] {
            std::fs::write(&file, wrong).unwrap();
            let error = tracking(dir, "b1").unwrap_err().to_string();
            assert!(error.contains("b1.tracking"), "{error}");
        }
    }
}
