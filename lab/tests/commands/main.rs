//! The commands of `tactus-lab`: cases, scenes, recordings, training, studies.

mod commands;
mod ignored;
mod images;
mod interrupted;
mod learning;
mod modelling;
mod pressure;
mod program;
mod recorded_presses;
mod recordings;
mod scenes;
mod study;
