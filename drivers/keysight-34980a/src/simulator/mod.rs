//! The mainframe as a state machine: relays, scan list, voltmeter, memory, sequences, sessions, status, error queue.
//!
//! No I/O, no clock, no physics: lines and time are passed in, relays and voltages go through [`Wires`]. Internal
//! activity (a scan into memory, a sequence) is executed when the time is next advanced, each event at its own instant:
//! see [`Simulator34980a::pass`] and [`Simulator34980a::due`].
//!
//! Assumptions where the fact sheet has no information: a command error ends its message, an execution error does not.
//! A setting of the voltmeter waits for the end of a measurement if the end can be foreseen, and is rejected otherwise;
//! relays may be moved during a scan. `*OPC?` does not wait for an operation that only a trigger or ABOR can end. A
//! READ? of more readings than the memory holds, or without end, is rejected. The readings of READ? are computed
//! when the command arrives: a message of another session during the scan finds the relays in their state after the scan.

mod calendar;
mod errors;
mod execute;
mod faults;
pub(crate) mod measurement;
mod relays;
mod sequences;
mod sessions;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

pub use scpi::Response;
use scpi::{ErrorEntry, ErrorQueue, ParseError, StandardEvent, StatusModel};
use survey::{Amps, Relay, Volts};

use crate::command::{Command, HeaderForm, MEMORIES};
use crate::modules::Module;
use crate::simulator::errors::QueuedError;
use crate::simulator::execute::Execution;
use crate::simulator::measurement::deferred::Deferred;
use crate::simulator::measurement::memory::Stored;
use crate::simulator::measurement::meter::{Meter, Settings};
use calendar::Calendar;
use relays::Relays;
use sequences::Sequences;
pub use sessions::Session;
use sessions::Sessions;

/// The circuit that the mainframe's relays and voltmeter are connected to. The simulated rig implements it.
pub trait Wires {
    /// Called with the closed relays whenever they change; during a scan for every channel. A relay that is stuck
    /// in the circuit is passed as commanded.
    fn relays(&mut self, closed: &BTreeSet<Relay>, at: Duration);

    /// Called instead of [`Wires::relays`] for sweeps that are not measured, because their readings would be
    /// overwritten before they could be read: these relays have closed and opened `times` times up to `at`. Does
    /// nothing by default.
    fn skipped(&mut self, _relays: &[Relay], _times: u32, _at: Duration) {}

    /// Returns the voltage between the voltmeter's terminals, before the limit of its range is applied.
    fn measure(&mut self, at: Duration, request: MeterRequest) -> Volts;

    /// Returns the alternating voltage between the voltmeter's terminals. Returns no alternating voltage by default.
    fn alternating(&mut self, _at: Duration, _request: MeterRequest) -> Alternating {
        Alternating::default()
    }
}

/// An alternating voltage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alternating {
    /// R.m.s. of the voltage without its mean.
    pub rms: Volts,
    /// Frequency, Hz; 0 without an alternating voltage.
    pub hertz: f64,
}

impl Default for Alternating {
    fn default() -> Self {
        Self {
            rms: Volts(0.0),
            hertz: 0.0,
        }
    }
}

/// The parameters of a voltage measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeterRequest {
    /// The scanned channel; `None` for the circuit that analogue bus 1 is connected to.
    pub channel: Option<Relay>,
    /// The range.
    pub range: Volts,
    /// Integration time, power-line cycles.
    pub nplc: f64,
    /// Current from the voltmeter's HI terminal to its LO terminal for a resistance measurement, otherwise 0. If the
    /// current cannot flow, the voltage is infinite.
    pub test_current: Amps,
    /// Whether the voltage is measured on analogue bus 2.
    pub four_wire: bool,
}

impl MeterRequest {
    /// A DC voltage, over one power-line cycle.
    pub fn volts(channel: Option<Relay>, range: Volts) -> Self {
        Self {
            channel,
            range,
            nplc: 1.0,
            test_current: Amps(0.0),
            four_wire: false,
        }
    }
}

/// Configuration of a simulated mainframe.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings34980a {
    /// First field of `*IDN?`.
    pub vendor: String,
    /// Third field of `*IDN?`.
    pub serial: String,
    /// The modules of slots 1 to 8.
    pub slots: [Option<Module>; 8],
    /// Mains frequency, Hz.
    pub line_hz: f64,
    /// Time to receive a message, independent of its content.
    pub message_time: Duration,
    /// Time that a measurement setting takes for each of its channels.
    pub setting_time: Duration,
    /// Number of readings that the memory holds.
    pub memory: usize,
    /// The clock at time zero, as time since 1970-01-01.
    pub clock: Duration,
    /// The accepted header form for autozero and input impedance; the other form gives error -113.
    pub headers: HeaderForm,
}

