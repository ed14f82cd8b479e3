//! The mainframe's telnet port (fact sheet 34980A, section 1): a greeting, a prompt, and lines as a person types them.
//!
//! Its clients have sessions like all others. Offers and requests of the telnet protocol (RFC 854) are declined.

use std::io;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpListener;
use tokio::task::JoinSet;

use rig::Stream;
use scpi::{Framer, ParseError};

use crate::transport::client::{ClientSession, LONGEST_MESSAGE};
use crate::transport::socket::next_client;
use crate::{Instrument, SimulatedRig};

/// The wording is assumed; the sources only mention a prompt.
const GREETING: &str = "Welcome to the 34980A Switch/Measure Unit, simulated\r\n";
const PROMPT: &str = "34980A> ";

/// Commands of the protocol.
const INTERPRET: u8 = 255;
const DONT: u8 = 254;
const DO: u8 = 253;
const WONT: u8 = 252;
const WILL: u8 = 251;
const BEGIN: u8 = 250;
const END: u8 = 240;

/// Serves the port.
pub(crate) async fn serve(rig: SimulatedRig, listener: TcpListener) {
    let mut clients = JoinSet::new();
    loop {
        let (stream, address) = next_client("telnet port", &listener).await;
        clients.spawn(converse(rig.clone(), stream, address));
        while clients.try_join_next().is_some() {}
    }
}

async fn converse(rig: SimulatedRig, mut stream: impl Stream, address: String) {
    let client = ClientSession::register(&rig, Instrument::Mainframe, &format!("telnet {address}"));
    tokio::select! {
        biased;
        () = client.cut() => {}
        ended = answer(&client, &mut stream) => if let Err(fault) = ended {
            tracing::debug!("telnet {address} disconnected: {fault}");
        }
    }
}

async fn answer(client: &ClientSession, stream: &mut impl Stream) -> io::Result<()> {
    stream
        .write_all(format!("{GREETING}{PROMPT}").as_bytes())
        .await?;
    let mut framer = Framer::new(LONGEST_MESSAGE);
    let mut protocol = Protocol::Text;
    let mut chunk = [0; 4096];
    loop {
        let count = stream.read(&mut chunk).await?;
        if count == 0 {
            return Ok(());
        }
        if client.is_silent() {
            continue;
        }
        let (mut typed, mut output) = (Vec::new(), Vec::new());
        for byte in &chunk[..count] {
            protocol = protocol.receive(*byte, &mut typed, &mut output);
        }
        // Enter alone gives a prompt; the framer ignores empty lines.
        let lines = typed.iter().filter(|byte| **byte == b'\n').count();
        framer.push(&typed);
        let mut received = 0;
        for message in framer.by_ref() {
            received += 1;
            match message {
                Ok(message) => {
                    let reply = client.receive(message).await?;
                    for line in reply.split_inclusive(|byte| *byte == b'\n') {
                        output.extend_from_slice(line.strip_suffix(b"\n").unwrap_or(line));
                        if line.ends_with(b"\n") {
                            output.extend_from_slice(b"\r\n");
                        }
                    }
                }
                Err(_) => drop(client.refuse(ParseError::InputOverrun)),
            }
            output.extend_from_slice(PROMPT.as_bytes());
        }
        for _ in received..lines {
            output.extend_from_slice(PROMPT.as_bytes());
        }
        stream.write_all(&output).await?;
        stream.flush().await?;
    }
}

/// State of the telnet protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Protocol {
    Text,
    /// After the byte that announces a command.
    Command,
    /// After DO, DONT, WILL or WONT: an option follows.
    Option(u8),
    /// Within a negotiation, and after an escape byte in it.
    Negotiation,
    NegotiationCommand,
}

impl Protocol {
    /// Processes one byte: typed text is passed on, offers and requests are declined.
    fn receive(self, byte: u8, typed: &mut Vec<u8>, output: &mut Vec<u8>) -> Self {
        match (self, byte) {
            (Self::Text, INTERPRET) => Self::Command,
            // A carriage return is followed by a line feed, or by nothing.
            (Self::Text, 0) => Self::Text,
            (Self::Text, byte) => {
                typed.push(byte);
                Self::Text
            }
            (Self::Command, WILL | WONT | DO | DONT) => Self::Option(byte),
            (Self::Command, BEGIN) => Self::Negotiation,
            (Self::Command, INTERPRET) => {
                typed.push(INTERPRET);
                Self::Text
            }
            (Self::Command, _) => Self::Text,
            (Self::Option(DO), option) => {
                output.extend([INTERPRET, WONT, option]);
                Self::Text
            }
            (Self::Option(WILL), option) => {
                output.extend([INTERPRET, DONT, option]);
                Self::Text
            }
            (Self::Option(_), _) => Self::Text,
            (Self::Negotiation, INTERPRET) => Self::NegotiationCommand,
            (Self::Negotiation, _) => Self::Negotiation,
            (Self::NegotiationCommand, END) => Self::Text,
            (Self::NegotiationCommand, _) => Self::Negotiation,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::transport::telnet::*;

    #[tokio::test]
    async fn offers_are_declined_and_lines_answered_with_a_prompt() {
        let profile = crate::Profile::default().at_pace(crate::Pace::Instant);
        let rig = SimulatedRig::new(&profile, crate::Scene::quiet()).unwrap();
        let (mut here, there) = tokio::io::duplex(4096);
        tokio::spawn(converse(rig, there, "memory".to_owned()));
        // DO 1, a negotiation with a line end in it, WILL 3, then two lines and an empty one.
        here.write_all(b"\xff\xfd\x01\xff\xfa\x18\n\xff\xf0\xff\xfb\x03*ESE 4\r\n*ESE?\r\n\r\n")
            .await
            .unwrap();
        here.shutdown().await.unwrap();
        let mut output = Vec::new();
        here.read_to_end(&mut output).await.unwrap();
        let begun = format!("{GREETING}{PROMPT}").into_bytes();
        let rest = output.strip_prefix(begun.as_slice()).unwrap();
        let expected = [
            &b"\xff\xfc\x01\xff\xfe\x03"[..],
            b"34980A> +4\r\n34980A> 34980A> ",
        ];
        assert_eq!(rest, expected.concat());
    }
}
