//! Connections of clients to an instrument: each has its own session; delivery of replies.

use std::io;
use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use rig::BoxStream;
use scpi::ParseError;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::sync::watch;
use tokio::time::Instant;

use crate::instrument::fault::ReplyFault;
use crate::instrument::{Instrument, Wire, WireState};
use crate::simulated_instruments::{MessageOutcome, ReplyTiming};
use crate::simulated_rig::SimulatedRig;

/// Longest message that an instrument accepts, bytes; a longer one is dropped and queues -363.
pub(crate) const LONGEST_MESSAGE: usize = 64 * 1024;

/// How long to wait for a reply for a client that has closed its sending side.
const HALF_CLOSED_TIMEOUT: Duration = Duration::from_secs(10);

/// A line that no instrument sends, as received with a wrong baud rate.
const RUBBISH: &[u8] = b"\x8f\xfe?%x\xc3(\xb2;,\x07\n";

/// Capacity of a pipe in memory, bytes.
const PIPE: usize = 64 * 1024;

/// A message this soon after the previous reply was due counts as sent immediately after it.
const IMMEDIATELY: Duration = Duration::from_millis(3);

/// Shortest interval for computing readings while a client waits for them.
const SHORTEST_STEP: Duration = Duration::from_millis(5);
const LONGEST_STEP: Duration = Duration::from_millis(100);

/// A client connected to an instrument; it is in the rig's list of clients until it is dropped.
#[derive(Debug)]
pub(crate) struct ClientSession {
    rig: SimulatedRig,
    instrument: Instrument,
    session: u32,
    line: watch::Receiver<WireState>,
    cuts: u64,
    /// When the last reply was due, without delays of timers.
    due: Mutex<Instant>,
    /// Whether this is the source's serial port, whose line end is a setting.
    serial: bool,
}

impl ClientSession {
    /// Registers a client; `address` is for display.
    pub(crate) fn register(rig: &SimulatedRig, instrument: Instrument, address: &str) -> Self {
        let session = rig.shared.sessions.fetch_add(1, Ordering::Relaxed);
        let line = rig.shared.wires[instrument.index()].subscribe();
        let cuts = line.borrow().cuts;
        // The instrument identifies a client of its network port by the address (`SYST:LOCK:OWN?`).
        let socket = address.rsplit(' ').next().unwrap_or(address);
        if let Ok(socket) = socket.parse::<SocketAddr>() {
            rig.name_session(instrument, session, &format!("LAN{}", socket.ip()));
        }
        rig.clients()
            .insert(session, (instrument, address.to_owned()));
        rig.shared.changed.notify_waiters();
        Self {
            rig: rig.clone(),
            instrument,
            session,
            line,
            cuts,
            due: Mutex::new(Instant::now()),
            serial: false,
        }
    }

    /// Sets the instrument's name for the session's interface.
    pub(crate) fn named(self, name: &str) -> Self {
        self.rig.name_session(self.instrument, self.session, name);
        self
    }

    /// Converts received bytes: a carriage return ends a message if the serial port is set so; next to a line feed it
    /// is white space.
    fn received_as(&self, bytes: &mut [u8]) {
        if self.serial && self.rig.serial_terminator() == "\r" {
            for byte in bytes.iter_mut().filter(|byte| **byte == b'\r') {
                *byte = b'\n';
            }
        }
    }

    /// Converts replies to the port's line end.
    fn sent_as(&self, bytes: Vec<u8>) -> Vec<u8> {
        let terminator = self.rig.serial_terminator();
        if !self.serial || terminator == "\n" {
            return bytes;
        }
        // No reply contains a line feed.
        let ended = |byte: u8| match byte {
            b'\n' => terminator.as_bytes().to_vec(),
            other => vec![other],
        };
        bytes.into_iter().flat_map(ended).collect()
    }

    /// Waits until the wire is cut.
    pub(crate) async fn cut(&self) {
        cut(self.line.clone(), self.cuts).await;
    }

    /// Whether the wire is silent.
    pub(crate) fn is_silent(&self) -> bool {
        self.line.borrow().wire == Wire::Silent
    }

    /// Passes a message to the instrument, waits for the reply, and returns the bytes to send.
    pub(crate) async fn receive(&self, message: Vec<u8>) -> io::Result<Vec<u8>> {
        let received = self.begin(message).await?;
        Ok(self.finish(received).await)
    }

    /// Passes a message to the instrument. [`ClientSession::finish`] waits for the reply.
    pub(crate) async fn begin(&self, message: Vec<u8>) -> io::Result<MessageOutcome> {
        let received = String::from_utf8_lossy(&message).into_owned();
        let (rig, instrument, session) = (self.rig.clone(), self.instrument, self.session);
        // A moved load needs a solution of the sheet, too long for a thread with other tasks.
        let reply = tokio::task::spawn_blocking(move || {
            rig.receive_from(instrument, session, &received, ReplyTiming::InTime)
        })
        .await;
        reply.map_err(io::Error::other)
    }

