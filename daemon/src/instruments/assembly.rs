//! Assembles a rig from addresses: connects, identifies every instrument, and leaves the source off and verified.

use std::time::Duration;

use gpio_mux::GpioMux;
use keithley_6221::Keithley6221;
use keysight_34980a::Keysight34980a;
use rig::{
    AcquireError, BoxStream, CleanupError, Clock, CurrentSource, InjectionSink, Link, LinkError,
    MeterSettings, Rig, RigError, RingTranscript, StartError, Stop, Switch, acquire_reporting,
    check_at_start, find_closed, name_relays, safe_off,
};
use self_test::{Measured, ProbeError, Request, probe};
use survey::{Frame, Plan, Relay, Sensing, Wiring};

use crate::instruments::address::InstrumentAddress;
use crate::instruments::identities::{Connected, ExpectedIdentities};
use crate::instruments::multiplexer::Multiplexer;
use crate::instruments::rig_plan::RigPlan;
use crate::instruments::simulation::SimulatedRig;
use survey::printable_within;

/// Timeout of a connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// A board restarts when its port is opened; it sends a message when it is ready.
const RESTART_TIMEOUT: Duration = Duration::from_secs(2);

type Source = Keithley6221<BoxStream>;
type Mainframe = Keysight34980a<BoxStream>;

/// The supported rigs: one current source, one voltmeter, two kinds of switch.
pub(crate) enum AnyRig {
    Mainframe(Rig<Source, Mainframe, Mainframe>),
    Board(Rig<Source, Multiplexer, Mainframe>),
}

/// A rig ready for work.
pub(crate) struct Assembled {
    pub rig: AnyRig,
    /// The instruments and modules that were found.
    pub identities: ExpectedIdentities,
    /// Why measurements are refused: relays found closed, with [`OnClosedRelays::Refuse`].
    pub closed: Option<String>,
}

/// What to do with relays that are found closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OnClosedRelays {
    /// Leave them: this daemon did not close them, and an operator must find out why.
    Refuse,
    /// Open and verify them: this daemon left them closed when it lost the rig.
    Open,
}

