//! The live topics with a real mosquitto and a fake daemon on a bus.

mod access;
#[path = "../servers/authority.rs"]
mod authority;
mod daemon;
#[path = "../../../logbook/tests/example_frames/taken.rs"]
mod frames;
#[path = "../../../tests/stories/mosquitto.rs"]
mod mosquitto;
mod outages;
mod publisher;
#[expect(dead_code, reason = "the rest is for the tests of the archive")]
#[path = "../postgres/server.rs"]
mod server;
#[expect(dead_code, reason = "the rest is for the tests of the archive")]
#[path = "../postgres/site.rs"]
mod site;
mod topics;
