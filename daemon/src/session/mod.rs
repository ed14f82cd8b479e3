//! Sessions: the controller that starts and ends them, the state machine, the monitoring task, and the reaction to a
//! panic. Frames are measured in `acquisition` and stored by `recording`.

pub(crate) mod controller;
mod health;
mod map_time;
pub(crate) mod observer;
pub(crate) mod option_values;
pub(crate) mod panics;
pub(crate) mod state;
