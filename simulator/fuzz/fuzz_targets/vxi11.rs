//! Arbitrary bytes at the mainframe's VXI-11 core channel, as they come and as records of RPC calls: nothing panics or
//! hangs, a client is answered by records or disconnected, and the mainframe's other client is served all the same.

#![no_main]

mod without_load;

use std::time::Duration;

use simulator::{CoreChannel, SimulatedRig};
use without_load::{RIG, RigWithoutLoad, rig_without_load};
use libfuzzer_sys::fuzz_target;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

const LAST_FRAGMENT: u32 = 1 << 31;
const CORE: u32 = 0x0006_07AF;

/// The input itself, or one call a piece: procedure, link, data.
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

async fn converse(rig: &SimulatedRig, sent: Vec<u8>) {
    let mut stream = CoreChannel::new(rig).connect();
    let (mut from, mut to) = tokio::io::split(&mut stream);
    let mut answered = Vec::new();
    let say = async {
        // Refused bytes end the connection: what is left cannot be sent.
        to.write_all(&sent).await.ok();
        to.shutdown().await.ok();
    };
    let (_, read) = tokio::join!(say, from.read_to_end(&mut answered));
    read.ok();
    let mut rest = answered.as_slice();
    while let Some((mark, tail)) = rest.split_first_chunk::<4>() {
        let length = (u32::from_be_bytes(*mark) & !LAST_FRAGMENT) as usize;
        assert!(length >= 12 && length <= tail.len());
        rest = &tail[length..];
    }
    assert!(rest.is_empty());
    let mut other = rig.connect_34980a();
    other.write_all(b"*IDN?\n").await.expect("the other client is served");
    let mut reported = [0; 64];
    let count = other.read(&mut reported).await.expect("the other client is served");
    assert!(reported[..count].starts_with(b"Agilent"));
}

fuzz_target!(|bytes: &[u8]| {
    RIG.with(|cell| {
        let RigWithoutLoad { runtime, rig } = cell.get_or_init(rig_without_load);
        let sent = records(bytes);
        let limit = Duration::from_secs(86_400 * 365);
        let talk = async { tokio::time::timeout(limit, converse(rig, sent)).await };
        runtime.block_on(talk).expect("no conversation hangs");
    });
});
