//! The sheet of the simulated rig with its present connections.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use keysight_34980a::MeterRequest;
use nalgebra::DMatrix;
use phantom::{Phantom, PhantomError, ReadingContext};
use survey::{Amps, Electrode, Ohms, Relay, Volts};

use crate::circuit::load_network::LoadNetwork;
use crate::circuit::terminals::Fixture;
use crate::circuit::{Flow, METER_HI, METER_LO, Point, Resistor};

/// Relays of the mainframe are numbered slot x 1000 + channel, those of the board pole x 100 + electrode.
const FIRST_OF_MAINFRAME: u32 = 1000;

/// The source's terminals.
const SOURCE: [Point; 2] = [Point::Source(true), Point::Source(false)];

/// The board's chips that connect poles to electrodes.
fn chips(poles: [Option<Electrode>; 4]) -> impl Iterator<Item = Relay> {
    (1..).zip(poles).filter_map(|(pole, electrode)| {
        let number = u32::try_from(electrode?.number()).ok()?;
        Some(Relay(pole * 100 + number))
    })
}

/// A phantom with its wiring: the load of the source, and the voltage at the voltmeter. While the phantom cannot be
/// solved, the source has an open circuit as its load and readings are over range.
#[derive(Debug)]
pub(crate) struct Sheet {
    pub(crate) phantom: Phantom,
    /// Resistors on the terminals instead of the phantom.
    load_network: Option<Vec<Resistor>>,
    no_sheet: DMatrix<f64>,
    fixture: Fixture,
    closed: BTreeSet<Relay>,
    /// The channel closed by the voltmeter's scan for the reading in progress, with its bank's bus relay.
    scanned: Vec<Relay>,
    /// Slots whose terminal block is open: a scan does not reach a bus there.
    open_blocks: BTreeSet<u32>,
    poles: [Option<Electrode>; 4],
    /// Relays stuck closed or open by a fault, whatever their instrument reports.
    stuck: BTreeMap<Relay, bool>,
    /// The same for relays at the end of their life; and those replaced since, which are not worn.
    worn: BTreeMap<Relay, bool>,
    replaced: BTreeSet<Relay>,
    /// Number of closures of each relay, if an effect of the scene needs it.
    closures: BTreeMap<Relay, u64>,
    /// Whether every reading is over range.
    pub(crate) overload: bool,
    flowing: Amps,
    source_range: Amps,
    /// Mains frequency, the unit of the integration time.
    line_hz: f64,
    /// Time of the last change of current or relays.
    changed: Duration,
}

impl Sheet {
    pub(crate) fn new(
        phantom: Phantom,
        fixture: Fixture,
        load_network: &LoadNetwork,
        line_hz: f64,
    ) -> Self {
        Self {
            load_network: load_network.resistors(phantom.electrodes()),
            no_sheet: DMatrix::zeros(0, 0),
            phantom,
            fixture,
            closed: BTreeSet::new(),
            scanned: Vec::new(),
            open_blocks: BTreeSet::new(),
            poles: [None; 4],
            stuck: BTreeMap::new(),
            worn: BTreeMap::new(),
            replaced: BTreeSet::new(),
            closures: BTreeMap::new(),
            overload: false,
            flowing: Amps(0.0),
            source_range: Amps(0.0),
            line_hz,
            changed: Duration::ZERO,
        }
    }

    pub(crate) fn set_closed(&mut self, closed: &BTreeSet<Relay>, at: Duration) {
        let new: Vec<Relay> = closed.difference(&self.closed).copied().collect();
        self.count(new, 1, at);
        self.closed.clone_from(closed);
        self.changed = at;
    }

    pub(crate) fn set_poles(&mut self, poles: [Option<Electrode>; 4], at: Duration) {
        let before: Vec<Relay> = chips(self.poles).collect();
        let new = chips(poles).filter(|relay| !before.contains(relay));
        self.count(new, 1, at);
        self.poles = poles;
        self.changed = at;
    }

    /// Counts closures of relays, if an effect of the scene needs them; relays may reach the end of their life.
    pub(crate) fn count(
        &mut self,
        relays: impl IntoIterator<Item = Relay>,
        times: u32,
        at: Duration,
    ) {
        if !self.phantom.affects_wires() {
            return;
        }
        for relay in relays {
            let closures = self.closures.entry(relay).or_default();
            *closures += u64::from(times);
            let contact = self.phantom.relay_contact(relay, *closures, at);
            if let Some(closed) = contact.stuck
                && !self.replaced.contains(&relay)
            {
                self.worn.entry(relay).or_insert(closed);
            }
        }
    }

