//! Golden conversations, typed from the fact sheet on the 6221; each names its section. They test the grammar from
//! outside: driver and simulator share it, and would share its errors.

mod settings;
mod source;
mod sweep;
mod talk;
mod trigger;
mod wave;
