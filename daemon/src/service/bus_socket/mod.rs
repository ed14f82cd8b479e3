//! The connection to the system bus: a separate thread reads ahead into a queue that is fair to the senders.
//!
//! A bus delivers the messages of all senders in one sequence, and does not limit calls that expect no reply. Messages
//! that are not read immediately wait in the bus, and block the calls of all senders. Therefore all messages are read
//! on arrival, messages without effect or beyond a sender's limit are dropped, and zbus receives the others one at a
//! time.

mod header;
mod queue;

use std::io::{self, IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::UnixStream as StdStream;
use std::path::PathBuf;
use std::sync::Arc;

use async_trait::async_trait;
use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, ReturnFlags, SendAncillaryBuffer,
    SendAncillaryMessage, SendFlags, Shutdown, recvmsg, sendmsg,
};
use tokio::io::Interest;
use tokio::net::UnixStream;
use tokio::runtime::{Builder, Runtime};
use zbus::Message;
use zbus::address::Transport;
use zbus::address::transport::UnixSocket;
use zbus::connection::socket::{ReadHalf, Socket, Split, WriteHalf};
use zbus::message::Type;
use zbus::names::BusName;

use crate::panics::containment;
use queue::{Disposition, Incoming};

pub(super) use queue::Queue;

/// Maximum number of file descriptors of one message (`SCM_MAX_FD` of the kernel).
const MOST_DESCRIPTORS: usize = 253;
/// Maximum number of bytes per read; a socket buffers about as many.
const CHUNK: usize = 256 * 1024;

/// Reports the number of calls that were dropped, and the sender of the last one.
type Report = Box<dyn Fn(u64, &str) + Send>;

/// A socket to a bus.
#[derive(Debug)]
pub(super) struct BusSocket {
    stream: UnixStream,
    queue: Arc<Queue>,
}

impl BusSocket {
    /// Connects, and starts the reading thread; `None` if the address is not a local socket.
    ///
    /// # Errors
    /// Connection refused, or no thread can be started.
    pub(super) async fn connect(
        address: &zbus::Address,
        queue: Arc<Queue>,
        report: Report,
    ) -> io::Result<Option<Self>> {
        let path = match address.transport() {
            Transport::Unix(unix) => match unix.path() {
                UnixSocket::File(path) => path.clone(),
                // tokio's form of an abstract address
                UnixSocket::Abstract(name) => {
                    let named = [b"\0", name.as_bytes()].concat();
                    PathBuf::from(std::ffi::OsStr::from_bytes(&named))
                }
                _ => return Ok(None),
            },
            _ => return Ok(None),
        };
        let stream = UnixStream::connect(path).await?;
        Self::over(stream, queue, report).map(Some)
    }

    fn over(stream: UnixStream, queue: Arc<Queue>, report: Report) -> io::Result<Self> {
        let stream = stream.into_std()?;
        let own = stream.try_clone()?;
        // a separate runtime, so that no other work runs on its thread
        let runtime = Builder::new_current_thread().enable_io().build()?;
        let reader = Reader {
            queue: Arc::clone(&queue),
            report,
        };
        std::thread::Builder::new()
            .name("bus-reader".to_owned())
            .spawn(move || reader.run(&runtime, own))?;
        Ok(Self {
            stream: UnixStream::from_std(stream)?,
            queue,
        })
    }
}

impl Socket for BusSocket {
    type ReadHalf = Served;
    type WriteHalf = Writer;

    fn split(self) -> Split<Served, Writer> {
        let stream = Arc::new(self.stream);
        let served = Served {
            stream: Arc::clone(&stream),
            queue: self.queue,
            begun: None,
        };
        let writer = Writer {
            stream,
            queue: Arc::clone(&served.queue),
        };
        Split::new(served, writer)
    }
}

/// Reads everything on arrival, on a separate thread.
struct Reader {
    queue: Arc<Queue>,
    report: Report,
}

impl Drop for Reader {
    /// Ends the connection for zbus, also after a panic.
    fn drop(&mut self) {
        self.queue.end();
    }
}

impl Reader {
    fn run(self, runtime: &Runtime, stream: StdStream) {
        containment::mark_thread();
        if let Err(error) = runtime.block_on(self.read(stream)) {
            tracing::debug!("the bus is no longer read: {error}");
        }
    }

    async fn read(&self, stream: StdStream) -> io::Result<()> {
        let stream = UnixStream::from_std(stream)?;
        let mut chunk = vec![0; CHUNK];
        // an incomplete message, and descriptors of later messages
        let mut rest = Vec::new();
        let mut descriptors = Vec::new();
        loop {
            let receive = || receive(&stream, &mut chunk, &mut descriptors);
            let count = stream.async_io(Interest::READABLE, receive).await?;
            if count == 0 {
                return Ok(());
            }
            rest.extend_from_slice(&chunk[..count]);
            let used = self.hand_over(&rest, &mut descriptors)?;
            rest.drain(..used);
        }
    }

