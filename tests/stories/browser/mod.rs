//! The live page in a real browser: Debian's chromium, driven by chromium-driver.

mod beside;
mod driver;
mod live_page;
mod night;
mod playback;
#[path = "../../../archive/tests/postgres/server.rs"]
#[allow(dead_code)]
mod server;
mod sheets;
