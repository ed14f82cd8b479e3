//! Test implementations of source, switch and voltmeter with a shared state that counts calls, fails on request, and
//! asserts the safety rules of a source.

// each test file uses only a part of this module
#![allow(dead_code)]

pub mod wirings;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rig::{
    ChainedReading, Compliance, CurrentSource, LinkError, MeterSettings, Move, Rig, RigError,
    Sample, Switch, Voltmeter,
};
use survey::{Amps, Dipole, Electrode, Measurement, Reading, Relay, Volts, Wiring};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    Source,
    SwitchAndMeter,
    Everything,
}

#[derive(Debug, Clone, Copy)]
pub enum Fault {
    /// This call fails, later ones work.
    Once,
    /// From this call on the instrument does not reply.
    Lost(Part),
}

type Act = Box<dyn FnOnce() + Send>;

struct World {
    wiring: Wiring,
    calls: usize,
    fault: Option<(usize, Fault)>,
    act: Option<(usize, Act)>,
    slow: Option<(Part, usize, Duration)>,
    lost: Option<Part>,
    on: bool,
    level: Amps,
    verified_off: bool,
    closed: BTreeSet<Relay>,
    held_back: Vec<Move>,
    bad_electrode: Option<Electrode>,
    latched: bool,
    answers: BTreeMap<Measurement, Reading>,
    loses_a_reading: bool,
    /// Added to every reading, independent of the current's direction.
    emf: f64,
}

#[derive(Clone)]
pub struct StandIn(Arc<Mutex<World>>);

/// One handle implements all three instruments.
pub type Played = Rig<StandIn, StandIn, StandIn>;

impl StandIn {
    pub fn new(wiring: &Wiring) -> Self {
        Self(Arc::new(Mutex::new(World {
            wiring: wiring.clone(),
            calls: 0,
            fault: None,
            act: None,
            slow: None,
            lost: None,
            on: false,
            level: Amps(0.0),
            verified_off: false,
            closed: BTreeSet::new(),
            held_back: Vec::new(),
            bad_electrode: None,
            latched: true,
            answers: BTreeMap::new(),
            loses_a_reading: false,
            emf: 0.0,
        })))
    }

    fn with(self, change: impl FnOnce(&mut World)) -> Self {
        change(&mut self.0.lock().unwrap());
        self
    }

    pub fn failing(self, call: usize, fault: Fault) -> Self {
        self.with(|world| world.fault = Some((call, fault)))
    }

    pub fn calling(self, call: usize, act: impl FnOnce() + Send + 'static) -> Self {
        self.with(|world| world.act = Some((call, Box::new(act))))
    }

    /// From this call on each call of the instrument takes this long.
    pub fn slow(self, part: Part, call: usize, by: Duration) -> Self {
        self.with(|world| world.slow = Some((part, call, by)))
    }

    pub fn in_compliance_at(self, electrode: Electrode) -> Self {
        self.with(|world| world.bad_electrode = Some(electrode))
    }

    pub fn answering(self, measurement: Measurement, reading: Reading) -> Self {
        self.with(|world| {
            world.answers.insert(measurement, reading);
        })
    }

    pub fn with_emf(self, volts: f64) -> Self {
        self.with(|world| world.emf = volts)
    }

    pub fn losing_a_reading(self) -> Self {
        self.with(|world| world.loses_a_reading = true)
    }

    pub fn close(&self, relays: impl IntoIterator<Item = Relay>) {
        self.0.lock().unwrap().closed.extend(relays);
    }

    pub fn open(&self, relay: Relay) {
        self.0.lock().unwrap().closed.remove(&relay);
    }

    pub fn rig(&self) -> Played {
        Rig::new(self.clone(), self.clone(), self.clone()).as_simulated(true)
    }

    pub fn calls(&self) -> usize {
        self.0.lock().unwrap().calls
    }

    pub fn closed(&self) -> Vec<Relay> {
        self.0.lock().unwrap().closed.iter().copied().collect()
    }

    pub fn is_off(&self) -> bool {
        let world = self.0.lock().unwrap();
        !world.on && world.level == Amps(0.0) && world.verified_off
    }

