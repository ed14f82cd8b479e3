//! The board as a state machine: four poles of two 16-way chips, every edge of their lines with its time.
//!
//! No I/O, no clock, no physics: time and lines come in as arguments, the joined electrodes go out through [`Poles`].

use std::collections::VecDeque;
use std::time::Duration;

use scpi::ErrorQueue;
use survey::Electrode;

use crate::command::{Command, Pole, Refusal, Reply, State};

/// What the four poles are led to. The bench's sheet implements it.
pub trait Poles {
    /// Told whenever an electrode comes on or off a pole, in the order of [`Pole::ALL`].
    fn poles(&mut self, joined: [Option<Electrode>; 4], at: Duration);
}

/// What a simulated board is set to before it is switched on.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Serial number in `*IDN?`.
    pub serial: String,
    /// Electrodes wired, 32 at most: two 16-way chips a pole.
    pub electrodes: usize,
    /// From a command's end to its reply (section 6: 1.5 ms over USB).
    pub latency: Duration,
    /// From one edge of a line to the next (section 4: 1 to 5 us on a SoC).
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

/// An answer, and how long the board needs for it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Response {
    /// The reply without its LF. Every line but an empty one has one.
    pub text: Option<String>,
    /// Time until the reply.
    pub busy: Duration,
}

/// One of the two chips of a pole.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Chip {
    /// Electrodes 1 to 16.
    A,
    /// Electrodes 17 to 32.
    B,
}

/// What changed on a pole's lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Edge {
    /// A chip's enable.
    Enable(Chip, bool),
    /// The address that both chips of the pole share.
    Address(u8),
}

/// An edge with its place and time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EdgeRecord {
    /// Since the board's start.
    pub at: Duration,
    /// On which pole.
    pub pole: Pole,
    /// What.
    pub edge: Edge,
}

#[derive(Debug, Clone, Copy, Default)]
struct Lines {
    address: u8,
    enabled: Option<Chip>,
}

impl Lines {
    fn electrode(self) -> Option<Electrode> {
        let first = match self.enabled? {
            Chip::A => 0,
            Chip::B => 16,
        };
        Some(Electrode(first + usize::from(self.address)))
    }
}

/// Edges remembered; older ones are forgotten.
const EDGES: usize = 8192;
const WATCHDOG: Duration = Duration::from_millis(2000);
const ERRORS: usize = 20;

/// A simulated board.
#[derive(Debug)]
pub struct SimulatorGpioMux {
    settings: Settings,
    poles: [Lines; 4],
    edges: VecDeque<EdgeRecord>,
    last_edge: Duration,
    watchdog: Duration,
    heard: Duration,
    errors: ErrorQueue,
}

