//! The consequences of a panic: containment for replies to clients, and the hook that reports all others. Switching the
//! source off is left to `session` and `instruments`.

pub(crate) mod containment;
pub(crate) mod hook;
