//! Golden conversations, written from the fact sheet of the 6221; the name of each test contains the section. They test
//! the grammar independently: driver and simulator share it, and would share its errors.

mod settings;
mod source;
mod sweep;
mod talk;
mod trigger;
mod wave;
