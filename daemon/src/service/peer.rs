//! The peer socket: D-Bus without a broker, one connection a client, the kernel says who it is.

use std::io;
use std::os::unix::fs::{DirBuilderExt, FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use tokio::net::{UnixListener, UnixStream};
use zbus::connection::Builder;

use crate::keeper::Keeper;

/// How long a client may take to introduce itself.
const TO_GREET: Duration = Duration::from_secs(5);
/// The group that may talk to the daemon.
const GROUP: &str = "tactus";

/// A socket that is removed again.
#[derive(Debug)]
pub(super) struct Listener {
    socket: UnixListener,
    path: PathBuf,
}

impl Drop for Listener {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Binds the socket, in a folder made for it if need be; a socket left over by a dead daemon is replaced, a living one
/// is not.
pub(super) fn bind(path: &Path) -> io::Result<Listener> {
    if let Some(folder) = path.parent()
        && !folder.as_os_str().is_empty()
        && !folder.exists()
    {
        std::fs::DirBuilder::new()
            .recursive(true)
            .mode(0o750)
            .create(folder)?;
    }
    match std::fs::symlink_metadata(path) {
        Ok(found) if !found.file_type().is_socket() => {
            return Err(io::Error::new(
                io::ErrorKind::AlreadyExists,
                "something that is no socket is there",
            ));
        }
        Ok(_) => {
            if std::os::unix::net::UnixStream::connect(path).is_ok() {
                return Err(io::Error::new(
                    io::ErrorKind::AddrInUse,
                    "another daemon listens there",
                ));
            }
            std::fs::remove_file(path)?;
        }
        Err(_) => {}
    }
    let socket = UnixListener::bind(path)?;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o660))?;
    Ok(Listener {
        socket,
        path: path.to_owned(),
    })
}

/// Serves everybody who may be served, for ever.
pub(super) async fn serve(listener: Listener, keeper: Arc<Keeper>) {
    loop {
        match listener.socket.accept().await {
            Ok((stream, _)) => {
                tokio::spawn(attend(stream, Arc::clone(&keeper)));
            }
            Err(error) => {
                tracing::warn!("the peer socket: {error}");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

/// One client, until it goes.
async fn attend(stream: UnixStream, keeper: Arc<Keeper>) {
    let allowed = match stream.peer_cred() {
        Ok(who) => may(who.uid(), who.gid()),
        Err(_) => false,
    };
    if !allowed {
        tracing::warn!("a user who is neither ours, root, nor of group {GROUP} was turned away");
        return;
    }
    let Ok(stream) = stream.into_std() else {
        return;
    };
    let Ok(hang_up) = stream.try_clone() else {
        return;
    };
    // listened to before it can speak: nothing is missed between
    let mut news = keeper.herald.listen();
    let builder = Builder::unix_stream(stream)
        .server(zbus::Guid::generate())
        .p2p();
    let greeted = super::furnish(builder, &keeper).build();
    let connection = match tokio::time::timeout(TO_GREET, greeted).await {
        Ok(Ok(connection)) => connection,
        Ok(Err(error)) => {
            tracing::debug!("a client did not come to speak: {error}");
            return;
        }
        Err(_) => return,
    };
    loop {
        tokio::select! {
            () = connection.closed() => return,
            notice = news.recv() => {
                let Some(notice) = notice else { return };
                if !super::say(&connection, &keeper, notice).await {
                    // answers that wait for a reader who never reads end with the socket
                    let _ = hang_up.shutdown(std::net::Shutdown::Both);
                    return;
                }
            }
        }
    }
}

/// The daemon's own user, root, and members of the group. Primary group as the kernel says; further members as the
/// system's files say.
fn may(uid: u32, gid: u32) -> bool {
    if uid == 0 || uid == rustix::process::geteuid().as_raw() {
        return true;
    }
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    is_member(uid, gid, &read("/etc/passwd"), &read("/etc/group"))
}

fn is_member(uid: u32, gid: u32, passwd: &str, group: &str) -> bool {
    let Some(entry) = group
        .lines()
        .map(|line| line.split(':').collect::<Vec<_>>())
        .find(|fields| fields.first() == Some(&GROUP))
    else {
        return false;
    };
    if entry.get(2).and_then(|id| id.parse().ok()) == Some(gid) {
        return true;
    }
    let user = passwd
        .lines()
        .map(|line| line.split(':').collect::<Vec<_>>())
        .find(|fields| fields.get(2).and_then(|id| id.parse().ok()) == Some(uid));
    let Some(name) = user.and_then(|fields| fields.first().copied()) else {
        return false;
    };
    entry
        .get(3)
        .is_some_and(|members| members.split(',').any(|member| member == name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn membership_is_by_primary_group_or_by_name() {
        let passwd = "root:x:0:0::/:\nann:x:1000:1000::/:\nbob:x:1001:1001::/:\n";
        let group = "ann:x:1000:\ntactus:x:990:ann,eve\n";
        assert!(is_member(1000, 1000, passwd, group), "ann is named");
        assert!(!is_member(1001, 1001, passwd, group), "bob is not");
        assert!(is_member(1001, 990, passwd, group), "primary group");
        assert!(!is_member(7, 7, passwd, group), "a user nobody knows");
        assert!(
            !is_member(1000, 1000, passwd, "ann:x:1000:\n"),
            "no such group"
        );
    }

    #[tokio::test]
    async fn a_dead_socket_is_replaced_and_a_living_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/peer");
        let first = bind(&path).unwrap();
        assert_eq!(bind(&path).unwrap_err().kind(), io::ErrorKind::AddrInUse);
        drop(first);
        assert!(!path.exists());
        drop(std::os::unix::net::UnixListener::bind(&path).unwrap());
        bind(&path).unwrap();
        let mode = std::fs::metadata(folder.path().join("deep"))
            .unwrap()
            .permissions()
            .mode();
        assert_eq!(mode & 0o777, 0o750);
        std::fs::write(folder.path().join("file"), "x").unwrap();
        assert!(bind(&folder.path().join("file")).is_err());
    }
}