/// Why a rig could not be assembled.
#[derive(Debug, thiserror::Error)]
pub(crate) enum AssemblyError {
    #[error("the {role} at {place} cannot be reached; is it switched on, and the address right?")]
    Unreachable {
        role: &'static str,
        place: InstrumentAddress,
        #[source]
        cause: LinkError,
    },
    #[error("the {role} at {place}")]
    Instrument {
        role: &'static str,
        place: InstrumentAddress,
        #[source]
        cause: RigError,
    },
    #[error("the wiring does not fit the mainframe")]
    Wiring(#[source] RigError),
    #[error("the rig could not be made safe: {0}")]
    Unsafe(CleanupError),
    #[error("the settings could not be applied")]
    Settings(#[source] RigError),
    #[error("{text}")]
    Others {
        /// What differs.
        text: String,
        found: Box<ExpectedIdentities>,
        /// Whether the source is the expected one, and verified off.
        source_off: bool,
    },
}

impl AssemblyError {
    /// Whether the source had been verified off before this.
    pub(crate) fn source_is_off(&self) -> bool {
        match self {
            Self::Unreachable { role, .. } | Self::Instrument { role, .. } => *role != "source",
            Self::Unsafe(cleanup) => !cleanup.source_state_unknown(),
            Self::Others { source_off, .. } => *source_off,
            Self::Wiring(_) | Self::Settings(_) => true,
        }
    }
}

impl AnyRig {
    /// Runs the plan once; the readings of each injection are also sent on their own.
    pub(crate) async fn acquire(
        &self,
        plan: &Plan,
        meter: MeterSettings,
        clock: impl Clock,
        stop: &Stop,
        injections: Option<InjectionSink>,
    ) -> Result<Frame, AcquireError> {
        match self {
            Self::Mainframe(rig) => {
                acquire_reporting(rig, plan, meter, clock, stop, injections).await
            }
            Self::Board(rig) => acquire_reporting(rig, plan, meter, clock, stop, injections).await,
        }
    }

    /// Source off and relays open, each verified.
    pub(crate) async fn safe_off(&self, wiring: &Wiring) -> Result<(), CleanupError> {
        match self {
            Self::Mainframe(rig) => safe_off(rig, wiring).await,
            Self::Board(rig) => safe_off(rig, wiring).await,
        }
    }

    async fn prepare(&self, plan: &Plan, meter: MeterSettings) -> Result<(), RigError> {
        match self {
            Self::Mainframe(rig) => rig::prepare(rig, plan, meter).await,
            Self::Board(rig) => rig::prepare(rig, plan, meter).await,
        }
    }

    /// Takes all readings of a self-test. The caller must make the rig safe afterwards.
    pub(crate) async fn probe(&self, mut request: Request<'_>) -> Result<Measured, ProbeError> {
        match self {
            Self::Mainframe(rig) => {
                let mut held = rig.lock().await;
                let wiring = &request.plan.wiring;
                if wiring.sensing == Sensing::Scan {
                    request.meter_relays = held.voltmeter.meter_relays(&wiring.measuring_relays());
                }
                probe(&mut held, &request).await
            }
            Self::Board(rig) => probe(&mut *rig.lock().await, &request).await,
        }
    }

    /// How often relays have closed; `None` if they are not counted.
    pub(crate) async fn relay_cycles(
        &self,
        relays: &[Relay],
    ) -> Option<Result<Vec<u64>, RigError>> {
        match self {
            Self::Mainframe(rig) => Some(rig.lock().await.voltmeter.relay_cycles(relays).await),
            Self::Board(_) => None,
        }
    }

    async fn check_at_start(&self, wiring: &Wiring) -> Result<(), StartError> {
        match self {
            Self::Mainframe(rig) => check_at_start(rig, wiring).await,
            Self::Board(rig) => check_at_start(rig, wiring).await,
        }
    }
}

/// Connects to every instrument, compares them with `identities`, checks the wiring against the modules, makes the rig
/// safe, applies the settings and verifies them. The source is verified off before any other instrument is queried. An
/// unexpected instrument receives no command.
pub(crate) async fn assemble(
    plan: &RigPlan,
    simulated_rig: &Option<SimulatedRig>,
    transcript: &RingTranscript,
    when_closed: OnClosedRelays,
    identities: Option<&ExpectedIdentities>,
) -> Result<Assembled, AssemblyError> {
    transcript.open();
    let places = &plan.instruments;
    let simulated = [&places.source, &places.switch, &places.voltmeter]
        .iter()
        .any(|(place, _)| *place == InstrumentAddress::Simulated);
    let wiring = &plan.plan.wiring;
    let mut source = connect_source(plan, simulated_rig, Some(transcript)).await?;
    // the source is off before the other instruments are queried
    let found = |role, identity: &str, place: &InstrumentAddress| Connected {
        role,
        identity: printable_within(identity, 200).into_owned(),
        address: place.to_string(),
        simulated: *place == InstrumentAddress::Simulated,
    };
    let mut instruments = vec![found("source", source.identity(), &places.source.0)];
    let source_off = identities.is_none_or(|identities| identities.has(&instruments[0]));
    if source_off {
        source
            .off()
            .await
            .map_err(|cause| AssemblyError::Instrument {
                role: "source",
                place: places.source.0.clone(),
                cause,
            })?;
    }
    let mainframe = connect_mainframe(plan, simulated_rig, Some(transcript)).await?;
    let modules = (1..)
        .zip(mainframe.cards())
        .filter_map(|(slot, card)| Some(format!("{slot}: {}", card.as_deref()?)))
        .collect();
    let cards = (1..)
        .zip(mainframe.cards().iter().zip(mainframe.serials()))
        .map(|(slot, (card, serial))| {
            let card = card.as_deref().unwrap_or("empty");
            format!(
                "slot {slot}: {card} {}",
                serial.as_deref().unwrap_or_default()
            )
        })
        .map(|card| card.trim_end().to_owned())
        .collect();
    let board = match plan.has_board() {
        true => Some(connect_board(plan, simulated_rig, Some(transcript)).await?),
        false => None,
    };
    let mainframe_is = |role| found(role, mainframe.identity(), &places.voltmeter.0);
    match &board {
        Some(board) => {
            instruments.push(found("switch", board.identity(), &places.switch.0));
            instruments.push(mainframe_is("voltmeter"));
        }
        None => instruments.push(mainframe_is("switch+voltmeter")),
    }
    let here = ExpectedIdentities {
        instruments,
        modules,
        cards,
    };
    if let Some(text) = identities.and_then(|identities| identities.differs(&here)) {
        return Err(AssemblyError::Others {
            text,
            found: Box::new(here),
            source_off,
        });
    }
    let rig = if let Some(board) = board {
        AnyRig::Board(if simulated {
            Rig::simulated(source, board, mainframe)
        } else {
            Rig::new(source, board, mainframe)
        })
    } else {
        mainframe
            .check_wiring(wiring)
            .and_then(|()| mainframe.check_modules(&plan.modules))
            .map_err(AssemblyError::Wiring)?;
        AnyRig::Mainframe(if simulated {
            Rig::simulated(source, mainframe.clone(), mainframe)
        } else {
            Rig::new(source, mainframe.clone(), mainframe)
        })
    };
    let closed = match rig.check_at_start(wiring).await {
        Ok(()) => None,
        Err(closed @ StartError::Closed(_)) => Some(closed.to_string()),
        Err(StartError::Unreadable(cause)) => {
            return Err(AssemblyError::Instrument {
                role: "switch",
                place: places.switch.0.clone(),
                cause,
            });
        }
    };
    let closed = closed.filter(|_| when_closed == OnClosedRelays::Refuse);
    if closed.is_none() {
        rig.safe_off(wiring).await.map_err(AssemblyError::Unsafe)?;
        rig.prepare(&plan.plan, plan.meter)
            .await
            .map_err(AssemblyError::Settings)?;
    }
    Ok(Assembled {
        rig,
        identities: here,
        closed,
    })
}

/// `--safe-off`: the source first, then the relays, independently, so that a missing instrument does not prevent the
/// other from being made safe. Returns a line for each.
pub(crate) async fn make_safe_each(
    plan: &RigPlan,
    simulated_rig: &Option<SimulatedRig>,
) -> Vec<Result<String, AssemblyError>> {
    let source = async {
        let mut source = connect_source(plan, simulated_rig, None).await?;
        let place = plan.instruments.source.0.clone();
        source
            .off()
            .await
            .map_err(|cause| AssemblyError::Instrument {
                role: "source",
                place,
                cause,
            })?;
        Ok(format!("source off, verified: {}", source.identity()))
    };
    vec![source.await, relays_open(plan, simulated_rig).await]
}

async fn relays_open(
    plan: &RigPlan,
    simulated_rig: &Option<SimulatedRig>,
) -> Result<String, AssemblyError> {
    let wiring = &plan.plan.wiring;
    let mut relays = wiring.injecting_relays();
    relays.extend(wiring.measuring_relays());
    relays.extend(&wiring.bus);
    let (found, opened, identity) = if plan.has_board() {
        let mut board = connect_board(plan, simulated_rig, None).await?;
        let found = find_closed(&mut board, wiring).await;
        let opened = board.open_verified(&relays).await;
        (found, opened, board.identity().to_owned())
    } else {
        let mut mainframe = connect_mainframe(plan, simulated_rig, None).await?;
        let found = find_closed(&mut mainframe, wiring).await;
        let opened = mainframe.open_verified(&relays).await;
        (found, opened, mainframe.identity().to_owned())
    };
    opened.map_err(|cause| AssemblyError::Instrument {
        role: "switch",
        place: plan.instruments.switch.0.clone(),
        cause,
    })?;
    let found = match found {
        Ok(closed) if !closed.is_empty() => format!("; found closed: {}", name_relays(&closed)),
        _ => String::new(),
    };
    Ok(format!(
        "{} relays open, verified: {identity}{found}",
        relays.len()
    ))
}

/// Opens the relays only, if the source cannot be reached: no current reaches the sheet through open relays.
pub(crate) async fn open_relays(
    plan: &RigPlan,
    simulated_rig: &Option<SimulatedRig>,
) -> Result<(), AssemblyError> {
    relays_open(plan, simulated_rig).await.map(drop)
}

async fn connect_source(
    plan: &RigPlan,
    simulated_rig: &Option<SimulatedRig>,
    transcript: Option<&RingTranscript>,
) -> Result<Source, AssemblyError> {
    let (place, deadline) = &plan.instruments.source;
    let stream = open(
        "source",
        place,
        simulated_rig.as_ref().map(SimulatedRig::connect_6221),
    )
    .await?;
    let link = Link::new(stream, format!("6221 ({place})"), *deadline);
    let link = transcribed(link, transcript);
    Keithley6221::connect(link)
        .await
        .map_err(|cause| AssemblyError::Instrument {
            role: "source",
            place: place.clone(),
            cause,
        })
}

async fn connect_mainframe(
    plan: &RigPlan,
    simulated_rig: &Option<SimulatedRig>,
    transcript: Option<&RingTranscript>,
) -> Result<Mainframe, AssemblyError> {
    let (place, deadline) = &plan.instruments.voltmeter;
    let stream = open(
        "voltmeter",
        place,
        simulated_rig.as_ref().map(SimulatedRig::connect_34980a),
    )
    .await?;
    let link = Link::new(stream, format!("34980A ({place})"), *deadline);
    let link = transcribed(link, transcript);
    Keysight34980a::connect(link)
        .await
        .map_err(|cause| AssemblyError::Instrument {
            role: "voltmeter",
            place: place.clone(),
            cause,
        })
}

async fn connect_board(
    plan: &RigPlan,
    simulated_rig: &Option<SimulatedRig>,
    transcript: Option<&RingTranscript>,
) -> Result<Multiplexer, AssemblyError> {
    let (place, deadline) = &plan.instruments.switch;
    let fault = |cause| AssemblyError::Instrument {
        role: "switch",
        place: place.clone(),
        cause,
    };
    if let InstrumentAddress::Gpiochip { path, first } = place {
        let electrodes = plan.plan.wiring.electrodes;
        let enable = plan.instruments.enable;
        return Multiplexer::on_gpiochip(path, *first, enable, electrodes).map_err(fault);
    }
    let mut stream = open(
        "switch",
        place,
        simulated_rig.as_ref().map(SimulatedRig::connect_gpio),
    )
    .await?;
    if matches!(place, InstrumentAddress::Serial { .. }) {
        let banner = gpio_mux::await_banner(&mut stream, RESTART_TIMEOUT).await;
        tracing::debug!(?banner, "multiplexer board");
    }
    let link = Link::new(stream, format!("gpio board ({place})"), *deadline);
    let link = transcribed(link, transcript);
    let board = GpioMux::connect(link).await.map_err(fault)?;
    Ok(Multiplexer::Serial(board))
}

fn transcribed(link: Link<BoxStream>, transcript: Option<&RingTranscript>) -> Link<BoxStream> {
    match transcript {
        Some(transcript) => link.with_transcript(transcript.clone()),
        None => link,
    }
}

/// Opens a stream to the address; `simulated` is used if the address is in memory.
async fn open(
    role: &'static str,
    place: &InstrumentAddress,
    simulated: Option<BoxStream>,
) -> Result<BoxStream, AssemblyError> {
    let opened = match place {
        InstrumentAddress::Simulated => {
            return Ok(simulated.expect("a plan with a simulated place has a simulated rig"));
        }
        InstrumentAddress::Tcp(address) => rig::connect_tcp(address, CONNECT_TIMEOUT).await,
        InstrumentAddress::Serial { path, baud } => {
            rig::open_serial(path, baud.unwrap_or_else(|| InstrumentAddress::baud(role)))
        }
        // a gpiochip is no stream; the configuration allows it for a board only, which is opened elsewhere
        InstrumentAddress::Gpiochip { path, .. } => Err(LinkError::Unreachable {
            address: path.clone(),
            cause: std::io::ErrorKind::Unsupported.into(),
        }),
    };
    opened.map_err(|cause| AssemblyError::Unreachable {
        role,
        place: place.clone(),
        cause,
    })
}
