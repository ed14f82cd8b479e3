//! The store of parts: the name of a part, and the operations of a store.

mod directory;
mod objects;
mod whole_file;

use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::PathBuf;

use serde::Serialize;

pub use directory::Directory;
pub use objects::{BucketAccess, Objects};
pub(crate) use whole_file::unique;
pub use whole_file::{WholeFileError, write_whole};

/// The name of a part in a store: `SITE/DAQ/SESSION/PART.SHA256.tactus`. The hash is that of the content, so a name
/// never identifies two contents.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PartName {
    /// The site.
    pub site: String,
    /// The machine within the site.
    pub daq: String,
    /// The session.
    pub session: String,
    /// The part.
    pub part: String,
    /// SHA-256 of the part, hexadecimal.
    pub sha256: String,
}

impl fmt::Display for PartName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            site,
            daq,
            session,
            part,
            sha256,
        } = self;
        write!(f, "{site}/{daq}/{session}/{part}.{sha256}.tactus")
    }
}

/// What is wrong with the name of a site or a machine; `None` if it can be part of a file name on every system.
pub fn name_fault(name: &str) -> Option<String> {
    let good =
        |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b"_-".contains(&byte);
    let begins = name
        .as_bytes()
        .first()
        .is_some_and(u8::is_ascii_alphanumeric);
    let allowed = begins && name.len() <= 64 && name.bytes().all(good);
    (!allowed).then(|| {
        format!(
            "'{name}' is not a name: use a to z, 0 to 9, _ and -, with a letter or digit first (1 to 64 of them)"
        )
    })
}

/// A part as the store holds it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stored {
    /// Size, bytes.
    pub bytes: u64,
    /// Whether the store held it before.
    pub existed: bool,
}

/// A store of parts. Parts are written once: a store never replaces one.
pub trait Store {
    /// Stores a part, reads it back and compares its hash with that of the name. An existing part is only read back.
    ///
    /// # Errors
    /// The content of the source or of the store does not have the hash of the name; no space; the store cannot be
    /// written.
    fn put(&self, name: &PartName, from: &mut File) -> Result<Stored, StoreError>;

    /// Opens a part for reading.
    ///
    /// # Errors
    /// It is missing, or cannot be read.
    fn open(&self, name: &PartName) -> Result<Box<dyn Read + '_>, StoreError>;

    /// Location of the store, for messages.
    fn place(&self) -> String;
}

/// Errors of a store.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// No space, or no quota.
    #[error("the store {place} is full: free space there; nothing of {name} was kept")]
    Full {
        /// The store.
        place: String,
        /// The part.
        name: String,
        /// Error of the system.
        #[source]
        source: std::io::Error,
    },
    /// The file that was read differs from the one that was hashed.
    #[error(
        "{name}: the file was changed while it was copied (its SHA-256 is now {found}); nothing was kept"
    )]
    SourceChanged {
        /// The part.
        name: String,
        /// Hash of what was read.
        found: String,
    },
    /// The content of the store does not match the hash in the name.
    #[error(
        "{name} in the store {place} is damaged: its SHA-256 is {found}; remove that file, and push the part again from where it was recorded"
    )]
    Altered {
        /// The store.
        place: String,
        /// The part.
        name: String,
        /// Hash of the content of the store.
        found: String,
    },
    /// The store accepts no file of this size.
    #[error(
        "{name} has {bytes} bytes, and the store {place} takes {most} at most: copy this part by other means, and lower record.roll_mb, so that later parts are smaller"
    )]
    TooLarge {
        /// The store.
        place: String,
        /// The part.
        name: String,
        /// Its size, bytes.
        bytes: u64,
        /// The limit, bytes.
        most: u64,
    },
    /// The store lacks the part.
    #[error("{name} is not in the store {place}")]
    Missing {
        /// The store.
        place: String,
        /// The part.
        name: String,
    },
    /// The store does not exist.
    #[error("the store {} does not exist: mount or create it (it is not created, so that an unmounted share is not taken for an empty store)", path.display())]
    NoStore {
        /// The folder.
        path: PathBuf,
    },
    /// The server of a bucket cannot be reached.
    #[error(
        "cannot reach the store {place}; its server may be down, or archive.store_endpoint is the wrong address"
    )]
    Unreachable {
        /// The store.
        place: String,
        /// The cause.
        #[source]
        source: std::io::Error,
    },
    /// The certificate of a bucket's server is not trusted, or it has none.
    #[error(
        "no trusted connection to the store {place}: its certificate must be issued by archive.store_ca for this host name, and the clock of this machine must be right"
    )]
    Untrusted {
        /// The store.
        place: String,
        /// The cause.
        #[source]
        source: std::io::Error,
    },
    /// The server of a bucket refuses.
    #[error(
        "the store {place} refuses {name}: {why} (HTTP {status}); NoSuchBucket: create the bucket; AccessDenied, InvalidAccessKeyId, SignatureDoesNotMatch: correct archive.store_keys_file or the rights of the key"
    )]
    Refused {
        /// The store.
        place: String,
        /// The part.
        name: String,
        /// Status of HTTP.
        status: u16,
        /// The server's error code.
        why: String,
    },
    /// Another error of the system.
    #[error("cannot {attempt} {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was attempted.
        attempt: &'static str,
        /// Error of the system.
        #[source]
        source: std::io::Error,
    },
}

impl StoreError {
    /// Whether the cause is this part, so that the store may accept other parts.
    pub fn is_of_one_part(&self) -> bool {
        matches!(
            self,
            Self::Altered { .. } | Self::SourceChanged { .. } | Self::TooLarge { .. }
        )
    }

    /// Whether a retry may succeed without a change of the configuration or the part.
    pub fn is_temporary(&self) -> bool {
        if let Self::Refused { status, .. } = self {
            // a conflict of two writers, too many requests, a fault of the server
            return matches!(status, 409 | 429 | 500..);
        }
        matches!(
            self,
            Self::Unreachable { .. }
                | Self::Full { .. }
                | Self::NoStore { .. }
                | Self::Io { .. }
                | Self::SourceChanged { .. }
        )
    }
}
