//! The procedures of the core and abort programs (VXI-11 revision 1.0, section B.6).

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use rig::{BoxStream, Stream};
use tokio::io::AsyncWriteExt;
use tokio::net::TcpListener;
use tokio::task::JoinSet;
use tokio::time::Instant;

use crate::transport::client::ClientSession;
use crate::transport::vxi11::link::{Fault, Link, ReadRequest, within};
use crate::transport::vxi11::port::Port;
use crate::transport::vxi11::rpc::{Call, Garbage, Reader, Reply, Writer, marked, read_record};
use crate::{Instrument, SimulatedRig};

const CORE: u32 = 0x0006_07AF;
const ABORT: u32 = 0x0006_07B0;
const VERSION: u32 = 1;

/// Most data in one device_write, bytes; what is longer comes in several.
const LARGEST_WRITE: usize = 16 * 1024;
/// Most data in one answer to device_read, bytes.
const LARGEST_READ: usize = 1024 * 1024;
/// Longest record: clients in use write a long message at once, whatever limit they were given.
const LARGEST_RECORD: usize = 256 * 1024;
/// Most links of a connection.
const LINKS: usize = 16;
/// The instrument's name.
const NAME: &[u8] = b"inst0";
/// Room of a connection in memory, bytes.
const PIPE: usize = 64 * 1024;

const WAIT_FOR_LOCK: u32 = 1;
const END: u32 = 8;
const UNTIL_CHARACTER: u32 = 128;

const MESSAGE_AVAILABLE: u32 = 1 << 4;

/// The mainframe's VXI-11 core channel, in memory; [`crate::serve`] gives it a port.
#[derive(Debug, Clone)]
pub struct CoreChannel(Arc<Port>);

impl CoreChannel {
    /// The channel of a rig; links of all its connections share one lock.
    pub fn new(rig: &SimulatedRig) -> Self {
        Self::on_port(rig.clone(), 0)
    }

    fn on_port(rig: SimulatedRig, number: u16) -> Self {
        Self(Arc::new(Port::new(rig, number)))
    }

    /// A connection that RPC records (RFC 5531) go over. Inside a tokio runtime.
    pub fn connect(&self) -> BoxStream {
        let (here, there) = tokio::io::duplex(PIPE);
        tokio::spawn(connection(self.0.clone(), there, "memory".to_owned()));
        Box::new(here)
    }
}

/// Serves the mainframe's core channel.
pub(crate) async fn serve(rig: SimulatedRig, listener: TcpListener) {
    let number = listener.local_addr().map_or(0, |address| address.port());
    let CoreChannel(port) = CoreChannel::on_port(rig, number);
    let mut clients = JoinSet::new();
    loop {
        match listener.accept().await {
            Ok((stream, address)) => {
                stream.set_nodelay(true).ok();
                clients.spawn(connection(port.clone(), stream, address.to_string()));
            }
            Err(fault) => {
                tracing::warn!("a VXI-11 client could not be accepted: {fault}");
                tokio::task::yield_now().await;
            }
        }
        while clients.try_join_next().is_some() {}
    }
}

async fn connection(port: Arc<Port>, mut stream: impl Stream, address: String) {
    let cut = port.rig.until_cut(Instrument::Mainframe);
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

/// The links of one connection; they end with it.
struct Links {
    port: Arc<Port>,
    address: String,
    links: BTreeMap<u32, Link>,
}

impl Drop for Links {
    fn drop(&mut self) {
        for link in self.links.keys() {
            self.port.release(*link);
            self.port.aborters().remove(link);
        }
    }
}

impl Links {
    async fn answer(&mut self, stream: &mut impl Stream) -> io::Result<()> {
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
            Err(Garbage) => Reply::GarbageArguments,
        }
    }

    fn abort(
        &self,
        procedure: u32,
        arguments: &mut Reader<'_>,
    ) -> Result<Option<Vec<u8>>, Garbage> {
        if procedure != 1 {
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
    ) -> Result<Option<Vec<u8>>, Garbage> {
        Ok(Some(match procedure {
            10 => self.create(arguments).await?,
            11 => {
                let link = arguments.word()?;
                let deadline = within(arguments.word()?);
                let lock = within(arguments.word()?);
                let flags = arguments.word()?;
                let data = arguments.opaque()?;
                let done = self.write(link, data, flags, deadline, lock).await;
                // The record's bound keeps the count small.
                let taken = done.map_or(0, |()| u32::try_from(data.len()).unwrap_or(u32::MAX));
                Writer::default().word(status(done)).word(taken).bytes()
            }
            12 => {
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
            13 => {
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
            14 => {
                let done = match self.generic(arguments).await? {
                    Ok((link, deadline)) => self.trigger(link, deadline).await,
                    Err(fault) => Err(fault),
                };
                code(done)
            }
            15 => {
                let request = self.generic(arguments).await?;
                if let Ok((link, _)) = request
                    && let Some(link) = self.links.get_mut(&link)
                {
                    link.clear().await;
                }
                code(request.map(|_| ()))
            }
            // There is no front panel to lock.
            16 | 17 => code(self.generic(arguments).await?.map(|_| ())),
            18 => {
                let link = arguments.word()?;
                let flags = arguments.word()?;
                let deadline = within(arguments.word()?);
                let wait = flags & WAIT_FOR_LOCK != 0;
                code(match self.known(link) {
                    Ok(()) => self.port.pass(link, true, wait, deadline).await,
                    Err(fault) => Err(fault),
                })
            }
            19 => {
                let link = arguments.word()?;
                code(self.known(link).and_then(|()| {
                    let held = self.port.release(link);
                    held.then_some(()).ok_or(Fault::NoLock)
                }))
            }
            // Service requests need the interrupt channel; enabling them without one does nothing.
            20 => {
                let link = arguments.word()?;
                arguments.flag()?;
                arguments.opaque()?;
                code(self.known(link))
            }
            22 => Writer::default()
                .word(Fault::NotSupported as u32)
                .opaque(&[])
                .bytes(),
            23 => {
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
            25 | 26 => code(Err(Fault::NotSupported)),
            _ => return Ok(None),
        }))
    }

    async fn create(&mut self, arguments: &mut Reader<'_>) -> Result<Vec<u8>, Garbage> {
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
            let link = Link::new(ClientSession::enter(
                &self.port.rig,
                Instrument::Mainframe,
                &address,
            ));
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

    /// The arguments that many procedures share: link, flags, lock timeout, I/O timeout. Gives the link and the deadline.
    async fn generic(
        &self,
        arguments: &mut Reader<'_>,
    ) -> Result<Result<(u32, Instant), Fault>, Garbage> {
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

    /// A serial poll: the status byte with message available as this link has it.
    async fn status_byte(&self, link: u32) -> u32 {
        let Some(link) = self.links.get(&link) else {
            return 0;
        };
        let byte = u32::from(link.client().status_byte().await);
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
