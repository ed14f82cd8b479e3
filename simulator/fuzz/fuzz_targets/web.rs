//! Arbitrary bytes sent to the mainframe's web server: it never panics or hangs, every reply is complete, and only an
//! incomplete request has no reply.

#![no_main]

mod without_load;

use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use simulator::SimulatedRig;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use without_load::{RIG, RigWithoutLoad, rig_without_load};

/// Maximum length of a request with all its headers, bytes.
const LONGEST: usize = 8192;

async fn ask(rig: &SimulatedRig, request: &[u8]) {
    let (mut from, mut to) = tokio::io::split(rig.connect_web());
    let mut answer = Vec::new();
    let say = async {
        // Bytes after a request are not read.
        to.write_all(request).await.ok();
        to.shutdown().await.ok();
    };
    let (_, read) = tokio::join!(say, from.read_to_end(&mut answer));
    read.expect("an answer that ends");
    let ended = request.windows(4).any(|four| four == b"\r\n\r\n");
    if !ended && request.len() < LONGEST {
        assert!(answer.is_empty(), "an answer before the end of the request");
        return;
    }
    let answer = String::from_utf8(answer).expect("text");
    let (head, body) = answer.split_once("\r\n\r\n").expect("a head and a body");
    let status = head.lines().next().unwrap_or_default();
    let whole = [
        "200 OK",
        "400 Bad Request",
        "404 Not Found",
        "405 Method Not Allowed",
        "431 Request Header Fields Too Large",
    ];
    assert!(
        whole
            .iter()
            .any(|known| status == format!("HTTP/1.1 {known}"))
    );
    let reported = head
        .lines()
        .find_map(|line| line.strip_prefix("Content-Length: "));
    let without_body = request.starts_with(b"HEAD ") && body.is_empty();
    assert!(without_body || reported.and_then(|length| length.parse().ok()) == Some(body.len()));
}

fuzz_target!(|bytes: &[u8]| {
    RIG.with(|cell| {
        let RigWithoutLoad { runtime, rig } = cell.get_or_init(rig_without_load);
        let limit = Duration::from_secs(60);
        let talk = async { tokio::time::timeout(limit, ask(rig, bytes)).await };
        runtime.block_on(talk).expect("no request hangs");
    });
});
