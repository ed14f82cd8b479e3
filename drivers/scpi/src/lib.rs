//! The grammar of SCPI in both directions, without I/O.
//!
//! The instrument's side has framing, headers, arguments, the error queue and status registers; the client's side
//! writes numbers and lists and parses replies. Bytes are passed in as arguments; the crate does not wait, reads no
//! clock and contains no command of a particular instrument. Invalid text is an error: a [`ParseError`] with the
//! standard's error number on the instrument's side, a [`ReplyError`] on the client's side. 9.9E37 is
//! [`Answer::Overload`], never a voltage.
//!
//! - **message**: one line; **call**: one unit between semicolons, its header resolved by the path rule
//! - **notation**: a header as in manuals, `[SOURce]:CURRent[:LEVel]`; **argument**: one typed datum of a call
//! - **answer**: one number of a reply; **register**, **queue**: an instrument's record of its events and errors
//!
//! ```
//! use scpi::{Numeric, Unit, parse_message};
//! let calls = parse_message("SOUR:CURR:RANG 2 mA;COMP MAX;:*IDN?;");
//! let range = calls[0].as_ref().unwrap();
//! assert!(range.is("[SOURce]:CURRent:RANGe"));
//! assert_eq!(range.arguments[0].number(Unit::Ampere), Ok(Numeric::Value(2e-3)));
//! let compliance = calls[1].as_ref().unwrap();
//! assert!(compliance.is("[SOURce]:CURRent:COMPliance"));
//! assert_eq!(compliance.arguments[0].number(Unit::Volt), Ok(Numeric::Max));
//! assert!(calls[2].as_ref().unwrap().is("*IDN?"));
//! ```
//!
//! Source: SCPI-1999 volumes 1 and 2 and IEEE 488.2, as described in the manuals of the supported instruments.

mod channel_list;
mod common_command;
mod error_code;
mod error_queue;
mod framer;
mod message;
mod reading;
mod response;
mod status;
pub(crate) mod syntax;

pub use crate::syntax::argument::{Argument, Numeric};
pub use crate::syntax::call::Call;
pub use crate::syntax::header::Pattern;
pub use crate::syntax::table::Table;
pub use crate::syntax::unit::Unit;
pub use channel_list::{ChannelEntry, ChannelList};
pub use common_command::Common;
pub use error_code::ParseError;
pub use error_queue::{ErrorEntry, ErrorQueue};
pub use framer::{Framer, Oversized};
pub use message::{join_units, parse_message};
pub use reading::{
    Answer, INFINITY, NOT_A_NUMBER, ReplyError, format_block, format_nr3, format_nr3_signed,
    parse_block, parse_boolean, parse_integer, parse_reading, parse_readings, quote, unquote,
};
pub use response::Response;
pub use status::{StandardEvent, StatusModel, StatusRegister};
