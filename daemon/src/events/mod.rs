//! Events on their way to the journal, the bus and the daemon log.
//! Which events a session records is decided by `recording`.

mod daemon_log;
pub(crate) mod event;
pub(crate) mod event_log;
pub(crate) mod journal;
pub(crate) mod kind;
pub(crate) mod rate_limit;
