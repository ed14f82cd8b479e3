//! The mainframe as a state machine: relays, scan list, voltmeter, memory, sequences, sessions, status, error queue.
//!
//! No I/O, no clock, no physics: lines and time come in as arguments, relays and voltages go out through [`Wires`].
//! What happens by itself (a scan into memory, a sequence) happens when time is next told, at its own instants: see
//! [`Simulator34980a::pass`] and [`Simulator34980a::due`].
//!
//! What the fact sheet leaves open is decided so: a command error ends its message, an error of execution does not.
//! Settings of the voltmeter wait for a measurement whose end can be foreseen and are refused during another; relays
//! move during a scan. `*OPC?` does not wait for what only a trigger or ABOR can end. READ? of more than the memory
//! holds, or without end, is refused, and its readings are taken ahead of their time: another session that speaks
//! meanwhile finds the relays as the scan leaves them.

mod calendar;
mod errors;
mod execute;
mod faults;
pub(crate) mod measurement;
mod relays;
mod sequences;
mod sessions;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use scpi::{ErrorEntry, ErrorQueue, ParseError, StandardEvent, StatusModel};
use survey::{Amps, Relay, Volts};

use crate::command::{Command, HeaderForm, MEMORIES};
use crate::modules::Module;
use crate::simulator::errors::Trouble;
use crate::simulator::execute::Turn;
use crate::simulator::measurement::deferred::Deferred;
use crate::simulator::measurement::meter::{Meter, Settings};
use calendar::Calendar;
use relays::Relays;
use sequences::Sequences;
use sessions::Sessions;
pub use sessions::{Output, Session};

/// What the mainframe's relays and its voltmeter are joined to. The simulated rig implements it.
pub trait Wires {
    /// Told which relays are closed now, whenever that changes; during a scan for every channel of it. A relay that is
    /// stuck is told as it is, whatever the mainframe believes.
    fn relays(&mut self, closed: &BTreeSet<Relay>, at: Duration);

    /// Asked for the voltage between the voltmeter's terminals, before its range is looked at.
    fn measure(&mut self, at: Duration, request: MeterRequest) -> Volts;

    /// Asked for what alternates between the voltmeter's terminals. Nothing, unless the wires know better.
    fn alternating(&mut self, _at: Duration, _request: MeterRequest) -> Alternating {
        Alternating::default()
    }
}

/// An alternating voltage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alternating {
    /// R.m.s. of the voltage without its mean.
    pub rms: Volts,
    /// Frequency, Hz; 0 of none.
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

/// How a voltage is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeterRequest {
    /// The scanned channel; `None`: what analogue bus 1 is joined to.
    pub channel: Option<Relay>,
    /// The range.
    pub range: Volts,
    /// Integration, power-line cycles.
    pub nplc: f64,
    /// What the voltmeter itself sends from its HI terminal to its LO, to measure a resistance; else 0. Where it cannot
    /// flow the voltage is infinite.
    pub test_current: Amps,
    /// The voltage is taken on analogue bus 2.
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

/// What a simulated mainframe is made of.
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
    /// Time to take a message in, whatever it says.
    pub message_time: Duration,
    /// Time that a measurement setting costs for each channel it is for.
    pub setting_time: Duration,
    /// Readings that the memory holds.
    pub memory: usize,
    /// What its clock shows at time zero: since 1970-01-01.
    pub clock: Duration,
    /// The form of autozero's and input impedance's header that it has; the other one is -113.
    pub headers: HeaderForm,
}

