//! What a panic ends: one answer to a client, or more; and the hook that decides which and reports it.
//! How the source is switched off after a panic is left to `session` and `instruments`.

pub(crate) mod containment;
pub(crate) mod hook;
