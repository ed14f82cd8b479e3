//! Instrument traits, a link with timeouts, and the acquisition of a plan with verified switch-off.
//!
//! Runs a [`survey::Plan`] on any implementation of [`CurrentSource`], [`Switch`] and [`Voltmeter`], over connections
//! that stall, split, merge and break, and leaves the source off and verified on every exit path. Commands of
//! particular instruments and mathematics are left to other crates. A late reply is never taken for the next one.
//!
//! - **link**: lines to and from one instrument, with timeouts; **unsynchronised**: state of a link after a fault,
//!   until its stream is replaced or it is resynchronised
//! - **conversation**: messages over a link, each of which ends with a query of the error queue
//! - **rig**: source, switch and voltmeter, held by one user at a time
//! - **acquire**: a plan in, a frame out; **safe off**: source off and relays open, each verified
//! - **transcript**: every line sent and received; a **ring transcript** keeps those of the last frames in memory
//!
//! ```
//! # #[tokio::main(flavor = "current_thread")] async fn main() -> Result<(), rig::LinkError> {
//! use std::time::Duration;
//! use tokio::io::{AsyncReadExt, AsyncWriteExt};
//!
//! let (here, mut there) = tokio::io::duplex(64);
//! let mut link = rig::Link::new(here, "a meter in memory", Duration::from_secs(1));
//! let meter = async {
//!     let mut received = [0; 6];
//!     there.read_exact(&mut received).await.unwrap();
//!     there.write_all(b"A METER\n").await.unwrap();
//! };
//! let (answer, ()) = tokio::join!(link.ask("*IDN?"), meter);
//! assert_eq!(answer?, "A METER");
//! # Ok(()) }
//! ```

mod acquire;
mod clock;
mod connect;
mod conversation;
mod fault;
mod found_relay;
mod link;
mod prepare;
mod safe;
mod stop;
mod traits;
pub mod transcript;

pub use crate::traits::{
    ChainedReading, Compliance, CurrentSource, Instruments, MeterSettings, Move, Rig, Sample,
    Switch, Voltmeter, mean,
};
pub use crate::transcript::ring::{RingTranscript, Transcript};
pub use acquire::{
    AcquireError, EndReason, InjectionReadings, InjectionSink, acquire, acquire_reporting, settings,
};
pub use clock::{Clock, SystemClock};
pub use connect::{connect_tcp, open_serial};
pub use conversation::{Conversation, Replies};
pub use fault::RigError;
pub use found_relay::{FoundRelay, name_relays};
pub use link::{BoxStream, Link, LinkError, Stream};
pub use prepare::prepare;
pub use safe::{CleanupError, StartError, check_at_start, find_closed, safe_off};
pub use stop::{Stop, StopButton};
