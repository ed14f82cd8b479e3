//! VXI-11 over ONC RPC, version 2 (RFC 5531), on TCP: the server of an instrument's core channel, and a client.
//!
//! The server implements version 1 of the core program with all its procedures except the interrupt channel and
//! `docmd`, and the abort program on the same port. The instrument's behaviour is behind the trait [`Device`]. The
//! client exchanges messages over links to a core channel, and finds core channels by a broadcast to port mappers.
//! Records, links and queues are bounded. The crate parses no SCPI and contains no instrument.
//!
//! ```no_run
//! # #[tokio::main(flavor = "current_thread")] async fn main() -> std::io::Result<()> {
//! let stream = tokio::net::TcpStream::connect("192.168.0.7:1024").await?;
//! let mut client = vxi11::Client::new(stream);
//! let link = client.create_link("inst0").await?;
//! client.write(link, b"*IDN?\n").await?;
//! println!("{}", String::from_utf8_lossy(&client.read(link, 1024).await?));
//! client.destroy_link(link).await
//! # }
//! ```

mod client;
mod procedure;
mod rpc;
mod server;

pub use client::{Client, LinkId, find_core_channels};
pub use server::{CoreChannel, Device, MessageFramer, Oversized, Refusal, Session};
