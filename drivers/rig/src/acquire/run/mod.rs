//! One run of a plan: sends each step to its instrument, and assigns the replies.

mod answers;
mod concurrent;

use std::time::Duration;

use survey::{Amps, Channel, Dipole, Electrode, Extra, Plan, Reading, Relay, Routed, Step, Volts};
use tokio::sync::watch;
use tokio::time::Instant;

use super::EndReason;
use super::injection::{InjectionReport, ends_before};
use crate::acquire::run::concurrent::{PendingExchange, interrupted};
use crate::prepare::prepare;
use crate::safe::open_checked;
use crate::traits::Instruments;
use crate::{
    ChainedReading, Compliance, CurrentSource, MeterSettings, Move, RigError, Sample, Stop, Switch,
    Voltmeter,
};

/// Delay between a scan message that also moves relays and the query of the source's compliance: longer than the
/// transmission and the slowest relays.
const RELAY_MOVE_TIME: Duration = Duration::from_millis(20);

/// The longest settling time left to a scan: unlike a wait here, it cannot be interrupted by a stop.
const LONGEST_SCAN_WAIT: Duration = Duration::from_secs(1);

/// The present injection: its pair, polarity and relays.
#[derive(Debug, Default)]
struct DriveState {
    now: Option<Dipole>,
    /// Injection applied after the last compliance query; its compliance state is not yet known.
    unqueried: Option<Dipole>,
    /// Whether the polarity is reversed.
    reversed: bool,
    /// Whether the injecting relays are known to have settled.
    settled: bool,
    /// Injecting relays that should be closed now.
    relays: Vec<Relay>,
    /// The injection that has not been reported yet, its start, and the time of its last reading.
    unreported: Option<(Dipole, Instant, Instant)>,
    /// Whether the source was in compliance during this injection.
    compliance: bool,
}

/// One run of a plan.
pub(super) struct Run<'a> {
    plan: &'a Plan,
    meter: MeterSettings,
    stop: Stop,
    /// Closed when the caller has dropped its future.
    caller: watch::Receiver<()>,
    pub(super) readings: Vec<Reading>,
    pub(super) extra: Vec<Extra>,
    pub(super) compliance: Vec<Electrode>,
    driven: DriveState,
    report: Option<InjectionReport>,
    /// The source's current as last set or read back; unknown at first.
    level: Option<Amps>,
    on: bool,
    /// Wait before the first reading of the next scan.
    wait: Duration,
    /// How long switching off took, if it was done during a reading.
    pub(super) off_after: Option<Duration>,
}

impl<'a> Run<'a> {
    pub(super) fn new(
        plan: &'a Plan,
        meter: MeterSettings,
        stop: Stop,
        caller: watch::Receiver<()>,
        report: Option<InjectionReport>,
    ) -> Self {
        Self {
            plan,
            meter,
            stop,
            caller,
            readings: vec![Reading::NotMeasured; plan.protocol.len()],
            extra: Vec::new(),
            compliance: Vec::new(),
            driven: DriveState::default(),
            report,
            level: None,
            on: false,
            wait: Duration::ZERO,
            off_after: None,
        }
    }

    pub(super) async fn run_steps<C, W, V>(
        &mut self,
        rig: &mut Instruments<C, W, V>,
    ) -> Result<(), EndReason>
    where
        C: CurrentSource,
        W: Switch,
        V: Voltmeter,
    {
        if self.must_end() {
            return Err(EndReason::Stop(1));
        }
        prepare(rig, self.plan, self.meter)
            .await
            .map_err(EndReason::Prepare)?;
        // `prepare` has just read back 0 A
        self.level = Some(Amps(0.0));
        let plan = self.plan;
        let mut steps = plan.steps.iter().enumerate().peekable();
        while let Some((index, step)) = steps.next() {
            if self.must_end() {
                return Err(EndReason::Stop(index + 1));
            }
            // A scan can wait by itself, in the message that moves the relays.
            if let Step::Settle { wait } = step
                && *wait <= LONGEST_SCAN_WAIT
                && matches!(steps.peek(), Some((_, Step::Scan { .. })))
            {
                self.wait = *wait;
                continue;
            }
            // The source can be queried while the voltmeter reads.
            let compliance_step =
                steps.next_if(|(_, next)| step.reads() && matches!(next, Step::Compliance { .. }));
            let done = match compliance_step {
                Some(_) => self.read(rig, step, true).await,
                None => self.step(rig, step).await,
            };
            done.map_err(|cause| EndReason::Step(index + 1, step.clone(), cause))?;
            if ends_before(steps.peek().map(|(_, next)| *next))
                && let Some((drive, from, to)) = self.driven.unreported.take()
                && let Some(report) = &self.report
            {
                let compliance = self.driven.compliance;
                report.ended(plan, drive, &self.readings, (from, to), compliance);
            }
        }
        Ok(())
    }

