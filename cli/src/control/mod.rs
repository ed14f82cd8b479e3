//! Commands that control the daemon's sessions: start, stop, baseline, status, watch, top, web, plan.
//! `instruments` has the commands about instruments.

pub(crate) mod alarms;
pub(crate) mod baseline;
pub(crate) mod health;
pub(crate) mod notify;
pub(crate) mod plan;
pub(crate) mod session;
pub(crate) mod status;
pub(crate) mod top;
pub(crate) mod viewer;
pub(crate) mod watch;
pub(crate) mod web;