    pub fn assert_safe(&self) {
        assert!(self.is_off(), "the source is not verified off");
        assert_eq!(self.closed(), [], "relays stay closed");
    }

    /// The voltage of a measurement: a different one for each.
    pub fn answer(measurement: Measurement) -> Reading {
        let pair = |dipole: Dipole| dipole.plus.0 * 100 + dipole.minus.0;
        Reading::Ok(Volts(
            (pair(measurement.drive) * 10_000 + pair(measurement.sense)) as f64,
        ))
    }

    /// Counts a call, and fails it if the test requested that. Yields, so that every call can be cancelled.
    async fn call(&self, part: Part) -> Result<std::sync::MutexGuard<'_, World>, RigError> {
        let act = {
            let mut world = self.0.lock().unwrap();
            let call = world.calls;
            world.calls += 1;
            let mut once = false;
            match world.fault {
                Some((at, Fault::Once)) if at == call => once = true,
                Some((at, Fault::Lost(part))) if at <= call => world.lost = Some(part),
                _ => {}
            }
            let lost = world.lost == Some(part) || world.lost == Some(Part::Everything);
            if once || lost {
                return Err(RigError::Link(LinkError::Lost {
                    instrument: format!("{part:?}"),
                    message: format!("call {call}"),
                    cause: None,
                }));
            }
            match world.act.take() {
                Some((at, act)) if at == call => Some(act),
                other => {
                    world.act = other;
                    None
                }
            }
        };
        if let Some(act) = act {
            act();
        }
        let slow = {
            let world = self.0.lock().unwrap();
            world
                .slow
                .filter(|(slow, from, _)| *slow == part && *from < world.calls)
        };
        if let Some((_, _, by)) = slow {
            tokio::time::sleep(by).await;
        }
        tokio::task::yield_now().await;
        Ok(self.0.lock().unwrap())
    }
}

impl World {
    fn is_live(&self) -> bool {
        self.on && self.level != Amps(0.0)
    }

    /// The pair connected to the source, if there is exactly one.
    fn driven(&self) -> Option<Dipole> {
        joined(&self.wiring.inject, &self.closed)
    }

    fn carry_out(&mut self) {
        for each in std::mem::take(&mut self.held_back) {
            match each {
                Move::Close(relays) => self.closed.extend(relays),
                Move::Open(relays) => {
                    for relay in relays {
                        assert!(self.closed.remove(&relay), "{relay} was not closed");
                    }
                }
            }
            assert!(
                !self.is_live() || self.driven().is_some() || self.closed.len() > 1,
                "a live source was left open"
            );
        }
    }

    fn read(&self, sense: Dipole) -> Reading {
        if self.slow.is_some() && !self.is_live() {
            // switched off during the reading
            return Reading::NotMeasured;
        }
        assert!(self.on, "read with the source off");
        let drive = self.driven().expect("exactly one pair is driven");
        let measurement = Measurement { drive, sense };
        let answer = self.answers.get(&measurement).copied();
        match answer.unwrap_or(StandIn::answer(measurement)) {
            // the reading changes its sign with the direction of the current
            Reading::Ok(volts) => {
                let way = if self.level.0 == 0.0 {
                    0.0
                } else {
                    self.level.0.signum()
                };
                Reading::Ok(Volts(volts.0 * way + self.emf))
            }
            lacking => lacking,
        }
    }
}

fn joined(pairs: &[(Dipole, Vec<Relay>)], closed: &BTreeSet<Relay>) -> Option<Dipole> {
    let mut joined = pairs
        .iter()
        .filter(|(_, relays)| relays.iter().all(|relay| closed.contains(relay)))
        .map(|(pair, _)| *pair);
    joined.next().filter(|_| joined.next().is_none())
}

impl CurrentSource for StandIn {
    async fn prepare(&mut self, _: Amps, _: Volts) -> Result<(), RigError> {
        let mut world = self.call(Part::Source).await?;
        (world.on, world.level, world.verified_off) = (false, Amps(0.0), true);
        world.latched = false;
        Ok(())
    }

