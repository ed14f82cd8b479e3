//! The procedures of the core and abort programs (VXI-11 revision 1.0, section B.6).

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt, DuplexStream};
use tokio::net::TcpListener;
use tokio::task::JoinSet;
use tokio::time::Instant;

use crate::procedure::*;
use crate::rpc::{Call, MalformedArguments, Reader, Reply, Writer, marked, read_record};
use crate::server::device::{Device, Session};
use crate::server::link::{Fault, Link, ReadRequest, within};
use crate::server::port::Port;

/// Largest amount of data in one device_write, bytes; clients send longer messages in several.
const LARGEST_WRITE: usize = 16 * 1024;
/// Largest amount of data in one reply to device_read, bytes.
const LARGEST_READ: usize = 1024 * 1024;
/// Longest record, bytes: common clients send a long message in one record, even if it exceeds [`LARGEST_WRITE`].
const LARGEST_RECORD: usize = 256 * 1024;
/// Most links per connection.
const LINKS: usize = 16;
/// The name of the instrument in create_link.
const NAME: &[u8] = b"inst0";
/// Buffer size of an in-memory connection, bytes.
const PIPE: usize = 64 * 1024;

const MESSAGE_AVAILABLE: u32 = 1 << 4;

/// The core channel of an instrument: in memory, or on a port.
#[derive(Debug)]
pub struct CoreChannel<D>(Arc<Port<D>>);

impl<D> Clone for CoreChannel<D> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<D: Device> CoreChannel<D> {
    /// The channel of a device; the links of all its connections share one lock.
    pub fn new(device: D) -> Self {
        Self(Arc::new(Port::new(device, 0)))
    }

    /// Opens an in-memory connection for RPC records. Must be called inside a tokio runtime.
    pub fn connect(&self) -> DuplexStream {
        let (here, there) = tokio::io::duplex(PIPE);
        tokio::spawn(connection(self.0.clone(), there, "memory".to_owned()));
        here
    }

    /// Serves the channel of a device on a port until the future is dropped.
    pub async fn serve(device: D, listener: TcpListener) {
        let number = listener.local_addr().map_or(0, |address| address.port());
        let port = Arc::new(Port::new(device, number));
        let mut clients = JoinSet::new();
        loop {
            match listener.accept().await {
                Ok((stream, address)) => {
                    stream.set_nodelay(true).ok();
                    clients.spawn(connection(port.clone(), stream, address.to_string()));
                }
                Err(fault) => {
                    tracing::warn!("a VXI-11 client could not be accepted: {fault}");
                    // out of descriptors: retry after a moment
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            }
            while clients.try_join_next().is_some() {}
        }
    }
}

async fn connection<D: Device>(
    port: Arc<Port<D>>,
    mut stream: impl AsyncRead + AsyncWrite + Unpin + Send,
    address: String,
) {
    let cut = port.device.until_cut();
    let mut links = Links {
        port,
        address,
        links: BTreeMap::new(),
    };
    tokio::select! {
        biased;
        () = cut => {}
        ended = links.answer(&mut stream) => if let Err(fault) = ended {
            tracing::warn!("the VXI-11 client at {} is disconnected: {fault}", links.address);
        }
    }
}

/// The links of one connection; they end when the connection ends.
struct Links<D: Device> {
    port: Arc<Port<D>>,
    address: String,
    links: BTreeMap<u32, Link<D::Session>>,
}

impl<D: Device> Drop for Links<D> {
    fn drop(&mut self) {
        for link in self.links.keys() {
            self.port.release(*link);
            self.port.aborters().remove(link);
        }
    }
}

impl<D: Device> Links<D> {
    async fn answer(
        &mut self,
        stream: &mut (impl AsyncRead + AsyncWrite + Unpin + Send),
    ) -> io::Result<()> {
        while let Some(record) = read_record(stream, LARGEST_RECORD).await? {
            let mut reader = Reader::new(&record);
            let Ok(call) = Call::read(&mut reader) else {
                return Err(io::Error::new(io::ErrorKind::InvalidData, "no RPC call"));
            };
            let reply = self.reply(call, &mut reader).await;
            stream.write_all(&marked(&reply.record(call.xid))).await?;
        }
        Ok(())
    }

