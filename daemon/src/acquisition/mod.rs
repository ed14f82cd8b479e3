//! Acquisition of one session: waits for the schedule, measures a frame or plays a recorded one, and hands it to the recorder.
//! What becomes of a frame afterwards is `recording`'s.

pub(crate) mod failed_frame;
pub(crate) mod measuring;
pub(crate) mod playback;
pub(crate) mod schedule;
pub(crate) mod task;
