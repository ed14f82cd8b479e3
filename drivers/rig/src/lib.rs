//! The seams of a rig, the one place that waits on a wire, and the acquisition of a plan.

mod fault;
mod link;
mod seams;

pub use fault::RigError;
pub use link::LinkError;
pub use seams::{CurrentSource, MeterSettings, Move, Rig, Switch, Voltmeter};
