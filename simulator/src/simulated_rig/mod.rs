//! The simulators, joined to one sheet, behind streams of bytes.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::atomic::AtomicU32;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use phantom::{Load, Phantom, PhantomError, Scene};
use rig::BoxStream;
use survey::{Amps, Electrode, Relay, Volts};
use tokio::sync::{Notify, watch};

use crate::fault::TimedFault;
use crate::profile::Profile;
use crate::program::status::{Client, SourceStatus, Status};
use crate::simulated_instruments::SimulatedInstruments;
use crate::transport::client::LinkFaults;

mod faults;
mod received;
mod record;

/// What a pipe in memory holds, bytes.
const PIPE: usize = 64 * 1024;

/// One of the simulated instruments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Instrument {
    /// The current source, a 6221.
    Source,
    /// The switch and voltmeter, a 34980A.
    Mainframe,
    /// The multiplexer board.
    Board,
}

impl Instrument {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Source, Self::Mainframe, Self::Board];

    pub(crate) fn index(self) -> usize {
        self as usize
    }

    /// The instrument that a transcript or a golden calls so: `6221`, `34980a`, `gpio`.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|instrument| instrument.name().eq_ignore_ascii_case(name))
    }

    /// What transcripts and goldens call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Source => "6221",
            Self::Mainframe => "34980a",
            Self::Board => "gpio",
        }
    }
}

impl fmt::Display for Instrument {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Source => "6221",
            Self::Mainframe => "34980a",
            Self::Board => "gpio board",
        })
    }
}

/// The state of the wire to an instrument: a fault that a test or a person may cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// Connected.
    Sound,
    /// Every connection is closed, and a new one at once.
    Cut,
    /// Open, but nothing comes through: the far side receives nothing and says nothing.
    Silent,
}

/// A wire, and how often it was cut: a cut that is mended at once breaks connections all the same.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WireState {
    pub(crate) wire: Wire,
    pub(crate) cuts: u64,
}

/// What an instrument has received and said, counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Messages {
    /// Messages received.
    pub received: u64,
    /// Replies given.
    pub answered: u64,
    /// Messages that made the voltmeter take readings.
    pub reading: u64,
    /// Readings that the voltmeter took.
    pub readings: u64,
}

/// One line of a transcript.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TranscriptLine {
    /// The instruments' time.
    pub at: Duration,
    /// Who received it.
    pub instrument: Instrument,
    /// What it received.
    pub received: String,
    /// What it answered.
    pub answered: Option<String>,
}

/// Why there is no simulated rig.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The sheet of the scene cannot be had.
    #[error("the simulated sheet cannot be made")]
    Sheet(#[from] PhantomError),
    /// The profile's boards are made for fewer electrodes.
    #[error("the scene has {electrodes} electrodes, {what} holds {most}")]
    Electrodes {
        /// The scene's.
        electrodes: usize,
        /// Which instrument.
        what: &'static str,
        /// What fits.
        most: usize,
    },
    /// The scene has a fault that these instruments do not know.
    #[error("{place}: {cause}")]
    Fault {
        /// Where it stands: `file:line:column`.
        place: String,
        /// What is wrong with it.
        cause: crate::FaultError,
    },
    /// The profile's load hangs on terminals that the fixture does not have.
    #[error("the load '{load}' needs more than the {electrodes} terminals of the scene")]
    Load {
        /// The load's words.
        load: String,
        /// The scene's electrodes.
        electrodes: usize,
    },
}

/// Simulated instruments joined to one simulated sheet. A handle: clones mean the same rig.
///
/// Connections are streams of bytes; no way from the sheet to a reading avoids text. Inside a tokio runtime.
#[derive(Debug, Clone)]
pub struct SimulatedRig {
    pub(crate) shared: Arc<Shared>,
}

/// Clients connected now: session, instrument, address.
pub(crate) type Clients = BTreeMap<u32, (Instrument, String)>;