    /// Moves complete messages into the queue; returns their size in bytes.
    fn hand_over(&self, bytes: &[u8], descriptors: &mut Vec<OwnedFd>) -> io::Result<usize> {
        let (mut used, mut lost) = (0, 0);
        let mut loser = String::new();
        while let Some(length) = header::length(&bytes[used..]).map_err(io::Error::other)? {
            let Some(message) = bytes[used..].get(..length) else {
                break;
            };
            used += length;
            let header = header::read(message);
            let own = header.map_or(0, |header| header.descriptors);
            let own = descriptors.drain(..own.min(descriptors.len())).collect();
            if self.queue.push(message, own) == Disposition::Dropped {
                lost += 1;
                loser = header.map_or("", |header| header.sender).to_owned();
            }
        }
        if lost > 0 {
            (self.report)(lost, &loser);
        }
        Ok(used)
    }
}

/// Reads available data; appends the descriptors received.
fn receive(
    stream: &UnixStream,
    chunk: &mut [u8],
    descriptors: &mut Vec<OwnedFd>,
) -> io::Result<usize> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(MOST_DESCRIPTORS))];
    let mut control = RecvAncillaryBuffer::new(&mut space);
    let mut into = [IoSliceMut::new(chunk)];
    let received = recvmsg(stream, &mut into, &mut control, RecvFlags::CMSG_CLOEXEC)?;
    for message in control.drain() {
        if let RecvAncillaryMessage::ScmRights(passed) = message {
            descriptors.extend(passed);
        }
    }
    // it would be unknown to which messages the received descriptors belong
    if received.flags.contains(ReturnFlags::CTRUNC) {
        return Err(io::Error::other("there was no room for its descriptors"));
    }
    Ok(received.bytes)
}

/// The reading side for zbus: one message at a time from the queue.
#[derive(Debug)]
pub(super) struct Served {
    stream: Arc<UnixStream>,
    queue: Arc<Queue>,
    /// The message being read by zbus, and how much of it has been read.
    begun: Option<(Incoming, usize)>,
}

impl Drop for Served {
    /// Ends the reading thread.
    fn drop(&mut self) {
        self.queue.end();
        let _ = rustix::net::shutdown(&self.stream, Shutdown::Both);
    }
}

#[async_trait]
impl ReadHalf for Served {
    async fn recvmsg(&mut self, buffer: &mut [u8]) -> io::Result<(usize, Vec<OwnedFd>)> {
        if self.begun.is_none() {
            let Some(next) = self.queue.next().await else {
                return Ok((0, Vec::new()));
            };
            self.begun = Some((next, 0));
        }
        let Some((incoming, read)) = &mut self.begun else {
            return Ok((0, Vec::new()));
        };
        let rest = &incoming.bytes[*read..];
        let count = rest.len().min(buffer.len());
        buffer[..count].copy_from_slice(&rest[..count]);
        *read += count;
        let descriptors = std::mem::take(&mut incoming.descriptors);
        if *read == incoming.bytes.len() {
            self.begun = None;
        }
        Ok((count, descriptors))
    }

    fn can_pass_unix_fd(&self) -> bool {
        true
    }
}

/// The writing side for zbus.
#[derive(Debug)]
pub(super) struct Writer {
    stream: Arc<UnixStream>,
    queue: Arc<Queue>,
}

#[async_trait]
impl WriteHalf for Writer {
    /// Sends all messages except replies to calls that expect none, which the bus would read and drop.
    async fn send_message(&mut self, message: &Message) -> zbus::Result<()> {
        if matches!(message.message_type(), Type::MethodReturn | Type::Error) {
            let header = message.header();
            if let (Some(BusName::Unique(to)), Some(serial)) =
                (header.destination(), header.reply_serial())
                && self.queue.is_served(to, serial.get())
            {
                return Ok(());
            }
        }
        let data = message.data();
        let bytes = data.bytes();
        let mut sent = 0;
        while sent < bytes.len() {
            let descriptors: Vec<BorrowedFd<'_>> = match sent {
                0 => data.fds().iter().map(AsFd::as_fd).collect(),
                _ => Vec::new(),
            };
            sent += self.sendmsg(&bytes[sent..], &descriptors).await?;
        }
        Ok(())
    }

    async fn sendmsg(&mut self, buffer: &[u8], fds: &[BorrowedFd<'_>]) -> io::Result<usize> {
        let send = || {
            let mut space = vec![MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(fds.len()))];
            let mut control = SendAncillaryBuffer::new(&mut space);
            if !fds.is_empty() && !control.push(SendAncillaryMessage::ScmRights(fds)) {
                return Err(io::Error::other("too many descriptors for one message"));
            }
            let bytes = [IoSlice::new(buffer)];
            Ok(sendmsg(
                &self.stream,
                &bytes,
                &mut control,
                SendFlags::NOSIGNAL,
            )?)
        };
        self.stream.async_io(Interest::WRITABLE, send).await
    }

    async fn close(&mut self) -> io::Result<()> {
        Ok(rustix::net::shutdown(&self.stream, Shutdown::Both)?)
    }

    fn can_pass_unix_fd(&self) -> bool {
        true
    }
}
