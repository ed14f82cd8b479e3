//! Invalid or incomplete D-Bus authentication on the peer socket.

use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::time::Duration;

use crate::site::{Site, frames};

/// More connections than one user may have at once.
const HALF_OPEN: usize = 100;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn malformed_greetings_end_only_their_own_connection() {
    let Some(site) = Site::prepare().await else {
        return;
    };
    let daemon = site.start().await;
    daemon.baseline().await;
    let session = daemon.measure().await;
    let before = daemon.size();
    for (what, bytes) in greetings() {
        let (what, path) = (what.to_owned(), site.stage.peer_path());
        tokio::task::block_in_place(|| greet(&path, &bytes));
        let state = session.state().await.unwrap();
        assert!(
            state == "running",
            "{what}: the session is {state}: {}\n{}",
            session.last_error().await.unwrap(),
            daemon.daemon.log()
        );
    }
    let held = session.frames_durable().await.unwrap();
    frames(&session, held + 1).await;

    // some send nothing, some stop in the middle; those beyond the limit are closed immediately
    let half_open: Vec<UnixStream> = (0..HALF_OPEN)
        .map(|number| {
            let mut stream = UnixStream::connect(site.stage.peer_path()).unwrap();
            if number % 2 == 0 {
                let _ = stream.write_all(b"\0AUTH EXT");
            }
            stream
        })
        .collect();
    let took = daemon.stop_by_command("system", &session).await;
    println!("with {HALF_OPEN} connections half open `tactus stop` on system took {took:.2?}");
    drop(half_open);
    daemon.assert_nothing_missed(&session).await;
    daemon.shrinks_to(before).await;
    let status = site.tactus("peer", &["status", "--json"]);
    assert_eq!(status.code, Some(0), "{status:?}");
}

/// Sends all bytes, and reads until the daemon closes the connection or a short timeout expires.
fn greet(path: &std::path::Path, bytes: &[u8]) {
    let mut stream = UnixStream::connect(path).unwrap();
    stream
        .set_write_timeout(Some(Duration::from_secs(1)))
        .unwrap();
    stream
        .set_read_timeout(Some(Duration::from_millis(100)))
        .unwrap();
    // it may be closed before all bytes are sent
    let _ = stream.write_all(bytes);
    let _ = stream.shutdown(Shutdown::Write);
    let _ = stream.read(&mut [0; 4096]);
}

fn greetings() -> Vec<(&'static str, Vec<u8>)> {
    let greeted = b"\0AUTH EXTERNAL 30\r\nNEGOTIATE_UNIX_FD\r\nBEGIN\r\n";
    let behind = |bytes: &[u8]| [greeted.as_slice(), bytes].concat();
    // little-endian method call, version 1: then the lengths of body, serial, header fields
    let message = |body: u32, fields: u32| {
        let mut bytes = vec![b'l', 1, 0, 1];
        for number in [body, 1, fields] {
            bytes.extend(number.to_le_bytes());
        }
        bytes
    };
    vec![
        ("a newline", b"\n".to_vec()),
        ("nothing", Vec::new()),
        ("a NUL", b"\0".to_vec()),
        ("many NULs", vec![0; 4096]),
        ("a NUL and a newline", b"\0\n".to_vec()),
        ("a NUL and an empty line", b"\0\r\n".to_vec()),
        ("noise", noise(4096, 1)),
        (
            "noise behind a NUL",
            [b"\0".to_vec(), noise(4096, 2)].concat(),
        ),
        ("a megabyte without a newline", vec![b'A'; 1 << 20]),
        (
            "a megabyte behind a NUL",
            [b"\0".to_vec(), vec![b'A'; 1 << 20]].concat(),
        ),
        ("half of AUTH", b"\0AUTH EXTER".to_vec()),
        ("AUTH without a mechanism", b"\0AUTH\r\n".to_vec()),
        (
            "AUTH by an unknown mechanism",
            b"\0AUTH KERBEROS_V4 30\r\n".to_vec(),
        ),
        ("AUTH with odd digits", b"\0AUTH EXTERNAL 3\r\n".to_vec()),
        ("AUTH with letters", b"\0AUTH EXTERNAL zz\r\n".to_vec()),
        (
            "AUTH as another user",
            b"\0AUTH EXTERNAL 3635353334\r\nBEGIN\r\n".to_vec(),
        ),
        (
            "AUTH with a huge number",
            [&b"\0AUTH EXTERNAL "[..], &[b'3'; 65_536], b"\r\n"].concat(),
        ),
        (
            "AUTH ANONYMOUS",
            b"\0AUTH ANONYMOUS 30\r\nBEGIN\r\n".to_vec(),
        ),
        ("BEGIN first", b"\0BEGIN\r\n".to_vec()),
        ("DATA first", b"\0DATA\r\n".to_vec()),
        ("CANCEL and ERROR", b"\0CANCEL\r\nERROR\r\n".to_vec()),
        ("text that is not UTF-8", b"\0AUTH \xff\xfe\r\n".to_vec()),
        (
            "many AUTH",
            [&b"\0"[..], &b"AUTH EXTERNAL 31\r\n".repeat(1000)].concat(),
        ),
        ("noise behind BEGIN", behind(&noise(4096, 3))),
        ("half a message", behind(&message(0, 64)[..10])),
        (
            "a message of four gigabytes",
            behind(&message(u32::MAX, 16)),
        ),
        (
            "header fields of four gigabytes",
            behind(&message(0, u32::MAX)),
        ),
        (
            "the longest message, of zeros",
            behind(&[message(1 << 20, 16), vec![0; 1 << 20]].concat()),
        ),
        ("a message without fields", behind(&message(0, 0))),
        (
            "an unknown byte order",
            behind(b"x\x01\x00\x01\0\0\0\0\x01\0\0\0\0\0\0\0"),
        ),
    ]
}

/// Pseudo-random bytes, the same every time.
fn noise(count: usize, seed: u64) -> Vec<u8> {
    let mut state = seed;
    (0..count)
        .map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 56) as u8
        })
        .collect()
}