impl Default for Settings34980a {
    /// Empty slots, 50 Hz, no time lost over messages, memory as in section 5, the year 2000.
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

/// An answer, and how long the instrument needs for it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Response {
    /// The replies of a message's queries joined by `;`, without line end; `None` when nothing is answered.
    pub text: Option<String>,
    /// Time from the message's end until the instrument has done what it says.
    pub busy: Duration,
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
    display: String,
    /// What `*SAV` has kept; it outlives `*RST` and the power.
    kept: [Option<Settings>; MEMORIES as usize],
    /// The users' labels of channels; they outlive `*RST` and the power.
    labels: BTreeMap<Relay, String>,
    /// Commands may begin before relays have settled.
    overlap: bool,
    /// `*OPC` waits for the end of what is going on.
    completion_awaited: bool,
    /// The reply to the message being received may come later.
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
            display: String::new(),
            kept: Default::default(),
            labels: BTreeMap::new(),
            overlap: false,
            completion_awaited: false,
            deferring: false,
            deferred: None,
            settings,
        }
    }

    /// The relays closed now, as the mainframe believes.
    pub fn closed(&self) -> &BTreeSet<Relay> {
        self.relays.closed()
    }

    /// How many errors wait to be read; never more than 20.
    pub fn errors_waiting(&self) -> usize {
        self.errors.len()
    }

    /// How many errors were ever queued, and the last of them: a look that leaves the queue as it is.
    pub fn latest_error(&self) -> (u64, Option<&ErrorEntry>) {
        (self.errors.added(), self.errors.latest())
    }

    /// When something next happens by itself: a reading, a sweep, a step of a sequence. Whoever owns the time tells it
    /// then by [`Simulator34980a::pass`], so that nothing else in the rig has moved on in between.
    pub fn due(&self) -> Option<Duration> {
        let due = [self.meter.due(), self.sequences.due()];
        due.into_iter().flatten().min()
    }

    /// Lets time pass: takes the readings and the steps of sequences that were due by then, each at its own instant.
    pub fn pass(&mut self, at: Duration, wires: &mut dyn Wires) {
        while let Some(due) = self.sequences.due().filter(|due| *due <= at) {
            self.meter.advance(due, &mut self.relays, wires);
            self.step(due, wires);
        }
        self.meter.advance(at, &mut self.relays, wires);
        self.settle_deferred(false);
        self.notice(at);
    }

    /// Switches power off and on: latching relays keep their state, sequences, relay counts and the clock are kept,
    /// everything else is as new (sections 3 and 6).
    pub fn power_cycle(&mut self, at: Duration, wires: &mut dyn Wires) {
        self.relays.lose_power();
        self.deferred = None;
        // Memory 0 is that of the power-down state.
        self.kept[0] = Some(self.meter.settings());
        self.meter.as_new();
        self.sequences.abort();
        self.sessions = Sessions::default();
        self.status = StatusModel::new();
        self.errors.clear();
        self.display.clear();
        self.overlap = false;
        self.completion_awaited = false;
        self.relays.tell(at, wires);
    }

    /// Receives one message (a line without its end) from the only session, and answers it.
    pub fn receive(&mut self, line: &str, at: Duration, wires: &mut dyn Wires) -> Response {
        self.receive_from(Session::default(), line, at, wires)
    }

    /// Receives one message of a session, and answers it. What the response's time is over, the session's next message may
    /// be received; other sessions need not wait for that.
    pub fn receive_from(
        &mut self,
        session: Session,
        line: &str,
        at: Duration,
        wires: &mut dyn Wires,
    ) -> Response {
        let mut turn = Turn {
            session,
            now: self.sessions.takes_up(session, at) + self.settings.message_time,
            replied: self.sessions.has_reply(session),
            last: false,
            depth: 0,
            wires,
        };
        let mut replies = Vec::new();
        let calls = scpi::parse_message(line);
        let count = calls.len();
        for (place, call) in calls.into_iter().enumerate() {
            turn.last = place + 1 == count;
            self.pass(turn.now, turn.wires);
            let received = call.and_then(|call| Ok((call.query, self.command(&call)?)));
            let (query, command) = match received {
                Ok(received) => received,
                Err(refusal) => {
                    self.fail(refusal.into());
                    // What follows a command error is not understood any more, what follows a bad value is.
                    if refusal.code() > -200 {
                        break;
                    }
                    continue;
                }
            };
            if self.sessions.forbids(session, query, &command) {
                self.fail(Trouble::LOCKED);
                continue;
            }
            match self.obey(command, &mut turn) {
                Ok(text) => replies.extend(text),
                Err(trouble) => self.fail(trouble),
            }
            turn.replied |= !replies.is_empty();
        }
        let done = turn.now;
        // Not up to `done`: what a message waits for is still to come, and others may speak before it does.
        self.pass(at, turn.wires);
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

    fn fail(&mut self, trouble: Trouble) {
        self.status.raise_error(trouble.code);
        if self.errors.len() >= ERRORS {
            // The entry that gives way makes an event of its own.
            self.status.raise_error(ParseError::QueueOverflow.code());
        }
        self.errors.push(trouble.code, trouble.text);
    }

    /// Brings the registers up to the time.
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
