//! The measurements of a self-test: relays one by one, all readings, no assessment.

use std::pin::pin;
use std::time::Duration;

use rig::{CurrentSource, Instruments, MeterSettings, Move, RigError, Stop, Switch, Voltmeter};
use survey::{Amps, Plan, Reading, Relay, Sensing, Volts};

mod faults;

use faults::partly_closed;

/// Number of scans or single readings for the noise.
const REPEATS: usize = 8;

/// Settings of a self-test.
pub struct Request<'a> {
    /// The plan whose wiring is tested, with its current and compliance.
    pub plan: &'a Plan,
    /// The voltmeter's settings for the plan.
    pub meter: MeterSettings,
    /// A range of the voltmeter that covers the source's voltage limit.
    pub wide: Volts,
    /// Relays that connect the scanned banks to the voltmeter. A scan closes them itself; for readings without a scan
    /// the self-test closes them.
    pub meter_relays: Vec<Relay>,
    /// Wait after a change of current.
    pub settle: Duration,
    /// Ends the probe early.
    pub stop: Stop,
    /// Called with the steps done, the number of steps, and a description of the present step.
    pub progress: &'a (dyn Fn(u64, u64, &str) + Send + Sync),
}

/// Why a probe ended early.
#[derive(Debug, thiserror::Error)]
pub enum ProbeError {
    /// A fault of an instrument or its connection.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// A stop was requested.
    #[error("the self-test was stopped")]
    Stopped,
}

/// One injection.
#[derive(Debug, Clone, Default)]
pub struct Row {
    /// The requested current did not flow.
    pub compliance: bool,
    /// Voltage of every measuring pair, V; `None` if it is over every range.
    pub volts: Vec<Option<f64>>,
}

/// Readings with some or none of the relays of a pair closed: no current or voltage is expected.
#[derive(Debug, Clone)]
pub struct PartlyClosed {
    /// The closed relays; none if a pair has one relay.
    pub closed: Vec<Relay>,
    /// The readings.
    pub row: Row,
}

/// A retry of a faulty pair, with a relay of another pair in place of one of its own.
#[derive(Debug, Clone)]
pub struct Retry {
    /// The pair, from 0.
    pub pair: usize,
    /// The pair's own relay in this retry.
    pub relay: Relay,
    /// Whether current flowed.
    pub flows: bool,
}

/// All measurements.
#[derive(Debug, Clone, Default)]
pub struct Measured {
    /// One row for each injecting pair.
    pub rows: Vec<Row>,
    /// Rows with only part of a pair's injecting relays closed, or none: any current flows through relays that should
    /// be open.
    pub lone_sources: Vec<PartlyClosed>,
    /// Rows with only part of a pair's measuring relays closed, or none: the voltage of each injection minus that at 0
    /// A.
    pub lone_meters: Vec<PartlyClosed>,
    /// Retries of pairs that carried no current.
    pub retries: Vec<Retry>,
    /// Retries of measuring pairs that read nothing; `flows` tells whether a voltage was read.
    pub meter_retries: Vec<Retry>,
    /// Repetitions of the same readings with current, one row each, V.
    pub repeats: Vec<Vec<Option<f64>>>,
    /// Repeated readings of every measuring pair at 0 A, one row each, V. They do not contain the noise of the current
    /// and of its path.
    pub zero: Vec<Vec<Option<f64>>>,
}

/// Takes all readings that an assessment needs. The caller makes the rig safe afterwards, whatever the result.
///
/// # Errors
/// A fault of an instrument or its connection, or the request's stop.
pub async fn probe<C, W, V>(
    rig: &mut Instruments<C, W, V>,
    request: &Request<'_>,
) -> Result<Measured, ProbeError>
where
    C: CurrentSource,
    W: Switch,
    V: Voltmeter,
{
    let pairs = request.plan.wiring.inject.len() as u64;
    let mut probe = Probe {
        rig,
        request,
        wide: MeterSettings {
            range: request.wide,
            ..request.meter
        },
        on: false,
        done: 0,
        steps: 4 * pairs + REPEATS as u64,
    };
    probe.run().await
}

struct Probe<'a, 'b, C, W, V> {
    rig: &'a mut Instruments<C, W, V>,
    request: &'a Request<'b>,
    wide: MeterSettings,
    on: bool,
    done: u64,
    steps: u64,
}

