//! One run of a plan: which step asks whom, and where each answer belongs.

use std::pin::Pin;
use std::time::Duration;

use survey::{
    Amps, Channel, Dipole, Electrode, Extra, Measurement, Plan, Reading, Relay, Routed, Step, Volts,
};
use tokio::sync::watch;
use tokio::time::Instant;

use super::Cut;
use crate::prepare::apply;
use crate::safe::{check_driven, every_relay};
use crate::seams::Instruments;
use crate::{
    Compliance, CurrentSource, Hop, MeterSettings, Move, RigError, Sample, Stop, Switch, Voltmeter,
};

/// Where the current goes, and which way.
#[derive(Debug, Default)]
struct Driven {
    now: Option<Dipole>,
    /// An injection that went on after the source had been asked about it.
    unwatched: Option<Dipole>,
    /// Against the plan's direction.
    turned: bool,
    /// Whether the injecting relays are known to have moved.
    settled: bool,
    /// Injecting relays that are to be closed now.
    relays: Vec<Relay>,
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
    driven: Driven,
    /// The source's level as last set; unknown at first.
    level: Option<Amps>,
    on: bool,
    /// How long switching off took, where it was done while a reading was under way.
    pub(super) off_after: Option<Duration>,
}

impl<'a> Run<'a> {
    pub(super) fn new(
        plan: &'a Plan,
        meter: MeterSettings,
        stop: Stop,
        caller: watch::Receiver<()>,
    ) -> Self {
        Self {
            plan,
            meter,
            stop,
            caller,
            readings: vec![Reading::NotMeasured; plan.protocol.len()],
            extra: Vec::new(),
            compliance: Vec::new(),
            driven: Driven::default(),
            level: None,
            on: false,
            off_after: None,
        }
    }

    pub(super) async fn every_step<C, W, V>(
        &mut self,
        rig: &mut Instruments<C, W, V>,
    ) -> Result<(), Cut>
    where
        C: CurrentSource,
        W: Switch,
        V: Voltmeter,
    {
        if self.is_over() {
            return Err(Cut::Stop(1));
        }
        apply(rig, self.plan, self.meter)
            .await
            .map_err(Cut::Prepare)?;
        let plan = self.plan;
        let mut steps = plan.steps.iter().enumerate().peekable();
        while let Some((index, step)) = steps.next() {
            if self.is_over() {
                return Err(Cut::Stop(index + 1));
            }
            // While the voltmeter reads the source can be asked, once it is certain that its relays have moved.
            let beside = steps.next_if(|(_, next)| {
                step.reads() && self.driven.settled && matches!(next, Step::Compliance { .. })
            });
            let done = match beside {
                Some(_) => self.read(rig, step, true).await,
                None => self.step(rig, step).await,
            };
            done.map_err(|cause| Cut::Step(index + 1, step.clone(), cause))?;
        }
        Ok(())
    }

