//! What a self-test does with the instruments: relays one by one, everything read, nothing judged.

use std::pin::pin;
use std::time::Duration;

use rig::{CurrentSource, Instruments, MeterSettings, Move, RigError, Stop, Switch, Voltmeter};
use survey::{Amps, Plan, Reading, Relay, Sensing, Volts};

/// Scans, or single readings, that noise is taken from.
const REPEATS: usize = 8;

/// What a self-test needs beside the instruments.
pub(crate) struct Asked<'a> {
    pub plan: &'a Plan,
    pub meter: MeterSettings,
    /// Joins the scanned banks to the voltmeter, where the voltmeter's own scan does that otherwise.
    pub meter_relays: Vec<Relay>,
    pub settle: Duration,
    pub stop: Stop,
    /// Steps done, of how many, and what is done now.
    pub progress: &'a (dyn Fn(u64, u64, &str) + Send + Sync),
}

/// Why a probe ended early.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ProbeError {
    #[error(transparent)]
    Rig(#[from] RigError),
    #[error("the self-test was stopped")]
    Stopped,
}

/// One injection.
#[derive(Debug, Clone, Default)]
pub(crate) struct Row {
    /// No current flowed as asked.
    pub compliance: bool,
    /// Voltage of every measuring pair, V; `None` where it is over any range.
    pub volts: Vec<Option<f64>>,
}

/// Some relays of a pair closed, not all: nothing should come of it.
#[derive(Debug, Clone)]
pub(crate) struct Lone {
    /// What was closed; none where a pair has one relay.
    pub closed: Vec<Relay>,
    pub row: Row,
}

/// A pair that carried no current, tried again with another pair's relay in place of one of its own.
#[derive(Debug, Clone)]
pub(crate) struct Retry {
    pub pair: usize,
    /// The pair's own relay in this try.
    pub relay: Relay,
    pub flows: bool,
}

/// Everything read.
#[derive(Debug, Clone, Default)]
pub(crate) struct Raw {
    /// For each injecting pair.
    pub rows: Vec<Row>,
    pub lone_sources: Vec<Lone>,
    /// Volts are of each injection, less those at 0 A.
    pub lone_meters: Vec<Lone>,
    pub retries: Vec<Retry>,
    /// The same of pairs that read nothing: whether something was read.
    pub meter_retries: Vec<Retry>,
    /// A row each: the same readings again and again.
    pub repeats: Vec<Vec<Option<f64>>>,
    /// At 0 A: every measuring pair, again and again. Noise of the current and of its path is not in it.
    pub zero: Vec<Vec<Option<f64>>>,
}

/// Reads everything that a judgement needs. The caller makes the rig safe afterwards, however this ends.
pub(crate) async fn probe<C, W, V>(
    rig: &mut Instruments<C, W, V>,
    asked: &Asked<'_>,
) -> Result<Raw, ProbeError>
where
    C: CurrentSource,
    W: Switch,
    V: Voltmeter,
{
    let pairs = asked.plan.wiring.inject.len() as u64;
    let mut probe = Probe {
        rig,
        asked,
        wide: wide(asked),
        on: false,
        done: 0,
        steps: 4 * pairs + REPEATS as u64,
    };
    probe.run().await
}

/// The range that holds whatever the source can give, at the same integration.
fn wide(asked: &Asked<'_>) -> MeterSettings {
    let most = asked.plan.compliance.0;
    let range = [0.1, 1.0, 10.0, 100.0]
        .into_iter()
        .find(|range| *range * 1.2 >= most);
    MeterSettings {
        range: Volts(range.unwrap_or(300.0)),
        ..asked.meter
    }
}

struct Probe<'a, 'b, C, W, V> {
    rig: &'a mut Instruments<C, W, V>,
    asked: &'a Asked<'b>,
    wide: MeterSettings,
    on: bool,
    done: u64,
    steps: u64,
}

