//! Settings of the archive, to which closed parts of sessions are copied.

use std::path::{Path, PathBuf};

use survey::Bounds::Within;

use crate::bounds::MEGABYTES;
use crate::section::section;

section! {
    /// `[archive]`, read by `tactus-archive` only.
    ArchiveSection, "archive" {
        /// The site, a name in the catalogue.
        site: String;
        /// Name of this machine within its site; its host name if not given.
        daq: Option<String>;
        /// Folder of the store, or `s3://BUCKET`.
        store: String;
        /// Address of the S3-compatible server of a bucket.
        store_endpoint: Option<String>;
        /// Region of the bucket.
        store_region: Option<String>;
        /// A file with two lines: the name of the bucket's key, and the key.
        store_keys_file: Option<PathBuf>;
        /// Certificates (PEM) of the authorities that may issue the certificate of the bucket's server.
        store_ca: Option<PathBuf>;
        /// PostgreSQL server of the catalogue, as URL or `key=value` words, without a password.
        dsn: String;
        /// Certificates (PEM) of the authorities that may issue the certificate of the PostgreSQL server.
        ca: Option<PathBuf>;
        /// A file with the password of the PostgreSQL user.
        password_file: Option<PathBuf>;
        /// Period of `tactus-archive run`, s.
        every_s: f64 = 60.0, in Within(1.0, 86_400.0);
        /// Largest size of the cache of sessions that were fetched for reading, MB.
        cache_mb: u64 = 20_000, in MEGABYTES;
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
        crate::join(folder, given);
        if !self.store.is_empty() && self.bucket().is_none() {
            self.store = folder.join(&self.store).to_string_lossy().into_owned();
        }
    }
}
