//! Shared data types of a rig, its measurements and its maps.
//!
//! Electrodes, the Sheffield order, the plan of a frame, frames of voltages, baselines, maps, and their units.
//! Contains no instruments, clocks, threads or mathematics; these are in other crates.
//!
//! - **electrode**: a contact on the edge of the sheet; **dipole**: two of them with a direction
//! - **measurement**: drive one pair, sense another; **protocol**: all measurements of a frame, in order
//! - **wiring**: which relays join which pair to source and voltmeter; **plan**: the steps of a frame, as data
//! - **reading**: the result of one measurement, a voltage or the reason why there is none; **frame**: all readings
//! - **baseline**: the mean of some frames of the unloaded sheet; **map**: a value for each triangle of the region
//!
//! ```
//! use survey::{Protocol, Dipole};
//! let protocol = Protocol::sheffield(26)?;
//! assert_eq!(protocol.len(), 598);
//! assert_eq!(protocol.measurements()[0].drive, Dipole::adjacent(0, 26));
//! # Ok::<(), survey::ProtocolError>(())
//! ```

mod bounds;
mod frame;
mod map;
mod nearest;
mod pattern;
mod plan;
mod printable;
mod quality;
mod reading;
mod ring;
mod sketch;
mod text_position;
mod units;
mod wiring;

pub use bounds::{Bounds, LONGEST_S, OutOfBounds, duration, nanoseconds};
pub use frame::{Baseline, BaselineError, Extra, Frame, Precautions, Settings, mean_of};
pub use map::{
    Adjacency, Doubt, Evidence, HotSpot, Map, MapQuality, MapUnit, NextKind, Reason, Verdict,
};
pub use nearest::nearest;
pub use pattern::{Measurement, Protocol, ProtocolError, half, hex, sheffield, skip};
pub use plan::{
    Channel, Counts, Injection, Limits, Plan, PlanError, RangeRule, RelayLimits, Resolution,
    Routed, SourceLimits, Step, Timing,
};
pub use printable::{
    asks_for_json, error_chain, error_line, printable, printable_json, printable_lines,
    printable_within,
};
pub use quality::{Checks, Quality, QualityFlag};
pub use reading::{Reading, relative_changes};
pub use ring::{Dipole, Electrode};
pub use text_position::line_and_column;
pub use units::{Amps, Ohms, Volts};
pub use wiring::{Relay, RelayTable, Sensing, Transition, Wiring, WiringError};