    fn is_over(&self) -> bool {
        self.stop.is_asked() || self.caller.has_changed().is_err()
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
                self.off(&mut rig.source).await?;
                if self.driven.unwatched.is_some() {
                    self.driven.now = None;
                    let asked = rig.source.compliance().await?;
                    self.heed(asked);
                }
                let driven = std::mem::take(&mut self.driven.relays);
                if !driven.is_empty() {
                    check_driven(&mut rig.switch, &self.plan.wiring, &driven).await?;
                }
                rig.switch
                    .open_verified(&every_relay(&self.plan.wiring))
                    .await
            }
            Step::Bus { close } => rig.switch.move_relays(&[Move::Close(close.clone())]).await,
            Step::Break { open, close, drive } => {
                self.drive(rig, Amps(0.0)).await?;
                rig.switch.move_relays(&moves(open, close)).await?;
                rig.switch.settle().await?;
                self.moved_to(*drive, close, true);
                self.switch_on(rig).await
            }
            Step::Overlap { open, close, drive } => {
                // switched off in compliance, it goes on again only when its pair is there
                let settled = !self.on;
                self.moved_to(*drive, close, settled);
                let close = Move::Close(close.clone());
                let open = Move::Open(open.clone());
                rig.switch.move_relays(&[close, open]).await?;
                if settled {
                    rig.switch.settle().await?;
                }
                self.switch_on(rig).await
            }
            Step::Reverse { .. } => {
                self.driven.turned = true;
                self.switch_on(rig).await
            }
            Step::Settle { wait } => {
                rig.switch.settle().await?;
                self.driven.settled = true;
                tokio::select! {
                    () = tokio::time::sleep(*wait) => {}
                    () = self.stop.asked() => {}
                }
                Ok(())
            }
            Step::Route { open, close, .. } => rig.switch.move_relays(&moves(open, close)).await,
            Step::Scan { .. } | Step::Read { .. } | Step::Chain { .. } => {
                self.read(rig, step, false).await
            }
            Step::Compliance { .. } => {
                let asked = rig.source.compliance().await?;
                if asked.ever() {
                    // the next injection switches it on again
                    self.off(&mut rig.source).await?;
                }
                self.heed(asked);
                Ok(())
            }
        }
    }

    /// Switches the source off, read back.
    async fn off<C: CurrentSource>(&mut self, source: &mut C) -> Result<(), RigError> {
        (self.level, self.on) = (None, false);
        source.off().await
    }

    /// Waits for readings. They may take minutes, and the source's own wire is free meanwhile: it can be asked about its
    /// compliance, and is switched off at once when it says so, or when a stop is asked for; what is read after a stop
    /// is thrown away with the frame.
    async fn read<C: CurrentSource, W, V: Voltmeter>(
        &mut self,
        rig: &mut Instruments<C, W, V>,
        step: &Step,
        ask: bool,
    ) -> Result<(), RigError> {
        let reading = std::pin::pin!(ask_voltmeter(&mut rig.voltmeter, step, self.meter));
        let mut reading = Beside::new(reading);
        let source = &mut rig.source;
        let mut asked = None;
        if ask {
            let told = reading.wait_for(source.compliance()).await;
            let off = match &told {
                Ok(told) if told.now => reading.wait_for(self.off(source)).await,
                _ => Ok(()),
            };
            asked = Some(off.and(told));
        }
        if !matches!(asked, Some(Err(_))) {
            let over = over(self.stop.clone(), self.caller.clone());
            if reading.came_before(over).await.is_none() {
                let detected = Instant::now();
                let off = reading.wait_for(self.off(source)).await;
                self.off_after = off.is_ok().then(|| detected.elapsed());
                asked = Some(off.and(asked.unwrap_or(Ok(Compliance::default()))));
            }
        }
        // Whatever else went wrong: half an exchange would leave the voltmeter's link out of step.
        let answer = reading.finish().await;
        let asked = asked.transpose()?;
        self.take(step, answer?)?;
        if let Some(asked) = asked {
            self.heed(asked);
            self.driven.unwatched = self.driven.now.filter(|_| self.on);
        }
        Ok(())
    }

    fn moved_to(&mut self, drive: Dipole, relays: &[Relay], settled: bool) {
        self.driven = Driven {
            now: Some(drive),
            unwatched: self.driven.unwatched,
            turned: false,
            settled,
            relays: relays.to_vec(),
        };
    }

    /// Puts readings in their places; those of the second direction become half differences.
    fn take(&mut self, step: &Step, came: Vec<Reading>) -> Result<(), RigError> {
        let counted = |expected: usize| match came.len() {
            came if came == expected => Ok(()),
            came => Err(RigError::ReadingCount { came, expected }),
        };
        match step {
            Step::Scan { channels } => {
                counted(channels.len())?;
                for (channel, reading) in channels.iter().zip(came) {
                    match (channel.reading, self.driven.now) {
                        (Some(index), _) => self.put(index, reading),
                        (None, Some(drive)) => self.put_beside(drive, channel.sense, reading),
                        (None, None) => {}
                    }
                }
            }
            Step::Chain { routes } => {
                counted(routes.len())?;
                for (route, reading) in routes.iter().zip(came) {
                    self.put(route.reading, reading);
                }
            }
            Step::Read { reading, .. } => {
                counted(1)?;
                self.put(*reading, came[0]);
            }
            _ => {}
        }
        // An answer of the mainframe comes when its relays have moved.
        self.driven.settled = true;
        Ok(())
    }

    fn put(&mut self, index: usize, reading: Reading) {
        let place = &mut self.readings[index];
        *place = match self.driven.turned {
            true => half_difference(*place, reading),
            false => reading,
        };
    }

    fn put_beside(&mut self, drive: Dipole, sense: Dipole, reading: Reading) {
        let question = Measurement { drive, sense };
        if !self.driven.turned {
            self.extra.push(Extra { question, reading });
            return;
        }
        let forward = self.extra.iter_mut().find(|one| one.question == question);
        if let Some(forward) = forward {
            forward.reading = half_difference(forward.reading, reading);
        }
    }

    /// Voids the injections at which the source was in compliance. What began since the last question and is over may
    /// have come while the last injection was still being read: then that one is void, too.
    fn heed(&mut self, asked: Compliance) {
        let here = self.driven.now.filter(|_| asked.ever());
        let unwatched = self.driven.unwatched.take();
        let before = unwatched.filter(|_| asked.since && !asked.now);
        for drive in here.into_iter().chain(before) {
            if !self.compliance.contains(&drive.plus) {
                self.compliance.push(drive.plus);
            }
            let questions = self.plan.protocol.measurements().iter();
            for (question, reading) in questions.zip(&mut self.readings) {
                if question.drive == drive {
                    *reading = Reading::NotMeasured;
                }
            }
            for extra in &mut self.extra {
                if extra.question.drive == drive {
                    extra.reading = Reading::NotMeasured;
                }
            }
        }
    }

    /// On at the plan's current, in the direction that is its turn.
    async fn switch_on<C: CurrentSource, W, V>(
        &mut self,
        rig: &mut Instruments<C, W, V>,
    ) -> Result<(), RigError> {
        let level = match (self.plan.zero, self.driven.turned) {
            (true, _) => Amps(0.0),
            (false, false) => self.plan.current,
            (false, true) => -self.plan.current,
        };
        if self.level.is_none() {
            self.drive(rig, Amps(0.0)).await?;
        }
        // The output goes on at 0 A, never at a level.
        if !self.on {
            rig.source.set_output(true).await?;
            self.on = true;
        }
        self.drive(rig, level).await
    }

    /// Brings the source to a level, saying nothing that it was told before.
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

