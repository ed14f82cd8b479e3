//! The Keysight (formerly Agilent) 34980A: relays and a voltmeter in one mainframe.
//!
//! Contains its commands in both directions, the channel numbers of its modules, the driver that implements
//! [`rig::Switch`] and [`rig::Voltmeter`], and a simulator of both. The simulator contains no physics: the simulated
//! rig implements [`Wires`]. An overload is never a number, and a channel that a module does not have is an error.
//!
//! - **module**: a card of relays in a slot, with its terminal block; **contact**: the switch behind a channel number
//! - **scan list**: the channels that a READ? measures in turn; **bare voltmeter**: the voltmeter without a scan list
//! - **message**: commands sent in one segment; relay moves are deferred to the next query
//! - **wires**: the simulated circuit that relays and voltmeter are connected to
//!
//! ```
//! use std::{collections::BTreeSet, time::Duration};
//! use keysight_34980a::{MeterRequest, Module, Settings34980a, Simulator34980a, Wires};
//! use survey::{Relay, Volts};
//!
//! /// Two volts behind relay 1036, on whatever is measured.
//! struct Battery(bool);
//! impl Wires for Battery {
//!     fn relays(&mut self, closed: &BTreeSet<Relay>, _: Duration) { self.0 = closed.contains(&Relay(1036)); }
//!     fn measure(&mut self, _: Duration, _: MeterRequest) -> Volts { Volts(if self.0 { 2.0 } else { 0.0 }) }
//! }
//! let mut settings = Settings34980a::default();
//! settings.slots[0] = Some("34924A".parse::<Module>()?);
//! let mut unit = Simulator34980a::new(settings);
//! let message = "CONF:VOLT:DC 10,(@1001:1002);:ROUT:CLOS (@1036);:READ?";
//! let answer = unit.receive(message, Duration::ZERO, &mut Battery(false));
//! assert_eq!(answer.text.as_deref(), Some("+2.00000000E+00,+2.00000000E+00"));
//! # Ok::<(), keysight_34980a::ModuleError>(())
//! ```

mod command;
mod driver;
mod meter;
mod modules;
#[cfg(feature = "simulator")]
mod simulator;
mod wiring;

pub use command::{
    Calculate, Channels, Command, Detail, Field, Function, Functions, HeaderForm, Limit, Measure,
    MeasurementRequest, Message, Protection, Quantity, Range, Route, Scaling, ScalingQuantity,
    Sense, Setting, SettingValue, Statistic, StatusGroup, System, TriggerSource,
};
pub use driver::Keysight34980a;
pub use meter::{INTEGRATION, OVERRANGE, RANGES, range_for, reading_timing, resolution};
pub use modules::{Contact, Model, Module, ModuleError, Terminal, join, split};
#[cfg(feature = "simulator")]
pub use simulator::{
    Alternating, MeterRequest, Response, Session, Settings34980a, Simulator34980a, Wires,
};
pub use wiring::{MapError, fast_34925a, matrix_34932a, matrix_34934a, pairs_34922a, pairs_34924a};
