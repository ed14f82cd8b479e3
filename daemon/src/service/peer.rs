//! The peer socket: D-Bus without a broker, one connection per client. The kernel identifies the user.

use std::io;
use std::os::unix::fs::{DirBuilderExt, FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use rustix::net::RecvFlags;
use tokio::io::{AsyncReadExt, AsyncWriteExt, Interest};
use tokio::net::{UnixListener, UnixStream};
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use zbus::connection::Builder;

use super::caller::{Caller, GROUP};
use super::gate::Gate;
use super::limit::CONNECTIONS;
use crate::events::kind::EventKind;
use crate::panics::containment::{PanicScope, answer};
use crate::session::controller::Controller;

/// Timeout of the authentication.
const AUTHENTICATION_TIMEOUT: Duration = Duration::from_secs(5);

/// Maximum length of a client's first line, bytes; a normal line has some thirty.
const FIRST_LINE: usize = 256;

/// Maximum number of clients to which the reached limit is being reported, and the timeout for each.
const MOST_REPORTED: usize = 16;
const REFUSAL_TIMEOUT: Duration = Duration::from_secs(1);

/// A socket that is removed when dropped.
#[derive(Debug)]
pub(super) struct PeerListener {
    socket: UnixListener,
    path: PathBuf,
}

impl Drop for PeerListener {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Binds the socket; creates its folder if needed. Replaces a socket left over from a daemon that has ended, but not
/// one in use.
pub(super) fn bind(path: &Path) -> io::Result<PeerListener> {
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
                "a file that is not a socket has this name",
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
    Ok(PeerListener {
        socket,
        path: path.to_owned(),
    })
}

/// Serves all admitted clients for ever; `acting` is the runtime of the sessions.
pub(super) async fn serve(listener: PeerListener, controller: Arc<Controller>, acting: Handle) {
    loop {
        match listener.socket.accept().await {
            Ok((stream, _)) => {
                let served = serve_client(stream, Arc::clone(&controller), acting.clone());
                tokio::spawn(answer(PanicScope::Reply, served));
            }
            Err(error) => {
                let text = format!("the peer socket: {error}");
                controller.events.journal(EventKind::PeerSocket, &text);
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

/// Serves one client until it disconnects.
async fn serve_client(stream: UnixStream, controller: Arc<Controller>, acting: Handle) {
    let caller = Caller::at(&stream).ok();
    let Some(caller) = caller.filter(|caller| caller.is_ours() || caller.is_member()) else {
        let text = format!(
            "a user was refused at the peer socket: only root, the daemon's user and members of the group {GROUP} may connect"
        );
        controller
            .events
            .journal(EventKind::PeerUnauthorised, &text);
        return;
    };
    let _permit = match CONNECTIONS.take(caller.counted()) {
        Ok(permit) => permit,
        Err(error) => {
            let text = format!(
                "a connection of user {} to the peer socket was closed: {}",
                caller.user(),
                error.text()
            );
            controller.events.journal(EventKind::PeersRefused, &text);
            refuse_busy(stream, &error).await;
            return;
        }
    };
    let greeted_by = tokio::time::Instant::now() + AUTHENTICATION_TIMEOUT;
    let first = match tokio::time::timeout_at(greeted_by, first_line(&stream)).await {
        Ok(Ok(first)) => first,
        Ok(Err(why)) => {
            let user = caller.user();
            let text = format!("a connection of user {user} to the peer socket was closed: {why}");
            return controller
                .events
                .journal(EventKind::PeerAuthenticationFailed, &text);
        }
        Err(_) => return tracing::debug!("a client has connected and sent nothing"),
    };
    let claimed = match caller.is_ours() {
        true => None,
        false => claimed_uid(&first),
    };
    let Ok(stream) = stream.into_std() else {
        return;
    };
    let Ok(hang_up) = stream.try_clone() else {
        return;
    };
    // subscribed before the client is served, so that it misses no event
    let mut events = controller.events.subscribe();
    let mut builder = Builder::unix_stream(stream)
        .server(zbus::Guid::generate())
        .p2p();
    if let Some(claimed) = claimed {
        builder = builder.user_id(claimed);
    }
    let gate = Gate::of_peer(caller, acting);
    let greeted = super::register_objects(builder, &controller, &gate).build();
    let connection = match tokio::time::timeout_at(greeted_by, greeted).await {
        Ok(Ok(connection)) => connection,
        Ok(Err(error)) => {
            tracing::debug!("a client did not authenticate: {error}");
            return;
        }
        Err(_) => return,
    };
    loop {
        tokio::select! {
            () = connection.closed() => break,
            event = events.recv() => {
                let Some(event) = event else { break };
                if !super::announce(&connection, &controller, &gate, event).await {
                    // replies waiting for a client that never reads end with the socket
                    let _ = hang_up.shutdown(std::net::Shutdown::Both);
                    break;
                }
            }
        }
    }
    gate.all_left();
}

/// Reports that the limit is reached, distinguishable from a refusal of access, and closes the connection; only for a
/// few clients at a time, because each takes a descriptor.
async fn refuse_busy(mut stream: UnixStream, error: &dbus::Fault) {
    static REPORTED: Semaphore = Semaphore::const_new(MOST_REPORTED);
    let Ok(_permit) = REPORTED.try_acquire() else {
        return;
    };
    let line = format!("ERROR {}{}\r\n", dbus::BUSY, error.text());
    let sending = async {
        stream.write_all(line.as_bytes()).await?;
        // if the connection were closed before the client has written its first line, the client would get a socket
        // error instead
        let mut first = [0; 128];
        loop {
            let read = stream.read(&mut first).await?;
            if read == 0 || first[..read].contains(&b'\n') {
                return Ok::<(), io::Error>(());
            }
        }
    };
    let _ = tokio::time::timeout(REFUSAL_TIMEOUT, sending).await;
}

/// Peeks at a client's first line. zbus panics on an empty line, and reads without limit if there is no line end.
async fn first_line(stream: &UnixStream) -> Result<Vec<u8>, String> {
    let mut first = [0; FIRST_LINE];
    loop {
        let ready = stream.ready(Interest::READABLE).await;
        let ready = ready.map_err(|error| format!("it cannot be read: {error}"))?;
        let peeked = stream.try_io(Interest::READABLE, || {
            Ok(rustix::net::recv(stream, &mut first[..], RecvFlags::PEEK)?.1)
        });
        let seen = match peeked {
            Ok(count) => &first[..count],
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => continue,
            Err(error) => return Err(format!("it cannot be read: {error}")),
        };
        if let Some(end) = seen.iter().position(|byte| *byte == b'\n') {
            let line = &seen[..=end];
            return match line.starts_with(b"\0AUTH") && line.ends_with(b"\r\n") {
                true => Ok(line.to_vec()),
                false => Err("its first line is not AUTH after a zero byte".to_owned()),
            };
        }
        if seen.len() == first.len() {
            return Err(format!("its first line is longer than {FIRST_LINE} bytes"));
        }
        if seen.is_empty() || ready.is_read_closed() {
            return Err("it was closed before its first line had ended".to_owned());
        }
        // polled: while unread data remain, the socket stays readable and cannot be awaited for more
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

/// The user number in a member's first line. In the unit's user namespace the kernel reports all other users under one
/// number, and zbus would reject the member's true one. Access was decided by the group; the number has no effect.
///
/// The format is `AUTH EXTERNAL` and the decimal number with each digit in hexadecimal ASCII, after a zero byte (D-Bus
/// specification, authentication protocol).
fn claimed_uid(first: &[u8]) -> Option<u32> {
    let line = std::str::from_utf8(first.strip_prefix(b"\0")?).ok()?;
    let digits = line.lines().next()?.strip_prefix("AUTH EXTERNAL ")?;
    let bytes: Option<Vec<u8>> = digits
        .as_bytes()
        .chunks(2)
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok())
        .collect();
    String::from_utf8(bytes?).ok()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn claimed_uid_is_parsed_and_left_in_the_socket() {
        assert_eq!(
            claimed_uid(b"\0AUTH EXTERNAL 31303030\r\nNEGOTIATE_UNIX_FD\r\n"),
            Some(1000)
        );
        for other in [
            &b"\0AUTH EXTERNAL\r\nDATA\r\n"[..],
            b"\0AUTH\r\n",
            b"\0AUTH EXTERNAL 3\r\n",
            b"\0AUTH EXTERNAL zz\r\n",
            b"AUTH EXTERNAL 31\r\n",
            b"",
        ] {
            assert_eq!(claimed_uid(other), None, "{other:?}");
        }
        let (ours, mut theirs) = UnixStream::pair().unwrap();
        // libdbus sends the zero byte separately
        theirs.write_all(b"\0").await.unwrap();
        let looks = tokio::spawn(async move { (first_line(&ours).await, ours) });
        theirs
            .write_all(b"AUTH EXTERNAL 31303030\r\n")
            .await
            .unwrap();
        let (seen, mut ours) = looks.await.unwrap();
        assert_eq!(claimed_uid(&seen.unwrap()), Some(1000));
        let mut byte = [1];
        ours.read_exact(&mut byte).await.unwrap();
        assert_eq!(byte, [0], "nothing was taken");
    }

    #[tokio::test]
    async fn unused_socket_is_replaced_and_one_in_use_is_not() {
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
