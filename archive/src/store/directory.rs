//! A folder as a store: a local path or a network file system.

use std::fs::{DirBuilder, File};
use std::io::{Error, ErrorKind, Read, Seek};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

use super::whole_file::{WholeFileError, read_back, sync_folder_of, tidy, write_whole};
use super::{PartName, Store, StoreError, Stored};

/// An existing folder. A part appears under its name only when it is complete.
#[derive(Debug, Clone)]
pub struct Directory {
    root: PathBuf,
}

impl Directory {
    /// The store in a folder.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    /// Checks that the root exists: an unmounted share must not be taken for an empty store.
    fn check_root(&self) -> Result<(), StoreError> {
        match self.root.is_dir() {
            true => Ok(()),
            false => Err(StoreError::NoStore {
                path: self.root.clone(),
            }),
        }
    }

    /// Creates the folders of a part below the root.
    fn make_folders(&self, name: &PartName) -> Result<(), StoreError> {
        let mut folder = self.root.clone();
        for step in [&name.site, &name.daq, &name.session] {
            folder.push(step);
            match DirBuilder::new().mode(0o750).create(&folder) {
                Ok(()) => sync_folder_of(&folder).map_err(|error| self.refused(name, error))?,
                Err(there) if there.kind() == ErrorKind::AlreadyExists => {}
                Err(source) => return Err(self.failed(name, &folder, "create", source)),
            }
        }
        Ok(())
    }

    fn failed(
        &self,
        name: &PartName,
        path: &Path,
        attempt: &'static str,
        source: Error,
    ) -> StoreError {
        match source.kind() {
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded => StoreError::Full {
                place: self.place(),
                name: name.to_string(),
                source,
            },
            _ => StoreError::Io {
                path: path.to_owned(),
                attempt,
                source,
            },
        }
    }

    fn refused(&self, name: &PartName, error: WholeFileError) -> StoreError {
        match error {
            WholeFileError::Source { found } => StoreError::SourceChanged {
                name: name.to_string(),
                found,
            },
            WholeFileError::ReadBack { found, .. } => StoreError::Altered {
                place: self.place(),
                name: name.to_string(),
                found,
            },
            WholeFileError::Exists(path) => StoreError::Io {
                path,
                attempt: "write",
                source: ErrorKind::AlreadyExists.into(),
            },
            WholeFileError::Io {
                path,
                attempt,
                source,
            } => self.failed(name, &path, attempt, source),
        }
    }

    /// Compares an existing part with the hash in its name.
    fn present(&self, name: &PartName, path: &Path) -> Result<Stored, StoreError> {
        tidy(path);
        let read = read_back(path, &name.sha256);
        let bytes = read.map_err(|error| self.refused(name, error))?;
        // the process that wrote it may have been killed before it synced the folder
        sync_folder_of(path).map_err(|error| self.refused(name, error))?;
        Ok(Stored {
            bytes,
            existed: true,
        })
    }
}

impl Store for Directory {
    fn put(&self, name: &PartName, from: &mut File) -> Result<Stored, StoreError> {
        self.check_root()?;
        let path = self.root.join(name.to_string());
        if path.exists() {
            return self.present(name, &path);
        }
        self.make_folders(name)?;
        from.rewind()
            .map_err(|source| self.failed(name, &path, "read the part for", source))?;
        match write_whole(from, &path, &name.sha256) {
            Ok(bytes) => Ok(Stored {
                bytes,
                existed: false,
            }),
            // another process stored it in the meantime
            Err(WholeFileError::Exists(_)) => self.present(name, &path),
            Err(error) => Err(self.refused(name, error)),
        }
    }

    fn open(&self, name: &PartName) -> Result<Box<dyn Read + '_>, StoreError> {
        self.check_root()?;
        let path = self.root.join(name.to_string());
        match File::open(&path) {
            Ok(file) => Ok(Box::new(file)),
            Err(absent) if absent.kind() == ErrorKind::NotFound => Err(StoreError::Missing {
                place: self.place(),
                name: name.to_string(),
            }),
            Err(source) => Err(self.failed(name, &path, "read", source)),
        }
    }

    fn place(&self) -> String {
        self.root.display().to_string()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn part(folder: &Path, content: &[u8]) -> (PartName, File) {
        let path = folder.join("m1.tactus");
        std::fs::write(&path, content).unwrap();
        let (sha256, _) = logbook::sha256_of(content).unwrap();
        let name = PartName {
            site: "berlin".into(),
            daq: "bed3".into(),
            session: "m1".into(),
            part: "m1".into(),
            sha256,
        };
        (name, File::open(path).unwrap())
    }

    fn files(folder: &Path) -> usize {
        std::fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn part_appears_whole_once_and_is_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("store");
        std::fs::create_dir(&store).unwrap();
        let directory = Directory::new(&store);
        let (name, mut file) = part(folder.path(), b"content");
        let session = store.join("berlin/bed3/m1");
        for existed in [false, true] {
            let stored = directory.put(&name, &mut file).unwrap();
            assert_eq!(stored, Stored { bytes: 7, existed });
            assert_eq!(files(&session), 1);
        }
        // the next attempt removes the leftover of a killed copy
        std::fs::write(
            session.join(format!(".m1.{}.tactus.77.unfinished", name.sha256)),
            "con",
        )
        .unwrap();
        directory.put(&name, &mut file).unwrap();
        assert_eq!(files(&session), 1);
        // altered in the store: reported, and kept as evidence
        let stored = store.join(name.to_string());
        std::fs::remove_file(&stored).unwrap();
        std::fs::write(&stored, "c0ntent").unwrap();
        let error = directory.put(&name, &mut file).unwrap_err();
        assert!(matches!(error, StoreError::Altered { .. }), "{error}");
        assert_eq!(std::fs::read(&stored).unwrap(), b"c0ntent");
    }

    #[test]
    fn file_that_changes_while_it_is_copied_is_not_stored() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("store");
        std::fs::create_dir(&store).unwrap();
        let (name, mut file) = part(folder.path(), b"content");
        let mut other = File::options()
            .append(true)
            .open(folder.path().join("m1.tactus"))
            .unwrap();
        other.write_all(b"!").unwrap();
        let error = Directory::new(&store).put(&name, &mut file).unwrap_err();
        assert!(matches!(error, StoreError::SourceChanged { .. }), "{error}");
        assert_eq!(files(&store.join("berlin/bed3/m1")), 0);
    }

    #[test]
    fn missing_folder_of_the_store_is_not_created() {
        let folder = tempfile::tempdir().unwrap();
        let (name, mut file) = part(folder.path(), b"content");
        let root = folder.path().join("unmounted");
        let error = Directory::new(&root).put(&name, &mut file).unwrap_err();
        assert!(
            matches!(error, StoreError::NoStore { .. }) && error.is_temporary(),
            "{error}"
        );
        assert!(!root.exists());
    }
}