    fn must_end(&self) -> bool {
        self.stop.is_requested() || self.caller.has_changed().is_err()
    }

    async fn step<C, W, V>(
        &mut self,
        rig: &mut Instruments<C, W, V>,
        step: &Step,
    ) -> Result<(), RigError>
    where
        C: CurrentSource,
        W: Switch,
        V: Voltmeter,
    {
        match step {
            Step::AllOff => {
                if self.on || self.level != Some(Amps(0.0)) {
                    self.off(&mut rig.source).await?;
                }
                if self.driven.unqueried.is_some() {
                    self.driven.now = None;
                    let compliance = rig.source.compliance().await?;
                    self.invalidate_by_compliance(compliance, true);
                }
                let driven = std::mem::take(&mut self.driven.relays);
                let wiring = &self.plan.wiring;
                match driven.is_empty() {
                    true => rig.switch.open_verified(&wiring.relays()).await,
                    false => open_checked(&mut rig.switch, wiring, &driven).await,
                }
            }
            Step::Bus { close } => rig.switch.move_relays(&[Move::Close(close.clone())]).await,
            Step::Break { open, close, drive } => {
                self.drive(rig, Amps(0.0)).await?;
                rig.switch.move_relays(&moves(open, close)).await?;
                rig.switch.settle().await?;
                self.set_drive(*drive, close, true);
                self.switch_on(rig).await
            }
            Step::Overlap { open, close, drive } => {
                // a source that is off (at first, or because of compliance) is switched on only after the relays of the
                // next pair have settled
                let settled = !self.on;
                self.set_drive(*drive, close, settled);
                let close = Move::Close(close.clone());
                let open = Move::Open(open.clone());
                rig.switch.move_relays(&[close, open]).await?;
                if settled {
                    rig.switch.settle().await?;
                }
                self.switch_on(rig).await
            }
            Step::Reverse { .. } => {
                self.driven.reversed = true;
                self.switch_on(rig).await
            }
            Step::Settle { wait } => {
                rig.switch.settle().await?;
                self.driven.settled = true;
                tokio::select! {
                    () = tokio::time::sleep(*wait) => {}
                    () = self.stop.requested() => {}
                }
                Ok(())
            }
            Step::Route { open, close, .. } => rig.switch.move_relays(&moves(open, close)).await,
            Step::Scan { .. } | Step::Read { .. } | Step::Chain { .. } => {
                self.read(rig, step, false).await
            }
            Step::Compliance { .. } => {
                let compliance = rig.source.compliance().await?;
                if compliance.occurred() {
                    // the next injection switches the source on again
                    self.off(&mut rig.source).await?;
                }
                self.invalidate_by_compliance(compliance, true);
                Ok(())
            }
        }
    }

    /// Switches the source off and verifies by read-back.
    async fn off<C: CurrentSource>(&mut self, source: &mut C) -> Result<(), RigError> {
        (self.level, self.on) = (None, false);
        source.off().await?;
        self.level = Some(Amps(0.0));
        Ok(())
    }