impl Default for Settings34980a {
    /// Empty slots, 50 Hz, no time for messages and settings, memory as in section 5, clock at the year 2000.
    fn default() -> Self {
        Self {
            vendor: "Agilent Technologies".to_owned(),
            serial: "MY44000001".to_owned(),
            slots: [None; 8],
            line_hz: 50.0,
            message_time: Duration::ZERO,
            setting_time: Duration::ZERO,
            memory: 500_000,
            clock: Duration::from_secs(946_684_800),
            headers: HeaderForm::default(),
        }
    }
}

/// Entries of the error queue (section 7).
const ERRORS: usize = 20;

/// Questionable bits (section 7).
const VOLTAGE_OVERLOAD: u8 = 0;
const CURRENT_OVERLOAD: u8 = 1;
const RESISTANCE_OVERLOAD: u8 = 9;
const TEMPERATURE_OVERLOAD: u8 = 10;
const MEMORY_OVERFLOW: u8 = 12;
/// Operation bits (section 7).
const MEASURING: u8 = 4;
const WAITING_FOR_TRIGGER: u8 = 5;
const CONFIGURATION_CHANGED: u8 = 8;
const MEMORY_THRESHOLD: u8 = 9;
const LOCKED: u8 = 10;
const SEQUENCE_RUNNING: u8 = 14;

/// A simulated mainframe.
#[derive(Debug)]
pub struct Simulator34980a {
    settings: Settings34980a,
    relays: Relays,
    meter: Meter,
    sequences: Sequences,
    sessions: Sessions,
    calendar: Calendar,
    status: StatusModel,
    errors: ErrorQueue,
    /// Readings that crossed a limit, with the numbers of their alarms, oldest first.
    alarms: VecDeque<(Stored, u8)>,
    display: String,
    display_on: bool,
    /// The settings stored by `*SAV`; they survive `*RST` and power off.
    kept: [Option<Settings>; MEMORIES as usize],
    /// Whether `kept[recalled]` is recalled at power on; both fields survive `*RST` and power off.
    recall_at_power_on: bool,
    recalled: u8,
    /// User labels of channels; they survive `*RST` and power off.
    labels: BTreeMap<Relay, String>,
    /// Whether commands may begin before relays have settled.
    overlap: bool,
    /// Whether `*OPC` waits for the end of pending operations.
    completion_awaited: bool,
    /// Whether the reply to the present message may be deferred.
    deferring: bool,
    deferred: Option<Deferred>,
}

impl Simulator34980a {
    /// A mainframe just switched on, all relays open.
    pub fn new(settings: Settings34980a) -> Self {
        Self {
            relays: Relays::new(settings.slots),
            meter: Meter::new(settings.line_hz, settings.memory),
            sequences: Sequences::default(),
            sessions: Sessions::default(),
            calendar: Calendar::new(settings.clock),
            status: StatusModel::new(),
            errors: ErrorQueue::new(ERRORS),
            alarms: VecDeque::new(),
            display: String::new(),
            display_on: true,
            kept: Default::default(),
            recall_at_power_on: false,
            recalled: 0,
            labels: BTreeMap::new(),
            overlap: false,
            completion_awaited: false,
            deferring: false,
            deferred: None,
            settings,
        }
    }

    /// The relays that the mainframe assumes to be closed.
    pub fn closed(&self) -> &BTreeSet<Relay> {
        self.relays.closed()
    }

    /// Number of errors in the queue; never more than 20.
    pub fn errors_waiting(&self) -> usize {
        self.errors.len()
    }

    /// Total number of errors queued so far, and the last of them. Reading them leaves the queue as it is.
    pub fn latest_error(&self) -> (u64, Option<&ErrorEntry>) {
        (self.errors.added(), self.errors.latest())
    }

    /// Time of the next internal event: a reading, a sweep, a step of a sequence. [`Simulator34980a::pass`] executes it
    /// at this time, even if called later.
    pub fn due(&self) -> Option<Duration> {
        let due = [self.meter.due(), self.sequences.due()];
        due.into_iter().flatten().min()
    }

    /// Advances time: takes the readings and the steps of sequences that were due, each at its own instant. Of an
    /// endless scan it takes at most about as many readings as the memory holds.
    pub fn pass(&mut self, at: Duration, wires: &mut dyn Wires) {
        while let Some(due) = self.sequences.due().filter(|due| *due <= at) {
            self.meter.advance(due, &mut self.relays, wires);
            self.step(due, wires);
        }
        self.meter.advance(at, &mut self.relays, wires);
        self.settle_deferred(false);
        self.notice(at);
    }

