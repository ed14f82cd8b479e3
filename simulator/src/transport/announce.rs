//! mDNS announcement of the served instruments under all their service types, and its withdrawal.
//!
//! `_scpi-raw._tcp` always; `_lxi._tcp`, `_http._tcp` and `_vxi-11._tcp` for the corresponding services, with the same
//! instance name and TXT record. A failure is not fatal: a machine without a multicast route still serves the
//! instruments.

use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use mdns_sd::{IfKind, ServiceDaemon, ServiceInfo};

/// Service types (fact sheet lxi-discovery, section 3).
pub(crate) const SCPI_RAW: &str = "_scpi-raw._tcp.local.";
pub(crate) const LXI: &str = "_lxi._tcp.local.";
pub(crate) const HTTP: &str = "_http._tcp.local.";
pub(crate) const SCPI_TELNET: &str = "_scpi-telnet._tcp.local.";
pub(crate) const VXI_11: &str = "_vxi-11._tcp.local.";

/// Timeout of the withdrawal.
const WITHDRAW_TIMEOUT: Duration = Duration::from_secs(2);

/// An announcement, until [`Announcement::withdraw`].
pub(crate) struct Announcement {
    daemon: ServiceDaemon,
    names: Vec<String>,
}

impl Announcement {
    /// Announces each service: its instrument's `*IDN?` reply, its type, its address; `None`, with a warning, if that
    /// fails.
    pub(crate) fn make(services: &[(String, &'static str, SocketAddr)]) -> Option<Self> {
        let daemon = ServiceDaemon::new()
            .inspect_err(|fault| tracing::warn!("instruments are not announced: {fault}"))
            .ok()?;
        if services
            .iter()
            .any(|(_, _, address)| address.ip().is_loopback())
        {
            // Disabled by default; a service bound to this interface can only be found on it.
            daemon.enable_interface(IfKind::LoopbackV4).ok();
            daemon.enable_interface(IfKind::LoopbackV6).ok();
        }
        let mut names = Vec::new();
        for (identity, kind, address) in services {
            match service(identity, kind, *address).and_then(|service| {
                let name = service.get_fullname().to_owned();
                daemon.register(service).map(|()| name)
            }) {
                Ok(name) => names.push(name),
                Err(fault) => tracing::warn!("'{identity}' is not announced: {fault}"),
            }
        }
        Some(Self { daemon, names })
    }

    /// Sends the goodbye records, which withdraw the announcement.
    pub(crate) async fn withdraw(self) {
        for name in &self.names {
            if let Ok(gone) = self.daemon.unregister(name) {
                tokio::time::timeout(WITHDRAW_TIMEOUT, gone.recv_async())
                    .await
                    .ok();
            }
        }
        if let Ok(ended) = self.daemon.shutdown() {
            tokio::time::timeout(WITHDRAW_TIMEOUT, ended.recv_async())
                .await
                .ok();
        }
    }
}

/// The four fields of `*IDN?`, unchanged, in the order of the fact sheet.
pub(crate) fn properties(identity: &str) -> Vec<(&'static str, String)> {
    let mut fields = identity.splitn(4, ',').map(str::to_owned);
    let mut next = || fields.next().unwrap_or_default();
    vec![
        ("txtvers", "1".to_owned()),
        ("Manufacturer", next()),
        ("Model", next()),
        ("SerialNumber", next()),
        ("FirmwareVersion", next()),
    ]
}

fn service(identity: &str, kind: &str, address: SocketAddr) -> mdns_sd::Result<ServiceInfo> {
    let properties = properties(identity);
    let (model, serial) = (&properties[2].1, &properties[3].1);
    let instance = format!("Tactus simulated {model} #{serial}");
    let letters = |text: &str| -> String {
        text.chars()
            .filter(char::is_ascii_alphanumeric)
            .collect::<String>()
            .to_lowercase()
    };
    let host = format!("tactus-{}-{}.local.", letters(model), letters(serial));
    let anywhere = address.ip().is_unspecified();
    let addresses: &[IpAddr] = if anywhere { &[] } else { &[address.ip()] };
    let service = ServiceInfo::new(
        kind,
        &instance,
        &host,
        addresses,
        address.port(),
        &properties[..],
    )?;
    Ok(if anywhere {
        service.enable_addr_auto()
    } else {
        service
    })
}

#[cfg(test)]
mod tests {
    use crate::transport::announce::*;

    #[test]
    fn the_txt_record_is_the_idn_reply_byte_for_byte() {
        let identity = "KEITHLEY INSTRUMENTS INC.,MODEL 6221,1234567,D04  /700x,1";
        let properties = properties(identity);
        assert_eq!(properties[0], ("txtvers", "1".to_owned()));
        let joined: Vec<&str> = properties[1..]
            .iter()
            .map(|(_, value)| value.as_str())
            .collect();
        assert_eq!(joined.join(","), identity);
        let service = service(identity, SCPI_RAW, "127.0.0.1:1394".parse().unwrap()).unwrap();
        assert_eq!(service.get_port(), 1394);
        assert!(
            service
                .get_fullname()
                .contains("Tactus simulated MODEL 6221 #1234567")
        );
    }
}
