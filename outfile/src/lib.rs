//! Writes the output files of commands.
//!
//! Every command with an output writes it through this crate, so that one set of rules holds everywhere:
//!
//! - An existing regular file is refused unless the user gives `--force`, even if an earlier run of the same command
//!   made it.
//! - A recorded session (any SQLite database, any name of a session file) is refused with `--force` too.
//! - A character device, a FIFO and the standard streams are written to; they are never replaced. Block devices,
//!   sockets and folders are refused.
//! - A file appears under its name whole or not at all: it is written to a temporary file with an unpredictable name in
//!   the same folder (`O_EXCL`), synced, and then renamed. Without `--force` the rename fails if the name exists.
//! - A symbolic link is replaced and not followed. A path through a link that another user made in a folder that
//!   everybody may write to is refused.
//!
//! ```
//! use outfile::Existing;
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("frames.csv");
//! outfile::write(&path, Existing::Refuse, b"1,2\n")?;
//! assert!(outfile::write(&path, Existing::Refuse, b"3,4\n").is_err());
//! outfile::write(&path, Existing::Replace, b"3,4\n")?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[cfg(feature = "arguments")]
mod arguments;
mod check;
mod folder;
mod path;
#[cfg(feature = "trial")]
pub mod trial;
mod writing;

use std::path::{Path, PathBuf};

#[cfg(feature = "arguments")]
pub use arguments::{check_arguments, outputs_of};
pub use check::{check, check_folder, folder_of, is_stream};
pub use folder::NewFolder;
pub use path::{GrowingFolder, OutFolder, OutPath};
pub use writing::{OutFile, create_in_place, finish_all, make_folder, remove, write};

/// What to do with an existing regular file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Existing {
    /// The file is kept, and the command fails.
    Refuse,
    /// The file is replaced: the user gave `--force`, or the file belongs to the program.
    Replace,
}

impl Existing {
    /// [`Existing::Replace`] if the user gave `--force`.
    pub fn forced(force: bool) -> Self {
        if force { Self::Replace } else { Self::Refuse }
    }
}

/// Why a file is not written.
#[derive(Debug, thiserror::Error)]
pub enum OutFileError {
    /// The file exists.
    #[error("{} exists already: name another file, or replace it by --force if the command has this option", .0.display())]
    Exists(PathBuf),
    /// The folder contains files.
    #[error("folder {} is not empty: name a new one, or write into it by --force if the command has this option", .0.display())]
    NotEmpty(PathBuf),
    /// The file is a recorded session or another database.
    #[error("{} is a database, as recorded sessions are, and is never overwritten: name another file", .0.display())]
    Session(PathBuf),
    /// The name is reserved for session files.
    #[error("{} has the name of a recorded session or of a part of one (.tactus): give the file another ending", .0.display())]
    SessionName(PathBuf),
    /// The path is a folder.
    #[error("{} is a folder: name a file in it", .0.display())]
    Folder(PathBuf),
    /// The path of the folder is a file.
    #[error("{} is not a folder: name another one", .0.display())]
    NotFolder(PathBuf),
    /// A block device or a socket.
    #[error("{} is a block device or a socket, which is never written to: name a file", .0.display())]
    Special(PathBuf),
    /// A link or FIFO of another user in a folder that everybody may write to.
    #[error(
        "{} leads through {}, a link or FIFO that another user made in a folder where everybody may write: name the target itself",
        .path.display(), .link.display()
    )]
    Foreign {
        /// The requested path.
        path: PathBuf,
        /// The untrusted link.
        link: PathBuf,
    },
    /// The system refuses the write.
    #[error("{} cannot be written", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        #[source]
        cause: std::io::Error,
    },
}

impl OutFileError {
    /// Wraps an error of the system about a file.
    fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |cause| Self::Io { path, cause }
    }

    /// Converts to an I/O error.
    pub fn into_io(self) -> std::io::Error {
        use std::io::ErrorKind::{AlreadyExists, InvalidInput};
        match self {
            // the caller names the file
            Self::Io { cause, .. } => cause,
            Self::Exists(_) | Self::NotEmpty(_) => std::io::Error::new(AlreadyExists, self),
            _ => std::io::Error::new(InvalidInput, self),
        }
    }
}
