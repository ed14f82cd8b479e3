//! Limits for each user, and in total, of calls, polkit queries, connections and streams. Requests beyond a limit are
//! refused at once; none waits.
//!
//! Limits are counted by user, because one user may open many connections. Trusted users (root, the daemon's own user,
//! the group) are counted separately from all others, who cannot exhaust their limits. Each kind of call has separate
//! limits, so that reading and waiting calls cannot block a stop.

use std::collections::BTreeMap;
use std::sync::Mutex;

use dbus::Fault;

use crate::locked::locked;

/// Calls that are replied immediately, from memory. A program has a few at a time.
pub(super) static QUERIES: Limit = Limit::new("calls that are not answered yet", 64, 512);

/// Calls that wait for a frame or the end of a session.
pub(super) static WAITING_CALLS: Limit = Limit::new("calls that wait for a session", 32, 256);

/// Calls that change something, running after they were admitted.
pub(super) static COMMANDS: Limit = Limit::new("calls that control the rig", 16, 64);

/// Calls that make the rig safe, with a separate limit.
pub(super) static SAFETY_CALLS: Limit = Limit::new("calls that make the rig safe", 64, 256);

/// Work on the reading threads, waiting or running.
pub(crate) static READ_JOBS: Limit = Limit::new("requests that read or compute", 8, 64);

/// Pending polkit queries: a normal client has one at a time, and a user answers few dialogs. The total is small, so
/// that polkit, which other services need too, is not flooded.
pub(super) static POLKIT_QUERIES: Limit = Limit::new("polkit queries without a reply", 8, 32);

/// Connections to the peer socket; each program has one. A connection costs two descriptors and up to 256 queued
/// events; the total stays well below a process's 1024 descriptors. In the unit's user namespace all users except root
/// and the daemon's own count as one.
pub(super) static CONNECTIONS: Limit = Limit::new("connections to the peer socket", 32, 64);

/// Open streams. Each costs a descriptor, a task and the kernel's buffer (200 kB); waiting records are shared by all.
pub(super) static STREAMS: Limit = Limit::new("open streams", 16, 64);

tokio::task_local! {
    /// The user whose call is being served.
    static CALLER: User;
}

/// A user, for limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct User {
    /// The user's number.
    pub id: u32,
    /// Whether the user has access without polkit: root, the daemon's own user, the group.
    pub trusted: bool,
}

impl User {
    /// The user whose call is being served; otherwise the daemon itself.
    pub(crate) fn calling() -> Self {
        CALLER.try_with(|user| *user).unwrap_or(Self {
            id: rustix::process::geteuid().as_raw(),
            trusted: true,
        })
    }

    /// Serves a call of this user.
    pub(crate) async fn calls<T>(self, answered: impl Future<Output = T>) -> T {
        CALLER.scope(self, answered).await
    }
}

/// A limit of concurrent uses.
#[derive(Debug)]
pub(crate) struct Limit {
    what: &'static str,
    each: usize,
    /// Total for trusted users, and for all others.
    all: usize,
    held: Mutex<BTreeMap<User, usize>>,
}

/// One use, released when dropped.
#[derive(Debug)]
pub(crate) struct Permit {
    limit: &'static Limit,
    who: User,
}

impl Limit {
    const fn new(what: &'static str, each: usize, all: usize) -> Self {
        Self {
            what,
            each,
            all,
            held: Mutex::new(BTreeMap::new()),
        }
    }

    /// Takes one use.
    ///
    /// # Errors
    /// [`Fault::LimitsExceeded`]: the user's limit or the total is reached.
    pub(crate) fn take(&'static self, who: User) -> Result<Permit, Fault> {
        let mut held = locked(&self.held);
        let own = held.get(&who).copied().unwrap_or(0);
        let alike = held
            .iter()
            .filter(|(other, _)| other.trusted == who.trusted);
        let all: usize = alike.map(|(_, permits)| permits).sum();
        let (whose, most) = match () {
            () if own >= self.each => ("you have", self.each),
            () if all >= self.all => ("all together have", self.all),
            () => {
                held.insert(who, own + 1);
                return Ok(Permit { limit: self, who });
            }
        };
        Err(Fault::LimitsExceeded(format!(
            "{whose} {most} {}, which is the limit; try again when one has ended",
            self.what
        )))
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        let mut held = locked(&self.limit.held);
        if let Some(own) = held.get_mut(&self.who) {
            *own -= 1;
            if *own == 0 {
                held.remove(&self.who);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn user(id: u32) -> User {
        User { id, trusted: false }
    }

    fn refused(answer: Result<Permit, Fault>) -> String {
        match answer {
            Err(Fault::LimitsExceeded(why)) => why,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn each_user_and_all_have_a_limit_and_a_permit_is_returned() {
        static TWO_EACH: Limit = Limit::new("dishes", 2, 3);
        let (ann, eve) = (user(1), user(2));
        let first = TWO_EACH.take(ann).unwrap();
        let _second = TWO_EACH.take(ann).unwrap();
        assert_eq!(
            refused(TWO_EACH.take(ann)),
            "you have 2 dishes, which is the limit; try again when one has ended"
        );
        let other = TWO_EACH.take(eve).unwrap();
        assert_eq!(
            refused(TWO_EACH.take(eve)),
            "all together have 3 dishes, which is the limit; try again when one has ended"
        );
        drop(first);
        let _third = TWO_EACH.take(ann).unwrap();
        drop(other);
        assert_eq!(locked(&TWO_EACH.held).len(), 1, "who has none is forgotten");
    }

    #[test]
    fn strangers_cannot_use_up_the_limit_of_trusted_users() {
        static ONE_EACH: Limit = Limit::new("cups", 1, 2);
        let _held = [1, 2].map(|id| ONE_EACH.take(user(id)).unwrap());
        assert!(refused(ONE_EACH.take(user(3))).starts_with("all together"));
        let root = User {
            id: 0,
            trusted: true,
        };
        ONE_EACH.take(root).unwrap();
    }
}
