//! The instrument models that the daemon supports: how each is connected, which configuration is proposed for it, its
//! limits and timing, and the rigs that the models form. Adding a model with the same roles changes no other file of
//! `instruments`.

mod connection;
mod multiplexer;

use std::collections::BTreeMap;
use std::time::Duration;

use gpio_mux::GpioMux;
use keithley_6221::Keithley6221;
use keysight_34980a::{Keysight34980a, Module};
use rig::{
    AcquireError, BoxStream, CleanupError, Clock, CurrentSource, FoundRelay, InjectionSink,
    MeterSettings, Rig, RigError, StartError, Stop, Switch, acquire_reporting, check_at_start,
    find_closed, safe_off,
};
use self_test::{Measured, ProbeError, Request, probe};
use survey::{Frame, Limits, Plan, Relay, Sensing, Timing, Wiring, duration};

use crate::instruments::address::InstrumentAddress;
pub(crate) use crate::instruments::kinds::connection::{ConnectError, Connector};
use crate::instruments::kinds::multiplexer::Multiplexer;
use crate::instruments::rig_plan::RigPlan;

// Ranges and integration times of the voltmeter. Other modules take them from here, so that they name no model.
pub(crate) use keysight_34980a::{INTEGRATION, RANGES, range_for, resolution};

/// A board restarts when its port is opened; it sends a message when it is ready.
const RESTART_TIMEOUT: Duration = Duration::from_secs(2);

type Source = Keithley6221<BoxStream>;
type Mainframe = Keysight34980a<BoxStream>;

/// Properties of a model that are known before it is connected.
pub(super) struct Model {
    /// Its name in messages and transcripts.
    name: &'static str,
    /// The name of its simulator.
    simulated: &'static str,
    /// Default rate of a serial line.
    baud: u32,
    /// Whether a reply to `*IDN?` names this model, in its second field.
    is_named: fn(&str) -> bool,
    /// The section of a configuration that discovery proposes, and the lines after it.
    section: &'static str,
    further_lines: &'static str,
}

const SOURCE: Model = Model {
    name: "6221",
    simulated: "6221",
    // factory default (fact sheet section 1)
    baud: 9600,
    is_named: |model| model.eq_ignore_ascii_case("MODEL 6221"),
    section: "source",
    further_lines: "",
};

const MAINFRAME: Model = Model {
    name: "34980A",
    simulated: "34980a",
    // not used: it has no serial port
    baud: 115_200,
    is_named: |model| model.eq_ignore_ascii_case("34980A"),
    section: "switch",
    further_lines: "",
};

const BOARD: Model = Model {
    name: "gpio board",
    simulated: "gpio",
    baud: 115_200,
    is_named: |model| model == gpio_mux::MODEL,
    section: "switch",
    further_lines: "\n[wiring]\nkind = \"gpio-board\"",
};

const MODELS: [&Model; 3] = [&SOURCE, &MAINFRAME, &BOARD];

/// The rate at which discovery queries a serial line without one in its address.
pub(super) const DISCOVERY_BAUD: u32 = SOURCE.baud;

/// The section of a configuration for a model, and the lines after it; `None` if no driver supports the model.
pub(super) fn proposal(model: &str) -> Option<(&'static str, &'static str)> {
    let known = MODELS.into_iter().find(|known| (known.is_named)(model))?;
    Some((known.section, known.further_lines))
}

/// Limits of source and modules; without modules, those of the multiplexer board.
pub(crate) fn limits(modules: &BTreeMap<u32, Module>) -> Limits {
    let source = keithley_6221::LIMITS;
    if modules.is_empty() {
        return Limits::of(source, [gpio_mux::RELAY_LIMITS]);
    }
    let relays = modules.values().map(|module| module.model().relay_limits());
    Limits::of(source, relays)
}