/// Asks the voltmeter what a step asks.
async fn ask_voltmeter<V: Voltmeter>(
    voltmeter: &mut V,
    step: &Step,
    meter: MeterSettings,
) -> Result<Vec<Reading>, RigError> {
    let on = |range: &Option<Volts>| range.unwrap_or(meter.range);
    match step {
        Step::Scan { channels } => {
            let sample = |channel: &Channel| Sample {
                relay: channel.relay,
                range: on(&channel.range),
            };
            let channels: Vec<Sample> = channels.iter().map(sample).collect();
            voltmeter.scan_on(&channels).await
        }
        Step::Chain { routes } => {
            let hop = |route: &Routed| Hop {
                moves: moves(&route.open, &route.close),
                range: on(&route.range),
            };
            let hops: Vec<Hop> = routes.iter().map(hop).collect();
            voltmeter.chain(&hops).await
        }
        Step::Read { range, .. } => Ok(vec![voltmeter.read_on(on(range)).await?]),
        _ => Ok(Vec::new()),
    }
}

/// Until a stop is asked for, or the caller has gone.
async fn over(mut stop: Stop, mut caller: watch::Receiver<()>) {
    tokio::select! {
        () = stop.asked() => {}
        // nothing is ever sent: only the caller's going away is heard
        _ = caller.changed() => {}
    }
}

/// An exchange under way, and its answer once it has come.
struct Beside<'a, F: Future> {
    exchange: Pin<&'a mut F>,
    answer: Option<F::Output>,
}

impl<'a, F: Future> Beside<'a, F> {
    fn new(exchange: Pin<&'a mut F>) -> Self {
        Self {
            exchange,
            answer: None,
        }
    }

    /// Waits for something else while the exchange goes on.
    async fn wait_for<T>(&mut self, other: impl Future<Output = T>) -> T {
        let mut other = std::pin::pin!(other);
        loop {
            tokio::select! {
                biased;
                done = &mut other => return done,
                came = self.exchange.as_mut(), if self.answer.is_none() => self.answer = Some(came),
            }
        }
    }

    /// Waits for the answer, or for something else; nothing where that was first.
    async fn came_before(&mut self, other: impl Future<Output = ()>) -> Option<()> {
        if self.answer.is_some() {
            return Some(());
        }
        tokio::select! {
            biased;
            came = self.exchange.as_mut() => self.answer = Some(came),
            () = other => return None,
        }
        Some(())
    }

    async fn finish(self) -> F::Output {
        match self.answer {
            Some(answer) => answer,
            None => self.exchange.await,
        }
    }
}

/// What turns with the current: half the difference of the two directions. What stays cancels.
fn half_difference(forward: Reading, backward: Reading) -> Reading {
    match (forward, backward) {
        (Reading::Ok(forward), Reading::Ok(backward)) => Reading::Ok((forward - backward) * 0.5),
        (Reading::Ok(_), lacking) => lacking,
        (lacking, _) => lacking,
    }
}

/// Open, then close; nothing for an empty list.
fn moves(open: &[Relay], close: &[Relay]) -> Vec<Move> {
    let open = (!open.is_empty()).then(|| Move::Open(open.to_vec()));
    let close = (!close.is_empty()).then(|| Move::Close(close.to_vec()));
    open.into_iter().chain(close).collect()
}
