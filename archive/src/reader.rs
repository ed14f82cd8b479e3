//! Reading the archive from a program without an asynchronous runtime: lists, and sessions fetched into a cache.

use std::path::{Path, PathBuf};

use logbook::{LogbookError, StateKind};
use tokio::runtime::Runtime;

use crate::cache::{self, InUse};
use crate::catalogue::{
    ArchivedName, ArchivedSession, Catalogue, CatalogueError, Machine, SessionFilter, SessionName,
    Unfound,
};
use crate::retrieval::{self, RetrievalError};
use crate::settings::{Settings, SettingsError};
use crate::store::unique;

/// Why the archive cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The configuration is wrong.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The catalogue refuses.
    #[error(transparent)]
    Catalogue(#[from] CatalogueError),
    /// A part cannot be fetched.
    #[error(transparent)]
    Retrieval(#[from] RetrievalError),
    /// No session has this name.
    #[error(
        "the archive has no session '{0}' that this role may see; `tactus sessions --archive` lists its sessions"
    )]
    NoSuchSession(String),
    /// Several sessions have this name.
    #[error("'{name}' stands for several sessions of the archive: {}; write more characters of the name", .found.join(", "))]
    Ambiguous {
        /// The name.
        name: String,
        /// Full names of some of them.
        found: Vec<String>,
    },
    /// The cache cannot be written.
    #[error("cannot write to the cache {}", path.display())]
    Cache {
        /// The folder.
        path: PathBuf,
        /// Error of the system.
        #[source]
        source: std::io::Error,
    },
    /// The files next to the parts in the cache cannot be written.
    #[error(transparent)]
    Record(#[from] LogbookError),
    /// The asynchronous runtime cannot be started.
    #[error("the asynchronous runtime cannot be started")]
    Runtime(#[source] std::io::Error),
}

/// A session in the cache.
#[derive(Debug, Clone)]
pub struct FetchedSession {
    /// Its full name.
    pub name: SessionName,
    /// Its first archived part; the others are next to it.
    pub path: PathBuf,
    /// Keeps it in the cache.
    pub in_use: InUse,
}

/// The archive for reading. Each method opens a new connection, so that a restart of the server causes no error. Not
/// to be used from asynchronous code.
#[derive(Debug, Clone)]
pub struct ArchiveReader {
    settings: Settings,
}

impl ArchiveReader {
    /// Reads `[archive]` of a configuration; its `site` and `daq` may be missing. Opens no connection.
    ///
    /// # Errors
    /// The configuration is wrong.
    pub fn open(config: &Path) -> Result<Self, ReadError> {
        let settings = Settings::read_for_reader(config)?;
        Ok(Self { settings })
    }

    /// Sessions, the oldest first.
    ///
    /// # Errors
    /// The catalogue refuses.
    pub fn sessions(&self, filter: &SessionFilter) -> Result<Vec<ArchivedSession>, ReadError> {
        runtime()?.block_on(async { Ok(self.catalogue().await?.sessions(filter).await?) })
    }

    /// All machines.
    ///
    /// # Errors
    /// The catalogue refuses.
    pub fn machines(&self) -> Result<Vec<Machine>, ReadError> {
        runtime()?.block_on(async { Ok(self.catalogue().await?.machines().await?) })
    }

    /// Fetches the parts of a session that are missing in the cache, and compares everything with the catalogue:
    /// parts by their hashes, then the stored quantities and the tracked baseline at the start of the session. Then
    /// removes the least recently read sessions, if the cache is larger than the configuration allows.
    ///
    /// # Errors
    /// No or several sessions of this name, a part that is missing in the store or has another content, a cache that
    /// cannot be written. Every file in the cache is then still complete.
    pub fn fetch(&self, wanted: &ArchivedName, cache: &Path) -> Result<FetchedSession, ReadError> {
        runtime()?.block_on(async {
            let catalogue = self.catalogue().await?;
            let name = found(&catalogue, wanted).await?;
            let parts = catalogue.parts_of(&name).await?;
            if parts.is_empty() {
                return Err(ReadError::NoSuchSession(name.to_string()));
            }
            let store = self.settings.store.open()?;
            // the folder in the cache has the name of the session
            retrieval::check_names([&name.site, &name.daq, &name.session])?;
            for part in &parts {
                retrieval::check_part(&part.name)?;
            }
            let failed = |source| ReadError::Cache {
                path: cache.to_owned(),
                source,
            };
            let (folder, in_use) = cache::enter(cache, &name).map_err(failed)?;
            let mut first = None;
            for part in &parts {
                let path = retrieval::pull(&*store, part, &folder)?;
                first.get_or_insert(path);
            }
            beside(&catalogue, &name, &folder).await?;
            let path = first.ok_or_else(|| ReadError::NoSuchSession(name.to_string()))?;
            cache::prune(cache, self.settings.cache_bytes).map_err(failed)?;
            Ok(FetchedSession { name, path, in_use })
        })
    }

    async fn catalogue(&self) -> Result<Catalogue, CatalogueError> {
        let catalogue = Catalogue::connect(&self.settings.access).await?;
        catalogue.check_version().await?;
        Ok(catalogue)
    }
}

fn runtime() -> Result<Runtime, ReadError> {
    crate::runtime::runtime().map_err(ReadError::Runtime)
}

/// Finds the session of a name.
pub(crate) async fn found(
    catalogue: &Catalogue,
    wanted: &ArchivedName,
) -> Result<SessionName, ReadError> {
    catalogue
        .session_named(wanted)
        .await?
        .map_err(|unfound| match unfound {
            Unfound::None => ReadError::NoSuchSession(wanted.to_string()),
            Unfound::Several(found) => ReadError::Ambiguous {
                name: wanted.to_string(),
                found: found.iter().map(ToString::to_string).collect(),
            },
        })
}

/// Writes the files next to the parts of a session: the tracked baseline and the quantities.
async fn beside(catalogue: &Catalogue, name: &SessionName, folder: &Path) -> Result<(), ReadError> {
    if let Some(state) = catalogue.tracking(name).await? {
        logbook::keep_state(folder, &name.session, StateKind::Tracking, &state)?;
    }
    let lines = catalogue.quantity_lines(name).await?;
    let there = logbook::quantity_lines(folder, &name.session)?;
    let there = there.map(|there| there.lines).unwrap_or_default();
    if there.iter().map(|line| &line.json).eq(&lines) {
        return Ok(());
    }
    // written under another name first, so that a file of the final name is always complete
    let unfinished = format!("{}_unfinished_{}", name.session, unique());
    let from = logbook::quantities_file(folder, &unfinished);
    let cache = |source| ReadError::Cache {
        path: folder.to_owned(),
        source,
    };
    let _ = std::fs::remove_file(&from);
    for line in &lines {
        logbook::append_quantities(folder, &unfinished, line)?;
    }
    std::fs::rename(&from, logbook::quantities_file(folder, &name.session)).map_err(cache)
}
