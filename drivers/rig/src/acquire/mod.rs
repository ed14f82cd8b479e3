//! Runs a plan to a frame, and leaves the source off and verified on every exit path.
//!
//! The plan runs in a separate task that holds the instruments. Dropping the caller's future only requests a stop: the
//! task finishes the exchange in progress (an interrupted message would leave its link unsynchronised, and the source
//! could not be commanded off), makes the rig safe, and releases it. A cleanup started from a `Drop` would find
//! unsynchronised links.

mod injection;
mod run;

use std::any::Any;
use std::error::Error;
use std::fmt;
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

/// Why there is no frame, and the state in which the rig was left.
#[derive(Debug)]
pub struct AcquireError {
    /// Why the plan ended early.
    pub reason: EndReason,
    /// `Ok`: the source is off and the relays are open, both verified; the time from detection to the read-back that
    /// the source is off. `Err`: what could not be made safe; the sheet may carry current.
    pub made_safe: Result<Duration, CleanupError>,
}

/// Why a plan ended early.
#[derive(Debug)]
pub enum EndReason {
    /// Source, switch or voltmeter could not be set up.
    Prepare(RigError),
    /// A step failed: its number (from 1), the step, and the error.
    Step(usize, Step, RigError),
    /// A stop was requested, or the caller's future was dropped, before the step with this number (from 1).
    Stop(usize),
}

impl AcquireError {
    /// What could not be made safe, if anything. In this case the sheet may carry current.
    pub fn cleanup(&self) -> Option<&CleanupError> {
        self.made_safe.as_ref().err()
    }

    /// Time from detecting the fault to the read-back that the source is off; `None` if it could not be verified off.
    pub fn off_after(&self) -> Option<Duration> {
        match &self.made_safe {
            Ok(off_after) => Some(*off_after),
            Err(cleanup) => cleanup.off_after,
        }
    }

    /// The error of an instrument or its connection, if that was the cause.
    pub fn cause(&self) -> Option<&RigError> {
        match &self.reason {
            EndReason::Prepare(cause) | EndReason::Step(_, _, cause) => Some(cause),
            EndReason::Stop(_) => None,
        }
    }
}

impl fmt::Display for AcquireError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.reason, &self.made_safe) {
            (EndReason::Prepare(_), Ok(_)) => {
                f.write_str("the instruments could not be prepared for the survey")?;
            }
            (EndReason::Prepare(_), Err(_)) => {
                f.write_str("the instruments could not be prepared")?;
            }
            (EndReason::Step(number, step, _), _) => {
                write!(f, "step {number} of the survey failed ({step})")?;
            }
            (EndReason::Stop(number), _) => {
                write!(f, "the survey was stopped before step {number}")?;
            }
        }
        match &self.made_safe {
            Ok(_) => Ok(()),
            Err(cleanup) => write!(f, ", and then the rig could not be made safe: {cleanup}"),
        }
    }
}

impl Error for AcquireError {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.cause().map(|cause| cause as _)
    }
}

/// Runs the plan once.
///
/// Readings over range, and readings of an injection at which the source was in compliance, are flags in the frame, not
/// errors. A stop is handled between two steps. Dropping the future requests a stop; the rig stays locked until it is
/// safe. Must be called inside a tokio runtime; if the runtime is shut down during a plan, nothing is made safe: use
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
            Ok(Err(reason)) => {
                let made = make_safe(&mut instruments, &plan_of_task.wiring).await;
                // if the source was switched off during a reading, the time of that switch-off is reported
                let made_safe = made.map(|off_after| run.off_after.unwrap_or(off_after));
                Err(AcquireError { reason, made_safe })
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
                return Err(AcquireError {
                    reason: EndReason::Stop(1),
                    made_safe: Err(CleanupError::runtime_ended()),
                });
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
