//! Size of a session while it is being written.

use std::path::Path;

use crate::files::{id_of, part_of, path_of};
use crate::{LogbookError, SessionReader};
use outfile::folder_of;

/// Size of the newest part of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Volume {
    /// Its number, from 1.
    pub part: u32,
    /// Bytes of the database; pages in its journal are counted once.
    pub bytes: u64,
    /// Sequence of its last frame.
    pub frames: u64,
}

/// Measures the newest part of a session, given the session's first file. The file sizes are not suitable: the
/// journal contains pages several times, and they are moved to the file a thousand at once.
///
/// # Errors
/// No such file, or it cannot be read.
pub fn volume(path: impl AsRef<Path>) -> Result<Volume, LogbookError> {
    let first = path.as_ref();
    let (session, mut part) = part_of(id_of(first));
    let later = |part: u32| path_of(folder_of(first), &format!("{session}_p{part}"));
    let mut path = first.to_owned();
    // parts are numbered without a gap, except for one that could not be created
    while let Some(next) = (part + 1..part + 3).find(|next| later(*next).exists()) {
        (part, path) = (next, later(next));
    }
    let path = path.as_path();
    let session = SessionReader::open(path)?;
    Ok(Volume {
        part,
        bytes: session.bytes()?,
        frames: session.last_sequence()?,
    })
}

#[cfg(test)]
mod tests {
    use crate::writer::size::*;
    use crate::{SessionHeader, SessionWriter};
    use chrono::DateTime;
    use survey::Protocol;

    #[test]
    fn newest_part_is_readable_while_written() {
        let folder = tempfile::tempdir().unwrap();
        let protocol = Protocol::sheffield(4).unwrap();
        let at = DateTime::UNIX_EPOCH;
        let header = SessionHeader::new("monday", at, protocol);
        let mut writer = SessionWriter::create(folder.path(), &header).unwrap();
        let first = writer.path().to_owned();
        let begun = volume(&first).unwrap();
        assert_eq!((begun.part, begun.frames), (1, 0));
        for _ in 0..200 {
            writer.event(at, "started", &"x".repeat(400)).unwrap();
        }
        let grown = volume(&first).unwrap();
        let by = grown.bytes - begun.bytes;
        assert!((80_000..200_000).contains(&by), "{by}");
        writer.roll(at).unwrap();
        let rolled = volume(&first).unwrap();
        assert!(rolled.part == 2 && rolled.bytes < grown.bytes, "{rolled:?}");
        assert!(volume(folder.path().join("tuesday.tactus")).is_err());
    }
}
