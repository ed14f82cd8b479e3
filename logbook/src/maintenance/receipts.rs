//! Receipts of the archive: a file next to a closed part, written when the archive has the part.

use std::io::Read;
use std::path::Path;

use chrono::{DateTime, Utc};
use outfile::Existing;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::LogbookError;
use crate::files::{id_of, part_of};

/// End of the name of a receipt.
const ARCHIVED: &str = "archived.json";

/// The archive's receipt of a part.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ArchiveReceipt {
    /// When the part was read for archiving.
    pub at: DateTime<Utc>,
    /// SHA-256 of the part, hexadecimal, computed from the content of the store.
    pub sha256: String,
    /// Size of the part, bytes.
    pub bytes: u64,
    /// Where the part is in the store.
    pub stored_as: String,
    /// Number of lines of the session's quantities in the archive; 0 for a part that is not the first one in the
    /// folder.
    pub quantity_lines: u64,
}

/// SHA-256 of everything read, hexadecimal, and the number of bytes.
///
/// # Errors
/// It cannot be read.
pub fn sha256_of(mut from: impl Read) -> std::io::Result<(String, u64)> {
    let mut hash = Sha256::new();
    let mut bytes = 0;
    let mut block = vec![0; 1 << 16];
    loop {
        let read = match from.read(&mut block) {
            Ok(0) => break,
            Ok(read) => read,
            Err(cause) if cause.kind() == std::io::ErrorKind::Interrupted => continue,
            Err(cause) => return Err(cause),
        };
        hash.update(&block[..read]);
        bytes += read as u64;
    }
    Ok((survey::hex(&hash.finalize()), bytes))
}

/// Writes the receipt of a part next to it.
///
/// # Errors
/// It cannot be written.
pub fn mark_archived(path: impl AsRef<Path>, receipt: &ArchiveReceipt) -> Result<(), LogbookError> {
    let mark = path.as_ref().with_extension(ARCHIVED);
    let text = serde_json::to_string(receipt).unwrap_or_default() + "\n";
    outfile::write(&mark, Existing::Replace, text.as_bytes())
        .map_err(|refused| LogbookError::disk(&mark, "write the receipt", refused.into_io()))
}

/// The receipt next to a part; `None` if there is none. Does not check that it matches the present file; see
/// [`archived`].
pub fn receipt(path: impl AsRef<Path>) -> Option<ArchiveReceipt> {
    let text = std::fs::read_to_string(path.as_ref().with_extension(ARCHIVED)).ok()?;
    serde_json::from_str(&text).ok()
}

/// The receipt of a part, if the archive has the present content of the part and, for the first part in the folder,
/// all stored quantities of the session. Reads the whole part.
pub fn archived(path: impl AsRef<Path>) -> Option<ArchiveReceipt> {
    let path = path.as_ref();
    let receipt = receipt(path)?;
    let (sha256, bytes) = sha256_of(std::fs::File::open(path).ok()?).ok()?;
    let parts = crate::parts(path).ok()?;
    let lines = match parts.first()?.file_name() == path.file_name() {
        true => {
            let session = part_of(id_of(path)).0;
            let beside = crate::quantity_lines(outfile::folder_of(path), session).ok()?;
            beside.map_or(0, |found| found.lines.last().map_or(0, |last| last.number))
        }
        false => 0,
    };
    (sha256 == receipt.sha256 && bytes == receipt.bytes && lines <= receipt.quantity_lines)
        .then_some(receipt)
}
