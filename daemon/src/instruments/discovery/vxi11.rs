//! Who answers a VXI-11 broadcast, and who that is (fact sheet lxi-discovery, section 6): a port mapper's GETPORT to
//! everybody, then `create_link`, `*IDN?`, `destroy_link` with each that answers.

use std::net::{Ipv4Addr, SocketAddr};
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpStream, UdpSocket};
use tokio::time::Instant;

use crate::instruments::address::Place;
use crate::instruments::discovery::{Candidate, PATIENCE, SCPI_RAW};

const PORT_MAPPER: u32 = 100_000;
const PORT_MAPPER_VERSION: u32 = 2;
const GET_PORT: u32 = 3;
const TCP: u32 = 6;
const CORE: u32 = 0x0006_07AF;
const CORE_VERSION: u32 = 1;
const CREATE_LINK: u32 = 10;
const DEVICE_WRITE: u32 = 11;
const DEVICE_READ: u32 = 12;
const DESTROY_LINK: u32 = 23;
const END: u32 = 8;
/// A record of RPC that is longer is no answer to `*IDN?`.
const LONGEST: usize = 4096;
const XID: u32 = 0x7461_6374;

/// Asks everybody on every interface; with the answers what could not be asked.
pub(super) async fn broadcast(within: Duration, port: u16) -> (Vec<Candidate>, Vec<String>) {
    let mut notes = Vec::new();
    let interfaces = match if_addrs::get_if_addrs() {
        Ok(interfaces) => interfaces,
        Err(fault) => {
            notes.push(format!(
                "the interfaces cannot be listed ({fault}): no VXI-11 broadcast"
            ));
            Vec::new()
        }
    };
    let until = Instant::now() + within;
    let mut asked = Vec::new();
    for interface in interfaces {
        let if_addrs::IfAddr::V4(address) = interface.addr else {
            continue;
        };
        let everybody = match address.broadcast {
            _ if address.ip.is_loopback() => address.ip,
            Some(everybody) => everybody,
            None => continue,
        };
        let name = interface.name;
        asked.push(tokio::spawn(async move {
            let answers = ask_everybody(address.ip, everybody, port, until).await;
            answers.map_err(|fault| format!("no VXI-11 broadcast on {name} ({fault})"))
        }));
    }
    let mut found: Vec<SocketAddr> = Vec::new();
    for task in asked {
        match task.await {
            Ok(Ok(answers)) => found.extend(answers),
            Ok(Err(note)) => notes.push(note),
            Err(_) => {}
        }
    }
    found.sort();
    found.dedup();
    let each = found.into_iter().map(|core| {
        tokio::spawn(async move {
            let identity = tokio::time::timeout(2 * PATIENCE, identify(core))
                .await
                .ok()
                .and_then(Result::ok);
            Candidate {
                // the daemon's own way to the same instrument
                places: vec![Place::Tcp(format!("{}:{SCPI_RAW}", core.ip()))],
                found_by: "vxi-11",
                name: String::new(),
                identity,
            }
        })
    });
    let mut candidates = Vec::new();
    for task in each.collect::<Vec<_>>() {
        candidates.extend(task.await);
    }
    (candidates, notes)
}

async fn ask_everybody(
    from: Ipv4Addr,
    everybody: Ipv4Addr,
    port: u16,
    until: Instant,
) -> std::io::Result<Vec<SocketAddr>> {
    let socket = UdpSocket::bind((from, 0)).await?;
    socket.set_broadcast(true)?;
    let call = call(PORT_MAPPER, PORT_MAPPER_VERSION, GET_PORT, |arguments| {
        for word in [CORE, CORE_VERSION, TCP, 0] {
            arguments.extend(word.to_be_bytes());
        }
    });
    socket.send_to(&call, (everybody, port)).await?;
    let mut answers = Vec::new();
    let mut buffer = [0; LONGEST];
    // a host without a port mapper says so, and that is no fault
    while let Ok(received) = tokio::time::timeout_at(until, socket.recv_from(&mut buffer)).await {
        let Ok((length, peer)) = received else {
            continue;
        };
        if let Some(words) = reply(&buffer[..length])
            && let Some(port) = word(words, 0).and_then(|port| u16::try_from(port).ok())
            && port != 0
        {
            answers.push(SocketAddr::new(peer.ip(), port));
        }
    }
    Ok(answers)
}