impl<C: CurrentSource, W: Switch, V: Voltmeter> Probe<'_, '_, C, W, V> {
    async fn run(&mut self) -> Result<Measured, ProbeError> {
        let plan = self.request.plan;
        let wiring = &plan.wiring;
        self.rig
            .source
            .prepare(plan.current, plan.compliance)
            .await?;
        // no relay moves while an injection settles and is read, at 0 A too in some tests
        let silence = self.request.settle + self.request.meter.deadline.unwrap_or_default() * 2;
        self.rig.switch.prepare_for_silence(silence).await?;
        let mut raw = Measured::default();
        self.prepare(self.request.meter).await?;
        // the first preparation resets the instrument, which opens every relay
        self.close(&wiring.bus).await?;
        for (pair, (_, relays)) in wiring.inject.iter().enumerate() {
            self.report(&format!("injecting pair {}", pair + 1))?;
            let row = self.inject(relays, None).await?;
            raw.rows.push(row);
        }
        if let Some(flows) = raw.rows.iter().position(|row| !row.compliance) {
            raw.repeats = self.repeat(flows).await?;
        }
        for scan in 0..REPEATS {
            self.report(&format!("noise at 0 A, {} of {REPEATS}", scan + 1))?;
            raw.zero.push(self.read_pairs(None).await?);
        }
        self.prepare(self.wide).await?;
        for (pair, (_, relays)) in wiring.inject.iter().enumerate() {
            self.report(&format!("pair {} on the wide range", pair + 1))?;
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
        for closed in partly_closed(&wiring.inject) {
            self.report("injecting relays that should be open")?;
            let row = self.inject(&closed, None).await?;
            raw.lone_sources.push(PartlyClosed { closed, row });
        }
        raw.retries = self.retry(&raw).await?;
        self.rig.voltmeter.prepare(self.wide, &[]).await?;
        self.close(&self.request.meter_relays).await?;
        for closed in partly_closed(&wiring.measure) {
            self.report("measuring relays that should be open")?;
            let row = self.read_partly_closed(&closed).await?;
            raw.lone_meters.push(PartlyClosed { closed, row });
        }
        self.open(&self.request.meter_relays).await?;
        raw.meter_retries = self.retry_meter(&raw).await?;
        self.done = self.steps;
        self.report("done")?;
        Ok(raw)
    }

    /// Reports the next step; fails if a stop was requested.
    fn report(&mut self, what: &str) -> Result<(), ProbeError> {
        (self.request.progress)(self.done.min(self.steps), self.steps, what);
        self.done += 1;
        match self.request.stop.is_requested() {
            true => Err(ProbeError::Stopped),
            false => Ok(()),
        }
    }

    async fn prepare(&mut self, meter: MeterSettings) -> Result<(), RigError> {
        let wiring = &self.request.plan.wiring;
        let scan = wiring.scanned_channels();
        self.rig.voltmeter.prepare(meter, &scan).await
    }

    async fn close(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        self.moved(relays, Move::Close).await
    }

    async fn open(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        self.moved(relays, Move::Open).await
    }

    async fn moved(
        &mut self,
        relays: &[Relay],
        direction: fn(Vec<Relay>) -> Move,
    ) -> Result<(), RigError> {
        if relays.is_empty() {
            return Ok(());
        }
        let switch = &mut self.rig.switch;
        switch.move_relays(&[direction(relays.to_vec())]).await?;
        switch.settle().await
    }

    /// Sets the current. The output is switched on at 0 A, never at a level.
    async fn drive(&mut self, level: Amps) -> Result<(), RigError> {
        if !self.on {
            self.rig.source.set_current(Amps(0.0)).await?;
            self.rig.source.set_output(true).await?;
            self.on = true;
        }
        self.rig.source.set_current(level).await
    }

    /// Closes relays at 0 A, applies the current, reads as [`Probe::read_pairs`], and opens the relays at 0 A again.
    async fn inject(&mut self, relays: &[Relay], only: Option<&[bool]>) -> Result<Row, ProbeError> {
        self.close(relays).await?;
        // clears compliance latched by the last injection
        self.rig.source.in_compliance().await?;
        self.drive(self.request.plan.current).await?;
        tokio::time::sleep(self.request.settle).await;
        let mut row = Row {
            compliance: self.rig.source.in_compliance().await?,
            volts: vec![None; self.request.plan.wiring.measure.len()],
        };
        if !row.compliance {
            row.volts = self.read_pairs(only).await?;
        }
        self.drive(Amps(0.0)).await?;
        self.open(relays).await?;
        Ok(row)
    }

    /// Reads every measuring pair, or those in `only` (a scan always reads all).
    async fn read_pairs(&mut self, only: Option<&[bool]>) -> Result<Vec<Option<f64>>, ProbeError> {
        let wiring = &self.request.plan.wiring;
        if wiring.sensing == Sensing::Scan {
            let scan = self.rig.voltmeter.scan();
            let scanned = interruptible(&self.request.stop, &mut self.rig.source, scan).await?;
            return Ok(scanned.into_iter().map(volts).collect());
        }
        let mut read = Vec::new();
        for (pair, (_, relays)) in wiring.measure.iter().enumerate() {
            if only.is_some_and(|only| !only[pair]) {
                read.push(None);
                continue;
            }
            self.close(relays).await?;
            let reading = self.interruptible_read().await?;
            self.open(relays).await?;
            read.push(volts(reading));
        }
        Ok(read)
    }

    async fn interruptible_read(&mut self) -> Result<Reading, ProbeError> {
        let reading = self.rig.voltmeter.read();
        interruptible(&self.request.stop, &mut self.rig.source, reading).await
    }

    /// Repeats the same readings with the current through this pair.
    async fn repeat(&mut self, pair: usize) -> Result<Vec<Vec<Option<f64>>>, ProbeError> {
        let wiring = &self.request.plan.wiring;
        let (_, relays) = &wiring.inject[pair];
        self.close(relays).await?;
        self.drive(self.request.plan.current).await?;
        tokio::time::sleep(self.request.settle).await;
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
}

/// Waits for a reading, which may take long. On a stop request the source, which has its own connection, is switched
/// off at once.
async fn interruptible<T>(
    stop: &Stop,
    source: &mut impl CurrentSource,
    reading: impl Future<Output = Result<T, RigError>>,
) -> Result<T, ProbeError> {
    let mut stop = stop.clone();
    let mut reading = pin!(reading);
    tokio::select! {
        read = &mut reading => Ok(read?),
        () = stop.requested() => {
            source.off().await?;
            reading.await?;
            Err(ProbeError::Stopped)
        }
    }
}

fn volts(reading: Reading) -> Option<f64> {
    reading.volts().map(|volts| volts.0)
}
