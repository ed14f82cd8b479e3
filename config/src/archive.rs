//! Settings of the archive: where closed parts of sessions go.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

/// `[archive]`, read by `tactus-archive` only.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArchiveSection {
    /// The site, a name in the catalogue.
    pub site: String,
    /// This machine within its site; its host name if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub daq: Option<String>,
    /// Folder of the store.
    pub store: PathBuf,
    /// PostgreSQL of the catalogue, as URL or `key=value` words, without a password.
    pub dsn: String,
    /// Certificates (PEM) that the server's certificate must be issued by.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ca: Option<PathBuf>,
    /// A file with the password.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub password_file: Option<PathBuf>,
    /// Period of `tactus-archive run`, s.
    pub every_s: f64,
}

impl Default for ArchiveSection {
    fn default() -> Self {
        Self {
            site: String::new(),
            daq: None,
            store: PathBuf::new(),
            dsn: String::new(),
            ca: None,
            password_file: None,
            every_s: 60.0,
        }
    }
}

impl ArchiveSection {
    /// Resolves paths against `folder`; an empty path stays empty, so that it can be reported as missing.
    pub(crate) fn resolve(&mut self, folder: &Path) {
        let given = [&mut self.ca, &mut self.password_file];
        for path in given.into_iter().flatten().chain([&mut self.store]) {
            if !path.as_os_str().is_empty() {
                *path = folder.join(&*path);
            }
        }
    }
}
