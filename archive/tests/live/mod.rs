//! The live topics with a real mosquitto and a fake daemon on a bus.

mod access;
mod daemon;
#[path = "../../../tests/stories/mosquitto.rs"]
mod mosquitto;
mod outages;
mod publisher;
mod topics;
