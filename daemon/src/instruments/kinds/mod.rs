//! The instrument models that the daemon supports: how each is connected, which configuration is proposed for it, its
//! limits and timing, and the rigs that the models form. Adding a model with the same roles changes no other file of
//! `instruments`.

mod connection;
mod gpiochip;

use std::collections::BTreeMap;
use std::time::Duration;

use gpio_mux::{CharacterDevice, GpioBoard, GpioMux};
use keithley_6221::Keithley6221;
use keysight_34980a::{Keysight34980a, Module};
use rig::{BoxStream, CurrentSource, FoundRelay, Move, Rig, RigError, Switch, find_closed};
use self_test::{Measured, ProbeError, Request};
use survey::{Limits, Relay, Sensing, Timing, Wiring, duration};

use crate::instruments::address::InstrumentAddress;
pub(crate) use crate::instruments::kinds::connection::{ConnectError, Connector};
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

async fn connect_board(by: Connector<'_>) -> Result<AnySwitch, ConnectError> {
    let place = by.switch();
    if let InstrumentAddress::Gpiochip { path, first } = place.address {
        let electrodes = by.plan.plan.wiring.electrodes;
        let enable = by.plan.instruments.enable;
        let board = gpiochip::board_on(path, *first, enable, electrodes);
        return board.map_err(place.fault());
    }
    let mut stream = by.open(place, &BOARD).await?;
    if matches!(place.address, InstrumentAddress::Serial { .. }) {
        let banner = gpio_mux::await_banner(&mut stream, RESTART_TIMEOUT).await;
        tracing::debug!(?banner, "multiplexer board");
    }
    let link = by.link(stream, place, &BOARD);
    let board = GpioMux::connect(link).await.map_err(place.fault())?;
    Ok(AnySwitch::Serial(board))
}

/// The switch of a rig.
// one value, which is moved into its rig immediately
#[allow(clippy::large_enum_variant)]
pub(crate) enum AnySwitch {
    Mainframe(Mainframe),
    /// A multiplexer board on a serial line.
    Serial(GpioMux<BoxStream>),
    /// A multiplexer board on a gpiochip.
    Lines(GpioBoard<CharacterDevice>, String),
}

impl AnySwitch {
    /// The reply to `*IDN?`; for a gpiochip, which has no identity, the path of the chip.
    pub(crate) fn identity(&self) -> &str {
        match self {
            Self::Mainframe(mainframe) => mainframe.identity(),
            Self::Serial(board) => board.identity(),
            Self::Lines(_, identity) => identity,
        }
    }
}

/// Evaluates an expression with the switch, for each variant.
macro_rules! with {
    ($any:expr, $switch:ident => $expression:expr) => {
        match $any {
            AnySwitch::Mainframe($switch) => $expression,
            AnySwitch::Serial($switch) => $expression,
            AnySwitch::Lines($switch, _) => $expression,
        }
    };
}

impl Switch for AnySwitch {
    async fn prepare_for_silence(&mut self, longest: Duration) -> Result<(), RigError> {
        with!(self, switch => switch.prepare_for_silence(longest).await)
    }

    async fn move_relays(&mut self, moves: &[Move]) -> Result<(), RigError> {
        with!(self, switch => switch.move_relays(moves).await)
    }

    async fn settle(&mut self) -> Result<(), RigError> {
        with!(self, switch => switch.settle().await)
    }

    async fn closed(&mut self, relays: &[Relay]) -> Result<Vec<bool>, RigError> {
        with!(self, switch => switch.closed(relays).await)
    }

    async fn open_verified(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        with!(self, switch => switch.open_verified(relays).await)
    }

    async fn closed_before_opening(
        &mut self,
        requested: &[Relay],
        relays: &[Relay],
    ) -> Result<Vec<bool>, RigError> {
        with!(self, switch => switch.closed_before_opening(requested, relays).await)
    }
}

/// All instruments of a rig except its source.
pub(super) struct SwitchAndVoltmeter {
    switch: AnySwitch,
    voltmeter: Mainframe,
}

impl SwitchAndVoltmeter {
    pub(super) async fn connect(by: Connector<'_>) -> Result<Self, ConnectError> {
        let voltmeter = connect_mainframe(by).await?;
        let switch = match by.plan.has_board() {
            true => connect_board(by).await?,
            // the mainframe switches and measures
            false => AnySwitch::Mainframe(voltmeter.clone()),
        };
        Ok(Self { switch, voltmeter })
    }