    /// When the reply to a message received now is due. A client that sends the next message immediately gets replies
    /// at the source's own rate (200 messages per second at 5 ms): delays of timers and transfers are compensated.
    fn due(&self, wait: Duration) -> Instant {
        let now = Instant::now();
        if self.instrument != Instrument::Source || wait.is_zero() {
            return now + wait;
        }
        let mut due = self.due.lock().unwrap_or_else(PoisonError::into_inner);
        let at_once = now.saturating_duration_since(*due) < IMMEDIATELY;
        *due = if at_once { *due + wait } else { now + wait };
        *due
    }

    /// Waits for the reply, and returns the bytes to send, with their line end unless a fault removed it.
    pub(crate) async fn finish(&self, received: MessageOutcome) -> Vec<u8> {
        // Delays of timers are compensated, a fault that slows the instrument is not.
        let slowness = self.rig.slowness(self.instrument);
        let end = self.due(received.wait) + slowness;
        // Each reading needs a solution of the sheet: they are computed during the wait, not at its end.
        let step = (received.wait / 8).clamp(SHORTEST_STEP, LONGEST_STEP);
        let mut aborted = false;
        while received.later && !aborted && end.saturating_duration_since(Instant::now()) > 2 * step
        {
            tokio::time::sleep(step).await;
            let (rig, instrument, session) = (self.rig.clone(), self.instrument, self.session);
            let there =
                tokio::task::spawn_blocking(move || rig.catch_up(instrument, session)).await;
            aborted = there.unwrap_or_default();
        }
        if !aborted && !(received.wait + slowness).is_zero() {
            tokio::time::sleep_until(end).await;
        }
        let text = if received.later {
            let (rig, instrument, session) = (self.rig.clone(), self.instrument, self.session);
            let fetched = tokio::task::spawn_blocking(move || rig.fetch(instrument, session)).await;
            fetched.ok().flatten()
        } else {
            received.text
        };
        let Some(text) = text else {
            return Vec::new();
        };
        if self.line.borrow().wire != Wire::Sound {
            return Vec::new();
        }
        let (fault, text) = self
            .rig
            .reply_fault(self.instrument, text, received.measured);
        let mut bytes = text.into_bytes();
        match fault {
            None | Some(ReplyFault::NotANumber | ReplyFault::Stale) => bytes.push(b'\n'),
            Some(ReplyFault::Lost) => bytes.clear(),
            Some(ReplyFault::Rubbish) => bytes = RUBBISH.to_vec(),
            Some(ReplyFault::HalfLine) => bytes.truncate(bytes.len() / 2),
            Some(ReplyFault::Late(by)) => {
                tokio::time::sleep(by).await;
                bytes.push(b'\n');
            }
            Some(ReplyFault::Doubled) => {
                bytes.push(b'\n');
                bytes.extend_from_within(..);
            }
        }
        bytes
    }

    /// Queues an error that does not belong to a message: -363, -410, -420. Only the board sends a reply.
    pub(crate) fn refuse(&self, refusal: ParseError) -> Option<String> {
        self.rig.refuse(self.instrument, self.session, refusal)
    }

    /// Device clear: ends what the instrument does for this client.
    pub(crate) async fn clear(&self) {
        let (rig, instrument, session) = (self.rig.clone(), self.instrument, self.session);
        // Opening relays needs a solution of the sheet. The blocking task is never cancelled.
        tokio::task::spawn_blocking(move || rig.clear_session(instrument, session))
            .await
            .ok();
    }

    /// The status byte of a serial poll, without message available.
    pub(crate) async fn status_byte(&self) -> u8 {
        let (rig, instrument) = (self.rig.clone(), self.instrument);
        let byte = tokio::task::spawn_blocking(move || rig.status_byte(instrument)).await;
        byte.unwrap_or_default()
    }

    /// Serves a byte stream until its client disconnects.
    pub(crate) async fn answer<S>(&self, stream: &mut S) -> io::Result<()>
    where
        S: AsyncRead + AsyncWrite + Unpin + Send,
    {
        let mut framer = scpi::Framer::new(LONGEST_MESSAGE);
        let mut chunk = [0; 4096];
        let mut banner = self.rig.shared.banners[self.instrument.index()].subscribe();
        let mut half_closed = false;
        loop {
            // Messages received while the instrument was busy are handled before more is read.
            while let Some(message) = framer.next() {
                let message = match message {
                    Ok(message) => message,
                    Err(scpi::Oversized { .. }) => {
                        if let Some(reply) = self.refuse(ParseError::InputOverrun) {
                            stream.write_all(format!("{reply}\n").as_bytes()).await?;
                        }
                        continue;
                    }
                };
                let mut ahead = Vec::new();
                let reply = {
                    let receiving = self.receive(message);
                    await_reply(receiving, stream, &mut ahead, &mut half_closed).await?
                };
                if !self.is_silent() {
                    self.received_as(&mut ahead);
                    framer.push(&ahead);
                }
                if !reply.is_empty() {
                    stream.write_all(&self.sent_as(reply)).await?;
                    stream.flush().await?;
                }
            }
            if half_closed {
                return Ok(());
            }
            let count = tokio::select! {
                count = stream.read(&mut chunk) => count?,
                Ok(()) = banner.changed() => {
                    let mut line = banner.borrow_and_update().clone();
                    line.push('\n');
                    stream.write_all(line.as_bytes()).await?;
                    stream.flush().await?;
                    framer.clear();
                    continue;
                }
            };
            if count == 0 {
                return Ok(());
            }
            if !self.is_silent() {
                self.received_as(&mut chunk[..count]);
                framer.push(&chunk[..count]);
            }
        }
    }
}

