//! Discovery of instruments by mDNS, VXI-11 broadcast, and given addresses. Results are proposals; none is used.
//!
//! Instruments are identified only by their reply to `*IDN?`, the only command sent; announcements are not trusted.
//! Each method may fail: a machine without multicast still queries the given addresses, and reports the failure.

mod mdns;
#[cfg(test)]
mod tests;
mod vxi11;

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::time::Duration;

use dbus::{Discovery, SeenInstrument};
use rig::Link;
use survey::{printable, printable_within};

use crate::instruments::address::InstrumentAddress;
use crate::instruments::kinds;

/// Timeout of a connection, and of a reply to `*IDN?`.
const REPLY_TIMEOUT: Duration = Duration::from_secs(2);
/// SCPI port of a 34980A (fact sheet lxi-discovery, section 2).
const SCPI_RAW: u16 = 5025;

/// Maximum number of characters kept of a reply or announcement; an identity has some 50.
const LONGEST_TEXT: usize = 200;

/// What to look for, and where.
#[derive(Debug, Clone)]
pub(crate) struct Search {
    /// Time to wait for announcements and broadcast replies.
    pub within: Duration,
    pub mdns: bool,
    pub broadcast: bool,
    /// Port of the port mapper, 111 except in tests.
    pub port_mapper: u16,
    /// Additional addresses to query.
    pub addresses: Vec<InstrumentAddress>,
    /// Instruments in use, with their identity when they were connected: they are not queried again, since some serve
    /// one client only.
    pub in_use: Vec<(String, String)>,
}

impl Default for Search {
    fn default() -> Self {
        Self {
            within: Duration::from_secs(3),
            mdns: true,
            broadcast: true,
            port_mapper: 111,
            addresses: Vec::new(),
            in_use: Vec::new(),
        }
    }
}

/// A possible instrument, and the addresses where it may be reached.
#[derive(Debug, Clone)]
struct Candidate {
    places: Vec<InstrumentAddress>,
    found_by: &'static str,
    name: String,
    /// The identity, if the discovery method has already queried it.
    identity: Option<String>,
}

/// Runs all methods and queries each candidate's identity.
pub(crate) async fn discover(search: &Search) -> Discovery {
    let mut found = Discovery::default();
    let announced = async {
        match search.mdns {
            true => mdns::browse(search.within).await,
            false => (Vec::new(), None),
        }
    };
    let answered = async {
        match search.broadcast {
            true => vxi11::broadcast(search.within, search.port_mapper).await,
            false => (Vec::new(), Vec::new()),
        }
    };
    let ((announced, silent), (answered, refused)) = tokio::join!(announced, answered);
    found.notes.extend(silent);
    found.notes.extend(refused);
    let given = search.addresses.iter().map(|place| Candidate {
        places: vec![place.clone()],
        found_by: "address",
        name: String::new(),
        identity: None,
    });
    for (address, identity) in &search.in_use {
        let identities =
            found_instrument(address.clone(), identity.clone(), "configuration", "", true);
        found.seen.push(identities);
    }
    let used = used_sockets(&search.in_use).await;
    let candidates: Vec<Candidate> = given.chain(announced).chain(answered).collect();
    let requested = candidates.into_iter().map(|candidate| {
        let used = used.clone();
        tokio::spawn(async move { ask(candidate, &used).await })
    });
    // all are queried in parallel: an unresponsive one must not delay the others
    for task in requested.collect::<Vec<_>>() {
        if let Ok(seen) = task.await {
            add(&mut found.seen, seen);
        }
    }
    found
}

/// A socket in use, its address in the configuration, its identity.
type Used = (SocketAddr, String, String);

/// Sockets of instruments in use, each with its address in the configuration and its identity.
async fn used_sockets(in_use: &[(String, String)]) -> Vec<Used> {
    let mut sockets = Vec::new();
    for (place, identity) in in_use {
        let Some(address) = place.strip_prefix("tcp:") else {
            continue;
        };
        if let Ok(resolved) = tokio::net::lookup_host(address).await {
            sockets.extend(resolved.map(|socket| (socket, place.clone(), identity.clone())));
        }
    }
    sockets
}

