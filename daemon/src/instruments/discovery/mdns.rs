//! Finds instruments announced by mDNS (fact sheet lxi-discovery, sections 3 and 7).

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr, UdpSocket};
use std::time::Duration;

use mdns_sd::{IfKind, ServiceDaemon, ServiceEvent};
use tokio::time::Instant;

use crate::instruments::address::InstrumentAddress;
use crate::instruments::discovery::{Candidate, SCPI_RAW};

/// Service types: first the one whose port is a SCPI socket; the others only show that a device exists.
const TYPES: [&str; 5] = [
    "_scpi-raw._tcp.local.",
    "_lxi._tcp.local.",
    "_vxi-11._tcp.local.",
    "_hislip._tcp.local.",
    "_scpi-telnet._tcp.local.",
];
/// Multicast address of mDNS.
const GROUP: Ipv4Addr = Ipv4Addr::new(224, 0, 0, 251);

/// Data of one device.
#[derive(Default)]
struct Instance {
    hosts: Vec<IpAddr>,
    /// Port of its SCPI socket.
    port: Option<u16>,
}

/// Collects announcements; returns a note if there is no multicast.
pub(super) async fn browse(within: Duration) -> (Vec<Candidate>, Option<String>) {
    let note = no_multicast();
    let daemon = match ServiceDaemon::new() {
        Ok(daemon) => daemon,
        Err(fault) => {
            return (
                Vec::new(),
                Some(format!(
                    "mDNS is not available here ({fault}); give addresses instead"
                )),
            );
        }
    };
    // the loopback interface is off by default; simulators on this machine may be announced only there
    daemon.enable_interface(IfKind::LoopbackV4).ok();
    daemon.enable_interface(IfKind::LoopbackV6).ok();
    let until = Instant::now() + within;
    let received = TYPES.map(|kind| {
        let events = daemon.browse(kind);
        async move {
            let mut resolved = Vec::new();
            let Ok(events) = events else { return resolved };
            while let Ok(Ok(event)) = tokio::time::timeout_at(until, events.recv_async()).await {
                if let ServiceEvent::ServiceResolved(service) = event {
                    resolved.push((kind, service));
                }
            }
            resolved
        }
    });
    let [raw, lxi, vxi, hislip, telnet] = received;
    let (raw, lxi, vxi, hislip, telnet) = tokio::join!(raw, lxi, vxi, hislip, telnet);
    daemon.shutdown().ok();
    let mut instances: BTreeMap<String, Instance> = BTreeMap::new();
    for (kind, service) in [raw, lxi, vxi, hislip, telnet].into_iter().flatten() {
        // an instrument has the same name under every service type and on every interface
        let name = service
            .fullname
            .trim_end_matches(kind)
            .trim_end_matches('.');
        let instance = instances.entry(name.to_owned()).or_default();
        for address in &service.addresses {
            let address = address.to_ip_addr();
            if !instance.hosts.contains(&address) {
                instance.hosts.push(address);
            }
        }
        if kind == TYPES[0] {
            instance.port = Some(service.port);
        }
    }
    let candidates = instances.into_iter().map(|(name, mut instance)| {
        // IPv4 first, and loopback last: an address that other machines can use is proposed if there is one
        instance
            .hosts
            .sort_by_key(|host| (host.is_loopback(), host.is_ipv6(), *host));
        let port = instance.port.unwrap_or(SCPI_RAW);
        let place = |host: IpAddr| match host {
            IpAddr::V4(host) => InstrumentAddress::Tcp(format!("{host}:{port}")),
            IpAddr::V6(host) => InstrumentAddress::Tcp(format!("[{host}]:{port}")),
        };
        Candidate {
            places: instance.hosts.into_iter().map(place).collect(),
            found_by: "mdns",
            name,
            identity: None,
        }
    });
    (candidates.collect(), note)
}

/// Error of the operating system if no interface supports multicast.
fn no_multicast() -> Option<String> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).ok()?;
    let refused = socket
        .join_multicast_v4(&GROUP, &Ipv4Addr::UNSPECIFIED)
        .err()?;
    Some(format!(
        "this machine has no multicast ({refused}): announcements of instruments cannot be received; give addresses \
         instead"
    ))
}