    /// Sets the channel that a scan reads; `None` for none.
    pub(crate) fn set_scanned(&mut self, channel: Option<Relay>) {
        self.scanned.clear();
        if let Some(channel) = channel {
            self.scanned.push(channel);
            let bus = self.fixture.scanned_by(channel);
            let closes = |bus: &Relay| !self.open_blocks.contains(&(bus.0 / 1000));
            self.scanned.extend(bus.filter(closes));
        }
    }

    /// Opens or shuts the terminal block of a slot.
    pub(crate) fn set_block(&mut self, slot: u32, shut: bool) {
        match shut {
            true => self.open_blocks.remove(&slot),
            false => self.open_blocks.insert(slot),
        };
    }

    /// Shuts all terminal blocks.
    pub(crate) fn shut_blocks(&mut self) {
        self.open_blocks.clear();
    }

    /// Makes a relay stick, closed or open.
    pub(crate) fn stick(&mut self, relay: Relay, closed: bool) {
        self.stuck.insert(relay, closed);
    }

    /// Frees a stuck relay; replaces a worn one.
    pub(crate) fn unstick(&mut self, relay: Relay) {
        self.stuck.remove(&relay);
        if self.worn.remove(&relay).is_some() {
            self.replaced.insert(relay);
        }
    }

    /// Whether a relay is stuck, by a fault or by wear.
    pub(crate) fn is_stuck(&self, relay: Relay) -> bool {
        self.stuck.contains_key(&relay) || self.worn.contains_key(&relay)
    }

    /// Whether a module of the mainframe, or the board if present, has this relay.
    pub(crate) fn has_relay(&self, relay: Relay, board: bool) -> bool {
        match relay.0 {
            FIRST_OF_MAINFRAME.. => self.fixture.has_relay(relay),
            _ => board && self.fixture.has_chip(relay),
        }
    }

    /// Whether the profile has a module in a slot, 1 to 8.
    pub(crate) fn has_module(&self, slot: u32) -> bool {
        self.fixture.module(slot).is_some()
    }

    pub(crate) fn unstick_all(&mut self) {
        self.stuck.clear();
        self.replaced
            .extend(std::mem::take(&mut self.worn).into_keys());
    }

    /// The mainframe's relays that are actually closed, without those of a scan.
    pub(crate) fn closed(&self) -> BTreeSet<Relay> {
        self.actually_closed(self.closed.iter().copied())
            .filter(|relay| relay.0 >= FIRST_OF_MAINFRAME)
            .collect()
    }

    /// The relays that are actually closed: those of the commanded ones that can close, and those stuck closed.
    fn actually_closed(
        &self,
        commanded: impl Iterator<Item = Relay>,
    ) -> impl Iterator<Item = Relay> {
        // A fault takes precedence over wear.
        let worn = self.worn.iter();
        let worn = worn.filter(|(relay, _)| !self.stuck.contains_key(relay));
        let stuck = self.stuck.iter().chain(worn);
        let stuck = stuck.filter(|(_, closed)| **closed);
        let moves =
            |relay: &Relay| !(self.stuck.contains_key(relay) || self.worn.contains_key(relay));
        commanded
            .filter(moves)
            .chain(stuck.map(|(relay, _)| *relay))
    }

    pub(crate) fn poles(&self) -> [Option<Electrode>; 4] {
        self.poles
    }

    pub(crate) fn flowing(&self) -> Amps {
        self.flowing
    }

    /// The voltage at an ideal voltmeter's terminals.
    pub(crate) fn voltage(&mut self, at: Duration) -> Volts {
        self.voltage_with(at, Amps(0.0), 1)
    }

    /// The voltage on a bus while the voltmeter sends its own test current; infinite without a path for that current.
    /// The effect of the test current on the source's compliance is ignored.
    fn voltage_with(&mut self, at: Duration, test: Amps, bus: u32) -> Volts {
        let flowing = self.flowing.0;
        if flowing == 0.0 && test.0 == 0.0 {
            return Volts(0.0);
        }
        let resistors = self.resistors(at);
        let [hi, lo] = [Point::Bus(bus, true), Point::Bus(bus, false)];
        match self.impedance(at) {
            Ok(z) => {
                let own = match flowing {
                    0.0 => 0.0,
                    _ => flowing * Flow::solve(resistors.clone(), z).across(z, hi, lo),
                };
                if test.0 == 0.0 {
                    return Volts(own);
                }
                let flow = Flow::solve_between(resistors, [METER_HI, METER_LO], z);
                let seen = match bus {
                    1 => flow.resistance(z),
                    _ if flow.resistance(z).is_finite() && flow.joins(hi, lo) => {
                        flow.across(z, hi, lo)
                    }
                    _ => f64::INFINITY,
                };
                Volts(own + test.0 * seen)
            }
            Err(_) => Volts(f64::INFINITY),
        }
    }