/// Timing of a wiring on these modules: the slowest relay and the slowest scan; without modules, on the multiplexer
/// board.
pub(crate) fn timing(
    wiring: &Wiring,
    modules: &BTreeMap<u32, Module>,
    nplc: f64,
    line_hz: f64,
) -> Timing {
    if modules.is_empty() {
        return Timing {
            round_trip: gpio_mux::ROUND_TRIP,
            ..keysight_34980a::reading_timing(nplc, line_hz)
        };
    }
    let slowest =
        |time: fn(&Module) -> Duration| modules.values().map(time).max().unwrap_or_default();
    let measuring = wiring.measuring_relays();
    let scans = measuring
        .iter()
        .filter_map(|relay| modules.get(&keysight_34980a::split(*relay)?.0));
    let rate = scans.filter_map(|module| module.model().scan_rate()).min();
    Timing {
        relay_close: slowest(|module| module.model().close_time()),
        relay_open: slowest(|module| module.model().open_time()),
        scan_period: duration(1.0 / f64::from(rate.unwrap_or(100))),
        ..keysight_34980a::reading_timing(nplc, line_hz)
    }
}

/// Connects to the source; leaves its output as it is.
pub(super) async fn connect_source(by: Connector<'_>) -> Result<Source, ConnectError> {
    let place = by.source();
    let stream = by.open(place, &SOURCE).await?;
    let link = by.link(stream, place, &SOURCE);
    Keithley6221::connect(link).await.map_err(place.fault())
}

/// Switches the source off and verifies it.
pub(super) async fn source_off(by: Connector<'_>, source: &mut Source) -> Result<(), ConnectError> {
    source.off().await.map_err(by.source().fault())
}

async fn connect_mainframe(by: Connector<'_>) -> Result<Mainframe, ConnectError> {
    let place = by.voltmeter();
    let stream = by.open(place, &MAINFRAME).await?;
    let link = by.link(stream, place, &MAINFRAME);
    Keysight34980a::connect(link).await.map_err(place.fault())
}

async fn connect_board(by: Connector<'_>) -> Result<Multiplexer, ConnectError> {
    let place = by.switch();
    if let InstrumentAddress::Gpiochip { path, first } = place.address {
        let electrodes = by.plan.plan.wiring.electrodes;
        let enable = by.plan.instruments.enable;
        let board = Multiplexer::on_gpiochip(path, *first, enable, electrodes);
        return board.map_err(place.fault());
    }
    let mut stream = by.open(place, &BOARD).await?;
    if matches!(place.address, InstrumentAddress::Serial { .. }) {
        let banner = gpio_mux::await_banner(&mut stream, RESTART_TIMEOUT).await;
        tracing::debug!(?banner, "multiplexer board");
    }
    let link = by.link(stream, place, &BOARD);
    let board = GpioMux::connect(link).await.map_err(place.fault())?;
    Ok(Multiplexer::Serial(board))
}

/// All instruments of a rig except its source.
// one value, which is moved into its rig immediately
#[allow(clippy::large_enum_variant)]
pub(super) enum SwitchAndVoltmeter {
    /// The mainframe switches and measures.
    Mainframe(Mainframe),
    /// The board switches, the mainframe measures.
    Board(Multiplexer, Mainframe),
}

impl SwitchAndVoltmeter {
    pub(super) async fn connect(by: Connector<'_>) -> Result<Self, ConnectError> {
        let mainframe = connect_mainframe(by).await?;
        Ok(match by.plan.has_board() {
            true => Self::Board(connect_board(by).await?, mainframe),
            false => Self::Mainframe(mainframe),
        })
    }

    /// Roles, identities and addresses.
    pub(super) fn identities<'a>(
        &'a self,
        by: Connector<'a>,
    ) -> Vec<(&'static str, &'a str, &'a InstrumentAddress)> {
        let (switch, voltmeter) = (by.switch().address, by.voltmeter().address);
        match self {
            Self::Mainframe(mainframe) => {
                vec![("switch+voltmeter", mainframe.identity(), voltmeter)]
            }
            Self::Board(board, mainframe) => vec![
                ("switch", board.identity(), switch),
                ("voltmeter", mainframe.identity(), voltmeter),
            ],
        }
    }

    /// The type and serial number of the module in each slot, as reported; none for instruments without slots.
    pub(super) fn slots(&self) -> Vec<(Option<&str>, Option<&str>)> {
        let (Self::Mainframe(mainframe) | Self::Board(_, mainframe)) = self;
        let cards = mainframe.cards().iter().zip(mainframe.serials());
        cards
            .map(|(card, serial)| (card.as_deref(), serial.as_deref()))
            .collect()
    }

    /// Checks that the instruments can execute the plan.
    pub(super) fn check(&self, plan: &RigPlan) -> Result<(), RigError> {
        match self {
            Self::Mainframe(mainframe) => mainframe
                .check_wiring(&plan.plan.wiring)
                .and_then(|()| mainframe.check_modules(&plan.modules)),
            Self::Board(..) => Ok(()),
        }
    }

    /// The rig; `simulated` if any of its instruments is.
    pub(super) fn with_source(self, source: Source, simulated: bool) -> AnyRig {
        match self {
            Self::Mainframe(mainframe) => {
                let rig = Rig::new(source, mainframe.clone(), mainframe);
                AnyRig::Mainframe(rig.as_simulated(simulated))
            }
            Self::Board(board, mainframe) => {
                AnyRig::Board(Rig::new(source, board, mainframe).as_simulated(simulated))
            }
        }
    }
}

