//! The simulated rig: the drivers' simulators connected to one phantom, in memory or on TCP.
//!
//! Every reading follows from the actual current and the relays that are actually closed. The drivers' simulators
//! provide the behaviour, the phantom provides physics and imperfections; this crate connects them and serves the byte
//! streams for drivers and other clients. Readings reach a client only as text on a wire, and the crate adds no
//! imperfections of its own.
//!
//! - **profile**: the instruments and their timing; **scene**: the sheet, its loads and effects (see `phantom`)
//! - **fixture**: the connections of each relay; **circuit**: the resulting currents, for any combination of closed
//!   relays
//! - **golden**: a conversation that a simulator must reproduce; **transcript**: a recorded one (see
//!   [`rig::transcript`])
//! - **wire**: the connection to an instrument, which may be cut or silent
//!
//! ```
//! # #[tokio::main(flavor = "current_thread")] async fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use std::time::Duration;
//! use simulator::{Instrument, Pace, Profile, SimulatedRig};
//!
//! let rig = SimulatedRig::new(&Profile::default().at_pace(Pace::Instant), phantom::Scene::quiet())?;
//! let mut source = rig::Link::new(rig.connect(Instrument::Source), "6221", Duration::from_secs(5));
//! source.send("SOUR:CURR 1e-3;:OUTP ON").await?;
//! // Nothing is closed: no current, and the source is in compliance.
//! assert_eq!(source.ask("STAT:MEAS:COND?").await?, "8");
//! assert_eq!(rig.flowing(), survey::Amps(0.0));
//! # Ok(()) }
//! ```

mod circuit;
mod control;
mod frame_times;
mod instrument;
mod profile;
mod program;
mod serve;
mod simulated_instruments;
mod simulated_rig;
mod transcripts;
mod transport;

pub use crate::circuit::load_network::{LoadNetwork, LoadNetworkError};
pub use crate::instrument::fault::{Fault, FaultError, ReplyFault, TimedFault};
pub use crate::instrument::isolated::InstrumentSetup;
pub use crate::instrument::{
    Board, Headers, Instrument, Mainframe, Pace, Profile, SecondClient, Source, Wire,
};
pub use crate::simulated_instruments::{Messages, TranscriptLine};
pub use crate::simulated_rig::status::{Client, SourceStatus, Status};
pub use crate::simulated_rig::{RigError, SimulatedRig};
pub use crate::transcripts::golden::{Expected, Golden, GoldenError, GoldenLine, Step};
pub use crate::transcripts::playback::{
    Comparison, ReplayError, ReplayStatistics, ReplayTarget, golden_of, replay,
};
pub use frame_times::{FrameTimeError, FrameTimes};
pub use phantom::{Load, LoadError, PhantomError, Scene, SceneError, Shape};
pub use profile::ProfileError;
pub use program::{command, run};
pub use serve::{Ready, ServeError, ServeOptions, Server, serve};