impl<C: CurrentSource, W: Switch, V: Voltmeter> Probe<'_, '_, C, W, V> {
    async fn run(&mut self) -> Result<Raw, ProbeError> {
        let plan = self.asked.plan;
        let wiring = &plan.wiring;
        self.rig
            .source
            .prepare(plan.current, plan.compliance)
            .await?;
        let mut raw = Raw::default();
        self.prepare(self.asked.meter).await?;
        // the first preparation resets the instrument, which opens every relay
        self.close(&wiring.bus).await?;
        for (pair, (_, relays)) in wiring.inject.iter().enumerate() {
            self.tell(&format!("injecting pair {}", pair + 1))?;
            let row = self.inject(relays, None).await?;
            raw.rows.push(row);
        }
        if let Some(flows) = raw.rows.iter().position(|row| !row.compliance) {
            raw.repeats = self.repeat(flows).await?;
        }
        for scan in 0..REPEATS {
            self.tell(&format!("noise at 0 A, {} of {REPEATS}", scan + 1))?;
            raw.zero.push(self.read_pairs(None).await?);
        }
        self.prepare(self.wide).await?;
        for (pair, (_, relays)) in wiring.inject.iter().enumerate() {
            self.tell(&format!("pair {} on the wide range", pair + 1))?;
            let row = &raw.rows[pair];
            if row.compliance || row.volts.iter().all(Option::is_some) {
                continue;
            }
            let missing: Vec<bool> = row.volts.iter().map(Option::is_none).collect();
            let again = self.inject(relays, Some(&missing)).await?;
            for (volts, again) in raw.rows[pair].volts.iter_mut().zip(again.volts) {
                *volts = volts.or(again);
            }
        }
        for closed in lone(&wiring.inject) {
            self.tell("injecting relays that should be open")?;
            let row = self.inject(&closed, None).await?;
            raw.lone_sources.push(Lone { closed, row });
        }
        raw.retries = self.retry(&raw).await?;
        self.rig.voltmeter.prepare(self.wide, &[]).await?;
        self.close(&self.asked.meter_relays).await?;
        for closed in lone(&wiring.measure) {
            self.tell("measuring relays that should be open")?;
            let row = self.lone_meter(&closed).await?;
            raw.lone_meters.push(Lone { closed, row });
        }
        self.open(&self.asked.meter_relays).await?;
        raw.meter_retries = self.retry_meter(&raw).await?;
        self.done = self.steps;
        self.tell("done")?;
        Ok(raw)
    }

    /// Says what comes, and hears a stop.
    fn tell(&mut self, what: &str) -> Result<(), ProbeError> {
        (self.asked.progress)(self.done.min(self.steps), self.steps, what);
        self.done += 1;
        match self.asked.stop.is_asked() {
            true => Err(ProbeError::Stopped),
            false => Ok(()),
        }
    }

    async fn prepare(&mut self, meter: MeterSettings) -> Result<(), RigError> {
        let wiring = &self.asked.plan.wiring;
        let scan = match wiring.sensing {
            Sensing::Scan => wiring.measuring_relays(),
            Sensing::Single | Sensing::Chain => Vec::new(),
        };
        self.rig.voltmeter.prepare(meter, &scan).await
    }

    async fn close(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        if relays.is_empty() {
            return Ok(());
        }
        let close = Move::Close(relays.to_vec());
        self.rig.switch.move_relays(&[close]).await?;
        self.rig.switch.settle().await
    }

    async fn open(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        if relays.is_empty() {
            return Ok(());
        }
        let open = Move::Open(relays.to_vec());
        self.rig.switch.move_relays(&[open]).await?;
        self.rig.switch.settle().await
    }

    /// The output goes on at 0 A, never at a level.
    async fn drive(&mut self, level: Amps) -> Result<(), RigError> {
        if !self.on {
            self.rig.source.set_current(Amps(0.0)).await?;
            self.rig.source.set_output(true).await?;
            self.on = true;
        }
        self.rig.source.set_current(level).await
    }

