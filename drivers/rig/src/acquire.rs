//! Runs a plan to a frame, and leaves the source off and verified on every way out.
//!
//! The plan runs in a task of its own that holds the instruments. A caller that drops its future only takes its wish
//! back: the task finishes the exchange under way (a message cut short would leave its link out of step, and then the
//! source could not be told to switch off), makes the rig safe, and lets go of it. A cleanup started from a `Drop` would
//! meet links out of step; this one does not.

use std::any::Any;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use survey::{Amps, Electrode, Frame, Plan, Reading, Relay, Settings, Step};
use tokio::sync::watch;
use tokio::time::Instant;

use crate::prepare::apply;
use crate::safe::{CleanupError, every_relay, make_safe};
use crate::seams::Instruments;
use crate::{Clock, CurrentSource, MeterSettings, Move, Rig, RigError, Stop, Switch, Voltmeter};

/// Why there is no frame. Every variant but the `Unsafe` ones leaves the source off and verified and the injecting
/// relays open. `off_after` is the time from the detection to the read-back that the source is off.
#[derive(Debug, thiserror::Error)]
pub enum AcquireError {
    /// Source or voltmeter could not be set up.
    #[error("the instruments could not be prepared for the survey")]
    Prepare {
        /// Why.
        #[source]
        cause: RigError,
        /// From detection to verified off.
        off_after: Duration,
    },
    /// They could not be set up, and the rig could not be made safe.
    #[error(
        "the instruments could not be prepared, and then the rig could not be made safe: {cleanup}"
    )]
    PrepareUnsafe {
        /// Why.
        #[source]
        cause: RigError,
        /// What could not be made safe.
        cleanup: CleanupError,
    },
    /// A step failed.
    #[error("step {number} of the survey failed ({step})")]
    Step {
        /// Counted from 1.
        number: usize,
        /// The step.
        step: Step,
        /// Why.
        #[source]
        cause: RigError,
        /// From detection to verified off.
        off_after: Duration,
    },
    /// A step failed, and the rig could not be made safe.
    #[error(
        "step {number} of the survey failed ({step}), and then the rig could not be made safe: {cleanup}"
    )]
    Unsafe {
        /// Counted from 1.
        number: usize,
        /// The step.
        step: Step,
        /// Why.
        #[source]
        cause: RigError,
        /// What could not be made safe.
        cleanup: CleanupError,
    },
    /// A stop was asked for, or the caller went away.
    #[error("the survey was stopped before step {number}")]
    Stopped {
        /// The step that was not begun, counted from 1.
        number: usize,
        /// From detection to verified off.
        off_after: Duration,
    },
    /// A stop was asked for, and the rig could not be made safe.
    #[error(
        "the survey was stopped before step {number}, and then the rig could not be made safe: {cleanup}"
    )]
    StoppedUnsafe {
        /// The step that was not begun, counted from 1.
        number: usize,
        /// What could not be made safe.
        cleanup: CleanupError,
    },
}

impl AcquireError {
    /// What could not be made safe, if so: then the sheet may be live.
    pub fn cleanup(&self) -> Option<&CleanupError> {
        match self {
            Self::PrepareUnsafe { cleanup, .. }
            | Self::Unsafe { cleanup, .. }
            | Self::StoppedUnsafe { cleanup, .. } => Some(cleanup),
            Self::Prepare { .. } | Self::Step { .. } | Self::Stopped { .. } => None,
        }
    }

    /// From the detection of what ended the survey to the read-back that the source is off; `None` where it could not be
    /// verified off.
    pub fn off_after(&self) -> Option<Duration> {
        match self {
            Self::Prepare { off_after, .. }
            | Self::Step { off_after, .. }
            | Self::Stopped { off_after, .. } => Some(*off_after),
            Self::PrepareUnsafe { cleanup, .. }
            | Self::Unsafe { cleanup, .. }
            | Self::StoppedUnsafe { cleanup, .. } => cleanup.off_after,
        }
    }

    /// What an instrument or its wire did, if that was the cause.
    pub fn cause(&self) -> Option<&RigError> {
        match self {
            Self::Prepare { cause, .. }
            | Self::PrepareUnsafe { cause, .. }
            | Self::Step { cause, .. }
            | Self::Unsafe { cause, .. } => Some(cause),
            Self::Stopped { .. } | Self::StoppedUnsafe { .. } => None,
        }
    }
}

