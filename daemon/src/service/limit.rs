//! How much one client, and all together, may have of what each costs the daemon something: calls, questions to polkit,
//! connections, streams. What is beyond is refused at once; nothing waits for a place.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use bus::Fault;
use zbus::Connection;
use zbus::message::Header;

/// Calls that wait, for a frame or the end of a session: more than a program has threads, and half of what a broker lets
/// through (dbus-daemon counts 128 replies a connection), for on the peer socket there is none.
pub(super) static CALLS: Limit<String> = Limit::new("calls that are not answered yet", 64, 1024);

/// Questions to polkit that wait for an answer: a client that asks for one thing at a time has one, and no person answers
/// more than a few dialogs. All together few enough that polkit, which others need, too, is not flooded.
pub(super) static QUESTIONS: Limit<String> =
    Limit::new("questions to polkit that are not answered yet", 4, 32);

/// Connections to the peer socket, by user: some programs of one person, each of which has one. A connection costs two
/// descriptors and up to 256 pieces of news; all together stay well below the 1024 descriptors that a process is given. In
/// the unit's user namespace all users but root and the daemon's own are one.
pub(super) static CONNECTIONS: Limit<u32> = Limit::new("connections to the peer socket", 32, 64);

/// Streams that are read: a picture, a recorder and a few more of one client. Each costs a descriptor, a task and the
/// kernel's buffer (200 kB); the records that wait are shared by all.
pub(super) static STREAMS: Limit<String> = Limit::new("open streams", 8, 64);

/// How many of something there may be at once.
#[derive(Debug)]
pub(super) struct Limit<Who> {
    what: &'static str,
    each: usize,
    all: usize,
    held: Mutex<BTreeMap<Who, usize>>,
}

/// A place, given back when dropped.
#[derive(Debug)]
pub(super) struct Place<Who: Ord + 'static> {
    limit: &'static Limit<Who>,
    who: Who,
}

impl<Who> Limit<Who> {
    const fn new(what: &'static str, each: usize, all: usize) -> Self {
        Self {
            what,
            each,
            all,
            held: Mutex::new(BTreeMap::new()),
        }
    }

    fn held(&self) -> MutexGuard<'_, BTreeMap<Who, usize>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<Who: Ord + Clone> Limit<Who> {
    /// A place for one more.
    ///
    /// # Errors
    /// [`Fault::LimitsExceeded`]: this one, or all together, have as many as there may be.
    pub(super) fn take(&'static self, who: Who) -> Result<Place<Who>, Fault> {
        let mut held = self.held();
        let own = held.get(&who).copied().unwrap_or(0);
        let (whose, most) = match () {
            () if own >= self.each => ("you have", self.each),
            () if held.values().sum::<usize>() >= self.all => ("all together have", self.all),
            () => {
                held.insert(who.clone(), own + 1);
                return Ok(Place { limit: self, who });
            }
        };
        Err(Fault::LimitsExceeded(format!(
            "{whose} {most} {}, and there may be no more at once",
            self.what
        )))
    }
}

impl<Who: Ord> Drop for Place<Who> {
    fn drop(&mut self) {
        let mut held = self.limit.held();
        if let Some(own) = held.get_mut(&self.who) {
            *own -= 1;
            if *own == 0 {
                held.remove(&self.who);
            }
        }
    }
}

/// Who a message is from: its sender on a bus, its connection on the peer socket.
pub(super) fn client(connection: &Connection, header: &Header<'_>) -> String {
    match header.sender() {
        Some(sender) if connection.is_bus() => sender.to_string(),
        // each connection has a number of its own
        _ => connection.server_guid().to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_has_its_share_and_all_have_theirs_and_a_place_comes_back() {
        static DISHES: Limit<&str> = Limit::new("dishes", 2, 3);
        let first = DISHES.take("ann").unwrap();
        let _second = DISHES.take("ann").unwrap();
        let refused = |who| match DISHES.take(who) {
            Err(Fault::LimitsExceeded(why)) => why,
            other => panic!("{other:?}"),
        };
        assert_eq!(
            refused("ann"),
            "you have 2 dishes, and there may be no more at once"
        );
        let eve = DISHES.take("eve").unwrap();
        assert_eq!(
            refused("eve"),
            "all together have 3 dishes, and there may be no more at once"
        );
        drop(first);
        let _third = DISHES.take("ann").unwrap();
        drop(eve);
        assert_eq!(DISHES.held().len(), 1, "who has none is forgotten");
    }
}
