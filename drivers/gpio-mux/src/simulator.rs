//! The board as a state machine: four poles with two 16-way chips each; records every edge of their lines with its
//! time.
//!
//! No I/O, no clock, no physics: time and received lines are passed in, the connected electrodes are passed on to
//! [`Poles`].

use std::collections::VecDeque;
use std::time::Duration;

pub use scpi::Response;
use scpi::{ErrorEntry, ErrorQueue};
use survey::Electrode;

use crate::command::{Command, MOST_ERRORS, Pole, Reply, State};
use crate::lines::{Chip, Levels, Line, Step, steps};

/// The circuit that the four poles are connected to. The simulated rig implements it.
pub trait Poles {
    /// Called whenever an electrode is connected to or disconnected from a pole; `joined` is in the order of
    /// [`Pole::ALL`].
    fn poles(&mut self, joined: [Option<Electrode>; 4], at: Duration);
}

/// Settings of a simulated board.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Serial number in `*IDN?`.
    pub serial: String,
    /// Number of electrodes wired, 32 at most: two 16-way chips a pole.
    pub electrodes: usize,
    /// Time from the end of a command to its reply (section 6: 1.5 ms over USB).
    pub latency: Duration,
    /// Time from one edge of a line to the next (section 4: 1 to 5 us on a SoC).
    pub edge_time: Duration,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            serial: "0001".to_owned(),
            electrodes: 26,
            latency: Duration::from_micros(1500),
            edge_time: Duration::from_micros(1),
        }
    }
}

/// A change on a pole's lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Edge {
    /// A chip's enable.
    Enable(Chip, bool),
    /// The address that both chips of the pole share.
    Address(u8),
}

/// An edge with its pole and time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EdgeRecord {
    /// Time since the board was first switched on; a reset does not restart it.
    pub at: Duration,
    /// The pole.
    pub pole: Pole,
    /// The change.
    pub edge: Edge,
}

/// Number of edges kept; older ones are dropped.
const EDGES: usize = 8192;
const WATCHDOG: Duration = Duration::from_millis(2000);

/// A simulated board.
#[derive(Debug)]
pub struct SimulatorGpioMux {
    settings: Settings,
    levels: Levels,
    edges: VecDeque<EdgeRecord>,
    /// Time of power on or of the last reset: time zero of the firmware's clock.
    started: Duration,
    /// Time of the last edge by the firmware's clock.
    last_edge: Duration,
    watchdog: Duration,
    received: Duration,
    errors: ErrorQueue,
}