/// Runs the plan once.
///
/// Readings over range, and readings of an injection at which the source was in compliance, are flags in the frame and
/// no error. A stop is heard between two steps. Dropping the future has the effect of a stop: the rig is then held until
/// it is safe. Must be called inside a tokio runtime; a runtime shut down in the middle of a plan ends it without
/// cleanup, which is what `tactusd --safe-off` is for.
///
/// # Errors
/// The step that failed and why; with it, if the rig could not be made safe, what of it is not.
///
/// # Panics
/// Hands on a panic of an instrument's driver, after the rig has been made safe.
pub async fn acquire<C, W, V>(
    rig: &Rig<C, W, V>,
    plan: &Plan,
    meter: MeterSettings,
    clock: impl Clock,
    stop: &Stop,
) -> Result<Frame, AcquireError>
where
    C: CurrentSource + 'static,
    W: Switch + 'static,
    V: Voltmeter + 'static,
{
    let (_here, caller) = watch::channel(());
    let mut instruments = rig.lock().await;
    let monotonic = clock.monotonic();
    let wall = clock.wall();
    let shared = Arc::new(plan.clone());
    let (plan_of_task, stop) = (Arc::clone(&shared), stop.clone());
    let task = tokio::spawn(async move {
        let mut run = Run {
            plan: &plan_of_task,
            meter,
            stop,
            caller,
            readings: vec![Reading::NotMeasured; plan_of_task.protocol.len()],
            compliance: Vec::new(),
            level: None,
            on: false,
            driven: Vec::new(),
            off_after: None,
        };
        let outcome = caught(run.every_step(&mut instruments)).await;
        let ended = match outcome {
            Ok(Ok(())) => Ok(()),
            Ok(Err(cut)) => {
                let made = make_safe(&mut instruments, &plan_of_task.wiring).await;
                Err(cut.with(made, run.off_after))
            }
            Err(panic) => {
                if let Err(cleanup) = make_safe(&mut instruments, &plan_of_task.wiring).await {
                    tracing::error!("after a panic the rig could not be made safe: {cleanup}");
                }
                std::panic::resume_unwind(panic)
            }
        };
        ended.map(|()| (run.readings, run.compliance))
    });
    let (readings, compliance) = match task.await {
        Ok(ended) => ended?,
        Err(join) => match join.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => {
                let number = 1;
                let cleanup = CleanupError::nobody_knows();
                return Err(AcquireError::StoppedUnsafe { number, cleanup });
            }
        },
    };
    Ok(Frame {
        sequence: 0,
        readings,
        monotonic,
        wall,
        duration: clock.monotonic().saturating_sub(monotonic),
        settings: settings(&shared, meter),
        compliance,
        simulated: rig.is_simulated(),
    })
}

/// The settings that a frame of this plan and meter carries; a baseline can be checked against them before acquiring.
pub fn settings(plan: &Plan, meter: MeterSettings) -> Settings {
    let settle = plan.steps.iter().find_map(|step| match step {
        Step::Settle { wait } => Some(*wait),
        _ => None,
    });
    Settings {
        protocol_hash: plan.protocol.hash(),
        current: plan.current,
        range: meter.range,
        nplc: meter.nplc,
        settle: settle.unwrap_or(Duration::ZERO),
        wiring: plan.wiring.name.clone(),
    }
}

/// Why the steps ended early.
enum Cut {
    Prepare(RigError),
    Step(usize, Step, RigError),
    Stop(usize),
}

impl Cut {
    /// `earlier` is how long it took where the source was switched off already while a reading was under way.
    fn with(self, made: Result<Duration, CleanupError>, earlier: Option<Duration>) -> AcquireError {
        let made = made.map(|off_after| earlier.unwrap_or(off_after));
        match (self, made) {
            (Self::Prepare(cause), Ok(off_after)) => AcquireError::Prepare { cause, off_after },
            (Self::Prepare(cause), Err(cleanup)) => AcquireError::PrepareUnsafe { cause, cleanup },
            (Self::Step(number, step, cause), Ok(off_after)) => AcquireError::Step {
                number,
                step,
                cause,
                off_after,
            },
            (Self::Step(number, step, cause), Err(cleanup)) => AcquireError::Unsafe {
                number,
                step,
                cause,
                cleanup,
            },
            (Self::Stop(number), Ok(off_after)) => AcquireError::Stopped { number, off_after },
            (Self::Stop(number), Err(cleanup)) => AcquireError::StoppedUnsafe { number, cleanup },
        }
    }
}

/// One run of a plan.
struct Run<'a> {
    plan: &'a Plan,
    meter: MeterSettings,
    stop: Stop,
    /// Closed when the caller has dropped its future.
    caller: watch::Receiver<()>,
    readings: Vec<Reading>,
    compliance: Vec<Electrode>,
    /// The source's level as last set; unknown at first.
    level: Option<Amps>,
    on: bool,
    /// Injecting relays that are to be closed now.
    driven: Vec<Relay>,
    /// How long switching off took, where it was done while a reading was under way.
    off_after: Option<Duration>,
}

