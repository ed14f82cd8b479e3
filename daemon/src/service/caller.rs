//! Identifies a caller: by the kernel on a socket, by the broker on a bus.

use std::io;
use std::mem::{size_of, size_of_val};
use std::os::fd::AsRawFd;

use tokio::net::UnixStream;
use zbus::names::{BusName, UniqueName};
use zbus::{Connection, fdo::DBusProxy};

use super::limit::User;

/// The group with the same rights as the daemon's own user.
pub(super) const GROUP: &str = "tactus";
/// Maximum number of supplementary groups that Linux allows (`NGROUPS_MAX`).
const MOST_GROUPS: usize = 65536;

/// A caller's user and groups.
#[derive(Debug)]
pub(super) struct Caller {
    user: u32,
    groups: Vec<u32>,
    /// The user for limits, computed once for all calls of the caller.
    counted: User,
}

/// The sender of a message on a bus.
///
/// # Errors
/// The sender has left the bus, or the bus does not report its user.
pub(super) async fn of(connection: &Connection, sender: &UniqueName<'_>) -> zbus::Result<Caller> {
    let bus = DBusProxy::new(connection).await?;
    let credentials = bus
        .get_connection_credentials(BusName::from(sender.to_owned()))
        .await?;
    let user = credentials
        .unix_user_id()
        .ok_or_else(|| zbus::Error::Failure("it does not report the user".into()))?;
    // a bus without group ids (before dbus 1.14): only root and the daemon's own user are recognised
    let groups = credentials.unix_group_ids().cloned().unwrap_or_default();
    Ok(Caller::new(user, groups))
}

impl Caller {
    /// The process at the other end of a socket. Also works in the daemon's user namespace, in which other users'
    /// numbers are not visible, but the group's number is.
    ///
    /// # Errors
    /// The kernel does not report the credentials.
    pub(super) fn at(stream: &UnixStream) -> io::Result<Self> {
        let who = stream.peer_cred()?;
        let mut groups = peer_groups(stream)?;
        groups.push(who.gid());
        Ok(Self::new(who.uid(), groups))
    }

    fn new(user: u32, groups: Vec<u32>) -> Self {
        let mut caller = Self {
            user,
            groups,
            counted: User {
                id: user,
                trusted: false,
            },
        };
        caller.counted.trusted = caller.is_ours() || caller.is_member();
        caller
    }

    /// The number of its user. In a user namespace, all users that are not visible there have the same number.
    pub(super) fn user(&self) -> u32 {
        self.user
    }

    /// The user for limits.
    pub(super) fn counted(&self) -> User {
        self.counted
    }

    /// Root, or the daemon's own user.
    pub(super) fn is_ours(&self) -> bool {
        self.user == 0 || self.user == rustix::process::geteuid().as_raw()
    }

    /// Whether the caller is a member of the group.
    pub(super) fn is_member(&self) -> bool {
        let groups = std::fs::read_to_string("/etc/group").unwrap_or_default();
        number(&groups).is_some_and(|group| self.groups.contains(&group))
    }
}

/// The group's number, in the text of `/etc/group`.
fn number(groups: &str) -> Option<u32> {
    groups
        .lines()
        .map(|line| line.split(':').collect::<Vec<_>>())
        .find(|fields| fields.first() == Some(&GROUP))
        .and_then(|fields| fields.get(2)?.parse().ok())
}

/// `SO_PEERGROUPS` (unix(7)): the supplementary groups that the other end had when it connected.
// the libraries in use have no safe function for this socket option
#[allow(unsafe_code)]
fn peer_groups(stream: &impl AsRawFd) -> io::Result<Vec<u32>> {
    let mut groups = vec![0_u32; MOST_GROUPS];
    let mut bytes = size_of_val(groups.as_slice()) as libc::socklen_t;
    // SAFETY: the pointer refers to the stated number of bytes, and the kernel writes no more than those
    let answered = unsafe {
        libc::getsockopt(
            stream.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_PEERGROUPS,
            groups.as_mut_ptr().cast(),
            &mut bytes,
        )
    };
    if answered != 0 {
        return Err(io::Error::last_os_error());
    }
    groups.truncate(bytes as usize / size_of::<u32>());
    // kept as long as the connection
    groups.shrink_to_fit();
    Ok(groups)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_group_is_known_by_its_name() {
        let groups = "ann:x:1000:\nnot-tactus:x:5:\ntactus:x:990:ann,eve\n";
        assert_eq!(number(groups), Some(990));
        assert_eq!(number("ann:x:1000:\n"), None);
        assert_eq!(number("tactus:x:many:\n"), None);
    }

    #[test]
    #[allow(unsafe_code)]
    fn a_caller_may_have_as_many_groups_as_linux_allows() {
        if !rustix::process::geteuid().is_root() {
            return needs::lacking("ROOT", "only root can set its groups");
        }
        let all: Vec<u32> = (1..=65536).collect();
        // the system call, unlike the function of the C library, changes the groups of one thread only
        let of_thread = std::thread::spawn(move || {
            // SAFETY: the pointer refers to the stated number of group numbers, which the kernel only reads
            let set = unsafe { libc::syscall(libc::SYS_setgroups, all.len(), all.as_ptr()) };
            assert_eq!(set, 0, "{}", io::Error::last_os_error());
            let (ours, _theirs) = std::os::unix::net::UnixStream::pair().unwrap();
            peer_groups(&ours).map(|groups| groups == all)
        });
        assert!(of_thread.join().unwrap().unwrap());
    }

    #[tokio::test]
    async fn the_kernel_names_the_client_of_a_connection() {
        let (ours, _theirs) = UnixStream::pair().unwrap();
        let caller = Caller::at(&ours).unwrap();
        assert!(caller.is_ours());
        assert!(caller.groups.contains(&rustix::process::getegid().as_raw()));
        let own = rustix::process::getgroups().unwrap();
        assert!(
            own.iter()
                .all(|group| caller.groups.contains(&group.as_raw())),
            "{caller:?} is not of all of {own:?}"
        );
        assert!(caller.counted().trusted);
        let stranger = Caller::new(4_000_000_000, vec![4_000_000_000]);
        assert!(!stranger.is_ours() && !stranger.is_member());
        assert!(!stranger.counted().trusted);
    }
}
