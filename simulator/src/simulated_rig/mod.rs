//! The simulated instruments with one sheet, connected by byte streams.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::AtomicU32;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use phantom::{Load, Phantom, PhantomError, Scene};
use survey::{Amps, Electrode, Relay, Volts};
use tokio::sync::{Notify, watch};

use crate::instrument::fault::TimedFault;
use crate::instrument::{Instrument, Profile, Source, Wire, WireState};
use crate::simulated_instruments::{Messages, SimulatedInstruments, TranscriptLine};
use crate::simulated_rig::faults::LinkFaults;
use crate::simulated_rig::status::{Client, SourceStatus, Status};

mod faults;
mod received;
mod record;
pub(crate) mod status;

/// Errors of a simulated rig.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The scene's sheet cannot be made.
    #[error("the simulated sheet cannot be made")]
    Sheet(#[from] PhantomError),
    /// The profile's board supports fewer electrodes.
    #[error(
        "the scene has {electrodes} electrodes, {what} connects at most {most}; choose another scene or profile"
    )]
    Electrodes {
        /// Electrodes of the scene.
        electrodes: usize,
        /// Which instrument.
        what: &'static str,
        /// Maximum number.
        most: usize,
    },
    /// A fault of the scene does not apply to these instruments.
    #[error("{place}: {cause}")]
    Fault {
        /// Its position: `file:line:column`.
        place: String,
        /// What is wrong with it.
        cause: crate::FaultError,
    },
    /// The profile's load uses terminals that the fixture does not have.
    #[error("the load '{load}' needs more than the {electrodes} terminals of the scene")]
    Load {
        /// The load, as text.
        load: String,
        /// Electrodes of the scene.
        electrodes: usize,
    },
}

/// Simulated instruments connected to one simulated sheet. A handle: clones refer to the same rig.
///
/// Connections are byte streams; every reading is transferred as text. Requires a tokio runtime.
#[derive(Debug, Clone)]
pub struct SimulatedRig {
    pub(crate) shared: Arc<Shared>,
}

/// Clients connected: session, instrument, address.
pub(crate) type Clients = BTreeMap<u32, (Instrument, String)>;

