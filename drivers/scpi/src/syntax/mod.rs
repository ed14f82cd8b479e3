//! The parts of one unit of a message: header, arguments, units behind numbers.
//! Messages of several units are put together in `message`.

pub(crate) mod argument;
pub(crate) mod call;
pub(crate) mod header;
pub(crate) mod keyword;
pub(crate) mod reader;
pub(crate) mod unit;