impl Run<'_> {
    async fn every_step<C, W, V>(&mut self, rig: &mut Instruments<C, W, V>) -> Result<(), Cut>
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
        for (index, step) in plan.steps.iter().enumerate() {
            if self.is_over() {
                return Err(Cut::Stop(index + 1));
            }
            self.step(rig, step)
                .await
                .map_err(|cause| Cut::Step(index + 1, step.clone(), cause))?;
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
                if !self.driven.is_empty() {
                    crate::safe::check_driven(&mut rig.switch, &self.plan.wiring, &self.driven)
                        .await?;
                    self.driven.clear();
                }
                rig.switch
                    .open_verified(&every_relay(&self.plan.wiring))
                    .await
            }
            Step::Bus { close } => rig.switch.move_relays(&[Move::Close(close.clone())]).await,
            Step::Break { open, close, .. } => {
                self.drive(rig, Amps(0.0)).await?;
                rig.switch.move_relays(&moves(open, close)).await?;
                rig.switch.settle().await?;
                self.driven.clone_from(close);
                self.drive(rig, self.plan.current).await
            }
            Step::Overlap { open, close, .. } => {
                self.driven.clone_from(close);
                let close = Move::Close(close.clone());
                let open = Move::Open(open.clone());
                rig.switch.move_relays(&[close, open]).await?;
                if !self.on {
                    // switched off in compliance: it goes on again only when its pair is there
                    rig.switch.settle().await?;
                }
                self.drive(rig, self.plan.current).await
            }
            Step::Settle { wait } => {
                rig.switch.settle().await?;
                tokio::select! {
                    () = tokio::time::sleep(*wait) => {}
                    () = self.stop.asked() => {}
                }
                Ok(())
            }
            Step::Scan { readings } => {
                let scanned = self.guarded(&mut rig.source, rig.voltmeter.scan()).await?;
                if scanned.len() != readings.len() {
                    return Err(RigError::ReadingCount {
                        came: scanned.len(),
                        expected: readings.len(),
                    });
                }
                for (index, reading) in readings.iter().zip(scanned) {
                    if let Some(index) = index {
                        self.readings[*index] = reading;
                    }
                }
                Ok(())
            }
            Step::Route { open, close, .. } => rig.switch.move_relays(&moves(open, close)).await,
            Step::Read { reading } => {
                let read = self.guarded(&mut rig.source, rig.voltmeter.read()).await?;
                self.readings[*reading] = read;
                Ok(())
            }
            Step::Compliance { drive } => {
                if rig.source.in_compliance().await? {
                    // the next injection switches it on again
                    self.off(&mut rig.source).await?;
                    self.compliance.push(drive.plus);
                    for (question, reading) in self
                        .plan
                        .protocol
                        .measurements()
                        .iter()
                        .zip(&mut self.readings)
                    {
                        if question.drive == *drive {
                            *reading = Reading::NotMeasured;
                        }
                    }
                }
                Ok(())
            }
        }
    }

    /// Switches the source off, read back.
    async fn off<C: CurrentSource>(&mut self, source: &mut C) -> Result<(), RigError> {
        (self.level, self.on) = (None, false);
        source.off().await
    }

    /// Waits for a reading. Readings may take minutes, the source's own wire is free meanwhile: a stop switches the
    /// source off at once, and what is read after that is thrown away with the frame.
    async fn guarded<C: CurrentSource, T>(
        &mut self,
        source: &mut C,
        reading: impl Future<Output = Result<T, RigError>>,
    ) -> Result<T, RigError> {
        let mut reading = std::pin::pin!(reading);
        let (mut stop, mut caller) = (self.stop.clone(), self.caller.clone());
        tokio::select! {
            biased;
            answer = &mut reading => return answer,
            () = stop.asked() => {}
            // nothing is ever sent: only the caller's going away is heard
            _ = caller.changed() => {}
        }
        let detected = Instant::now();
        // The voltmeter's answer is awaited beside it: half an exchange would leave its link out of step.
        let off = async {
            let off = self.off(source).await;
            (off, detected.elapsed())
        };
        let ((off, after), answer) = tokio::join!(off, reading);
        off?;
        self.off_after = Some(after);
        answer
    }

    /// Brings the source to a level, saying nothing that it was told before. The output goes on at 0 A, never at a level.
    async fn drive<C: CurrentSource, W, V>(
        &mut self,
        rig: &mut Instruments<C, W, V>,
        level: Amps,
    ) -> Result<(), RigError> {
        if self.level.is_none() && level != Amps(0.0) {
            rig.source.set_current(Amps(0.0)).await?;
        }
        if level != Amps(0.0) && !self.on {
            rig.source.set_output(true).await?;
            self.on = true;
        }
        if self.level != Some(level) {
            rig.source.set_current(level).await?;
            self.level = Some(level);
        }
        Ok(())
    }
}

/// Open, then close; nothing for an empty list.
fn moves(open: &[Relay], close: &[Relay]) -> Vec<Move> {
    let open = (!open.is_empty()).then(|| Move::Open(open.to_vec()));
    let close = (!close.is_empty()).then(|| Move::Close(close.to_vec()));
    open.into_iter().chain(close).collect()
}

/// Runs a future, and catches its panic so that the rig can be made safe before it is handed on.
async fn caught<F: Future>(future: F) -> Result<F::Output, Box<dyn Any + Send>> {
    let mut future = std::pin::pin!(future);
    std::future::poll_fn(move |context| {
        let polled = std::panic::catch_unwind(AssertUnwindSafe(|| future.as_mut().poll(context)));
        match polled {
            Ok(Poll::Ready(output)) => Poll::Ready(Ok(output)),
            Ok(Poll::Pending) => Poll::Pending,
            Err(panic) => Poll::Ready(Err(panic)),
        }
    })
    .await
}
