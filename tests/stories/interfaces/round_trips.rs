//! Number of D-Bus messages that a command sends to the daemon.

use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::thread;

use crate::test_rig::{self, Needs, baseline, measure};

/// Relays one connection to the daemon's socket, and counts the client's calls.
fn counted(listener: &UnixListener, daemon: &Path) -> usize {
    let (client, _) = listener.accept().expect("a client");
    let server = UnixStream::connect(daemon).expect("the daemon's socket");
    let (mut from_server, mut to_client) = (clone(&server), clone(&client));
    let answers = thread::spawn(move || {
        // ends when either side closes
        let _ = std::io::copy(&mut from_server, &mut to_client);
        let _ = to_client.shutdown(Shutdown::Both);
    });
    let (mut client, mut server, mut sent) = (client, server, Vec::new());
    let mut bytes = [0; 4096];
    while let Ok(read @ 1..) = client.read(&mut bytes) {
        sent.extend_from_slice(&bytes[..read]);
        if server.write_all(&bytes[..read]).is_err() {
            break;
        }
    }
    let _ = server.shutdown(Shutdown::Both);
    answers.join().expect("answers were passed on");
    calls(&sent)
}

fn clone(stream: &UnixStream) -> UnixStream {
    stream.try_clone().expect("a descriptor")
}

/// Number of method calls in the bytes of a client: authentication, then messages.
fn calls(sent: &[u8]) -> usize {
    const BEGIN: &[u8] = b"BEGIN\r\n";
    let begun = sent.windows(BEGIN.len()).position(|window| window == BEGIN);
    let mut messages = &sent[begun.expect("an authentication") + BEGIN.len()..];
    let mut calls = 0;
    while let Some(header) = messages.first_chunk::<16>() {
        assert_eq!(header[0], b'l', "little endian");
        let number = |at: usize| {
            let bytes = header[at..at + 4].try_into().expect("four bytes");
            u32::from_le_bytes(bytes) as usize
        };
        calls += usize::from(header[1] == 1);
        let length = 16 + number(12).next_multiple_of(8) + number(4);
        messages = &messages[length..];
    }
    calls
}

#[test]
fn status_is_one_snapshot_in_at_most_three_round_trips() {
    let Some(stage) = test_rig::set(Needs::ANY, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 2);
    let id = measure(&stage, 2);
    let path = stage.path().join("counted");
    let listener = UnixListener::bind(&path).expect("a socket");
    let peer = stage.peer_path();
    let counting = thread::spawn(move || counted(&listener, &peer));
    let status = stage
        .tactus_with(&["status", "--json"], |command| {
            command.env("TACTUS_BUS", format!("unix:{}", path.display()));
        })
        .and_then(|status| status.succeeded())
        .unwrap_or_else(|fault| panic!("{fault}"))
        .json();
    assert_eq!(status[0]["health"]["last_frame"]["session"], id.as_str());
    assert_eq!(status[0]["state"], "idle");
    let calls = counting.join().expect("the calls are counted");
    assert!((1..=3).contains(&calls), "{calls} calls");
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}
