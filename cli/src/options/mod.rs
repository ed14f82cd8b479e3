//! Options shared by several commands, parsed into their types. `args` has the options of single commands.

pub(crate) mod about;
pub(crate) mod choices;
pub(crate) mod duration;
pub(crate) mod instant;
pub(crate) mod measuring;
pub(crate) mod moment;
pub(crate) mod numbers;
