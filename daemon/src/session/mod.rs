//! Sessions: the controller that starts and ends them, the state machine, the schedule, and the marks of ended sessions.
//! Frames are measured in `acquisition` and kept by `recording`.

pub(crate) mod controller;
pub(crate) mod end_marks;
pub(crate) mod schedule;
pub(crate) mod state;
