//! Runs a plan to a frame, and leaves the source off and verified on every exit path.
//!
//! The plan runs in a separate task that holds the instruments. Dropping the caller's future only requests a stop: the
//! task finishes the exchange in progress (an interrupted message would leave its link out of step, and the source
//! could not be commanded off), makes the rig safe, and releases it. A cleanup started from a `Drop` would find links
//! out of step.

mod injection;
mod run;

use std::any::Any;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use survey::{Frame, Plan, Precautions, Settings, Step, Volts};
use tokio::sync::watch;
use tokio::time::Instant;

use crate::safe::{CleanupError, make_safe};
use crate::{Clock, CurrentSource, MeterSettings, Rig, RigError, Stop, Switch, Voltmeter};
use injection::InjectionReport;
pub use injection::{InjectionReadings, InjectionSink};
use run::Run;

/// Why there is no frame. All variants except the `Unsafe` ones leave the source off and verified and the injecting
/// relays open. `off_after` is the time from detection to the read-back that the source is off.
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
    /// A stop was requested, or the caller went away.
    #[error("the survey was stopped before step {number}")]
    Stopped {
        /// The step that was not started, counted from 1.
        number: usize,
        /// From detection to verified off.
        off_after: Duration,
    },
    /// A stop was requested, and the rig could not be made safe.
    #[error(
        "the survey was stopped before step {number}, and then the rig could not be made safe: {cleanup}"
    )]
    StoppedUnsafe {
        /// The step that was not started, counted from 1.
        number: usize,
        /// What could not be made safe.
        cleanup: CleanupError,
    },
}

impl AcquireError {
    /// What could not be made safe, if anything: then the sheet may carry current.
    pub fn cleanup(&self) -> Option<&CleanupError> {
        match self {
            Self::PrepareUnsafe { cleanup, .. }
            | Self::Unsafe { cleanup, .. }
            | Self::StoppedUnsafe { cleanup, .. } => Some(cleanup),
            Self::Prepare { .. } | Self::Step { .. } | Self::Stopped { .. } => None,
        }
    }

    /// Time from detecting the fault to the read-back that the source is off; `None` if it could not be verified off.
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

    /// The error of an instrument or its connection, if that was the cause.
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
/// Readings over range, and readings of an injection at which the source was in compliance, are flags in the frame, not
/// errors. A stop is handled between two steps. Dropping the future requests a stop: the rig is then held until it is
/// safe. Must be called inside a tokio runtime; if the runtime is shut down during a plan there is no cleanup: use
/// `tactusd --safe-off`.
///
/// # Errors
/// The failed step and its cause; also what could not be made safe, if anything.
///
/// # Panics
/// Propagates a panic of an instrument's driver, after the rig has been made safe.
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
    acquire_reporting(rig, plan, meter, clock, stop, None).await
}

/// Like [`acquire`], and sends the readings of each injection as soon as they are complete.
///
/// # Errors
/// As [`acquire`]; some injections may have been sent before.
///
/// # Panics
/// As [`acquire`].
pub async fn acquire_reporting<C, W, V>(
    rig: &Rig<C, W, V>,
    plan: &Plan,
    meter: MeterSettings,
    clock: impl Clock,
    stop: &Stop,
    injections: Option<InjectionSink>,
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
    let report = injections.map(|sink| InjectionReport {
        sink,
        began: Instant::now(),
        monotonic,
        wall,
    });
    let shared = Arc::new(plan.clone());
    let (plan_of_task, stop) = (Arc::clone(&shared), stop.clone());
    let task = tokio::spawn(async move {
        let mut run = Run::new(&plan_of_task, meter, stop, caller, report);
        let outcome = catch_panic(run.run_steps(&mut instruments)).await;
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
        ended.map(|()| (run.readings, run.extra, run.compliance))
    });
    let (readings, extra, compliance) = match task.await {
        Ok(ended) => ended?,
        Err(join) => match join.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => {
                let number = 1;
                let cleanup = CleanupError::runtime_ended();
                return Err(AcquireError::StoppedUnsafe { number, cleanup });
            }
        },
    };
    Ok(Frame {
        sequence: 0,
        readings,
        extra,
        monotonic,
        wall,
        duration: clock.monotonic().saturating_sub(monotonic),
        settings: settings(&shared, meter),
        compliance,
        simulated: rig.is_simulated(),
    })
}

/// The settings of a frame of this plan and meter; a baseline can be checked against them before acquiring.
pub fn settings(plan: &Plan, meter: MeterSettings) -> Settings {
    let ranges = plan.ranges();
    let planned_ranges = ranges.iter().any(Option::is_some);
    let range = ranges
        .iter()
        .map(|range| range.unwrap_or(meter.range).0)
        .reduce(f64::max)
        .map_or(meter.range, Volts);
    Settings {
        protocol_hash: plan.protocol.hash(),
        current: plan.current,
        range,
        nplc: meter.nplc,
        settle: plan.settle,
        wiring: plan.wiring.name.clone(),
        precautions: Precautions {
            autozero: meter.autozero,
            averages: meter.averages,
            channel_delay: meter.channel_delay,
            reversal: plan.reversal,
            zeroed: false,
            planned_ranges,
            resolution: meter.resolution,
        },
    }
}

/// Why the steps ended early.
enum EndReason {
    Prepare(RigError),
    Step(usize, Step, RigError),
    Stop(usize),
}

impl EndReason {
    /// `earlier`: how long switching off took if it was done during a reading.
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

/// Runs a future, and catches its panic so that the rig can be made safe before the panic is propagated.
async fn catch_panic<F: Future>(future: F) -> Result<F::Output, Box<dyn Any + Send>> {
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
