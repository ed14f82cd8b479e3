//! Sessions: the controller that starts and ends them, the state machine, and the tasks beside it: monitors, and what
//! follows a panic.
//! Frames are measured in `acquisition` and kept by `recording`.

pub(crate) mod controller;
mod health;
mod map_time;
pub(crate) mod observer;
pub(crate) mod option_values;
pub(crate) mod panics;
pub(crate) mod state;
