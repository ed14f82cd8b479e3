//! Assembles a rig from addresses: connects, identifies every instrument, and leaves the source off and verified.

use rig::{
    CleanupError, RigError, RingTranscript, StartError, check_at_start, name_relays, prepare,
    safe_off,
};
use survey::printable_within;

use crate::instruments::address::InstrumentAddress;
use crate::instruments::identities::{Connected, ExpectedIdentities};
pub(crate) use crate::instruments::kinds::AnyRig;
use crate::instruments::kinds::{self, ConnectError, Connector, SwitchAndVoltmeter};
use crate::instruments::rig_plan::RigPlan;
use crate::instruments::simulation::SimulatedRig;

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

/// The known state of the source while nothing uses it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SourceState {
    /// Off, verified.
    Off,
    /// Under the configuration in force, no source at its address has received a command. The daemon has switched
    /// nothing on, but an instrument at that address may be on.
    NeverReached,
    /// It was used, and is not verified off.
    Unknown,
}

/// Why a rig could not be assembled.
#[derive(Debug, thiserror::Error)]
pub(crate) enum AssemblyError {
    #[error(transparent)]
    Connect(#[from] ConnectError),
    #[error(transparent)]
    SourceNotOff(ConnectError),
    #[error("the wiring does not fit the mainframe")]
    Wiring(#[source] RigError),
    #[error("the rig could not be made safe: {0}")]
    Unsafe(CleanupError),
    #[error("the settings could not be applied")]
    Settings(#[source] RigError),
    #[error("{text}; it was not switched off, and the other instruments cannot be used")]
    OtherSource {
        /// What differs.
        text: String,
        #[source]
        cause: ConnectError,
    },
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
    /// The known state of the source after this error.
    pub(crate) fn source_state(&self) -> SourceState {
        match self {
            Self::Connect(error) if error.role() == "source" => SourceState::NeverReached,
            Self::OtherSource { .. }
            | Self::Others {
                source_off: false, ..
            } => SourceState::NeverReached,
            Self::SourceNotOff(_) => SourceState::Unknown,
            Self::Unsafe(cleanup) if cleanup.source_state_unknown() => SourceState::Unknown,
            Self::Connect(_)
            | Self::Wiring(_)
            | Self::Unsafe(_)
            | Self::Settings(_)
            | Self::Others { .. } => SourceState::Off,
        }
    }

    /// Whether relays were commanded, and are not verified open.
    pub(crate) fn leaves_relays_unknown(&self) -> bool {
        matches!(self, Self::Unsafe(cleanup) if cleanup.relays.is_some())
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
    let by = Connector {
        plan,
        simulated_rig: simulated_rig.as_ref(),
        transcript: Some(transcript),
    };
    let mut source = kinds::connect_source(by).await?;
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
        let off = kinds::source_off(by, &mut source).await;
        off.map_err(AssemblyError::SourceNotOff)?;
    }
    let others = SwitchAndVoltmeter::connect(by).await;
    let others = others.map_err(|cause| {
        let source = ExpectedIdentities {
            instruments: instruments.clone(),
            ..ExpectedIdentities::default()
        };
        match identities.and_then(|identities| identities.differs(&source)) {
            Some(text) => AssemblyError::OtherSource { text, cause },
            None => AssemblyError::Connect(cause),
        }
    })?;
    let slots = others.slots();
    let modules = (1..)
        .zip(&slots)
        .filter_map(|(slot, (card, _))| Some(format!("{slot}: {}", (*card)?)))
        .collect();
    let cards = (1..)
        .zip(&slots)
        .map(|(slot, (card, serial))| {
            let card = card.unwrap_or("empty");
            format!("slot {slot}: {card} {}", serial.unwrap_or_default())
        })
        .map(|card| card.trim_end().to_owned())
        .collect();
    for (role, identity, place) in others.identities(by) {
        instruments.push(found(role, identity, place));
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
    others.check(plan).map_err(AssemblyError::Wiring)?;
    let rig = others.with_source(source, simulated);
    let closed = match check_at_start(&rig, wiring).await {
        Ok(()) => None,
        Err(closed @ StartError::Closed(_)) => Some(closed.to_string()),
        Err(StartError::Unreadable(cause)) => {
            return Err(AssemblyError::Connect(ConnectError::Instrument {
                role: "switch",
                place: places.switch.0.clone(),
                cause,
            }));
        }
    };
    let closed = closed.filter(|_| when_closed == OnClosedRelays::Refuse);
    if closed.is_none() {
        safe_off(&rig, wiring)
            .await
            .map_err(AssemblyError::Unsafe)?;
        let prepared = prepare(&mut *rig.lock().await, &plan.plan, plan.meter).await;
        prepared.map_err(AssemblyError::Settings)?;
    }
    Ok(Assembled {
        rig,
        identities: here,
        closed,
    })
}

/// `--safe-off`: switches the source off, then opens the relays. Each is tried even if the other instrument is missing.
/// Returns a line for each.
pub(crate) async fn make_safe_each(
    plan: &RigPlan,
    simulated_rig: &Option<SimulatedRig>,
) -> Vec<Result<String, AssemblyError>> {
    let by = alone(plan, simulated_rig);
    let source = async {
        let mut source = kinds::connect_source(by).await?;
        kinds::source_off(by, &mut source).await?;
        Ok(format!("source off, verified: {}", source.identity()))
    };
    vec![source.await, relays_open(by).await]
}

/// A connector for a single instrument; its messages are not recorded in a transcript.
fn alone<'a>(plan: &'a RigPlan, simulated_rig: &'a Option<SimulatedRig>) -> Connector<'a> {
    Connector {
        plan,
        simulated_rig: simulated_rig.as_ref(),
        transcript: None,
    }
}

async fn relays_open(by: Connector<'_>) -> Result<String, AssemblyError> {
    let wiring = &by.plan.plan.wiring;
    let relays = wiring.relays();
    let opened = kinds::open_relays(by, &relays).await?;
    let found = match opened.found {
        Ok(closed) if !closed.is_empty() => format!("; found closed: {}", name_relays(&closed)),
        _ => String::new(),
    };
    Ok(format!(
        "{} relays open, verified: {}{found}",
        relays.len(),
        opened.identity
    ))
}

/// Opens only the relays, for when the source cannot be reached: no current reaches the sheet through open relays.
pub(crate) async fn open_relays(
    plan: &RigPlan,
    simulated_rig: &Option<SimulatedRig>,
) -> Result<(), AssemblyError> {
    relays_open(alone(plan, simulated_rig)).await.map(drop)
}