    /// Takes the readings of a step, which may take minutes. The source's connection is free meanwhile: with `ask` its
    /// compliance is queried. In compliance, or on a stop request, the source is switched off at once; readings after a
    /// stop are discarded with the frame.
    ///
    /// Relays that move in the message of the readings get [`RELAY_MOVE_TIME`] before the source is queried. If they
    /// need longer, the compliance reported may be that of the previous injection: then both injections are
    /// invalidated.
    async fn read<C: CurrentSource, W, V: Voltmeter>(
        &mut self,
        rig: &mut Instruments<C, W, V>,
        step: &Step,
        ask: bool,
    ) -> Result<(), RigError> {
        let wait = std::mem::take(&mut self.wait);
        let reading = std::pin::pin!(ask_voltmeter(&mut rig.voltmeter, step, self.meter, wait));
        let mut reading = PendingExchange::new(reading);
        let source = &mut rig.source;
        let mut compliance = None;
        let mut settled = self.driven.settled;
        let mut must_end = false;
        if ask && !settled {
            let interrupted = interrupted(self.stop.clone(), self.caller.clone());
            let moved =
                tokio::time::timeout(RELAY_MOVE_TIME, reading.completes_before(interrupted)).await;
            (settled, must_end) = (moved == Ok(Some(())), moved == Ok(None));
        }
        if ask && !must_end {
            let reported = reading.wait_for(source.compliance()).await;
            let off = match &reported {
                Ok(reported) if reported.now => reading.wait_for(self.off(source)).await,
                _ => Ok(()),
            };
            compliance = Some(off.and(reported));
        }
        if !matches!(compliance, Some(Err(_))) {
            let interrupted = interrupted(self.stop.clone(), self.caller.clone());
            if reading.completes_before(interrupted).await.is_none() {
                let detected = Instant::now();
                let off = reading.wait_for(self.off(source)).await;
                self.off_after = off.is_ok().then(|| detected.elapsed());
                compliance = Some(off.and(compliance.unwrap_or(Ok(Compliance::default()))));
            }
        }
        // Finished in any case: an interrupted exchange would leave the voltmeter's link unsynchronised.
        let answer = reading.finish().await;
        let compliance = compliance.transpose()?;
        self.take(step, answer?)?;
        if let Some(compliance) = compliance {
            self.invalidate_by_compliance(compliance, settled);
            self.driven.unqueried = self.driven.now.filter(|_| self.on);
        }
        Ok(())
    }

    fn set_drive(&mut self, drive: Dipole, relays: &[Relay], settled: bool) {
        let now = Instant::now();
        self.driven = DriveState {
            now: Some(drive),
            unqueried: self.driven.unqueried,
            reversed: false,
            settled,
            relays: relays.to_vec(),
            unreported: Some((drive, now, now)),
            compliance: false,
        };
    }

    /// Switches the source on at the plan's current, negative if the polarity is reversed.
    async fn switch_on<C: CurrentSource, W, V>(
        &mut self,
        rig: &mut Instruments<C, W, V>,
    ) -> Result<(), RigError> {
        let level = match (self.plan.zero, self.driven.reversed) {
            (true, _) => Amps(0.0),
            (false, false) => self.plan.current,
            (false, true) => -self.plan.current,
        };
        if self.on {
            return self.drive(rig, level).await;
        }
        // The output is switched on at 0 A, never at a level.
        self.drive(rig, Amps(0.0)).await?;
        rig.source.switch_on(level).await?;
        (self.level, self.on) = (Some(level), true);
        Ok(())
    }

    /// Sets the source's current; skips commands that change nothing.
    async fn drive<C: CurrentSource, W, V>(
        &mut self,
        rig: &mut Instruments<C, W, V>,
        level: Amps,
    ) -> Result<(), RigError> {
        if self.level != Some(level) {
            rig.source.set_current(level).await?;
            self.level = Some(level);
        }
        Ok(())
    }
}

/// Requests the readings of a step from the voltmeter.
async fn ask_voltmeter<V: Voltmeter>(
    voltmeter: &mut V,
    step: &Step,
    meter: MeterSettings,
    wait: Duration,
) -> Result<Vec<Reading>, RigError> {
    let on = |range: &Option<Volts>| range.unwrap_or(meter.range);
    match step {
        Step::Scan { channels } => {
            let sample = |channel: &Channel| Sample {
                relay: channel.relay,
                range: on(&channel.range),
                wait: Duration::ZERO,
            };
            let mut channels: Vec<Sample> = channels.iter().map(sample).collect();
            // The voltmeter scans in ascending order: the wait belongs to the lowest channel.
            let first = channels.iter_mut().min_by_key(|sample| sample.relay);
            if let Some(first) = first {
                first.wait = wait;
            }
            voltmeter.scan_on(&channels).await
        }
        Step::Chain { routes } => {
            let one = |route: &Routed| ChainedReading {
                moves: moves(&route.open, &route.close),
                range: on(&route.range),
            };
            let chained: Vec<ChainedReading> = routes.iter().map(one).collect();
            voltmeter.chain(&chained).await
        }
        Step::Read { range, .. } => Ok(vec![voltmeter.read_on(on(range)).await?]),
        _ => Ok(Vec::new()),
    }
}

/// The moves that open and then close these relays; none for an empty list.
fn moves(open: &[Relay], close: &[Relay]) -> Vec<Move> {
    let open = (!open.is_empty()).then(|| Move::Open(open.to_vec()));
    let close = (!close.is_empty()).then(|| Move::Close(close.to_vec()));
    open.into_iter().chain(close).collect()
}
