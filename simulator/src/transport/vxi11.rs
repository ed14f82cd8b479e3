//! The mainframe's VXI-11 core channel, on any port (no port mapper, no privileges).
//!
//! A reply that is overwritten is lost (-410), a read without a query times out (-420).

use std::io;

use scpi::{Framer, ParseError};
use vxi11::{Device, MessageFramer, Oversized, Refusal, Session};

use crate::simulated_instruments::MessageOutcome;
use crate::transport::client::{ClientSession, LONGEST_MESSAGE};
use crate::{Instrument, SimulatedRig};

/// The mainframe as a VXI-11 device.
#[derive(Debug, Clone)]
pub(crate) struct Mainframe(pub(crate) SimulatedRig);

impl Device for Mainframe {
    type Session = ClientSession;

    fn open_session(&self, address: &str) -> ClientSession {
        ClientSession::register(&self.0, Instrument::Mainframe, address).named("VXI11")
    }

    fn until_cut(&self) -> impl Future<Output = ()> + Send + 'static {
        self.0.until_cut(Instrument::Mainframe)
    }
}

/// The message framer of the instrument's sockets.
pub(crate) struct Messages(Framer);

impl MessageFramer for Messages {
    fn push(&mut self, bytes: &[u8]) {
        self.0.push(bytes);
    }

    fn next_message(&mut self) -> Option<Result<Vec<u8>, Oversized>> {
        self.0.next().map(|message| message.map_err(|_| Oversized))
    }

    fn is_partial(&self) -> bool {
        self.0.is_partial()
    }

    fn clear(&mut self) {
        self.0.clear();
    }
}

impl Session for ClientSession {
    type Framer = Messages;
    type Received = MessageOutcome;

    fn framer(&self) -> Messages {
        Messages(Framer::new(LONGEST_MESSAGE))
    }

    fn is_silent(&self) -> bool {
        ClientSession::is_silent(self)
    }

    async fn begin(&self, message: Vec<u8>) -> io::Result<MessageOutcome> {
        ClientSession::begin(self, message).await
    }

    async fn finish(&self, received: MessageOutcome) -> Vec<u8> {
        ClientSession::finish(self, received).await
    }

    fn refuse(&self, refusal: Refusal) {
        let error = match refusal {
            Refusal::InputOverrun => ParseError::InputOverrun,
            Refusal::QueryInterrupted => ParseError::QueryInterrupted,
            Refusal::QueryUnterminated => ParseError::QueryUnterminated,
        };
        ClientSession::refuse(self, error);
    }

    async fn clear(&self) {
        ClientSession::clear(self).await;
    }

    async fn status_byte(&self) -> u8 {
        ClientSession::status_byte(self).await
    }
}