    async fn set_current(&mut self, current: Amps) -> Result<(), RigError> {
        let mut world = self.call(Part::Source).await?;
        world.level = current;
        world.verified_off = false;
        Ok(())
    }

    async fn set_output(&mut self, on: bool) -> Result<(), RigError> {
        let mut world = self.call(Part::Source).await?;
        assert!(
            world.level == Amps(0.0),
            "the output went on at {}",
            world.level
        );
        world.on = on;
        world.verified_off = false;
        Ok(())
    }

    async fn compliance(&mut self) -> Result<Compliance, RigError> {
        let mut world = self.call(Part::Source).await?;
        let here = world.is_live()
            && world.bad_electrode.is_some()
            && world.driven().map(|pair| pair.plus) == world.bad_electrode;
        Ok(Compliance {
            now: here,
            since: std::mem::take(&mut world.latched),
        })
    }

    async fn off(&mut self) -> Result<(), RigError> {
        let mut world = self.call(Part::Source).await?;
        (world.on, world.level, world.verified_off) = (false, Amps(0.0), true);
        Ok(())
    }
}

impl Switch for StandIn {
    async fn move_relays(&mut self, moves: &[Move]) -> Result<(), RigError> {
        let mut world = self.call(Part::SwitchAndMeter).await?;
        world.held_back.extend(moves.iter().cloned());
        Ok(())
    }

    async fn settle(&mut self) -> Result<(), RigError> {
        self.call(Part::SwitchAndMeter).await?.carry_out();
        Ok(())
    }

    async fn closed(&mut self, relays: &[Relay]) -> Result<Vec<bool>, RigError> {
        let world = self.call(Part::SwitchAndMeter).await?;
        Ok(relays
            .iter()
            .map(|relay| world.closed.contains(relay))
            .collect())
    }

    async fn open_verified(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        let mut world = self.call(Part::SwitchAndMeter).await?;
        world.held_back.clear();
        world.closed.retain(|relay| !relays.contains(relay));
        Ok(())
    }
}

impl Voltmeter for StandIn {
    async fn prepare(&mut self, _: MeterSettings, _: &[Relay]) -> Result<(), RigError> {
        self.call(Part::SwitchAndMeter).await.map(|_| ())
    }

    async fn scan(&mut self) -> Result<Vec<Reading>, RigError> {
        unreachable!("acquire says which channels")
    }

    async fn scan_on(&mut self, channels: &[Sample]) -> Result<Vec<Reading>, RigError> {
        self.call(Part::SwitchAndMeter).await?.carry_out();
        tokio::time::sleep(channels.iter().map(|channel| channel.wait).sum()).await;
        let world = self.0.lock().unwrap();
        let pair = |relay: Relay| {
            let mut pairs = world.wiring.measure.iter();
            pairs.find(|(_, relays)| relays == &[relay]).unwrap().0
        };
        let mut readings: Vec<Reading> = channels
            .iter()
            .map(|channel| world.read(pair(channel.relay)))
            .collect();
        if world.loses_a_reading {
            readings.pop();
        }
        Ok(readings)
    }

    async fn read(&mut self) -> Result<Reading, RigError> {
        unreachable!("acquire says on which range")
    }

    async fn read_on(&mut self, _: Volts) -> Result<Reading, RigError> {
        let mut world = self.call(Part::SwitchAndMeter).await?;
        world.carry_out();
        let routed = joined(&world.wiring.measure, &world.closed).expect("one pair is routed");
        Ok(world.read(routed))
    }

    async fn chain(&mut self, chained: &[ChainedReading]) -> Result<Vec<Reading>, RigError> {
        let mut world = self.call(Part::SwitchAndMeter).await?;
        let mut readings = Vec::new();
        for one in chained {
            world.held_back.extend(one.moves.iter().cloned());
            world.carry_out();
            let routed = joined(&world.wiring.measure, &world.closed).expect("one pair is routed");
            readings.push(world.read(routed));
        }
        Ok(readings)
    }
}
