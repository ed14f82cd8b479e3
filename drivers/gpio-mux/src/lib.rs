//! The multiplexer board that connects any electrode to each of four poles, controlled by lines of text over a serial
//! port.
//!
//! Contains the line protocol in both directions, the driver that implements [`rig::Switch`] over it, and a simulator
//! that records every edge of the board's lines. [`GpioBoard`] drives a board whose lines are on a gpiochip of this
//! machine, through the trait [`GpioChip`] and the kernel's character device. Two electrodes on one pole, one electrode
//! on both current poles, and every relay number other than pole x 100 + electrode are errors.
//!
//! - **pole**: one of I+, I-, V+, V-; **state**: the electrode on each of them
//! - **line**: one of the 24 control lines of the multiplexers; **levels**: the levels of all of them
//! - **edge**: a change of an enable or of an address, with its time; break comes before make
//! - **watchdog**: opens everything when no command arrives in time
//!
//! ```
//! use std::time::Duration;
//! use gpio_mux::{Poles, Settings, SimulatorGpioMux};
//! use survey::Electrode;
//!
//! struct Sheet([Option<Electrode>; 4]);
//! impl Poles for Sheet {
//!     fn poles(&mut self, joined: [Option<Electrode>; 4], _: Duration) { self.0 = joined; }
//! }
//! let (mut board, mut sheet) = (SimulatorGpioMux::new(Settings::default()), Sheet([None; 4]));
//! let answer = board.receive("PAIR I 26", Duration::ZERO, &mut sheet);
//! assert_eq!(answer.text.as_deref(), Some("26,1,OFF,OFF"));
//! assert_eq!(sheet.0[1], Some(Electrode(0)));
//! ```

mod board;
#[cfg(target_os = "linux")]
mod character_device;
mod chip;
mod command;
mod driver;
mod lines;
mod moves;
#[cfg(feature = "simulator")]
mod simulator;
mod wiring;

pub use board::GpioBoard;
#[cfg(target_os = "linux")]
pub use character_device::{CharacterDevice, EnableLevel};
pub use chip::{GpioChip, GpioFault};
pub use command::{Command, NotAState, Pair, Pole, Reply, State, error_in_reply};
pub use driver::{GpioMux, Options, await_banner};
pub use lines::{Chip, LINES, Levels, Line, Step, steps};
#[cfg(feature = "simulator")]
pub use simulator::{Edge, EdgeRecord, Poles, Response, Settings, SimulatorGpioMux};
pub use wiring::{RELAY_LIMITS, ROUND_TRIP, wiring};

/// The model field of `*IDN?`.
pub const MODEL: &str = "GPIO-MUX";