    /// Switches power off and on: latching relays keep their state; sequences, relay counts, labels, stored settings
    /// and the clock are kept; settings are recalled if `MEM:STAT:REC:AUTO` is on; everything else is reset (sections 3
    /// and 6).
    pub fn power_cycle(&mut self, at: Duration, wires: &mut dyn Wires) {
        self.relays.lose_power();
        self.deferred = None;
        // Memory 0 holds the power-down state.
        self.kept[0] = Some(self.meter.settings.clone());
        self.meter.as_new();
        self.sequences.abort();
        self.sessions = Sessions::default();
        self.status = StatusModel::new();
        self.errors.clear();
        self.clear_alarms();
        self.display.clear();
        self.display_on = true;
        self.overlap = false;
        self.completion_awaited = false;
        if self.recall_at_power_on {
            match self.stored(self.recalled) {
                Ok(kept) => self.meter.take_settings(kept, &self.relays),
                Err(error) => self.fail(error),
            }
        }
        self.relays.tell(at, wires);
    }

    /// The settings stored in a memory.
    fn stored(&self, place: u8) -> Result<Settings, QueuedError> {
        let kept = self.kept[usize::from(place)].clone();
        kept.ok_or(QueuedError::NOTHING_KEPT)
    }

    /// Receives one message (a line without its end) from the only session, and returns the response.
    pub fn receive(&mut self, line: &str, at: Duration, wires: &mut dyn Wires) -> Response {
        self.receive_from(Session::default(), line, at, wires)
    }

    /// Receives one message of a session, and returns the response. The session's next message may be received when the
    /// response's time is over; other sessions need not wait for that.
    pub fn receive_from(
        &mut self,
        session: Session,
        line: &str,
        at: Duration,
        wires: &mut dyn Wires,
    ) -> Response {
        let mut execution = Execution {
            session,
            now: self.sessions.start_execution(session, at) + self.settings.message_time,
            replied: false,
            last: false,
            depth: 0,
            wires,
        };
        let mut replies = Vec::new();
        let calls = scpi::parse_message(line);
        let count = calls.len();
        for (place, call) in calls.into_iter().enumerate() {
            execution.last = place + 1 == count;
            self.pass(execution.now, execution.wires);
            let received = call.and_then(|call| Ok((call.query, self.command(&call)?)));
            let (query, command) = match received {
                Ok(received) => received,
                Err(refusal) => {
                    self.fail(refusal.into());
                    // commands after a command error are ignored; commands after an invalid value are executed
                    if refusal.code() > -200 {
                        break;
                    }
                    continue;
                }
            };
            if self.sessions.forbids(session, query, &command) {
                self.fail(QueuedError::LOCKED);
                continue;
            }
            match self.execute(command, &mut execution) {
                Ok(text) => replies.extend(text),
                Err(error) => self.fail(error),
            }
            execution.replied |= !replies.is_empty();
        }
        let done = execution.now;
        // time is not advanced to `done`: the awaited event is in the future, and other sessions may send messages
        // before it
        self.pass(at, execution.wires);
        self.sessions.keep_busy(session, done);
        Response {
            text: (!replies.is_empty()).then(|| replies.join(";")),
            busy: done - at,
        }
    }

    fn command(&self, call: &scpi::Call) -> Result<Command, ParseError> {
        let command = Command::of(call)?;
        match &command {
            Command::Sense(sense)
                if sense
                    .header_form()
                    .is_some_and(|form| form != self.settings.headers) =>
            {
                Err(ParseError::UndefinedHeader)
            }
            _ => Ok(command),
        }
    }

    fn fail(&mut self, error: QueuedError) {
        self.status.raise_error(error.code);
        if self.errors.len() >= ERRORS {
            // The replaced entry causes an event of its own.
            self.status.raise_error(ParseError::QueueOverflow.code());
        }
        self.errors.push(error.code, error.text);
    }

    /// Updates the status registers for this time.
    fn notice(&mut self, now: Duration) {
        let operation = &mut self.status.operation;
        operation.set(MEASURING, self.meter.is_measuring(now));
        operation.set(WAITING_FOR_TRIGGER, self.meter.is_waiting());
        operation.set(LOCKED, self.sessions.is_locked());
        operation.set(SEQUENCE_RUNNING, self.sequences.is_running());
        let noticed = self.meter.take_noticed();
        if noticed.measured {
            operation.latch(MEASURING);
        }
        if noticed.threshold {
            operation.latch(MEMORY_THRESHOLD);
        }
        for bit in noticed.overload {
            self.status.questionable.latch(bit);
        }
        self.raise_alarms(noticed.alarms);
        let overflown = self.meter.memory().is_overflown();
        self.status.questionable.set(MEMORY_OVERFLOW, overflown);
        let pending = self.meter.is_measuring(now)
            || self.sequences.is_running()
            || self.relays.settled_at(None) > now;
        if self.completion_awaited && !pending {
            self.completion_awaited = false;
            self.status.raise(StandardEvent::OperationComplete);
        }
    }
}
