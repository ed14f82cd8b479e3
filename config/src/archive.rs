//! Settings of the archive, to which closed parts of sessions are copied.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

/// `[archive]`, read by `tactus-archive` only.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArchiveSection {
    /// The site, a name in the catalogue.
    pub site: String,
    /// Name of this machine within its site; its host name if not given.
    pub daq: Option<String>,
    /// Folder of the store, or `s3://BUCKET`.
    pub store: String,
    /// Address of the S3-compatible server of a bucket.
    pub store_endpoint: Option<String>,
    /// Region of the bucket.
    pub store_region: Option<String>,
    /// A file with two lines: the name of the bucket's key, and the key.
    pub store_keys_file: Option<PathBuf>,
    /// Certificates (PEM) of the authorities that may issue the certificate of the bucket's server.
    pub store_ca: Option<PathBuf>,
    /// PostgreSQL server of the catalogue, as URL or `key=value` words, without a password.
    pub dsn: String,
    /// Certificates (PEM) of the authorities that may issue the certificate of the PostgreSQL server.
    pub ca: Option<PathBuf>,
    /// A file with the password of the PostgreSQL user.
    pub password_file: Option<PathBuf>,
    /// Period of `tactus-archive run`, s.
    pub every_s: f64,
    /// Largest size of the cache of sessions that were fetched for reading, MB.
    pub cache_mb: u64,
}

impl Default for ArchiveSection {
    fn default() -> Self {
        Self {
            site: String::new(),
            daq: None,
            store: String::new(),
            store_endpoint: None,
            store_region: None,
            store_keys_file: None,
            store_ca: None,
            dsn: String::new(),
            ca: None,
            password_file: None,
            every_s: 60.0,
            cache_mb: 20_000,
        }
    }
}

impl ArchiveSection {
    /// The bucket that `store` names; `None` for a folder.
    pub fn bucket(&self) -> Option<&str> {
        self.store.strip_prefix("s3://")
    }

    /// Resolves paths against `folder`; an empty path stays empty, so that it can be reported as missing.
    pub(crate) fn resolve(&mut self, folder: &Path) {
        let given = [
            &mut self.ca,
            &mut self.password_file,
            &mut self.store_keys_file,
            &mut self.store_ca,
        ];
        for path in given.into_iter().flatten() {
            *path = folder.join(&*path);
        }
        if !self.store.is_empty() && self.bucket().is_none() {
            self.store = folder.join(&self.store).to_string_lossy().into_owned();
        }
    }
}