/// What the instrument behind a core channel answers to `*IDN?`.
async fn identify(core: SocketAddr) -> std::io::Result<String> {
    let strange = || std::io::Error::from(std::io::ErrorKind::InvalidData);
    let mut stream = TcpStream::connect(core).await?;
    let link = exchange(&mut stream, CREATE_LINK, |arguments| {
        for word in [1, 0, 2000] {
            arguments.extend(u32::to_be_bytes(word));
        }
        opaque(arguments, b"inst0");
    })
    .await?;
    let id = match (word(&link, 0), word(&link, 1)) {
        (Some(0), Some(id)) => id,
        _ => return Err(strange()),
    };
    exchange(&mut stream, DEVICE_WRITE, |arguments| {
        for word in [id, 2000, 2000, END] {
            arguments.extend(word.to_be_bytes());
        }
        opaque(arguments, b"*IDN?\n");
    })
    .await?;
    let said = exchange(&mut stream, DEVICE_READ, |arguments| {
        for word in [id, 1024, 2000, 2000, 0, 0] {
            arguments.extend(u32::to_be_bytes(word));
        }
    })
    .await?;
    exchange(&mut stream, DESTROY_LINK, |arguments| {
        arguments.extend(id.to_be_bytes())
    })
    .await?;
    // error, reason, length, text
    let length = word(&said, 2)
        .filter(|_| word(&said, 0) == Some(0))
        .ok_or_else(strange)? as usize;
    let text = said
        .get(12..)
        .and_then(|text| text.get(..length))
        .ok_or_else(strange)?;
    Ok(String::from_utf8_lossy(text).trim().to_owned())
}

/// One call on the core channel and its result.
async fn exchange(
    stream: &mut TcpStream,
    procedure: u32,
    arguments: impl FnOnce(&mut Vec<u8>),
) -> std::io::Result<Vec<u8>> {
    let strange = || std::io::Error::from(std::io::ErrorKind::InvalidData);
    let call = call(CORE, CORE_VERSION, procedure, arguments);
    let length = u32::try_from(call.len()).map_err(|_| strange())?;
    stream.write_all(&(length | 1 << 31).to_be_bytes()).await?;
    stream.write_all(&call).await?;
    let length = (stream.read_u32().await? & !(1 << 31)) as usize;
    if length > LONGEST {
        return Err(strange());
    }
    let mut record = vec![0; length];
    stream.read_exact(&mut record).await?;
    reply(&record).map(<[u8]>::to_vec).ok_or_else(strange)
}

/// A call without credentials.
fn call(
    program: u32,
    version: u32,
    procedure: u32,
    arguments: impl FnOnce(&mut Vec<u8>),
) -> Vec<u8> {
    let head = [XID, 0, 2, program, version, procedure, 0, 0, 0, 0];
    let mut call: Vec<u8> = head.into_iter().flat_map(u32::to_be_bytes).collect();
    arguments(&mut call);
    call
}

/// What an accepted and successful reply to our call carries; `None` for any other.
fn reply(record: &[u8]) -> Option<&[u8]> {
    let accepted = word(record, 0)? == XID && word(record, 1)? == 1 && word(record, 2)? == 0;
    let verifier = word(record, 4)? as usize;
    let rest = record
        .get(20..)?
        .get(verifier.checked_next_multiple_of(4)?..)?;
    (accepted && word(rest, 0)? == 0)
        .then(|| rest.get(4..))
        .flatten()
}

fn word(bytes: &[u8], place: usize) -> Option<u32> {
    let word = bytes.get(4 * place..)?.first_chunk::<4>()?;
    Some(u32::from_be_bytes(*word))
}

fn opaque(arguments: &mut Vec<u8>, bytes: &[u8]) {
    arguments.extend(u32::try_from(bytes.len()).unwrap_or(0).to_be_bytes());
    arguments.extend(bytes);
    arguments.resize(arguments.len().next_multiple_of(4), 0);
}

#[cfg(test)]
mod tests {
    use crate::instruments::discovery::vxi11::*;

    #[test]
    fn a_reply_is_read_and_anything_else_is_none() {
        let words = |words: &[u32]| -> Vec<u8> {
            words.iter().flat_map(|word| word.to_be_bytes()).collect()
        };
        let sound = words(&[XID, 1, 0, 0, 0, 0, 703]);
        assert_eq!(reply(&sound).and_then(|rest| word(rest, 0)), Some(703));
        let refused = words(&[XID, 1, 1, 0, 0]);
        let stranger = words(&[1, 1, 0, 0, 0, 0, 703]);
        let endless = words(&[XID, 1, 0, 0, u32::MAX, 0, 703]);
        for other in [refused.as_slice(), &stranger, &endless, &[], b"GET /"] {
            assert_eq!(reply(other), None);
        }
        for length in 0..sound.len() {
            reply(&sound[..length]);
        }
    }
}
