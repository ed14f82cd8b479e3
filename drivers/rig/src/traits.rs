//! The traits of a rig's instruments: what `acquire` needs of a source, a switch and a voltmeter.

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use survey::{Amps, Reading, Relay, Timing, Volts};
use tokio::sync::{Mutex, OwnedMutexGuard};

use crate::RigError;

/// Drives a known current through the pair that the switch has connected to it. Every method fails with [`RigError`] if
/// the instrument rejects a command, replies in an unexpected form, or cannot be reached.
pub trait CurrentSource: Send {
    /// Sets 0 A, output off, the fixed range that holds `current`, and the voltage limit, and verifies all of them by
    /// read-back. Clears earlier compliance events.
    fn prepare(
        &mut self,
        current: Amps,
        compliance: Volts,
    ) -> impl Future<Output = Result<(), RigError>> + Send;

    /// Sets the level. A level outside the prepared range is refused, never clipped.
    fn set_current(&mut self, current: Amps) -> impl Future<Output = Result<(), RigError>> + Send;

    /// Switches the output.
    fn set_output(&mut self, on: bool) -> impl Future<Output = Result<(), RigError>> + Send;

    /// Turns the output on at 0 A, then sets the current. One message if the instrument allows it.
    fn switch_on(&mut self, current: Amps) -> impl Future<Output = Result<(), RigError>> + Send {
        async move {
            self.set_output(true).await?;
            self.set_current(current).await
        }
    }

    /// Reads whether the source is in compliance (limited by its voltage limit) now, or entered it since the last call.
    fn compliance(&mut self) -> impl Future<Output = Result<Compliance, RigError>> + Send;

    /// Reads whether the source is in compliance now, or was since the last call.
    fn in_compliance(&mut self) -> impl Future<Output = Result<bool, RigError>> + Send {
        async { Ok(self.compliance().await?.occurred()) }
    }

    /// Sets 0 A and output off, then reads both back.
    ///
    /// # Errors
    /// [`RigError::NotOff`] if the read-back differs.
    fn off(&mut self) -> impl Future<Output = Result<(), RigError>> + Send;
}

/// Compliance state of a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Compliance {
    /// Whether the source is in compliance now.
    pub now: bool,
    /// Whether the source entered compliance at any time since the last call.
    pub since: bool,
}

impl Compliance {
    /// Whether the source is in compliance now, or entered it since the last call.
    pub fn occurred(self) -> bool {
        self.now || self.since
    }
}

/// A relay command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Move {
    /// Close these.
    Close(Vec<Relay>),
    /// Open these.
    Open(Vec<Relay>),
}

/// Connects pairs of electrodes to source and voltmeter. Every method fails as those of [`CurrentSource`], and with
/// [`RigError::Unable`] or [`RigError::WrongModule`] for a relay that the switch does not have.
pub trait Switch: Send {
    /// Prepares for this time between two messages while relays are closed, the longest that is planned. Without effect
    /// on a switch that never opens relays by itself.
    fn prepare_for_silence(
        &mut self,
        _longest: Duration,
    ) -> impl Future<Output = Result<(), RigError>> + Send {
        async { Ok(()) }
    }

    /// Executes the moves in order. They may be held back and sent in one segment with the next query to the same
    /// instrument; [`Switch::settle`] ensures that the relays have moved.
    fn move_relays(&mut self, moves: &[Move]) -> impl Future<Output = Result<(), RigError>> + Send;

    /// Sends the moves held back and waits until the relays have moved.
    fn settle(&mut self) -> impl Future<Output = Result<(), RigError>> + Send;

    /// Reads back which of the relays are closed, in the order given.
    fn closed(
        &mut self,
        relays: &[Relay],
    ) -> impl Future<Output = Result<Vec<bool>, RigError>> + Send;

    /// Opens the relays given and verifies by read-back.
    ///
    /// # Errors
    /// [`RigError::StillClosed`] naming the relays that stay closed.
    fn open_verified(
        &mut self,
        relays: &[Relay],
    ) -> impl Future<Output = Result<(), RigError>> + Send;

    /// Reads back which of `requested` are closed, then opens `relays` like [`Switch::open_verified`]; in one message
    /// if the instrument allows it.
    fn closed_before_opening(
        &mut self,
        requested: &[Relay],
        relays: &[Relay],
    ) -> impl Future<Output = Result<Vec<bool>, RigError>> + Send {
        async move {
            let closed = self.closed(requested).await?;
            self.open_verified(relays).await?;
            Ok(closed)
        }
    }
}

/// Settings of the voltmeter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeterSettings {
    /// The range of readings that have no range of their own.
    pub range: Volts,
    /// Integration time, power-line cycles; one of those that the voltmeter has.
    pub nplc: f64,
    /// Resolution at this integration time as a fraction of the range, from the driver's table; 0 if unknown.
    pub resolution: f64,
    /// Whether a zero reading follows every reading.
    pub autozero: bool,
    /// Readings averaged to one, 1 or more.
    pub averages: u32,
    /// Delay before each scanned channel.
    pub channel_delay: Duration,
    /// Time allowed for the readings of one query ([`survey::Plan::longest_answer`]), in addition to the link's
    /// timeout; `None`: the driver's own estimate.
    pub deadline: Option<Duration>,
}