    /// Closes relays at 0 A, drives the current, reads every pair (or those `only`), and opens them at 0 A again.
    async fn inject(&mut self, relays: &[Relay], only: Option<&[bool]>) -> Result<Row, ProbeError> {
        self.close(relays).await?;
        // what the last injection latched is not this one's
        self.rig.source.in_compliance().await?;
        self.drive(self.asked.plan.current).await?;
        tokio::time::sleep(self.asked.settle).await;
        let mut row = Row {
            compliance: self.rig.source.in_compliance().await?,
            volts: vec![None; self.asked.plan.wiring.measure.len()],
        };
        if !row.compliance {
            row.volts = self.read_pairs(only).await?;
        }
        self.drive(Amps(0.0)).await?;
        self.open(relays).await?;
        Ok(row)
    }

    /// Reads every measuring pair, or those `only`.
    async fn read_pairs(&mut self, only: Option<&[bool]>) -> Result<Vec<Option<f64>>, ProbeError> {
        let wiring = &self.asked.plan.wiring;
        if wiring.sensing == Sensing::Scan {
            let scanned = self.guarded_scan().await?;
            return Ok(scanned.into_iter().map(volts).collect());
        }
        let mut read = Vec::new();
        for (pair, (_, relays)) in wiring.measure.iter().enumerate() {
            if only.is_some_and(|only| !only[pair]) {
                read.push(None);
                continue;
            }
            self.close(relays).await?;
            let reading = self.guarded_read().await?;
            self.open(relays).await?;
            read.push(volts(reading));
        }
        Ok(read)
    }

    /// A reading may take long; the source's own wire is free, and a stop switches it off at once.
    async fn guarded_scan(&mut self) -> Result<Vec<Reading>, ProbeError> {
        let mut stop = self.asked.stop.clone();
        let mut reading = pin!(self.rig.voltmeter.scan());
        tokio::select! {
            read = &mut reading => Ok(read?),
            () = stop.asked() => {
                self.rig.source.off().await?;
                reading.await?;
                Err(ProbeError::Stopped)
            }
        }
    }

    async fn guarded_read(&mut self) -> Result<Reading, ProbeError> {
        let mut stop = self.asked.stop.clone();
        let mut reading = pin!(self.rig.voltmeter.read());
        tokio::select! {
            read = &mut reading => Ok(read?),
            () = stop.asked() => {
                self.rig.source.off().await?;
                reading.await?;
                Err(ProbeError::Stopped)
            }
        }
    }

    /// The same readings several times over, with the current through this pair.
    async fn repeat(&mut self, pair: usize) -> Result<Vec<Vec<Option<f64>>>, ProbeError> {
        let wiring = &self.asked.plan.wiring;
        let (_, relays) = &wiring.inject[pair];
        self.close(relays).await?;
        self.drive(self.asked.plan.current).await?;
        tokio::time::sleep(self.asked.settle).await;
        // far from the driven pair, where no range overflows
        let mut only = vec![false; wiring.measure.len()];
        let far = (pair + only.len() / 2) % only.len();
        only[far] = true;
        let mut repeats = Vec::new();
        for _ in 0..REPEATS {
            repeats.push(self.read_pairs(Some(&only)).await?);
        }
        self.drive(Amps(0.0)).await?;
        self.open(relays).await?;
        Ok(repeats)
    }