#[derive(Debug)]
pub(crate) struct Shared {
    instruments: Mutex<SimulatedInstruments>,
    pub(crate) wires: Vec<watch::Sender<WireState>>,
    link_faults: Mutex<Vec<LinkFaults>>,
    clients: Mutex<Clients>,
    /// The next client's session; 0 is the rig's own.
    pub(crate) sessions: AtomicU32,
    /// What the board says unasked.
    pub(crate) banner: watch::Sender<String>,
    /// Something that people look at may have changed.
    pub(crate) changed: Notify,
    electrodes: usize,
    has_board: bool,
    source: crate::profile::Source,
}

impl SimulatedRig {
    /// Instruments just switched on, the scene's time at zero.
    ///
    /// # Errors
    /// A scene whose sheet cannot be made, or has more electrodes than the profile's board takes.
    pub fn new(profile: &Profile, scene: Scene) -> Result<Self, RigError> {
        let mut time_line = profile.faults.clone();
        for fault in &scene.faults {
            let read = TimedFault::read(fault.at, fault.lasts, &fault.what);
            time_line.extend(read.map_err(|cause| RigError::Fault {
                place: fault.place.clone(),
                cause,
            })?);
        }
        let phantom = Phantom::new(scene)?;
        let electrodes = phantom.electrodes();
        if profile.board.is_some() && electrodes > 32 {
            return Err(RigError::Electrodes {
                electrodes,
                what: "the multiplexer board",
                most: 32,
            });
        }
        if profile.load.terminals() > electrodes {
            return Err(RigError::Load {
                load: profile.load.to_string(),
                electrodes,
            });
        }
        Ok(Self {
            shared: Arc::new(Shared {
                instruments: Mutex::new(SimulatedInstruments::new(profile, phantom, time_line)),
                wires: Instrument::ALL
                    .map(|_| {
                        watch::Sender::new(WireState {
                            wire: Wire::Sound,
                            cuts: 0,
                        })
                    })
                    .into(),
                link_faults: Mutex::new(Instrument::ALL.map(|_| LinkFaults::default()).into()),
                clients: Mutex::default(),
                sessions: AtomicU32::new(1),
                banner: watch::Sender::new(String::new()),
                changed: Notify::new(),
                electrodes,
                has_board: profile.board.is_some(),
                source: profile.source.clone(),
            }),
        })
    }

    /// Number of electrodes of the sheet.
    pub fn electrodes(&self) -> usize {
        self.shared.electrodes
    }

    /// Who may connect to the source, and for how long its place stays taken.
    pub(crate) fn source_profile(&self) -> &crate::profile::Source {
        &self.shared.source
    }

    /// Whether the profile has a multiplexer board.
    pub fn has_board(&self) -> bool {
        self.shared.has_board
    }

    /// Connects to the current source.
    pub fn connect_6221(&self) -> BoxStream {
        self.connect(Instrument::Source)
    }

    /// Connects to the mainframe. It serves several clients at once.
    pub fn connect_34980a(&self) -> BoxStream {
        self.connect(Instrument::Mainframe)
    }

    /// Connects to the multiplexer board. Its port has been open since it was switched on: no banner comes.
    pub fn connect_gpio(&self) -> BoxStream {
        self.connect(Instrument::Board)
    }

    /// Connects to one of the instruments.
    pub fn connect(&self, instrument: Instrument) -> BoxStream {
        let (here, there) = tokio::io::duplex(PIPE);
        tokio::spawn(
            self.clone()
                .converse(instrument, "memory".to_owned(), there),
        );
        Box::new(here)
    }

    /// Breaks or mends the wire to an instrument.
    pub fn set_wire(&self, instrument: Instrument, wire: Wire) {
        self.shared.wires[instrument.index()].send_modify(|line| {
            line.wire = wire;
            line.cuts += u64::from(wire == Wire::Cut);
        });
    }

    /// Presses a load on the sheet, beside those of the scene, until [`SimulatedRig::release`].
    ///
    /// # Errors
    /// A load that cannot be.
    pub fn press(&self, load: Load) -> Result<(), PhantomError> {
        self.with_phantom(|phantom| phantom.press(load))
    }

    /// Takes off again what was pressed.
    pub fn release(&self) {
        self.with_phantom(Phantom::release);
    }

