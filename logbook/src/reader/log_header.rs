//! The header of a write-ahead log.
//!
//! It is checked before SQLite reads the log: SQLite takes a damaged header for a writer at work, and tries again for
//! ten seconds at each opening. Format: <https://www.sqlite.org/fileformat.html>, section 4.1.

use std::io::{ErrorKind, Read};
use std::path::Path;

use crate::files::open_at_once;

/// Bytes of the header.
pub(super) const LENGTH: usize = 32;
/// The last bit of the magic number gives the byte order of the checksums.
const MAGIC: u32 = 0x377f_0682;

/// What a log holds, judged by its header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LogHeader {
    /// No log, or one without frames that ends within its header, or whose header was not on the disk when the power
    /// failed. SQLite syncs the header before it writes a frame, so nothing was acknowledged.
    Empty,
    Intact,
    Damaged,
}

/// Reads the header of a log.
pub(super) fn of(log: &Path) -> std::io::Result<LogHeader> {
    let mut header = [0; LENGTH];
    let read = open_at_once(log).and_then(|mut file| {
        file.read_exact(&mut header)?;
        Ok(file.metadata()?.len())
    });
    match read {
        Ok(length) if length == LENGTH as u64 && header == [0; LENGTH] => Ok(LogHeader::Empty),
        Ok(_) if is_intact(&header) => Ok(LogHeader::Intact),
        Ok(_) => Ok(LogHeader::Damaged),
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::UnexpectedEof) => {
            Ok(LogHeader::Empty)
        }
        Err(error) => Err(error),
    }
}

fn is_intact(header: &[u8; LENGTH]) -> bool {
    let (words, _) = header.as_chunks::<4>();
    let magic = u32::from_be_bytes(words[0]);
    let little_endian = magic == MAGIC;
    let (mut first, mut second) = (0_u32, 0_u32);
    for pair in words[..6].chunks_exact(2) {
        let [a, b] = [pair[0], pair[1]].map(|word| match little_endian {
            true => u32::from_le_bytes(word),
            false => u32::from_be_bytes(word),
        });
        first = first.wrapping_add(a).wrapping_add(second);
        second = second.wrapping_add(b).wrapping_add(first);
    }
    let stored = [words[6], words[7]].map(u32::from_be_bytes);
    magic & !1 == MAGIC && stored == [first, second]
}
