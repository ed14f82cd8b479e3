//! The archive: closed parts of sessions of many sites in one place.
//!
//! - **part**: a closed file of a session; it never changes again
//! - **store**: holds the files of parts, each under the hash of its content ([`Store`], [`Directory`])
//! - **catalogue**: PostgreSQL; which parts there are, their events and alarms, the quantities of each minute
//!   ([`Catalogue`])
//! - **receipt**: a file next to a part, written when the store has it (read back) and the catalogue's row is committed
//! - **live topics**: the daemon's present state, on an MQTT broker; for display only ([`LiveSettings`])
//!
//! [`ArchiveReader`] lists the content of the archive and fetches sessions. [`Uploader`] archives what is missing.
//! Every step may be repeated or interrupted: the key of a part is its content, and rows are only inserted.

mod args;
mod cache;
mod catalogue;
mod credentials;
mod live;
mod part;
mod program;
mod reader;
mod retrieval;
mod runtime;
mod settings;
mod store;
mod upload;

pub use args::{Filter, Pull, Task};
pub use cache::InUse;
pub use catalogue::{
    Access, ArchivedName, ArchivedPart, ArchivedSession, Catalogue, CatalogueError, Machine,
    Migration, SessionFilter, SessionName,
};
pub use live::LiveSettings;
pub use part::{Part, PartError};
pub use program::{Failure, command, perform_task, run};
pub use reader::{ArchiveReader, FetchedSession, ReadError};
pub use retrieval::{Holding, RetrievalError, pull, verify};
pub use settings::{Settings, SettingsError};
pub use store::{
    BucketAccess, Directory, Objects, PartName, Store, StoreError, Stored, WholeFileError,
    name_fault,
};
pub use upload::{Owner, Status, Step, UploadError, Uploader};
