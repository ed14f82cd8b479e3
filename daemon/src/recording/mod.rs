//! Processing of frames after acquisition: the recorder and its sinks (logbook, session status, stream), the
//! reconstruction worker, the marks of ended sessions, the index of the record. Session files are left to the crate
//! `logbook`.

pub(crate) mod end_marks;
pub(crate) mod frame_sink;
pub(crate) mod logbook_sink;
pub(crate) mod pace;
pub(crate) mod published;
pub(crate) mod reconstruction_worker;
pub(crate) mod recorder;
pub(crate) mod recorder_message;
pub(crate) mod records;
pub(crate) mod ring;
pub(crate) mod session_status;
pub(crate) mod stream;
pub(crate) mod stream_sink;
