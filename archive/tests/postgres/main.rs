//! The archive against a real PostgreSQL: pushes, repetitions, faults, kills, refusals; and live topics at a real broker.
//!
//! Live topics have no executable of their own: their tests wait most of the time.

#[path = "../servers/authority.rs"]
mod authority;
mod clocks;
mod faults;
#[path = "../../../logbook/tests/example_frames/taken.rs"]
mod frames;
mod kills;
mod links;
#[path = "../live/mod.rs"]
mod live;
mod objects;
mod proxy;
mod pushes;
mod reading;
mod refusals;
mod server;
mod site;
mod timescale;

use server::Server;
use site::Site;

/// A server with the catalogue, and a registered site; `None` without PostgreSQL.
fn archive(site: &str) -> Option<(Server, Site)> {
    let server = Server::start()?;
    let owner = Site::new(&server, "owner");
    let done = owner.owner(&server, &["migrate"]);
    assert!(done.status.success(), "{done:?}");
    let site = Site::added(&server, site);
    Some((server, site))
}
