//! Files that appear under their names completely, or not at all.

use std::fs::{File, Permissions};
use std::io::{BufWriter, ErrorKind, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::{FileExt, PermissionsExt};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::check::{Stream, Target, check_folder, folder_of, open_stream, target};
use crate::{Existing, OutFileError};

/// A file being written. If it is dropped before [`OutFile::finish`], no file remains; a device or FIFO keeps what was
/// written.
#[derive(Debug)]
pub struct OutFile {
    path: PathBuf,
    existing: Existing,
    sink: Sink,
}

#[derive(Debug)]
enum Sink {
    Temporary(BufWriter<NamedTempFile>),
    Stream(BufWriter<File>),
}

impl OutFile {
    /// Starts a file.
    ///
    /// # Errors
    /// See [`OutFileError`].
    pub fn create(path: &Path, existing: Existing) -> Result<Self, OutFileError> {
        let sink = match target(path, existing)? {
            Target::Stream(stream) => Sink::Stream(BufWriter::new(open(path, stream)?)),
            Target::New | Target::Replaced => Sink::Temporary(BufWriter::new(
                temporary(path).map_err(OutFileError::io(path))?,
            )),
        };
        Ok(Self {
            path: path.to_owned(),
            existing,
            sink,
        })
    }

    /// Writes, with the file's name in the error.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn put(&mut self, bytes: &[u8]) -> Result<(), OutFileError> {
        self.write_all(bytes).map_err(OutFileError::io(&self.path))
    }

    /// Replaces bytes that were written, for formats whose first bytes depend on what follows (a number of records).
    ///
    /// # Errors
    /// A disk error, or a device or FIFO, whose bytes cannot be replaced.
    pub fn put_at(&mut self, offset: u64, bytes: &[u8]) -> Result<(), OutFileError> {
        let replaced = match &mut self.sink {
            Sink::Temporary(writer) => writer
                .flush()
                .and_then(|()| writer.get_ref().as_file().write_all_at(bytes, offset)),
            Sink::Stream(_) => Err(ErrorKind::Unsupported.into()),
        };
        replaced.map_err(OutFileError::io(&self.path))
    }

    /// Path of the content until [`OutFile::finish`], for writers that need a path; `None` for a device or FIFO.
    pub fn temporary_path(&self) -> Option<&Path> {
        match &self.sink {
            Sink::Temporary(writer) => Some(writer.get_ref().path()),
            Sink::Stream(_) => None,
        }
    }

    /// Moves the file to its path, durably.
    ///
    /// # Errors
    /// A disk error, or the name has been taken since [`OutFile::create`].
    pub fn finish(self) -> Result<PathBuf, OutFileError> {
        self.complete()?.place()
    }

    /// Writes what is still in memory, and syncs.
    fn complete(mut self) -> Result<CompleteFile, OutFileError> {
        self.flush().map_err(OutFileError::io(&self.path))?;
        let path = self.path;
        let written = match self.sink {
            Sink::Stream(_) => None,
            Sink::Temporary(writer) => {
                let written = writer
                    .into_inner()
                    .map_err(|fault| OutFileError::io(&path)(fault.into_error()))?;
                let synced = written.as_file().sync_all();
                synced.map_err(OutFileError::io(&path))?;
                Some(written)
            }
        };
        Ok(CompleteFile {
            path,
            existing: self.existing,
            written,
        })
    }
}

/// Moves files that belong together to their paths: the first one only when all are complete and no path is refused, so
/// that a full disk or a taken name does not mix them with files of an earlier output. Only an error of a rename itself
/// leaves some of them replaced.
///
/// # Errors
/// As [`OutFile::finish`].
pub fn finish_all(files: Vec<OutFile>) -> Result<Vec<PathBuf>, OutFileError> {
    let files = files.into_iter().map(OutFile::complete);
    let files = files.collect::<Result<Vec<_>, _>>()?;
    for file in &files {
        file.destination()?;
    }
    files.into_iter().map(CompleteFile::place).collect()
}

/// A file whose content is complete and on disk, under its temporary name; `written` is `None` for a device or FIFO.
struct CompleteFile {
    path: PathBuf,
    existing: Existing,
    written: Option<NamedTempFile>,
}

