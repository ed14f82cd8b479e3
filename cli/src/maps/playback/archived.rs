//! All sheets of an archive for the page of `tactus web`.

use archive::{ArchiveReader, FetchedSession, SessionFilter};
use serde_json::{Value, json};
use web::Sheets;

use crate::archived;
use crate::args::Global;
use crate::failure::{Failure, chain};

/// Most sessions of a machine on the page; `tactus sessions --archive` lists all.
const SESSIONS: u32 = 200;

/// The archive of a configuration.
pub(super) struct ArchivedSheets {
    global: Global,
    reader: ArchiveReader,
}

impl ArchivedSheets {
    /// Reads the configuration; does not connect.
    ///
    /// # Errors
    /// The configuration is invalid.
    pub(super) fn open(global: &Global) -> Result<Self, Failure> {
        Ok(Self {
            global: global.clone(),
            reader: archived::reader(global)?,
        })
    }

    /// A session, fetched into the cache.
    ///
    /// # Errors
    /// As [`archived::fetch`].
    pub(super) fn fetch(&self, named: &str) -> Result<FetchedSession, Failure> {
        archived::fetch(&self.global, named)
    }
}

impl Sheets for ArchivedSheets {
    fn machines(&self) -> Result<Value, String> {
        let machines = self.reader.machines().map_err(|error| chain(&error))?;
        Ok(json!(machines))
    }

    fn sessions(&self, site: &str, daq: &str) -> Result<Value, String> {
        let filter = SessionFilter {
            site: Some(site.to_owned()),
            daq: Some(daq.to_owned()),
            most: Some(SESSIONS),
            ..SessionFilter::default()
        };
        let mut sessions = self
            .reader
            .sessions(&filter)
            .map_err(|error| chain(&error))?;
        sessions.reverse();
        Ok(json!(sessions))
    }
}