    /// Duration of an integration of this many power-line cycles.
    pub(crate) fn integration(&self, nplc: f64) -> Duration {
        survey::duration(nplc / self.line_hz)
    }

    /// The measured voltage: the ideal voltage with the scene's effects. `mean` is the mean current during the reading,
    /// if the source computes it.
    pub(crate) fn measured(
        &mut self,
        at: Duration,
        request: MeterRequest,
        mean: Option<Amps>,
    ) -> Volts {
        let flowing = self.flowing;
        self.flowing = mean.unwrap_or(flowing);
        let volts = self.read(at, request);
        self.flowing = flowing;
        volts
    }

    fn read(&mut self, at: Duration, request: MeterRequest) -> Volts {
        if self.overload {
            return Volts(f64::INFINITY);
        }
        let bus = if request.four_wire { 2 } else { 1 };
        let exact = self.voltage_with(at, request.test_current, bus);
        if !exact.0.is_finite() {
            return exact;
        }
        let needs = self.phantom.needs();
        let leads = self.phantom.loop_resistance().0;
        let mut seen = |needed: bool, from: [Point; 2]| {
            let resistance = needed.then(|| self.resistance_between(from, at));
            Ohms(resistance.unwrap_or(0.0))
        };
        let context = ReadingContext {
            source_resistance: seen(needs.source_resistance, [METER_HI, METER_LO]),
            load_resistance: Ohms(seen(needs.load_resistance, SOURCE).0 + leads),
            at,
            integration: self.integration(request.nplc),
            range: request.range,
            nplc: request.nplc,
            resolution: keysight_34980a::resolution(request.nplc),
            relay: request.channel,
            flowing: self.flowing,
            source_range: self.source_range,
            since_change: at.saturating_sub(self.changed),
        };
        self.phantom.reading(exact, context)
    }

    /// Resistance between two points, ohm; infinite if they are not connected or the phantom cannot be solved.
    fn resistance_between(&mut self, [from, to]: [Point; 2], at: Duration) -> f64 {
        let resistors = self.resistors(at);
        match self.impedance(at) {
            Ok(z) => Flow::solve_between(resistors, [from, to], z).resistance(z),
            Err(_) => f64::INFINITY,
        }
    }

    /// Voltage at the voltmeter per ampere of the source.
    pub(crate) fn transfer(&mut self, at: Duration) -> Ohms {
        let resistors = self.resistors(at);
        match self.impedance(at) {
            Ok(z) => Ohms(Flow::solve(resistors, z).across(z, METER_HI, METER_LO)),
            Err(_) => Ohms(0.0),
        }
    }

    fn resistors(&mut self, at: Duration) -> Vec<Resistor> {
        let scanned = self
            .scanned
            .iter()
            .filter(|relay| !self.closed.contains(relay));
        let commanded = self.closed.iter().chain(scanned).copied();
        let closed = self.actually_closed(commanded.chain(chips(self.poles)));
        let wires: Vec<Resistor> = if self.phantom.affects_wires() {
            let closed: Vec<Relay> = closed.collect();
            let mut wires = Vec::new();
            for relay in closed {
                let closures = self.closures.get(&relay).copied().unwrap_or(0);
                let more = self.phantom.relay_contact(relay, closures, at).ohms.0;
                wires.extend(self.fixture.joined(relay).map(|wire| Resistor {
                    ohms: wire.ohms + more,
                    ..wire
                }));
            }
            wires
        } else {
            closed
                .flat_map(|relay| self.fixture.joined(relay))
                .collect()
        };
        let Some(load_network) = &self.load_network else {
            return wires;
        };
        let lead = |point| match point {
            Point::Electrode(index) => Point::Terminal(index),
            other => other,
        };
        wires
            .into_iter()
            .map(|wire| Resistor {
                from: lead(wire.from),
                to: lead(wire.to),
                ..wire
            })
            .chain(load_network.iter().copied())
            .collect()
    }

    /// The transfer impedance of the sheet; it has no connected electrodes if resistors replace it.
    fn impedance(&mut self, at: Duration) -> Result<&DMatrix<f64>, PhantomError> {
        match self.load_network {
            Some(_) => Ok(&self.no_sheet),
            None => self.phantom.transfer_impedance(at),
        }
    }
}

impl keithley_6221::Load for Sheet {
    fn resistance(&mut self, at: Duration) -> Ohms {
        let leads = self.phantom.loop_resistance().0;
        Ohms(self.resistance_between(SOURCE, at) + leads)
    }

    fn drive(&mut self, flowing: Amps, range: Amps, at: Duration) {
        self.flowing = flowing;
        self.source_range = range;
        self.changed = at;
    }
}
