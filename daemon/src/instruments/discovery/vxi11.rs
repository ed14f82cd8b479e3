//! Discovery by VXI-11 broadcast (fact sheet lxi-discovery, section 6): broadcasts a port mapper's GETPORT, then sends
//! `create_link`, `*IDN?`, `destroy_link` to each device that replies.

use std::net::SocketAddr;
use std::time::Duration;

use tokio::net::TcpStream;
use tokio::time::Instant;
use vxi11::Client;

use crate::instruments::address::InstrumentAddress;
use crate::instruments::discovery::{Candidate, REPLY_TIMEOUT, SCPI_RAW};

/// Maximum length of a reply to `*IDN?`, bytes.
const LONGEST: u32 = 1024;

/// Broadcasts on every interface; returns the replies and the failures.
pub(super) async fn broadcast(within: Duration, port: u16) -> (Vec<Candidate>, Vec<String>) {
    let mut notes = Vec::new();
    let interfaces = match if_addrs::get_if_addrs() {
        Ok(interfaces) => interfaces,
        Err(fault) => {
            notes.push(format!(
                "the interfaces cannot be listed ({fault}): no VXI-11 broadcast"
            ));
            Vec::new()
        }
    };
    let until = Instant::now() + within;
    let mut requested = Vec::new();
    for interface in interfaces {
        let if_addrs::IfAddr::V4(address) = interface.addr else {
            continue;
        };
        let everybody = match address.broadcast {
            _ if address.ip.is_loopback() => address.ip,
            Some(everybody) => everybody,
            None => continue,
        };
        let name = interface.name;
        requested.push(tokio::spawn(async move {
            let answers = vxi11::find_core_channels(address.ip, everybody, port, until).await;
            answers.map_err(|fault| format!("no VXI-11 broadcast on {name} ({fault})"))
        }));
    }
    let mut found: Vec<SocketAddr> = Vec::new();
    for task in requested {
        match task.await {
            Ok(Ok(answers)) => found.extend(answers),
            Ok(Err(note)) => notes.push(note),
            Err(_) => {}
        }
    }
    found.sort();
    found.dedup();
    let each = found.into_iter().map(|core| {
        tokio::spawn(async move {
            let identity = tokio::time::timeout(2 * REPLY_TIMEOUT, identify(core))
                .await
                .ok()
                .and_then(Result::ok);
            Candidate {
                // the address that the daemon would use for the same instrument
                places: vec![InstrumentAddress::Tcp(format!("{}:{SCPI_RAW}", core.ip()))],
                found_by: "vxi-11",
                name: String::new(),
                identity,
            }
        })
    });
    let mut candidates = Vec::new();
    for task in each.collect::<Vec<_>>() {
        candidates.extend(task.await);
    }
    (candidates, notes)
}

/// The reply to `*IDN?` from the instrument behind a core channel.
async fn identify(core: SocketAddr) -> std::io::Result<String> {
    let mut client = Client::new(TcpStream::connect(core).await?);
    let link = client.create_link("inst0").await?;
    client.write(link, b"*IDN?\n").await?;
    let identity = client.read(link, LONGEST).await?;
    client.destroy_link(link).await?;
    Ok(String::from_utf8_lossy(&identity).trim().to_owned())
}
