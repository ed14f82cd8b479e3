//! Arbitrary bytes at a VXI-11 core channel, raw and as records of RPC calls: nothing panics or hangs, a client gets
//! records or is disconnected, and the channel's other client is still served.

#![no_main]

use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use vxi11::{Client, CoreChannel, Device, MessageFramer, Oversized, Refusal, Session};

/// A device that repeats each message.
#[derive(Clone)]
struct Echo;

impl Device for Echo {
    type Session = Self;

    fn open_session(&self, _address: &str) -> Self {
        Self
    }

    fn until_cut(&self) -> impl Future<Output = ()> + Send + 'static {
        std::future::pending()
    }
}

impl Session for Echo {
    type Framer = LineFramer;
    type Received = Vec<u8>;

    fn framer(&self) -> LineFramer {
        LineFramer::new(64)
    }

    fn is_silent(&self) -> bool {
        false
    }

    async fn begin(&self, message: Vec<u8>) -> std::io::Result<Vec<u8>> {
        Ok(message)
    }

    async fn finish(&self, received: Vec<u8>) -> Vec<u8> {
        received
    }

    fn refuse(&self, _refusal: Refusal) {}

    async fn clear(&self) {}

    async fn status_byte(&self) -> u8 {
        0xff
    }
}

/// A framer for devices whose messages end with a line feed.
#[derive(Debug)]
struct LineFramer {
    bytes: Vec<u8>,
    longest: usize,
}

impl LineFramer {
    /// A framer for messages of at most `longest` bytes.
    fn new(longest: usize) -> Self {
        Self {
            bytes: Vec::new(),
            longest,
        }
    }
}

impl MessageFramer for LineFramer {
    fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        // One byte over the limit marks a message as too long; further bytes need not be kept.
        let ended = self.bytes.iter().rposition(|byte| *byte == b'\n');
        let begun = ended.map_or(0, |end| end + 1);
        self.bytes
            .truncate(self.bytes.len().min(begun + self.longest + 1));
    }

    fn next_message(&mut self) -> Option<Result<Vec<u8>, Oversized>> {
        let end = self.bytes.iter().position(|byte| *byte == b'\n')?;
        let mut message: Vec<u8> = self.bytes.drain(..=end).collect();
        message.pop();
        Some(if message.len() > self.longest {
            Err(Oversized)
        } else {
            Ok(message)
        })
    }

    fn is_partial(&self) -> bool {
        self.bytes.last().is_some_and(|byte| *byte != b'\n')
    }

    fn clear(&mut self) {
        self.bytes.clear();
    }
}

const LAST_FRAGMENT: u32 = 1 << 31;
const CORE: u32 = 0x0006_07AF;

/// The input itself, or one call for each piece: procedure, link, data.
fn records(bytes: &[u8]) -> Vec<u8> {
    let [shape, rest @ ..] = bytes else {
        return Vec::new();
    };
    if shape % 4 == 0 {
        return rest.to_vec();
    }
    let mut sent = Vec::new();
    for (xid, piece) in rest.split(|byte| *byte == 0xff).enumerate() {
        let (procedure, arguments) = match piece {
            [] => (10, &[][..]),
            [first, rest @ ..] => (u32::from(first % 32), rest),
        };
        let mut record = Vec::new();
        for word in [xid as u32, 0, 2, CORE, 1, procedure, 0, 0, 0, 0] {
            record.extend(word.to_be_bytes());
        }
        match procedure {
            10 => {
                for word in [1, 0, 0, 5] {
                    record.extend(u32::to_be_bytes(word));
                }
                record.extend(b"inst0\0\0\0");
            }
            11 => {
                for word in [1, 100, 100, 8, arguments.len() as u32] {
                    record.extend(u32::to_be_bytes(word));
                }
                record.extend(arguments);
                record.resize(record.len().next_multiple_of(4), 0);
            }
            12 => {
                for word in [1, 1024, 100, 100, 0, 10] {
                    record.extend(u32::to_be_bytes(word));
                }
            }
            _ => record.extend(arguments),
        }
        sent.extend((record.len() as u32 | LAST_FRAGMENT).to_be_bytes());
        sent.extend(record);
    }
    sent
}

async fn converse(sent: Vec<u8>) {
    let channel = CoreChannel::new(Echo);
    let mut stream = channel.connect();
    let (mut from, mut to) = tokio::io::split(&mut stream);
    let mut received = Vec::new();
    let send = async {
        // Rejected bytes end the connection, so that the rest cannot be sent.
        to.write_all(&sent).await.ok();
        to.shutdown().await.ok();
    };
    let (_, read) = tokio::join!(send, from.read_to_end(&mut received));
    read.ok();
    let mut rest = received.as_slice();
    while let Some((mark, tail)) = rest.split_first_chunk::<4>() {
        let length = (u32::from_be_bytes(*mark) & !LAST_FRAGMENT) as usize;
        assert!(length >= 12 && length <= tail.len());
        rest = &tail[length..];
    }
    assert!(rest.is_empty());
    let mut other = Client::new(channel.connect());
    let link = other
        .create_link("inst0")
        .await
        .expect("the other client is served");
    other
        .write(link, b"*IDN?\n")
        .await
        .expect("the other client is served");
    let reply = other
        .read(link, 64)
        .await
        .expect("the other client is served");
    assert_eq!(reply, b"*IDN?");
}

fuzz_target!(|bytes: &[u8]| {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    let runtime = builder
        .enable_time()
        .start_paused(true)
        .build()
        .expect("a runtime");
    // each call may request two waits of up to 50 days: for a lock, and for a reply
    let limit = Duration::from_secs(86_400 * 36_500);
    let talk = async { tokio::time::timeout(limit, converse(records(bytes))).await };
    runtime.block_on(talk).expect("no conversation hangs");
});