impl SimulatorGpioMux {
    /// A board just switched on: everything open.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            levels: Levels::default(),
            edges: VecDeque::new(),
            started: Duration::ZERO,
            last_edge: Duration::ZERO,
            watchdog: WATCHDOG,
            received: Duration::ZERO,
            errors: ErrorQueue::new(MOST_ERRORS),
        }
    }

    /// The line that the board sends when its port is opened.
    pub fn banner(&self) -> String {
        format!("{} ready", self.identity())
    }

    /// The electrodes connected now.
    pub fn state(&self) -> State {
        self.levels.state()
    }

    /// Number of errors in the queue; never more than 20.
    pub fn errors_waiting(&self) -> usize {
        self.errors.len()
    }

    /// Total number of errors queued so far, and the last of them. Reading them leaves the queue as it is.
    pub fn latest_error(&self) -> (u64, Option<&ErrorEntry>) {
        (self.errors.added(), self.errors.latest())
    }

    /// The last edges, oldest first.
    pub fn edges(&self) -> impl Iterator<Item = &EdgeRecord> {
        self.edges.iter()
    }

    /// Switches power off and on: all off, all state cleared. Returns the new banner.
    pub fn reset(&mut self, at: Duration, poles: &mut dyn Poles) -> String {
        self.all_off(at, poles);
        self.watchdog = WATCHDOG;
        self.received = at;
        self.started = at;
        self.last_edge = Duration::ZERO;
        self.errors.clear();
        self.banner()
    }

    /// Advances time without a command. The watchdog opens everything when its time has run out.
    pub fn pass(&mut self, at: Duration, poles: &mut dyn Poles) {
        let due = self.received + self.watchdog;
        if self.watchdog > Duration::ZERO && at >= due && self.state() != State::default() {
            self.all_off(due, poles);
        }
    }

    /// Receives one line and returns the reply.
    pub fn receive(&mut self, line: &str, at: Duration, poles: &mut dyn Poles) -> Response {
        self.pass(at, poles);
        if line.trim().is_empty() {
            return Response {
                text: None,
                busy: Duration::ZERO,
            };
        }
        let answer = line.parse().and_then(|command| {
            // Only a command restarts the watchdog; noise on the serial line is not one.
            self.received = at;
            self.execute(command, at, poles)
        });
        self.answer(answer)
    }

    /// Receives a line that is longer than the buffer. It has one reply like every command.
    pub fn receive_oversized(&mut self, at: Duration, poles: &mut dyn Poles) -> Response {
        self.pass(at, poles);
        self.answer(Err(ErrorEntry::new(-363, "Input buffer overrun")))
    }

    fn answer(&mut self, answer: Result<Reply, ErrorEntry>) -> Response {
        let reply = answer.unwrap_or_else(|error| {
            self.errors.push(error.code, error.message.as_str());
            Reply::Refused(error)
        });
        Response {
            text: Some(reply.to_string()),
            busy: self.settings.latency,
        }
    }

    fn execute(
        &mut self,
        command: Command,
        at: Duration,
        poles: &mut dyn Poles,
    ) -> Result<Reply, ErrorEntry> {
        match command {
            Command::Identify => return Ok(Reply::Identity(self.identity())),
            Command::Set(pole, electrode) => {
                self.move_to(self.state().with(pole, electrode), at, poles)?;
            }
            Command::Pair(pair, plus) => {
                let minus = Electrode((plus.0 + 1) % self.settings.electrodes.max(1));
                let [plus_pole, minus_pole] = pair.poles();
                let target = self
                    .state()
                    .with(plus_pole, Some(plus))
                    .with(minus_pole, Some(minus));
                self.move_to(target, at, poles)?;
            }
            Command::Off => self.all_off(at, poles),
            Command::AskState => {}
            Command::AskLastEdge => return Ok(Reply::LastEdge(self.last_edge)),
            Command::NextError => return Ok(Reply::Error(self.errors.pop())),
            Command::Watchdog(milliseconds) => {
                self.watchdog = Duration::from_millis(milliseconds.into());
            }
        }
        Ok(Reply::State(self.state()))
    }

    /// Moves the poles that differ: every enable off, then addresses, then enables (section 3). Invalid moves are
    /// rejected before a line is set.
    fn move_to(
        &mut self,
        target: State,
        at: Duration,
        poles: &mut dyn Poles,
    ) -> Result<(), ErrorEntry> {
        let most = self.settings.electrodes.min(32);
        if let Some(electrode) = target
            .0
            .iter()
            .flatten()
            .find(|electrode| electrode.0 >= most)
        {
            return Err(ErrorEntry::new(
                -222,
                format!("Data out of range; electrode {electrode} of {most}"),
            ));
        }
        if let Some(electrode) = target.shorted() {
            return Err(ErrorEntry::new(
                -221,
                format!("Settings conflict; electrode {electrode} would be on I+ and on I-"),
            ));
        }
        let mut clock = at;
        for step in steps(self.state(), target) {
            self.take(step, &mut clock, poles);
        }
        Ok(())
    }

    fn all_off(&mut self, at: Duration, poles: &mut dyn Poles) {
        let mut clock = at;
        for step in steps(self.state(), State::default()) {
            self.take(step, &mut clock, poles);
        }
    }

    /// Sets lines pole by pole: the address lines of a pole together, enables one by one. A line that already has the
    /// level makes no edge.
    fn take(&mut self, step: Step, clock: &mut Duration, poles: &mut dyn Poles) {
        for pole in Pole::ALL {
            let address = Levels::addresses(pole) & step.mask;
            if address != 0 && (self.levels.0 ^ step.bits) & address != 0 {
                self.levels = self.levels.with(address, step.bits);
                let number = (step.bits & address) >> Line::Address(pole, 0).number();
                // An address has four lines.
                self.edge(pole, Edge::Address(number as u8), clock, poles);
            }
            for chip in [Chip::A, Chip::B] {
                let enable = Line::Enable(pole, chip).mask() & step.mask;
                if enable != 0 && (self.levels.0 ^ step.bits) & enable != 0 {
                    self.levels = self.levels.with(enable, step.bits);
                    let on = step.bits & enable != 0;
                    self.edge(pole, Edge::Enable(chip, on), clock, poles);
                }
            }
        }
    }

    fn edge(&mut self, pole: Pole, edge: Edge, clock: &mut Duration, poles: &mut dyn Poles) {
        *clock += self.settings.edge_time;
        if self.edges.len() == EDGES {
            self.edges.pop_front();
        }
        self.edges.push_back(EdgeRecord {
            at: *clock,
            pole,
            edge,
        });
        self.last_edge = clock.saturating_sub(self.started);
        if matches!(edge, Edge::Enable(..)) {
            poles.poles(self.state().0, *clock);
        }
    }

    fn identity(&self) -> String {
        format!("Tactus,{},{},1.0", crate::MODEL, self.settings.serial)
    }
}