    async fn reply(&mut self, call: Call, arguments: &mut Reader<'_>) -> Reply {
        if !call.is_understood() {
            return Reply::Denied;
        }
        if ![CORE, ABORT].contains(&call.program) {
            return Reply::NoProgram;
        }
        if call.program_version != VERSION {
            return Reply::NoVersion(VERSION);
        }
        let results = if call.procedure == 0 {
            Ok(Some(Vec::new()))
        } else if call.program == ABORT {
            self.abort(call.procedure, arguments)
        } else {
            self.core(call.procedure, arguments).await
        };
        match results {
            Ok(Some(results)) => Reply::Done(results),
            Ok(None) => Reply::NoProcedure,
            Err(MalformedArguments) => Reply::GarbageArguments,
        }
    }

    fn abort(
        &self,
        procedure: u32,
        arguments: &mut Reader<'_>,
    ) -> Result<Option<Vec<u8>>, MalformedArguments> {
        if procedure != DEVICE_ABORT {
            return Ok(None);
        }
        let link = arguments.word()?;
        let aborter = self.port.aborters().get(&link).cloned();
        Ok(Some(code(aborter.map_or(
            Err(Fault::InvalidLink),
            |aborter| {
                aborter.abort();
                Ok(())
            },
        ))))
    }

    async fn core(
        &mut self,
        procedure: u32,
        arguments: &mut Reader<'_>,
    ) -> Result<Option<Vec<u8>>, MalformedArguments> {
        Ok(Some(match procedure {
            CREATE_LINK => self.create(arguments).await?,
            DEVICE_WRITE => {
                let link = arguments.word()?;
                let deadline = within(arguments.word()?);
                let lock = within(arguments.word()?);
                let flags = arguments.word()?;
                let data = arguments.opaque()?;
                let done = self.write(link, data, flags, deadline, lock).await;
                // The bound on a record's length keeps the count small.
                let taken = done.map_or(0, |()| u32::try_from(data.len()).unwrap_or(u32::MAX));
                Writer::default().word(status(done)).word(taken).bytes()
            }
            DEVICE_READ => {
                let link = arguments.word()?;
                let most = (arguments.word()? as usize).min(LARGEST_READ);
                let deadline = within(arguments.word()?);
                let lock = within(arguments.word()?);
                let flags = arguments.word()?;
                let character = arguments.word()?;
                let request = ReadRequest {
                    most,
                    // A char is sent as a word; its lowest byte is the character.
                    until: (flags & UNTIL_CHARACTER != 0).then_some(character.to_be_bytes()[3]),
                    deadline,
                };
                let (status, (reason, data)) = match self.read(link, request, flags, lock).await {
                    Ok(read) => (0, read),
                    Err(fault) => (fault as u32, (0, Vec::new())),
                };
                Writer::default()
                    .word(status)
                    .word(reason)
                    .opaque(&data)
                    .bytes()
            }
            DEVICE_READSTB => {
                let request = self.generic(arguments).await?;
                let byte = match &request {
                    Ok((link, _)) => self.status_byte(*link).await,
                    Err(_) => 0,
                };
                Writer::default()
                    .word(status(request.map(|_| ())))
                    .word(byte)
                    .bytes()
            }
            DEVICE_TRIGGER => {
                let done = match self.generic(arguments).await? {
                    Ok((link, deadline)) => self.trigger(link, deadline).await,
                    Err(fault) => Err(fault),
                };
                code(done)
            }
            DEVICE_CLEAR => {
                let request = self.generic(arguments).await?;
                if let Ok((link, _)) = request
                    && let Some(link) = self.links.get_mut(&link)
                {
                    link.clear().await;
                }
                code(request.map(|_| ()))
            }
            // There is no front panel to lock.
            DEVICE_REMOTE | DEVICE_LOCAL => code(self.generic(arguments).await?.map(|_| ())),
            DEVICE_LOCK => {
                let link = arguments.word()?;
                let flags = arguments.word()?;
                let deadline = within(arguments.word()?);
                let wait = flags & WAIT_FOR_LOCK != 0;
                code(match self.known(link) {
                    Ok(()) => self.port.pass(link, true, wait, deadline).await,
                    Err(fault) => Err(fault),
                })
            }
            DEVICE_UNLOCK => {
                let link = arguments.word()?;
                code(self.known(link).and_then(|()| {
                    let held = self.port.release(link);
                    held.then_some(()).ok_or(Fault::NoLock)
                }))
            }
            // Service requests need the interrupt channel; enabling them without one does nothing.
            DEVICE_ENABLE_SRQ => {
                let link = arguments.word()?;
                arguments.flag()?;
                arguments.opaque()?;
                code(self.known(link))
            }
            DEVICE_DOCMD => Writer::default()
                .word(Fault::NotSupported as u32)
                .opaque(&[])
                .bytes(),
            DESTROY_LINK => {
                let link = arguments.word()?;
                code(match self.links.remove(&link) {
                    Some(_) => {
                        self.port.release(link);
                        self.port.aborters().remove(&link);
                        Ok(())
                    }
                    None => Err(Fault::InvalidLink),
                })
            }
            CREATE_INTERRUPT_CHANNEL | DESTROY_INTERRUPT_CHANNEL => code(Err(Fault::NotSupported)),
            _ => return Ok(None),
        }))
    }

