//! Maintenance of recorded sessions: verify, repair, prune, and removal of what a killed writer left.
//! Reading and writing sessions are `reader` and `writer`.

pub(crate) mod leftovers;
pub(crate) mod prune;
pub(crate) mod receipts;
pub(crate) mod repair;
pub(crate) mod verify;