/// Relays of a switch that was opened without the rest of the rig.
pub(super) struct Opened {
    /// The injecting relays that were closed, if they could be read.
    pub(super) found: Result<Vec<FoundRelay>, RigError>,
    /// The switch.
    pub(super) identity: String,
}

/// Connects to the switch alone, opens the relays, and verifies that they are.
pub(super) async fn open_relays(
    by: Connector<'_>,
    relays: &[Relay],
) -> Result<Opened, ConnectError> {
    let wiring = &by.plan.plan.wiring;
    let (found, opened, identity) = if by.plan.has_board() {
        let mut board = connect_board(by).await?;
        let found = find_closed(&mut board, wiring).await;
        let opened = board.open_verified(relays).await;
        (found, opened, board.identity().to_owned())
    } else {
        let mut mainframe = connect_mainframe(by).await?;
        let found = find_closed(&mut mainframe, wiring).await;
        let opened = mainframe.open_verified(relays).await;
        (found, opened, mainframe.identity().to_owned())
    };
    opened.map_err(by.switch().fault())?;
    Ok(Opened { found, identity })
}

/// The supported rigs: one current source, one voltmeter, two kinds of switch.
pub(crate) enum AnyRig {
    Mainframe(Rig<Source, Mainframe, Mainframe>),
    Board(Rig<Source, Multiplexer, Mainframe>),
}

/// Evaluates an expression with the rig, for either variant.
macro_rules! with {
    ($any:expr, $rig:ident => $expression:expr) => {
        match $any {
            AnyRig::Mainframe($rig) => $expression,
            AnyRig::Board($rig) => $expression,
        }
    };
}

impl AnyRig {
    /// Runs the plan once; also sends the readings of each injection to `injections` during the frame.
    pub(crate) async fn acquire(
        &self,
        plan: &Plan,
        meter: MeterSettings,
        clock: impl Clock,
        stop: &Stop,
        injections: Option<InjectionSink>,
    ) -> Result<Frame, AcquireError> {
        with!(self, rig => acquire_reporting(rig, plan, meter, clock, stop, injections).await)
    }

    /// Source off and relays open, each verified.
    pub(crate) async fn safe_off(&self, wiring: &Wiring) -> Result<(), CleanupError> {
        with!(self, rig => safe_off(rig, wiring).await)
    }

    pub(super) async fn prepare(&self, plan: &Plan, meter: MeterSettings) -> Result<(), RigError> {
        with!(self, rig => rig::prepare(&mut *rig.lock().await, plan, meter).await)
    }

    pub(super) async fn check_at_start(&self, wiring: &Wiring) -> Result<(), StartError> {
        with!(self, rig => check_at_start(rig, wiring).await)
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

    /// The number of closures of each relay; `None` if the instrument does not count them.
    pub(crate) async fn relay_cycles(
        &self,
        relays: &[Relay],
    ) -> Option<Result<Vec<u64>, RigError>> {
        match self {
            Self::Mainframe(rig) => Some(rig.lock().await.voltmeter.relay_cycles(relays).await),
            Self::Board(_) => None,
        }
    }
}

#[cfg(all(test, feature = "simulator"))]
mod tests {
    use super::MODELS;

    #[test]
    fn every_model_has_a_simulator() {
        for model in MODELS {
            let simulated = simulator::Instrument::named(model.simulated);
            assert!(simulated.is_some(), "{}: {}", model.name, model.simulated);
        }
    }
}