impl MeterSettings {
    /// Settings without averaging, autozero and delay; resolution unknown.
    pub const fn new(range: Volts, nplc: f64) -> Self {
        Self {
            range,
            nplc,
            resolution: 0.0,
            autozero: false,
            averages: 1,
            channel_delay: Duration::ZERO,
            deadline: None,
        }
    }

    /// Settings with the integration time, averaging, autozero and delay of this timing; resolution unknown.
    pub const fn timed(range: Volts, timing: &Timing) -> Self {
        Self {
            autozero: timing.autozero,
            averages: timing.averages,
            channel_delay: timing.channel_delay,
            ..Self::new(range, timing.nplc)
        }
    }
}

/// A channel to scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// The channel's relay.
    pub relay: Relay,
    /// The channel's range.
    pub range: Volts,
    /// Delay between closing its relay and reading, in addition to the delay of every channel: the settling time of the
    /// sheet after a change of current.
    pub wait: Duration,
}

/// A pair to connect to the voltmeter and to read.
#[derive(Debug, Clone, PartialEq)]
pub struct ChainedReading {
    /// The moves that open the previous pair and close this one.
    pub moves: Vec<Move>,
    /// The pair's range.
    pub range: Volts,
}

/// The mean of readings of one voltage, or the first invalid reading.
pub fn mean(readings: &[Reading]) -> Reading {
    let mut sum = 0.0;
    for reading in readings {
        match reading {
            Reading::Ok(volts) => sum += volts.0,
            lacking => return *lacking,
        }
    }
    match readings.len() {
        0 => Reading::NotMeasured,
        count => Reading::Ok(Volts(sum / count as f64)),
    }
}

/// Reads voltages. With averaging each reading is the mean of several. Every method fails as those of
/// [`CurrentSource`], and with [`RigError::Unable`] for a setting or operation that the voltmeter does not have.
pub trait Voltmeter: Send {
    /// Sets function, range, integration, and the relays to scan in this order (empty: single readings only).
    fn prepare(
        &mut self,
        meter: MeterSettings,
        scan: &[Relay],
    ) -> impl Future<Output = Result<(), RigError>> + Send;

    /// Scans the prepared list once on the prepared range. Returns one reading for each relay, in the order of the
    /// list.
    fn scan(&mut self) -> impl Future<Output = Result<Vec<Reading>, RigError>> + Send;

    /// Scans these channels, each on its range and after its delay. Returns one reading for each channel, in their
    /// order. Relay moves held back by a switch of the same instrument are executed first.
    fn scan_on(
        &mut self,
        channels: &[Sample],
    ) -> impl Future<Output = Result<Vec<Reading>, RigError>> + Send;

    /// Reads the pair connected to the voltmeter once, on the prepared range.
    fn read(&mut self) -> impl Future<Output = Result<Reading, RigError>> + Send;

    /// Reads the pair connected to the voltmeter once, on this range.
    fn read_on(&mut self, range: Volts) -> impl Future<Output = Result<Reading, RigError>> + Send;

    /// Connects and reads one pair after the other in a single message. Returns one reading for each pair, in order.
    ///
    /// # Errors
    /// [`RigError::Unable`] if the voltmeter has no relays.
    fn chain(
        &mut self,
        chained: &[ChainedReading],
    ) -> impl Future<Output = Result<Vec<Reading>, RigError>> + Send;
}

/// The instruments of a rig. Switch and voltmeter may be two handles of one instrument.
#[derive(Debug)]
pub struct Instruments<C, W, V> {
    /// The current source.
    pub source: C,
    /// The switch.
    pub switch: W,
    /// The voltmeter.
    pub voltmeter: V,
}

/// A handle of a rig: clones share the instruments, and each user locks them exclusively.
///
/// [`crate::acquire`] needs shared instruments to finish safely if its future is dropped: its task keeps them locked
/// until the source is off, and the next user waits for that.
#[derive(Debug)]
pub struct Rig<C, W, V> {
    instruments: Arc<Mutex<Instruments<C, W, V>>>,
    simulated: bool,
}

impl<C, W, V> Clone for Rig<C, W, V> {
    fn clone(&self) -> Self {
        Self {
            instruments: Arc::clone(&self.instruments),
            simulated: self.simulated,
        }
    }
}

impl<C, W, V> Rig<C, W, V> {
    /// A rig of real instruments; see [`Rig::as_simulated`].
    pub fn new(source: C, switch: W, voltmeter: V) -> Self {
        Self {
            instruments: Arc::new(Mutex::new(Instruments {
                source,
                switch,
                voltmeter,
            })),
            simulated: false,
        }
    }

    /// Sets whether any part of the rig is simulated; the frames are then marked as simulated.
    pub fn as_simulated(self, simulated: bool) -> Self {
        Self { simulated, ..self }
    }

    /// Whether any part is simulated.
    pub fn is_simulated(&self) -> bool {
        self.simulated
    }

    /// Waits until no other user holds the instruments, then locks them.
    pub async fn lock(&self) -> OwnedMutexGuard<Instruments<C, W, V>> {
        Arc::clone(&self.instruments).lock_owned().await
    }
}