    async fn create(&mut self, arguments: &mut Reader<'_>) -> Result<Vec<u8>, MalformedArguments> {
        let _client = arguments.word()?;
        let lock = arguments.flag()?;
        let deadline = within(arguments.word()?);
        let name = arguments.opaque()?;
        let made = if !name.eq_ignore_ascii_case(NAME) {
            Err(Fault::NotAccessible)
        } else if self.links.len() >= LINKS {
            Err(Fault::OutOfResources)
        } else {
            let number = self.port.next_link.fetch_add(1, Ordering::Relaxed);
            let passed = match lock {
                true => self.port.pass(number, true, true, deadline).await,
                false => Ok(()),
            };
            passed.map(|()| number)
        };
        let created = Writer::default().word(status(made.map(|_| ())));
        let number = made.unwrap_or(0);
        if made.is_ok() {
            let address = format!("VXI11 {}", self.address);
            let link = Link::new(self.port.device.open_session(&address));
            self.port.aborters().insert(number, link.aborter());
            self.links.insert(number, link);
        }
        let largest = u32::try_from(LARGEST_WRITE).unwrap_or(u32::MAX);
        let created = created.word(number).word(u32::from(self.port.number));
        Ok(created.word(largest).bytes())
    }

    fn known(&self, link: u32) -> Result<(), Fault> {
        let known = self.links.contains_key(&link);
        known.then_some(()).ok_or(Fault::InvalidLink)
    }

    /// Reads the arguments that many procedures share (link, flags, lock timeout, I/O timeout) and waits until no other
    /// link holds the lock. Returns the link and the deadline of the I/O timeout.
    async fn generic(
        &self,
        arguments: &mut Reader<'_>,
    ) -> Result<Result<(u32, Instant), Fault>, MalformedArguments> {
        let link = arguments.word()?;
        let flags = arguments.word()?;
        let lock = within(arguments.word()?);
        let deadline = within(arguments.word()?);
        if let Err(fault) = self.known(link) {
            return Ok(Err(fault));
        }
        let wait = flags & WAIT_FOR_LOCK != 0;
        let passed = self.port.pass(link, false, wait, lock).await;
        Ok(passed.map(|()| (link, deadline)))
    }

    async fn write(
        &mut self,
        link: u32,
        data: &[u8],
        flags: u32,
        deadline: Instant,
        lock: Instant,
    ) -> Result<(), Fault> {
        self.known(link)?;
        let wait = flags & WAIT_FOR_LOCK != 0;
        self.port.pass(link, false, wait, lock).await?;
        let found = self.links.get_mut(&link).ok_or(Fault::InvalidLink)?;
        found.write(data, flags & END != 0, deadline).await
    }

    async fn read(
        &self,
        link: u32,
        request: ReadRequest,
        flags: u32,
        lock: Instant,
    ) -> Result<(u32, Vec<u8>), Fault> {
        let found = self.links.get(&link).ok_or(Fault::InvalidLink)?;
        let wait = flags & WAIT_FOR_LOCK != 0;
        self.port.pass(link, false, wait, lock).await?;
        found.read(request).await
    }

    /// A serial poll: the status byte, with the message-available bit of this link.
    async fn status_byte(&self, link: u32) -> u32 {
        let Some(link) = self.links.get(&link) else {
            return 0;
        };
        let byte = u32::from(link.session().status_byte().await);
        match link.has_reply() {
            true => byte | MESSAGE_AVAILABLE,
            false => byte & !MESSAGE_AVAILABLE,
        }
    }

    async fn trigger(&self, link: u32, deadline: Instant) -> Result<(), Fault> {
        let link = self.links.get(&link).ok_or(Fault::InvalidLink)?;
        link.trigger(deadline).await
    }
}

fn status(done: Result<(), Fault>) -> u32 {
    done.map_or_else(|fault| fault as u32, |()| 0)
}

fn code(done: Result<(), Fault>) -> Vec<u8> {
    Writer::default().word(status(done)).bytes()
}
