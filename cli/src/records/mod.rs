//! Commands that read or maintain recorded sessions, with or without a daemon. The crate `logbook` defines the file
//! format.

pub(crate) mod case_folder;
pub(crate) mod events;
pub(crate) mod export;
pub(crate) mod log;
pub(crate) mod maintenance;
pub(crate) mod report;
pub(crate) mod sessions;
pub(crate) mod show;