    /// Roles, identities and addresses.
    pub(super) fn identities<'a>(
        &'a self,
        by: Connector<'a>,
    ) -> Vec<(&'static str, &'a str, &'a InstrumentAddress)> {
        let (switch, voltmeter) = (by.switch().address, by.voltmeter().address);
        let measures = self.voltmeter.identity();
        match &self.switch {
            AnySwitch::Mainframe(_) => vec![("switch+voltmeter", measures, voltmeter)],
            board => vec![
                ("switch", board.identity(), switch),
                ("voltmeter", measures, voltmeter),
            ],
        }
    }

    /// The type and serial number of the module in each slot, as reported; none for instruments without slots.
    pub(super) fn slots(&self) -> Vec<(Option<&str>, Option<&str>)> {
        let cards = self.voltmeter.cards().iter();
        let cards = cards.zip(self.voltmeter.serials());
        cards
            .map(|(card, serial)| (card.as_deref(), serial.as_deref()))
            .collect()
    }

    /// Checks that the instruments can execute the plan.
    pub(super) fn check(&self, plan: &RigPlan) -> Result<(), RigError> {
        let AnySwitch::Mainframe(mainframe) = &self.switch else {
            return Ok(());
        };
        mainframe.check_wiring(&plan.plan.wiring)?;
        mainframe.check_modules(&plan.modules)
    }

    /// The rig; `simulated` if any of its instruments is.
    pub(super) fn with_source(self, source: Source, simulated: bool) -> AnyRig {
        Rig::new(source, self.switch, self.voltmeter).as_simulated(simulated)
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
    let mut switch = match by.plan.has_board() {
        true => connect_board(by).await?,
        false => AnySwitch::Mainframe(connect_mainframe(by).await?),
    };
    let found = find_closed(&mut switch, wiring).await;
    let opened = switch.open_verified(relays).await;
    opened.map_err(by.switch().fault())?;
    let identity = switch.identity().to_owned();
    Ok(Opened { found, identity })
}

/// The supported rigs: one current source, any switch, one voltmeter.
pub(crate) type AnyRig = Rig<Source, AnySwitch, Mainframe>;

/// Takes all readings of a self-test. The caller must make the rig safe afterwards.
pub(crate) async fn probe(rig: &AnyRig, mut request: Request<'_>) -> Result<Measured, ProbeError> {
    let mut held = rig.lock().await;
    let wiring = &request.plan.wiring;
    if wiring.sensing == Sensing::Scan && matches!(held.switch, AnySwitch::Mainframe(_)) {
        request.meter_relays = held.voltmeter.meter_relays(&wiring.measuring_relays());
    }
    self_test::probe(&mut held, &request).await
}

/// The number of closures of each relay; `None` if the switch does not count them.
pub(crate) async fn relay_cycles(
    rig: &AnyRig,
    relays: &[Relay],
) -> Option<Result<Vec<u64>, RigError>> {
    match &rig.lock().await.switch {
        AnySwitch::Mainframe(mainframe) => Some(mainframe.relay_cycles(relays).await),
        _ => None,
    }
}

#[cfg(all(test, feature = "simulator"))]
mod tests {
    use rig::Link;
    use simulator::{Instrument, Profile, Scene, SimulatedRig};

    use super::*;
    use crate::preparation::{FramesFrom, prepare};

    #[test]
    fn every_model_has_a_simulator() {
        for model in MODELS {
            let simulated = Instrument::named(model.simulated);
            assert!(simulated.is_some(), "{}: {}", model.name, model.simulated);
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_board_waits_for_the_longest_silence() {
        let seconds = Duration::from_secs;
        let profile = Profile::shipped("gpio-board").unwrap();
        let rig = SimulatedRig::new(&profile, Scene::quiet()).unwrap();
        let link = Link::new(rig.connect(Instrument::Board), "board", seconds(5));
        let mut switch = AnySwitch::Serial(GpioMux::connect(link).await.unwrap());
        switch.prepare_for_silence(seconds(60)).await.unwrap();
        let relays = [Relay(101), Relay(202)];
        let close = [Move::Close(relays.to_vec())];
        switch.move_relays(&close).await.unwrap();
        tokio::time::sleep(seconds(60)).await;
        assert_eq!(switch.closed(&relays).await.unwrap(), [true, true]);
    }

    /// Eight electrodes on a board, each reading 8 s: 200 power-line cycles of 20 ms, and as long for the zero.
    const SLOW: &str = "[rig]\nprofile = \"gpio-board\"\n[wiring]\nkind = \"gpio-board\"\n\
                        [geometry]\npreset = \"disc-tank\"\n[geometry.disc-tank]\nelectrodes = 8\n\
                        [survey]\ncompliance_v = 4.5\nnplc = 200\nautozero = true\n[record]\ndirectory = \"state\"\n";

    #[tokio::test(start_paused = true)]
    async fn a_board_stays_closed_in_a_self_test_of_slow_readings() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        std::fs::write(&path, SLOW).unwrap();
        let prepared = prepare(&path).unwrap_or_else(|problems| panic!("{problems:?}"));
        let FramesFrom::Rig(plan) = &prepared.frames else {
            panic!("it is a rig");
        };
        let simulated = prepared.simulated_rig().unwrap();
        let by = Connector {
            plan,
            simulated_rig: simulated.as_ref(),
            transcript: None,
        };
        let source = connect_source(by).await.unwrap();
        let others = SwitchAndVoltmeter::connect(by).await.unwrap();
        let rig = others.with_source(source, true);
        let (_button, stop) = rig::Stop::button();
        let request = Request {
            plan: &self_test::with_neighbours(&plan.plan).unwrap(),
            meter: plan.meter,
            wide: range_for(plan.plan.compliance),
            meter_relays: Vec::new(),
            settle: plan.plan.settle,
            stop,
            progress: &|_, _, _| {},
        };
        let probed = probe(&rig, request).await;
        assert!(probed.is_ok(), "{:?}", probed.err());
    }
}
