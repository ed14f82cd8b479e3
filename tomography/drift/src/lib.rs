//! Drift of a sheet over months: what separates a load from ageing, and what cannot.
//!
//! A map compares a frame with a baseline. Over days the sheet itself changes: its conductance as a whole, its contacts,
//! slowly varying fields, and places. This crate gives a frame the covariance of these changes, and follows them through
//! time where frames of the past are known. It computes from readings that it is given: no files, no clock, no instruments, no phantom.
//!
//! - **pairs**: a frame as 299 means of reciprocal readings, relative to a baseline, and 299 differences that no load and no
//!   drift changes
//! - **sheet**: gain, contacts and an uneven conductance fitted once to the first baseline
//! - **model**: sensitivity at that sheet, and the covariance D(s) of gain, contacts, smooth field and local change
//! - **evidence**: the sizes of these changes that make one frame most probable, and its drift, for methods that take a
//!   baseline; **whitened**: data and sensitivity for linear methods; **disc**: a disc with its covariance, also one that moves
//! - **tracker**: the baseline followed through time, learnt only from frames without load; **electrodes**: which one is faulty

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