impl CompleteFile {
    /// What the path is now: another kind of file may have the name since [`OutFile::create`]. `None` for a device or
    /// FIFO, which has been written to.
    fn destination(&self) -> Result<Option<Target>, OutFileError> {
        if self.written.is_none() {
            return Ok(None);
        }
        match target(&self.path, self.existing)? {
            Target::Stream(_) => Err(OutFileError::Exists(self.path.clone())),
            target => Ok(Some(target)),
        }
    }

    fn place(self) -> Result<PathBuf, OutFileError> {
        let destination = self.destination()?;
        let path = self.path;
        let Some((written, destination)) = self.written.zip(destination) else {
            return Ok(path);
        };
        let placed = match destination {
            Target::Replaced => written.persist(&path),
            _ => written.persist_noclobber(&path),
        };
        placed.map_err(|fault| match fault.error.kind() {
            ErrorKind::AlreadyExists => OutFileError::Exists(path.clone()),
            _ => OutFileError::io(&path)(fault.error),
        })?;
        // not every file system can sync a folder; the file itself is on disk
        let _unsynced = File::open(folder_of(&path)).and_then(|folder| folder.sync_all());
        Ok(path)
    }
}

impl Write for OutFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        match &mut self.sink {
            Sink::Temporary(writer) => writer.write(bytes),
            Sink::Stream(writer) => writer.write(bytes),
        }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        match &mut self.sink {
            Sink::Temporary(writer) => writer.flush(),
            Sink::Stream(writer) => writer.flush(),
        }
    }
}

/// Writes a whole file.
///
/// # Errors
/// See [`OutFileError`].
pub fn write(path: &Path, existing: Existing, bytes: &[u8]) -> Result<(), OutFileError> {
    let mut file = OutFile::create(path, existing)?;
    file.put(bytes)?;
    file.finish()?;
    Ok(())
}

/// Removes a file that an earlier output left and the present one does not have; a missing file is not an error.
/// Refuses what [`write()`] would refuse.
///
/// # Errors
/// See [`OutFileError`].
pub fn remove(path: &Path, existing: Existing) -> Result<(), OutFileError> {
    match target(path, existing)? {
        Target::New | Target::Stream(_) => Ok(()),
        Target::Replaced => std::fs::remove_file(path).map_err(OutFileError::io(path)),
    }
}

/// Creates a file that must be visible under its name while it grows (a transcript); never replaces a file.
///
/// # Errors
/// See [`OutFileError`].
pub fn create_in_place(path: &Path) -> Result<File, OutFileError> {
    match target(path, Existing::Refuse)? {
        Target::Stream(stream) => open(path, stream),
        Target::New | Target::Replaced => {
            File::create_new(path).map_err(|cause| match cause.kind() {
                ErrorKind::AlreadyExists => OutFileError::Exists(path.to_owned()),
                _ => OutFileError::io(path)(cause),
            })
        }
    }
}

/// Creates a folder and its parents, as [`check_folder`] allows.
///
/// # Errors
/// See [`OutFileError`].
pub fn make_folder(path: &Path, existing: Existing) -> Result<(), OutFileError> {
    check_folder(path, existing)?;
    std::fs::create_dir_all(path).map_err(OutFileError::io(path))
}

fn open(path: &Path, stream: Stream) -> Result<File, OutFileError> {
    let own = match stream {
        Stream::Named => return open_stream(path),
        Stream::Output => std::io::stdout().as_fd().try_clone_to_owned(),
        Stream::Error => std::io::stderr().as_fd().try_clone_to_owned(),
    };
    own.map(File::from).map_err(OutFileError::io(path))
}

/// Creates a temporary file in the folder of `path`, so that it can be renamed, with permissions set by the umask.
fn temporary(path: &Path) -> std::io::Result<NamedTempFile> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let prefix: String = std::iter::once('.').chain(name.chars().take(60)).collect();
    tempfile::Builder::new()
        .prefix(&format!("{prefix}."))
        .suffix(".part")
        .rand_bytes(12)
        .permissions(Permissions::from_mode(0o666))
        .tempfile_in(folder_of(path))
}