/// Waits for a reply and watches the client: bytes received meanwhile are kept, up to a limit. A client that breaks
/// the connection is released immediately. A client that has closed its sending side is released after
/// [`HALF_CLOSED_TIMEOUT`], because it cannot be distinguished from one that no longer exists.
async fn await_reply<S>(
    receiving: impl Future<Output = io::Result<Vec<u8>>>,
    stream: &mut S,
    ahead: &mut Vec<u8>,
    half_closed: &mut bool,
) -> io::Result<Vec<u8>>
where
    S: AsyncRead + Unpin,
{
    let mut chunk = [0; 4096];
    tokio::pin!(receiving);
    let grace = tokio::time::sleep(HALF_CLOSED_TIMEOUT);
    tokio::pin!(grace);
    loop {
        tokio::select! {
            biased;
            reply = &mut receiving => return reply,
            count = stream.read(&mut chunk), if !*half_closed && ahead.len() < LONGEST_MESSAGE => {
                match count? {
                    0 => {
                        *half_closed = true;
                        grace.as_mut().reset(Instant::now() + HALF_CLOSED_TIMEOUT);
                    }
                    count => ahead.extend_from_slice(&chunk[..count]),
                }
            }
            () = &mut grace, if *half_closed => {
                return Err(io::Error::new(io::ErrorKind::TimedOut, "its client has disconnected"));
            }
        }
    }
}

impl Drop for ClientSession {
    fn drop(&mut self) {
        self.rig.clients().remove(&self.session);
        self.rig.forget_session(self.instrument, self.session);
        self.rig.shared.changed.notify_waiters();
    }
}

async fn cut(mut line: watch::Receiver<WireState>, before: u64) {
    // Waiting cannot fail: the waiting task holds the rig, and with it the sender.
    line.wait_for(|line| line.wire == Wire::Cut || line.cuts != before)
        .await
        .ok();
}

/// How a connection ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    /// The client closed it.
    Clean,
    /// The connection was reset, or the wire cut.
    Abnormal,
}

impl SimulatedRig {
    /// Connects a client to one of the instruments. The mainframe serves several clients at once. The port of the
    /// multiplexer board has been open since power on, so no banner is sent.
    pub fn connect(&self, instrument: Instrument) -> BoxStream {
        let (here, there) = tokio::io::duplex(PIPE);
        tokio::spawn(
            self.clone()
                .converse(instrument, "memory".to_owned(), there),
        );
        Box::new(here)
    }

    /// Waits until the wire to an instrument is cut after this call.
    pub(crate) fn until_cut(&self, instrument: Instrument) -> impl Future<Output = ()> + use<> {
        let line = self.shared.wires[instrument.index()].subscribe();
        let cuts = line.borrow().cuts;
        cut(line, cuts)
    }

    /// Waits until the wire to an instrument is not cut.
    pub(crate) async fn until_connected(&self, instrument: Instrument) {
        let mut line = self.shared.wires[instrument.index()].subscribe();
        line.wait_for(|line| line.wire != Wire::Cut).await.ok();
    }

    /// Serves one connection until its client disconnects or the wire is cut.
    pub(crate) async fn converse<S>(self, instrument: Instrument, address: String, stream: S) -> End
    where
        S: AsyncRead + AsyncWrite + Unpin + Send,
    {
        let client = ClientSession::register(&self, instrument, &address);
        serve_client(client, address, stream).await
    }

    /// Serves a serial port until it is removed.
    pub(crate) async fn converse_by_serial<S>(
        self,
        instrument: Instrument,
        address: String,
        stream: S,
    ) -> End
    where
        S: AsyncRead + AsyncWrite + Unpin + Send,
    {
        let mut client = ClientSession::register(&self, instrument, &address);
        client.serial = instrument == Instrument::Source;
        serve_client(client, address, stream).await
    }
}

async fn serve_client<S>(client: ClientSession, address: String, mut stream: S) -> End
where
    S: AsyncRead + AsyncWrite + Unpin + Send,
{
    tokio::select! {
        biased;
        () = client.cut() => End::Abnormal,
        ended = client.answer(&mut stream) => match ended {
            Ok(()) => {
                stream.shutdown().await.ok();
                End::Clean
            }
            Err(fault) => {
                tracing::debug!("{address} disconnected from the {}: {fault}", client.instrument);
                End::Abnormal
            }
        }
    }
}
