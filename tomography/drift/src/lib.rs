//! Drift of a sheet over months: separates loads from ageing, as far as the readings allow it.
//!
//! A map compares a frame with a baseline. Over days the sheet itself changes: its overall conductance, its contacts,
//! slowly varying fields, and local spots. This crate provides the covariance of these changes for a frame, and tracks
//! them over time if earlier frames are available. Its input is readings only; it uses no files, clock, instruments or
//! phantom.
//!
//! - **pairs**: a frame as 299 means of reciprocal readings, relative to a baseline
//! - **sheet**: gain, contacts and an uneven conductance fitted once to the first baseline
//! - **model**: sensitivity of that sheet, and the covariance D(s) of gain, contacts, smooth field and local change
//! - **evidence**: the sizes of these changes that make one frame most probable, and the drift in that frame, for
//!   methods that use a baseline; **whitened**: data and sensitivity for linear methods; **disc**: a disc with its
//!   covariance, at rest or moving
//! - **tracker**: the baseline tracked over time, learnt only from frames without load; **electrodes**: detects faulty
//!   ones

mod basis;
mod disc;
mod electrodes;
mod error;
mod evidence;
mod kinds;
mod model;
mod overlap;
mod pairs;
mod sheet;
mod sizes;
mod tracker;
mod whitened;

pub use disc::{Disc, DiscFit, INJECTIONS, Injection, MovingLoad, TimedReading};
pub use electrodes::{Allowed, ElectrodeCheck, ElectrodeFault};
pub use error::DriftError;
pub use evidence::{Assessed, FrameDrift, MapDeviation};
pub use kinds::{DriftKinds, LocalChange};
pub use model::{DriftModel, Noise};
pub use pairs::{Pairs, Relative};
pub use sheet::{FitOptions, SheetFit};
pub use sizes::Sizes;
pub use tracker::bits;
pub use tracker::{
    AnchorAlarm, Answer, Event, Judgement, MOST_MASKED, Tracker, TrackerState, TrackingOrder,
};
pub use whitened::Whitened;
