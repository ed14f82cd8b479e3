//! The simulators, joined to one sheet, behind streams of bytes.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::AtomicU32;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use phantom::{Load, Phantom, PhantomError, Scene};
use survey::{Amps, Electrode, Relay, Volts};
use tokio::sync::{Notify, watch};

use crate::fault::TimedFault;
use crate::instrument::{Instrument, Wire, WireState};
use crate::profile::Profile;
use crate::simulated_instruments::{Messages, SimulatedInstruments, TranscriptLine};
use crate::simulated_rig::faults::LinkFaults;
use crate::simulated_rig::status::{Client, SourceStatus, Status};

mod faults;
mod received;
mod record;
pub(crate) mod status;

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

    /// Takes off again what was pressed; false where nothing was.
    pub fn release(&self) -> bool {
        self.with_phantom(Phantom::release)
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