impl SimulatorGpioMux {
    /// A board just switched on: everything open.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            poles: [Lines::default(); 4],
            edges: VecDeque::new(),
            last_edge: Duration::ZERO,
            watchdog: WATCHDOG,
            heard: Duration::ZERO,
            errors: ErrorQueue::new(ERRORS),
        }
    }

    /// What it says, unasked, when its port is opened.
    pub fn banner(&self) -> String {
        format!("{} ready", self.identity())
    }

    /// The electrodes joined now.
    pub fn state(&self) -> State {
        State(self.poles.map(Lines::electrode))
    }

    /// How many errors wait to be read; never more than 20.
    pub fn errors_waiting(&self) -> usize {
        self.errors.len()
    }

    /// The last edges, oldest first.
    pub fn edges(&self) -> impl Iterator<Item = &EdgeRecord> {
        self.edges.iter()
    }

    /// Switches power off and on: all off, everything forgotten, a new banner to be sent.
    pub fn reset(&mut self, at: Duration, poles: &mut dyn Poles) -> String {
        self.all_off(at, poles);
        self.watchdog = WATCHDOG;
        self.heard = at;
        self.errors = ErrorQueue::new(ERRORS);
        self.banner()
    }

    /// Lets time pass without a command: the watchdog opens everything when its time is over.
    pub fn pass(&mut self, at: Duration, poles: &mut dyn Poles) {
        let due = self.heard + self.watchdog;
        if self.watchdog > Duration::ZERO && at >= due && self.state() != State::default() {
            self.all_off(due, poles);
        }
    }

    /// Hears one line and answers it.
    pub fn hear(&mut self, line: &str, at: Duration, poles: &mut dyn Poles) -> Response {
        self.pass(at, poles);
        if line.trim().is_empty() {
            return Response {
                text: None,
                busy: Duration::ZERO,
            };
        }
        self.heard = at;
        let reply = line
            .parse()
            .and_then(|command| self.obey(command, at, poles))
            .unwrap_or_else(|refusal| {
                self.errors.push(refusal.code, refusal.text.as_str());
                Reply::Refused(refusal)
            });
        Response {
            text: Some(reply.to_string()),
            busy: self.settings.latency,
        }
    }

    fn obey(
        &mut self,
        command: Command,
        at: Duration,
        poles: &mut dyn Poles,
    ) -> Result<Reply, Refusal> {
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
            Command::NextError => {
                let entry = self.errors.pop();
                return Ok(Reply::Error(entry.code, entry.message));
            }
            Command::Watchdog(milliseconds) => {
                self.watchdog = Duration::from_millis(milliseconds.into());
            }
        }
        Ok(Reply::State(self.state()))
    }

    /// Moves the poles that differ: every enable off, then addresses, then enables (section 3). Refuses before
    /// touching a line.
    fn move_to(
        &mut self,
        target: State,
        at: Duration,
        poles: &mut dyn Poles,
    ) -> Result<(), Refusal> {
        let most = self.settings.electrodes.min(32);
        if let Some(electrode) = target
            .0
            .iter()
            .flatten()
            .find(|electrode| electrode.0 >= most)
        {
            return Err(Refusal::new(
                -222,
                format!("Data out of range; electrode {electrode} of {most}"),
            ));
        }
        if let Some(electrode) = target.shorted() {
            return Err(Refusal::new(
                -221,
                format!("Settings conflict; electrode {electrode} would be on I+ and on I-"),
            ));
        }
        let now = self.state();
        let moving: Vec<Pole> = Pole::ALL
            .into_iter()
            .filter(|pole| now.on(*pole) != target.on(*pole))
            .collect();
        let mut clock = at;
        for pole in &moving {
            if let Some(chip) = self.poles[pole.index()].enabled {
                self.edge(*pole, Edge::Enable(chip, false), &mut clock, poles);
            }
        }
        for pole in &moving {
            if let Some(electrode) = target.on(*pole) {
                let address = (electrode.0 % 16) as u8;
                if self.poles[pole.index()].address != address {
                    self.edge(*pole, Edge::Address(address), &mut clock, poles);
                }
            }
        }
        for pole in &moving {
            if let Some(electrode) = target.on(*pole) {
                let chip = if electrode.0 < 16 { Chip::A } else { Chip::B };
                self.edge(*pole, Edge::Enable(chip, true), &mut clock, poles);
            }
        }
        Ok(())
    }

    fn all_off(&mut self, at: Duration, poles: &mut dyn Poles) {
        let mut clock = at;
        for pole in Pole::ALL {
            if let Some(chip) = self.poles[pole.index()].enabled {
                self.edge(pole, Edge::Enable(chip, false), &mut clock, poles);
            }
        }
    }

    fn edge(&mut self, pole: Pole, edge: Edge, clock: &mut Duration, poles: &mut dyn Poles) {
        *clock += self.settings.edge_time;
        let lines = &mut self.poles[pole.index()];
        match edge {
            Edge::Enable(chip, on) => lines.enabled = on.then_some(chip),
            Edge::Address(address) => lines.address = address,
        }
        if self.edges.len() == EDGES {
            self.edges.pop_front();
        }
        self.edges.push_back(EdgeRecord {
            at: *clock,
            pole,
            edge,
        });
        self.last_edge = *clock;
        if matches!(edge, Edge::Enable(..)) {
            poles.poles(self.state().0, *clock);
        }
    }

    fn identity(&self) -> String {
        format!("Tactus,{},{},1.0", crate::MODEL, self.settings.serial)
    }
}
