//! Options that several commands share, parsed into their types.
//! Options of one command are in `args`.

pub(crate) mod about;
pub(crate) mod choices;
pub(crate) mod duration;
pub(crate) mod measuring;
pub(crate) mod numbers;
