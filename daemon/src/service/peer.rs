//! The peer socket: D-Bus without a broker, one connection a client, the kernel says who it is.

use std::io;
use std::os::unix::fs::{DirBuilderExt, FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use tokio::net::{UnixListener, UnixStream};
use zbus::connection::Builder;

use super::access::Door;
use super::caller::{Caller, GROUP};
use crate::keeper::Keeper;

/// How long a client may take to introduce itself.
const TO_GREET: Duration = Duration::from_secs(5);

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
    let allowed = Caller::at(&stream).is_ok_and(|caller| caller.is_ours() || caller.is_member());
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
    let greeted = super::furnish(builder, &keeper, Door::Peer).build();
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
                if !super::say(&connection, &keeper, Door::Peer, notice).await {
                    // answers that wait for a reader who never reads end with the socket
                    let _ = hang_up.shutdown(std::net::Shutdown::Both);
                    return;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
