//! Locks that allow one daemon an instrument; the kernel releases a lock when the process ends, however it ends.
//!
//! A lock is a listening socket in Linux's abstract name space: it leaves no file behind, needs no folder shared by
//! several users, and the kernel can report its owner. Any process may take any name, so a lock prevents mistakes, not
//! attacks. `--safe-off` takes no lock: switching off must not wait.

use std::collections::BTreeMap;
use std::net::ToSocketAddrs;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener, UnixStream};

use crate::instruments::address::InstrumentAddress;
use crate::instruments::rig_plan::InstrumentAddresses;

/// Another process uses an instrument.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the {role} at {place} is in use by another daemon{}; stop that one first",
    .pid.map(|pid| format!(" (pid {pid})")).unwrap_or_default()
)]
pub(crate) struct InUse {
    role: &'static str,
    place: String,
    pid: Option<u32>,
}

/// The locks of this daemon; released when dropped.
#[derive(Debug, Default)]
pub(crate) struct InstrumentLocks(BTreeMap<String, UnixListener>);

impl InstrumentLocks {
    /// Locks every instrument of a rig, and releases those no longer used.
    ///
    /// # Errors
    /// Another daemon holds one of them; then nothing has changed.
    pub(crate) fn take(&mut self, places: &InstrumentAddresses) -> Result<(), InUse> {
        let roles = [
            ("source", &places.source.0),
            ("switch", &places.switch.0),
            ("voltmeter", &places.voltmeter.0),
        ];
        let mut new = BTreeMap::new();
        let mut wanted = Vec::new();
        for (role, place) in roles {
            let Some(name) = name(place) else {
                continue;
            };
            wanted.push(name.clone());
            if self.0.contains_key(&name) || new.contains_key(&name) {
                continue;
            }
            let held = acquire_lock(&name).map_err(|pid| InUse {
                role,
                place: place.to_string(),
                pid,
            })?;
            new.insert(name, held);
        }
        self.0.append(&mut new);
        self.0.retain(|name, _| wanted.contains(name));
        Ok(())
    }
}

/// Name of an instrument's lock, the same for all forms of its address; `None` for a simulated one.
fn name(place: &InstrumentAddress) -> Option<String> {
    let real = |path: &str| {
        std::fs::canonicalize(path).map_or_else(
            |_| path.to_owned(),
            |path| path.to_string_lossy().into_owned(),
        )
    };
    match place {
        InstrumentAddress::Simulated => None,
        InstrumentAddress::Tcp(address) => {
            let found = address
                .to_socket_addrs()
                .ok()
                .and_then(|mut all| all.next());
            Some(found.map_or_else(|| address.clone(), |found| found.to_string()))
        }
        InstrumentAddress::Serial { path, .. } | InstrumentAddress::Gpiochip { path, .. } => {
            Some(real(path))
        }
    }
}

/// Takes a lock; fails with the process that holds it, if the kernel reports it.
fn acquire_lock(name: &str) -> Result<UnixListener, Option<u32>> {
    let name = format!("tactus instrument {name}");
    let address = SocketAddr::from_abstract_name(name).map_err(|_| None)?;
    UnixListener::bind_addr(&address).map_err(|_| {
        let holder = UnixStream::connect_addr(&address).ok()?;
        let holder = rustix::net::sockopt::socket_peercred(&holder).ok()?;
        u32::try_from(holder.pid.as_raw_nonzero().get()).ok()
    })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use crate::instruments::lock::*;
    use config::EnableName;

    fn places(source: &str, mainframe: &str) -> InstrumentAddresses {
        let place = |text: &str| (text.parse().unwrap(), Duration::ZERO);
        InstrumentAddresses {
            source: place(source),
            switch: place(mainframe),
            voltmeter: place(mainframe),
            enable: EnableName::Low,
        }
    }

    #[test]
    fn an_instrument_has_one_daemon_under_whichever_name() {
        // ports that no other test uses, without listeners
        let mut first = InstrumentLocks::default();
        first
            .take(&places("tcp:127.0.0.1:61", "tcp:127.0.0.1:62"))
            .unwrap();
        let mut second = InstrumentLocks::default();
        let refused = second
            .take(&places("tcp:127.0.0.1:63", "tcp:localhost:62"))
            .unwrap_err();
        let text = refused.to_string();
        assert!(
            text.starts_with("the switch at tcp:localhost:62")
                && text.contains(&format!("pid {}", std::process::id())),
            "{text}"
        );
        // locks of a failed attempt are released, and so are unused ones
        first
            .take(&places("tcp:127.0.0.1:63", "tcp:127.0.0.1:64"))
            .unwrap();
        second
            .take(&places("tcp:127.0.0.1:61", "tcp:127.0.0.1:62"))
            .unwrap();
        drop(first);
        second
            .take(&places("simulated", "tcp:127.0.0.1:64"))
            .unwrap();
    }
}