/// Queries a candidate's identity at the first address that replies.
async fn ask(candidate: Candidate, used: &[Used]) -> SeenInstrument {
    let Candidate {
        places,
        found_by,
        name,
        identity,
    } = candidate;
    let mut remark = String::new();
    for place in &places {
        if let InstrumentAddress::Tcp(address) = place
            && let Ok(resolved) = tokio::net::lookup_host(address).await
        {
            let resolved: BTreeSet<SocketAddr> = resolved.collect();
            if let Some((_, place, identity)) =
                used.iter().find(|(socket, ..)| resolved.contains(socket))
            {
                return found_instrument(place.clone(), identity.clone(), found_by, &name, true);
            }
        }
        match identify(place).await {
            Ok(identity) => {
                return found_instrument(place.to_string(), identity, found_by, &name, false);
            }
            Err(why) => remark = why,
        }
    }
    let identities = identity.is_some();
    let address = match (identities, places.first()) {
        (false, Some(place)) => place.to_string(),
        _ => String::new(),
    };
    SeenInstrument {
        remark: match identities {
            true => {
                "it replies on VXI-11 only; the daemon uses raw sockets and serial lines".to_owned()
            }
            false => remark,
        },
        proposal: String::new(),
        ..found_instrument(
            address,
            identity.unwrap_or_default(),
            found_by,
            &name,
            false,
        )
    }
}

/// Sends `*IDN?` only, then closes the connection.
async fn identify(place: &InstrumentAddress) -> Result<String, String> {
    let stream = match place {
        InstrumentAddress::Tcp(address) => rig::connect_tcp(address, REPLY_TIMEOUT).await,
        InstrumentAddress::Serial { path, baud } => {
            rig::open_serial(path, baud.unwrap_or(kinds::DISCOVERY_BAUD))
        }
        InstrumentAddress::Simulated | InstrumentAddress::Gpiochip { .. } => {
            return Err("an instrument of this kind has no identity to query".to_owned());
        }
    };
    let stream = stream.map_err(|cause| survey::error_chain(&cause))?;
    let mut link = Link::new(stream, place.to_string(), REPLY_TIMEOUT);
    let answer = link.ask("*IDN?").await;
    answer.map_err(|cause| survey::error_chain(&cause))
}

/// Merges duplicates: the same identity at the same address, or the same serial number, is one instrument.
fn add(all: &mut Vec<SeenInstrument>, one: SeenInstrument) {
    let same = all.iter_mut().find(|identities| {
        let identity = !one.identity.is_empty() && identities.identity == one.identity;
        let address = !one.address.is_empty() && identities.address == one.address;
        let name = !one.name.is_empty() && identities.name == one.name;
        identity || address || name
    });
    let Some(identities) = same else {
        all.push(one);
        return;
    };
    if !identities.found_by.contains(&one.found_by) {
        identities.found_by = format!("{}, {}", identities.found_by, one.found_by);
    }
    if identities.name.is_empty() {
        identities.name = one.name;
    }
    if (identities.identity.is_empty() && !one.identity.is_empty()) || identities.address.is_empty()
    {
        identities.address = one.address;
        identities.identity = one.identity;
        identities.proposal = one.proposal;
        identities.remark = one.remark;
    }
    identities.in_use |= one.in_use;
}

fn found_instrument(
    address: String,
    identity: String,
    found_by: &str,
    name: &str,
    in_use: bool,
) -> SeenInstrument {
    let identity = printable_within(&identity, LONGEST_TEXT).into_owned();
    let (proposal, remark) = propose(&address, &identity);
    SeenInstrument {
        proposal,
        remark,
        address,
        identity,
        found_by: found_by.to_owned(),
        name: printable_within(name, LONGEST_TEXT).into_owned(),
        in_use,
    }
}

/// Proposed lines of configuration, by the model in its identity.
fn propose(address: &str, identity: &str) -> (String, String) {
    let model = identity.split(',').nth(1).unwrap_or_default().trim();
    // an address may contain a host name from outside, and these lines are copied into a configuration
    let address = toml::Value::String(printable(address).into_owned());
    match kinds::proposal(model) {
        Some((section, further_lines)) => (
            format!("[{section}]\naddress = {address}{further_lines}"),
            String::new(),
        ),
        None if identity.is_empty() => (String::new(), String::new()),
        None => {
            let remark = "an instrument that the daemon has no driver for".to_owned();
            (String::new(), remark)
        }
    }
}
