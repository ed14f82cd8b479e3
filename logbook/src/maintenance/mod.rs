//! Maintenance of recorded sessions: verify, repair, prune, and removal of the leftovers of a killed writer. Sessions
//! are read in `reader` and written in `writer`.

pub(crate) mod leftovers;
pub(crate) mod prune;
pub(crate) mod receipts;
pub(crate) mod repair;
pub(crate) mod verify;
