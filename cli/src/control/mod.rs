//! Commands that talk to the daemon about sessions: connection, start, stop, baseline, status, watch, plan.
//! Commands about instruments are in `instruments`.

pub(crate) mod baseline;
pub(crate) mod connection;
pub(crate) mod health;
pub(crate) mod notify;
pub(crate) mod plan;
pub(crate) mod session;
pub(crate) mod status;
pub(crate) mod viewer;
pub(crate) mod watch;
