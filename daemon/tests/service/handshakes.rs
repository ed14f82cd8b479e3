//! The first bytes of a program on the peer socket: none of them affects the running session.

use std::time::Duration;

use crate::stage::{Measuring, Running, within};
use dbus::Address;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::UnixStream;
use tokio::task::JoinHandle;

/// A first line as sent by libdbus, for the user that runs the test.
fn greeting() -> Vec<u8> {
    let user = rustix::process::getuid().as_raw().to_string();
    let digits: String = user.bytes().map(|digit| format!("{digit:02x}")).collect();
    format!("\0AUTH EXTERNAL {digits}\r\n").into_bytes()
}

/// Reproducible pseudo-random bytes of all 256 values.
fn noise(length: u32) -> Vec<u8> {
    (0..length)
        .map(|at| (at.wrapping_mul(2_654_435_761) >> 24) as u8)
        .collect()
}

/// Sends these bytes and waits until the daemon has closed the connection.
async fn send_and_await_close(socket: &std::path::Path, words: &[u8], leaves: bool) {
    let mut stream = within(UnixStream::connect(socket)).await.unwrap();
    // the daemon may have closed the connection before everything was sent
    let _ = within(stream.write_all(words)).await;
    if leaves {
        let _ = stream.shutdown().await;
    }
    let mut answer = Vec::new();
    let _ = within(stream.read_to_end(&mut answer)).await;
}

/// Asserts that the session takes another frame, and that the daemon is not faulted.
async fn assert_frames_continue(
    measuring: &mut Measuring,
    end: &mut JoinHandle<String>,
    after: &str,
) {
    // signals that were queued during the attack; if nobody read them, they would delay the replies on this connection
    let frames = &mut measuring.frames;
    while let Ok(Some(_)) = tokio::time::timeout(Duration::ZERO, dbus::next(frames)).await {}
    // the first signal may have been queued before
    for _ in 0..2 {
        let frame = async {
            tokio::select! {
                frame = dbus::next(&mut measuring.frames) => frame.is_some(),
                why = &mut *end => panic!("after {after} the session ended: {why:?}"),
            }
        };
        assert!(within(frame).await, "after {after}");
    }
    let state = within(measuring.daemon.manager.state()).await.unwrap();
    assert_ne!(state, "faulted", "after {after}");
}

/// Waits in a task for the end of the session, which must not occur.
fn watched(measuring: &Measuring) -> JoinHandle<String> {
    let session = measuring.session.clone();
    tokio::spawn(async move { format!("{:?}", session.wait().await) })
}

async fn ended(daemon: Running) -> String {
    let (status, log) = daemon.terminate().await;
    assert!(status.success(), "{log}");
    log
}

#[tokio::test(flavor = "multi_thread")]
async fn no_greeting_on_the_peer_socket_disturbs_the_session() {
    let mut measuring = Measuring::begin().await;
    let mut end = watched(&measuring);
    let socket = measuring.stage.path().join("run/peer");
    let hello = greeting();
    let and = |more: &[u8]| [&hello[..], more].concat();
    let attacks: Vec<(&str, Vec<u8>, bool)> = vec![
        ("one newline", b"\n".to_vec(), false),
        ("newlines", b"\n\n\n\r\n".to_vec(), false),
        ("nothing", Vec::new(), true),
        ("a zero byte", b"\0".to_vec(), true),
        ("a zero byte and a newline", b"\0\n".to_vec(), false),
        ("BEGIN first", b"\0BEGIN\r\n".to_vec(), false),
        ("half of AUTH", b"\0AUTH EXT".to_vec(), true),
        ("a megabyte", vec![b'a'; 1 << 20], false),
        (
            "a megabyte behind AUTH",
            [&b"\0AUTH "[..], &vec![b'a'; 1 << 20]].concat(),
            false,
        ),
        ("noise", noise(4096), false),
        (
            "noise behind a zero byte",
            [&b"\0AUTH"[..], &noise(4096)].concat(),
            false,
        ),
        ("a newline after AUTH", b"\0AUTH\r\n\n".to_vec(), false),
        ("a newline after being known", and(b"\n"), false),
        ("no user", b"\0AUTH EXTERNAL zz\r\n".to_vec(), false),
        ("noise after being known", and(&noise(4096)), false),
        (
            "a megabyte after being known",
            and(&vec![b'a'; 1 << 20]),
            true,
        ),
        (
            "noise for messages",
            and(&[&b"BEGIN\r\n"[..], &noise(4096)].concat()),
            true,
        ),
        ("a message that ends", and(b"BEGIN\r\nl\x01\0\x01"), true),
    ];
    for (what, words, leaves) in &attacks {
        send_and_await_close(&socket, words, *leaves).await;
        assert_frames_continue(&mut measuring, &mut end, what).await;
    }
    within(measuring.session.stop()).await.unwrap();
    let log = ended(measuring.daemon).await;
    // two of the attacks cause a panic in zbus: the first is logged, the other counted
    let panics = log.lines().filter(|line| line.contains("panicked at"));
    assert_eq!(panics.count(), 1, "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn idle_connection_is_dropped_and_delays_no_other() {
    let mut measuring = Measuring::begin().await;
    let mut end = watched(&measuring);
    let socket = measuring.stage.path().join("run/peer");
    let mut silent = Vec::new();
    for k in 0..30 {
        let mut stream = within(UnixStream::connect(&socket)).await.unwrap();
        let words: &[u8] = match k % 3 {
            0 => b"",
            1 => b"\0AUTH",
            _ => b"\0AUTH\r\n",
        };
        within(stream.write_all(words)).await.unwrap();
        silent.push(stream);
    }
    // another client is served meanwhile
    let address = Address::Unix(socket.clone());
    let (other, _) = within(dbus::connect(Some(&address))).await.unwrap();
    let manager = dbus::Manager1Proxy::new(&other).await.unwrap();
    assert_ne!(within(manager.state()).await.unwrap(), "faulted");
    for mut stream in silent {
        let mut answer = Vec::new();
        let _ = within(stream.read_to_end(&mut answer)).await;
    }
    assert_frames_continue(&mut measuring, &mut end, "silence").await;
    // and the connection slots of those clients are free again
    let mut others = Vec::new();
    for _ in 0..30 {
        let connected = async {
            loop {
                match dbus::connect(Some(&address)).await {
                    Ok((other, _)) => return other,
                    // a slot is released when the daemon detects that the client has left
                    Err(_) => tokio::task::yield_now().await,
                }
            }
        };
        others.push(within(connected).await);
    }
}
