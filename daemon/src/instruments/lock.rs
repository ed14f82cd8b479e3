//! Locks that reserve each instrument for one daemon. The kernel releases a lock when the process ends for any reason.
//!
//! A lock is a listening socket in Linux's abstract name space: it leaves no file behind, needs no folder shared by
//! several users, and the kernel can report its owner. Any process may take any name, so a lock prevents mistakes, not
//! attacks. `--safe-off` takes no lock: switching off must not wait.

use std::collections::BTreeMap;
use std::net::ToSocketAddrs;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener};
use std::sync::Arc;

use rustix::net::{
    AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with, sockopt,
};

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

/// The locks of a rig; each is released when the last clone that contains it is dropped.
#[derive(Debug, Default, Clone)]
pub(crate) struct InstrumentLocks(BTreeMap<String, Arc<UnixListener>>);

impl InstrumentLocks {
    /// Locks every instrument of a rig. Locks that `self` already holds are shared, so that either set of locks can be
    /// dropped afterwards. Blocks while host names are resolved.
    ///
    /// # Errors
    /// Another daemon holds one of them.
    pub(crate) fn of_rig(&self, places: &InstrumentAddresses) -> Result<Self, InUse> {
        let roles = [
            ("source", &places.source.0),
            ("switch", &places.switch.0),
            ("voltmeter", &places.voltmeter.0),
        ];
        let mut locks = BTreeMap::new();
        for (role, place) in roles {
            let Some(name) = name(place) else {
                continue;
            };
            let lock = match self.0.get(&name).or_else(|| locks.get(&name)) {
                Some(held) => Arc::clone(held),
                None => Arc::new(acquire_lock(&name).map_err(|pid| InUse {
                    role,
                    place: place.to_string(),
                    pid,
                })?),
            };
            locks.insert(name, lock);
        }
        Ok(Self(locks))
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
    let address = SocketAddr::from_abstract_name(&name).map_err(|_| None)?;
    UnixListener::bind_addr(&address).map_err(|_| holder(&name))
}

/// The process that holds a lock. The lock's socket never accepts a connection, so every attempt to connect stays in
/// its queue. The attempt must not block: it would wait for ever once the queue is full.
fn holder(name: &str) -> Option<u32> {
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None).ok()?;
    let lock = SocketAddrUnix::new_abstract_name(name.as_bytes()).ok()?;
    connect(&socket, &lock).ok()?;
    let holder = sockopt::socket_peercred(&socket).ok()?;
    u32::try_from(holder.pid.as_raw_nonzero().get()).ok()
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
        let none = InstrumentLocks::default();
        let mut first = none
            .of_rig(&places("tcp:127.0.0.1:61", "tcp:127.0.0.1:62"))
            .unwrap();
        let refused = none
            .of_rig(&places("tcp:127.0.0.1:63", "tcp:localhost:62"))
            .unwrap_err();
        let text = refused.to_string();
        assert!(
            text.starts_with("the switch at tcp:localhost:62")
                && text.contains(&format!("pid {}", std::process::id())),
            "{text}"
        );
        // the locks of a failed attempt are released, and so are those no longer used
        first = first
            .of_rig(&places("tcp:127.0.0.1:63", "tcp:127.0.0.1:64"))
            .unwrap();
        let second = none
            .of_rig(&places("tcp:127.0.0.1:61", "tcp:127.0.0.1:62"))
            .unwrap();
        drop(first);
        second
            .of_rig(&places("simulated", "tcp:127.0.0.1:64"))
            .unwrap();
    }

    #[test]
    fn a_lock_is_refused_however_often_it_was_before() {
        let name = "tcp:127.0.0.1:68";
        let lock = acquire_lock(name).unwrap();
        let (refused, refusals) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            // more connections than the kernel queues
            let all = (0..5000).all(|_| acquire_lock(name).is_err());
            refused.send(all)
        });
        let deadline = Duration::from_secs(120);
        assert_eq!(refusals.recv_timeout(deadline), Ok(true));
        drop(lock);
        // a program that another test starts at this moment has the lock until it runs
        while acquire_lock(name).is_err() {
            std::thread::yield_now();
        }
    }

    #[test]
    fn either_of_two_rigs_can_be_given_up() {
        let none = InstrumentLocks::default();
        let old = places("tcp:127.0.0.1:65", "tcp:127.0.0.1:66");
        let new = places("tcp:127.0.0.1:67", "tcp:127.0.0.1:66");
        let first = none.of_rig(&old).unwrap();
        let second = first.of_rig(&new).unwrap();
        assert!(none.of_rig(&old).is_err() && none.of_rig(&new).is_err());
        drop(second);
        none.of_rig(&places("tcp:127.0.0.1:67", "simulated"))
            .unwrap();
        none.of_rig(&old).unwrap_err();
        let second = first.of_rig(&new).unwrap();
        drop(first);
        none.of_rig(&places("tcp:127.0.0.1:65", "simulated"))
            .unwrap();
        none.of_rig(&new).unwrap_err();
        drop(second);
    }
}
