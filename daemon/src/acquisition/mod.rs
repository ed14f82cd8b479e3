//! Acquisition of one session: waits for the schedule, takes a frame from the rig or a recording, and sends it to the
//! recorder. Processing and storing frames is left to `recording`.

pub(crate) mod failed_frame;
pub(crate) mod measuring;
pub(crate) mod playback;
pub(crate) mod schedule;
pub(crate) mod task;
