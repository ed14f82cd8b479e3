//! How much one user, and all together, may have of what each costs the daemon something: calls, questions to polkit,
//! connections, streams. What is beyond is refused at once; nothing waits for a place.
//!
//! Places are counted by user, because one user may open many connections. Those who may control the rig (root, the
//! daemon's own user, the group) are counted apart from all others: however many strangers look, they have places left.
//! Each kind of call has its own places, so that no number of looks or waits takes the place of a stop.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use dbus::Fault;

/// Calls that are answered at once from memory. A program has a few at a time.
pub(super) static LOOKS: Limit = Limit::new("calls that are not answered yet", 64, 512);

/// Calls that wait, for a frame or the end of a session; those of the programs that one person runs.
pub(super) static WAITS: Limit = Limit::new("calls that wait for a session", 32, 256);

/// Calls that change something, under way after they were allowed.
pub(super) static ACTS: Limit = Limit::new("calls that control the rig", 16, 64);

/// Calls that make the rig safe: nothing else takes these places.
pub(super) static SAFETY: Limit = Limit::new("calls that make the rig safe", 64, 256);

/// Work on the threads that read for clients: what waits for them, and what they do.
pub(crate) static READS: Limit = Limit::new("requests that read or compute", 8, 64);

/// Questions to polkit that wait for an answer: a client that asks for one thing at a time has one, and no person answers
/// more than a few dialogs. All together few enough that polkit, which others need, too, is not flooded.
pub(super) static QUESTIONS: Limit =
    Limit::new("questions to polkit that are not answered yet", 8, 32);

/// Connections to the peer socket: some programs of one person, each of which has one. A connection costs two
/// descriptors and up to 256 pieces of news; all together stay well below the 1024 descriptors that a process is given. In
/// the unit's user namespace all users but root and the daemon's own are one.
pub(super) static CONNECTIONS: Limit = Limit::new("connections to the peer socket", 32, 64);

/// Streams that are read: a picture, a recorder and a few more of one person. Each costs a descriptor, a task and the
/// kernel's buffer (200 kB); the records that wait are shared by all.
pub(super) static STREAMS: Limit = Limit::new("open streams", 16, 64);

tokio::task_local! {
    /// Whose call is being answered.
    static CALLER: User;
}

/// Who is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct User {
    /// The user's number.
    pub id: u32,
    /// Whether they may control the rig where there is no polkit: root, the daemon's own user, the group.
    pub trusted: bool,
}

impl User {
    /// Whose call is being answered; the daemon itself where none is.
    pub(crate) fn calling() -> Self {
        CALLER.try_with(|user| *user).unwrap_or(Self {
            id: rustix::process::geteuid().as_raw(),
            trusted: true,
        })
    }

    /// Answers a call of this user.
    pub(crate) async fn calls<T>(self, answered: impl Future<Output = T>) -> T {
        CALLER.scope(self, answered).await
    }
}

/// How many of something there may be at once.
#[derive(Debug)]
pub(crate) struct Limit {
    what: &'static str,
    each: usize,
    /// All who are trusted, and all who are not.
    all: usize,
    held: Mutex<BTreeMap<User, usize>>,
}

/// A place, given back when dropped.
#[derive(Debug)]
pub(crate) struct Place {
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

    fn held(&self) -> MutexGuard<'_, BTreeMap<User, usize>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A place for one more.
    ///
    /// # Errors
    /// [`Fault::LimitsExceeded`]: this one, or all together, have as many as there may be.
    pub(crate) fn take(&'static self, who: User) -> Result<Place, Fault> {
        let mut held = self.held();
        let own = held.get(&who).copied().unwrap_or(0);
        let alike = held
            .iter()
            .filter(|(other, _)| other.trusted == who.trusted);
        let all: usize = alike.map(|(_, places)| places).sum();
        let (whose, most) = match () {
            () if own >= self.each => ("you have", self.each),
            () if all >= self.all => ("all together have", self.all),
            () => {
                held.insert(who, own + 1);
                return Ok(Place { limit: self, who });
            }
        };
        Err(Fault::LimitsExceeded(format!(
            "{whose} {most} {}, and there may be no more at once",
            self.what
        )))
    }
}

impl Drop for Place {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn user(id: u32) -> User {
        User { id, trusted: false }
    }

    fn refused(answer: Result<Place, Fault>) -> String {
        match answer {
            Err(Fault::LimitsExceeded(why)) => why,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn one_has_its_share_and_all_have_theirs_and_a_place_comes_back() {
        static DISHES: Limit = Limit::new("dishes", 2, 3);
        let (ann, eve) = (user(1), user(2));
        let first = DISHES.take(ann).unwrap();
        let _second = DISHES.take(ann).unwrap();
        assert_eq!(
            refused(DISHES.take(ann)),
            "you have 2 dishes, and there may be no more at once"
        );
        let other = DISHES.take(eve).unwrap();
        assert_eq!(
            refused(DISHES.take(eve)),
            "all together have 3 dishes, and there may be no more at once"
        );
        drop(first);
        let _third = DISHES.take(ann).unwrap();
        drop(other);
        assert_eq!(DISHES.held().len(), 1, "who has none is forgotten");
    }

    #[test]
    fn strangers_cannot_use_up_the_places_of_trusted_users() {
        static CUPS: Limit = Limit::new("cups", 1, 2);
        let _held = [1, 2].map(|id| CUPS.take(user(id)).unwrap());
        assert!(refused(CUPS.take(user(3))).starts_with("all together"));
        let root = User {
            id: 0,
            trusted: true,
        };
        CUPS.take(root).unwrap();
    }
}