#[derive(Debug)]
pub(crate) struct Shared {
    instruments: Mutex<SimulatedInstruments>,
    pub(crate) wires: Vec<watch::Sender<WireState>>,
    link_faults: Mutex<Vec<LinkFaults>>,
    clients: Mutex<Clients>,
    /// Number of the next client's session; 0 is the rig's own.
    pub(crate) sessions: AtomicU32,
    /// For each instrument, the text that it sends without a query.
    pub(crate) banners: [watch::Sender<String>; Instrument::ALL.len()],
    /// Notifies displays of a possible change.
    pub(crate) changed: Notify,
    electrodes: usize,
    /// For each instrument, the reason for refusing its faults if this rig does not have it.
    lacking: [Option<&'static str>; Instrument::ALL.len()],
    source: Source,
}

impl SimulatedRig {
    /// Instruments after power on, with the scene's time at zero.
    ///
    /// # Errors
    /// A scene whose sheet cannot be made, or has more electrodes than the profile's board supports.
    pub fn new(profile: &Profile, scene: Scene) -> Result<Self, RigError> {
        let mut time_line = profile.faults.clone();
        for fault in &scene.faults {
            for at in fault.moments() {
                let read = TimedFault::read(at, fault.lasts, &fault.what);
                time_line.extend(read.map_err(|cause| RigError::Fault {
                    place: fault.place.clone(),
                    cause,
                })?);
            }
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
                banners: Instrument::ALL.map(|_| watch::Sender::new(String::new())),
                changed: Notify::new(),
                electrodes,
                lacking: Instrument::ALL.map(|instrument| (instrument.kind().lacking)(profile)),
                source: profile.source.clone(),
            }),
        })
    }

    /// Number of electrodes of the sheet.
    pub fn electrodes(&self) -> usize {
        self.shared.electrodes
    }

    /// Settings of the source, including those of its connections.
    pub(crate) fn source_profile(&self) -> &Source {
        &self.shared.source
    }

    /// Whether the profile has a multiplexer board.
    pub fn has_board(&self) -> bool {
        self.has(Instrument::Board)
    }

    /// Whether the profile has this instrument.
    pub(crate) fn has(&self, instrument: Instrument) -> bool {
        self.shared.lacking[instrument.index()].is_none()
    }

    /// Cuts or restores the wire to an instrument.
    pub fn set_wire(&self, instrument: Instrument, wire: Wire) {
        self.shared.wires[instrument.index()].send_modify(|line| {
            line.wire = wire;
            line.cuts += u64::from(wire == Wire::Cut);
        });
    }

    /// Presses a load on the sheet, in addition to those of the scene, until [`SimulatedRig::release`].
    ///
    /// # Errors
    /// An invalid load.
    pub fn press(&self, load: Load) -> Result<(), PhantomError> {
        self.with_phantom(|phantom| phantom.press(load))
    }

    /// Removes the pressed loads; false if there are none.
    pub fn release(&self) -> bool {
        self.with_phantom(Phantom::release)
    }

    /// Access to the phantom behind the instruments, for presses and for the true conductance.
    pub fn with_phantom<T>(&self, act: impl FnOnce(&mut Phantom) -> T) -> T {
        act(&mut self.instruments().sheet.phantom)
    }

    /// The instruments' clock, which is also that of the scene's time line.
    pub fn now(&self) -> Duration {
        self.instruments().now()
    }

    /// Advances the instruments' time.
    pub fn advance(&self, by: Duration) {
        self.instruments().advance(by);
    }

    /// The actual current.
    pub fn flowing(&self) -> Amps {
        self.instruments_now().sheet.flowing()
    }

    /// Whether the source's output is on, and the level it is set to.
    pub fn source_output(&self) -> (bool, Amps) {
        let source = self.instruments().source().state();
        (source.output, source.level)
    }

    /// The mainframe's relays that are actually closed.
    pub fn closed(&self) -> BTreeSet<Relay> {
        self.instruments_now().sheet.closed()
    }

    /// The electrodes that the board's poles are actually connected to: I+, I-, V+, V-.
    pub fn poles(&self) -> [Option<Electrode>; 4] {
        self.instruments_now().sheet.poles()
    }

    /// The present voltage at the terminals of an ideal voltmeter on analogue bus 1.
    pub fn voltage(&self) -> Volts {
        let mut instruments = self.instruments_now();
        let at = instruments.now();
        instruments.sheet.voltage(at)
    }

    /// Counters of an instrument's messages.
    pub fn messages(&self, instrument: Instrument) -> Messages {
        self.instruments().messages(instrument)
    }

    /// Starts a new transcript in memory.
    pub fn keep_transcript(&self) {
        self.instruments().transcript = Some(Vec::new());
    }

    /// The transcript since [`SimulatedRig::keep_transcript`].
    pub fn transcript(&self) -> Vec<TranscriptLine> {
        self.instruments().transcript.clone().unwrap_or_default()
    }

    /// Power cycle of an instrument: its settings are lost, latching relays stay, its connections break.
    pub fn power_cycle(&self, instrument: Instrument) {
        self.while_cut(instrument, || {
            self.instruments().power_cycle(instrument);
        });
    }

    /// Breaks the instrument's connections while this happens; a fault of the wire lasts.
    fn while_cut(&self, instrument: Instrument, happens: impl FnOnce()) {
        let wire = self.shared.wires[instrument.index()].borrow().wire;
        self.set_wire(instrument, Wire::Cut);
        happens();
        self.set_wire(instrument, wire);
    }

    /// The instrument's `*IDN?` reply, without taking its time.
    pub(crate) fn identity(&self, instrument: Instrument) -> String {
        let instruments = self.instruments();
        instruments.identity(instrument).to_owned()
    }

    /// The state of the rig, for display.
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
        let source = instruments.source().state();
        Status {
            at_s: instruments.now().as_secs_f64(),
            clients,
            source: SourceStatus {
                output: source.output,
                level_a: source.level.0,
                flowing_a: instruments.sheet.flowing().0,
                range_a: source.range.0,
                in_compliance: source.in_compliance,
                pulses: source.pulses,
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

    /// The instruments, advanced to the present time.
    fn instruments_now(&self) -> MutexGuard<'_, SimulatedInstruments> {
        let mut instruments = self.instruments();
        instruments.catch_up();
        instruments
    }

    /// The instruments. After a panic of a simulator, which was logged, their state is still useful for display.
    fn instruments(&self) -> MutexGuard<'_, SimulatedInstruments> {
        self.shared
            .instruments
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}