    /// Which relay of two does not close, for pairs that carry no current although their neighbours do.
    async fn retry(&mut self, raw: &Raw) -> Result<Vec<Retry>, ProbeError> {
        let inject = &self.asked.plan.wiring.inject;
        let n = inject.len();
        let mut retries = Vec::new();
        for (pair, (_, relays)) in inject.iter().enumerate() {
            let fails = |pair: usize| raw.rows[pair % n].compliance;
            let [plus, minus] = relays.as_slice() else {
                continue;
            };
            let other = (pair + 2) % n;
            if !fails(pair) || fails(pair + 1) || fails(pair + n - 1) || fails(other) {
                continue;
            }
            let [other_plus, other_minus] = inject[other].1.as_slice() else {
                continue;
            };
            for (relay, with) in [(*plus, *other_minus), (*minus, *other_plus)] {
                let row = self.inject(&[relay, with], Some(&vec![false; n])).await?;
                retries.push(Retry {
                    pair,
                    relay,
                    flows: !row.compliance,
                });
            }
        }
        Ok(retries)
    }

    /// Which measuring relay of two does not close, for pairs that read nothing of any injection.
    async fn retry_meter(&mut self, raw: &Raw) -> Result<Vec<Retry>, ProbeError> {
        let wiring = &self.asked.plan.wiring;
        let n = wiring.measure.len();
        let most = |pair: usize| {
            let read = raw.rows.iter().filter_map(|row| row.volts[pair]);
            read.fold(0.0_f64, |most, volts| most.max(volts.abs()))
        };
        let mut each: Vec<f64> = (0..n).map(most).collect();
        each.sort_by(f64::total_cmp);
        let silent = 1e-3 * each.get(n / 2).copied().unwrap_or(0.0);
        let mut retries = Vec::new();
        for (pair, (_, relays)) in wiring.measure.iter().enumerate() {
            let other = (pair + 2) % n;
            let drive = (pair + n / 2) % n;
            if most(pair) >= silent || most(other) < silent || raw.rows[drive].compliance {
                continue;
            }
            let ([plus, minus], [other_plus, other_minus]) =
                (relays.as_slice(), wiring.measure[other].1.as_slice())
            else {
                continue;
            };
            for (relay, with) in [(*plus, *other_minus), (*minus, *other_plus)] {
                let closed = [relay, with];
                self.close(&closed).await?;
                let driven = &wiring.inject[drive].1;
                let follows = self.follows(driven).await?;
                self.open(&closed).await?;
                retries.push(Retry {
                    pair,
                    relay,
                    flows: follows.is_some_and(|volts| volts.abs() > silent),
                });
            }
        }
        Ok(retries)
    }

    /// What follows the current at the voltmeter: a voltmeter joined to nothing shows anything.
    async fn follows(&mut self, driven: &[Relay]) -> Result<Option<f64>, ProbeError> {
        self.close(driven).await?;
        let still = volts(self.guarded_read().await?);
        self.drive(self.asked.plan.current).await?;
        tokio::time::sleep(self.asked.settle).await;
        let read = volts(self.guarded_read().await?);
        self.drive(Amps(0.0)).await?;
        self.open(driven).await?;
        Ok(read.zip(still).map(|(read, still)| read - still))
    }

    /// What the voltmeter sees of each injection with these measuring relays closed and no other.
    async fn lone_meter(&mut self, closed: &[Relay]) -> Result<Row, ProbeError> {
        self.close(closed).await?;
        let mut row = Row::default();
        for (_, relays) in &self.asked.plan.wiring.inject {
            row.volts.push(self.follows(relays).await?);
        }
        self.open(closed).await?;
        Ok(row)
    }
}

fn volts(reading: Reading) -> Option<f64> {
    reading.volts().map(|volts| volts.0)
}

/// What is closed to find relays that should be open: nothing where a pair has one relay; where it has two, each side
/// alone, on two electrodes far apart.
fn lone(pairs: &[(survey::Dipole, Vec<Relay>)]) -> Vec<Vec<Relay>> {
    match pairs.first().map(|(_, relays)| relays.len()) {
        Some(2) => {
            let far = [0, pairs.len() / 2];
            let sides = [1, 0].into_iter();
            sides
                .flat_map(|side| far.map(|pair| vec![pairs[pair].1[side]]))
                .collect()
        }
        _ => vec![Vec::new()],
    }
}