    /// The phantom behind the instruments, for pressing it and asking it for the truth.
    pub fn with_phantom<T>(&self, act: impl FnOnce(&mut Phantom) -> T) -> T {
        act(&mut self.instruments().sheet.phantom)
    }

    /// What the instruments' clock shows: the scene's time line runs by it.
    pub fn now(&self) -> Duration {
        self.instruments().now()
    }

    /// Lets the instruments' time pass.
    pub fn advance(&self, by: Duration) {
        self.instruments().advance(by);
    }

    /// The current that really flows.
    pub fn flowing(&self) -> Amps {
        self.instruments_now().sheet.flowing()
    }

    /// Whether the source's output is on, and the level it is set to.
    pub fn source_output(&self) -> (bool, Amps) {
        let instruments = self.instruments();
        (instruments.source().output(), instruments.source().level())
    }

    /// The mainframe's relays that are really closed.
    pub fn closed(&self) -> BTreeSet<Relay> {
        self.instruments_now().sheet.closed()
    }

    /// The electrodes that the board's poles are really joined to: I+, I-, V+, V-.
    pub fn poles(&self) -> [Option<Electrode>; 4] {
        self.instruments_now().sheet.poles()
    }

    /// What an ideal voltmeter on analogue bus 1 would have at its terminals now.
    pub fn voltage(&self) -> Volts {
        let mut instruments = self.instruments_now();
        let at = instruments.now();
        instruments.sheet.voltage(at)
    }

    /// Why the sheet could not be computed, if it ever could not; readings are then over range.
    pub fn sheet_fault(&self) -> Option<String> {
        self.instruments().sheet.fault().map(ToString::to_string)
    }

    /// What an instrument has received and said so far.
    pub fn messages(&self, instrument: Instrument) -> Messages {
        self.instruments().messages(instrument)
    }

    /// Begins to write down everything that is said, from nothing.
    pub fn keep_transcript(&self) {
        self.instruments().transcript = Some(Vec::new());
    }

    /// Everything said since [`SimulatedRig::keep_transcript`].
    pub fn transcript(&self) -> Vec<TranscriptLine> {
        self.instruments().transcript.clone().unwrap_or_default()
    }

    /// Switches an instrument off and on: its settings are lost, latching relays stay, its connections break.
    pub fn power_cycle(&self, instrument: Instrument) {
        self.set_wire(instrument, Wire::Cut);
        self.instruments().power_cycle(instrument);
        self.set_wire(instrument, Wire::Sound);
    }

    /// What an instrument says of itself, without taking its time.
    pub(crate) fn identity(&self, instrument: Instrument) -> String {
        let instruments = self.instruments();
        instruments.identity(instrument).to_owned()
    }

    /// What a person wants to know about the rig.
    pub fn status(&self) -> Status {
        let clients = self
            .clients()
            .values()
            .map(|(instrument, address)| Client {
                instrument: instrument.to_string(),
                address: address.clone(),
            })
            .collect();
        let instruments = self.instruments_now();
        Status {
            at_s: instruments.now().as_secs_f64(),
            clients,
            source: SourceStatus {
                output: instruments.source().output(),
                level_a: instruments.source().level().0,
                flowing_a: instruments.sheet.flowing().0,
                range_a: instruments.source().range().0,
                in_compliance: instruments.source().in_compliance(),
                pulses: instruments.source().pulses(),
            },
            closed: instruments
                .sheet
                .closed()
                .iter()
                .map(|relay| relay.0)
                .collect(),
            poles: instruments
                .sheet
                .poles()
                .map(|pole| pole.map(Electrode::number)),
            last_error: instruments.last_error.clone(),
        }
    }

    pub(crate) fn clients(&self) -> MutexGuard<'_, Clients> {
        let clients = self.shared.clients.lock();
        clients.unwrap_or_else(PoisonError::into_inner)
    }

    /// The instruments, brought up to the present time.
    fn instruments_now(&self) -> MutexGuard<'_, SimulatedInstruments> {
        let mut instruments = self.instruments();
        instruments.catch_up();
        instruments
    }

    /// A simulator that panicked has logged that already; its state is still what people want to see.
    fn instruments(&self) -> MutexGuard<'_, SimulatedInstruments> {
        self.shared
            .instruments
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}
