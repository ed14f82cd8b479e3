//! The parts of one unit of a message: header, arguments, units of numbers. Messages of several units are parsed in
//! `message`.

pub(crate) mod argument;
pub(crate) mod call;
pub(crate) mod header;
pub(crate) mod reader;
pub(crate) mod table;
pub(crate) mod unit;
