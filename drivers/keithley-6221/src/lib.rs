//! The Keithley 6221 current source: commands, driver and simulator.
//!
//! A floating current source with a voltage limit. It has no voltmeter: the only thing it reports about its load is
//! whether the voltage limit reduces the current (*compliance*). A current or voltage limit beyond those of the
//! instrument is an error; nothing is clipped. The simulator contains no physics (a [`Load`] returns the resistance),
//! and rejects delta modes as an instrument without a 2182A does.
//!
//! - **level**: the requested current; **range**: the scale for a level, up to 5 % above its nominal full scale
//! - **compliance**: the voltage limit, and the state in which it reduces the current
//! - **parameter**: a setting that is one value; **sweep**, **wave**: levels as a function of time
//! - **command**: one unit of a message as a value
//!
//! ```
//! # #[tokio::main(flavor = "current_thread")] async fn main() -> Result<(), rig::RigError> {
//! use std::time::Duration;
//! use keithley_6221::{Keithley6221, Resistor, Settings6221, Simulator6221};
//! use rig::{CurrentSource, Link};
//! use survey::{Amps, Ohms, Volts};
//! use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
//!
//! let (here, there) = tokio::io::duplex(256);
//! tokio::spawn(async move {
//!     let (mut simulator, mut load) = (Simulator6221::new(Settings6221::default()), Resistor::new(Ohms(500.0)));
//!     let (received, mut replies) = tokio::io::split(there);
//!     let mut lines = BufReader::new(received).lines();
//!     while let Ok(Some(line)) = lines.next_line().await {
//!         if let Some(text) = simulator.receive(&line, Duration::ZERO, &mut load).text {
//!             replies.write_all(format!("{text}\n").as_bytes()).await.ok();
//!         }
//!     }
//! });
//! let mut source = Keithley6221::connect(Link::new(here, "6221 in memory", Duration::from_secs(5))).await?;
//! source.prepare(Amps(1e-3), Volts(5.0)).await?;
//! source.set_output(true).await?;
//! source.set_current(Amps(1e-3)).await?;
//! assert!(!source.in_compliance().await?);
//! source.off().await?;
//! # Ok(()) }
//! ```
//!
//! Source: fact sheet `keithley-6221`. The sections cited in this crate are those of the fact sheet.

mod command;
mod driver;
mod kind;
#[cfg(feature = "simulator")]
mod load;
mod parameter;
mod range;
#[cfg(feature = "simulator")]
mod simulator;

pub use command::{
    Address, Ask, Board, Command, DeltaMode, Element, Line, List, Shield, Speed, StatusGroup,
};
pub use driver::Keithley6221;
pub use kind::Kind;
#[cfg(feature = "simulator")]
pub use load::{Load, Resistor};
pub use parameter::Parameter;
pub use range::{
    LARGEST_CURRENT, LARGEST_LIMIT, LIMIT_STEP, LIMITS, RANGES, Range, SMALLEST_LIMIT,
};
#[cfg(feature = "simulator")]
pub use simulator::{Response, Settings6221, Simulator6221, Trigger};
