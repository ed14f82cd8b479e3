//! The way of a frame after acquisition: recorder, reconstruction worker, session status, stream.
//! Session files are the crate `logbook`'s.

pub(crate) mod end_marks;
pub(crate) mod order;
pub(crate) mod reconstruction_worker;
pub(crate) mod recorder;
pub(crate) mod records;
pub(crate) mod ring;
pub(crate) mod session_status;
pub(crate) mod stream;
