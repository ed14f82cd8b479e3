//! VXI-11 over ONC RPC, version 2 (RFC 5531), on TCP: the server of an instrument's core channel, and a client.
//!
//! The server implements version 1 of the core program with all its procedures except the interrupt channel and
//! `docmd`, and the abort program on the same port. The instrument's behaviour is behind the trait [`Device`]. The
//! client exchanges messages over links to a core channel, and finds core channels by a broadcast to port mappers.
//! Records, links and queues are bounded. The crate parses no SCPI and contains no instrument.
//!
//! ```
//! # #[tokio::main(flavor = "current_thread")] async fn main() -> std::io::Result<()> {
//! // A client connects to a core channel; the device of this example repeats each message.
//! # use vxi11::{Device, LineFramer, Refusal, Session};
//! #[derive(Clone)]
//! struct Echo;
//! # impl Device for Echo {
//! #     type Session = Echo;
//! #     fn open_session(&self, _address: &str) -> Echo { Echo }
//! #     fn until_cut(&self) -> impl Future<Output = ()> + Send + 'static { std::future::pending() }
//! # }
//! # impl Session for Echo {
//! #     type Framer = LineFramer;
//! #     type Received = Vec<u8>;
//! #     fn framer(&self) -> LineFramer { LineFramer::new(1024) }
//! #     fn is_silent(&self) -> bool { false }
//! #     async fn begin(&self, message: Vec<u8>) -> std::io::Result<Vec<u8>> { Ok(message) }
//! #     async fn finish(&self, received: Vec<u8>) -> Vec<u8> { received }
//! #     fn refuse(&self, _refusal: Refusal) {}
//! #     async fn clear(&self) {}
//! #     async fn status_byte(&self) -> u8 { 0 }
//! # }
//! let mut client = vxi11::Client::new(vxi11::CoreChannel::new(Echo).connect());
//! let link = client.create_link("inst0").await?;
//! client.write(link, b"*IDN?\n").await?;
//! assert_eq!(client.read(link, 1024).await?, b"*IDN?");
//! client.destroy_link(link).await
//! # }
//! ```

mod client;
mod procedure;
mod rpc;
mod server;

pub use client::{Client, LinkId, find_core_channels};
pub use server::{CoreChannel, Device, LineFramer, MessageFramer, Oversized, Refusal, Session};
