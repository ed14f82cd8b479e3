//! The commands of `tactus-lab` that work on plain files: cases, scenes, recordings, training.

mod commands;
mod interrupted;
mod learning;
mod modelling;
mod pressure;
mod recordings;
mod scenes;
#[path = "../workshop/mod.rs"]
mod workshop;
