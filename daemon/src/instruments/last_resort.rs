//! If the daemon's main task panics, connects to the instruments again and switches them off.

use std::panic::AssertUnwindSafe;
use std::time::Duration;

use tokio::runtime::{Builder, Runtime};

use crate::instruments::assembly::make_safe_each;
use crate::instruments::rig_plan::RigPlan;
use survey::error_chain as chain;

/// First and longest time between attempts; the time doubles.
const RETRY_INTERVALS: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));

/// Runs `life` to its end; `None` if it panicked and the instruments of `rig`, if any, have been switched off over new
/// connections.
pub(crate) fn run<T>(
    runtime: Runtime,
    rig: Option<&RigPlan>,
    life: impl Future<Output = T>,
) -> Option<T> {
    let life = AssertUnwindSafe(|| runtime.block_on(life));
    if let Ok(outcome) = std::panic::catch_unwind(life) {
        // a client that never reads must not keep the process alive
        runtime.shutdown_timeout(Duration::from_secs(2));
        return Some(outcome);
    }
    // closes its connections, so that the instruments can be reached again; a task that does not end is not awaited
    runtime.shutdown_timeout(Duration::from_secs(1));
    if let (Some(rig), Ok(fresh)) = (rig, Builder::new_current_thread().enable_all().build()) {
        fresh.block_on(last_resort(rig));
    }
    None
}

/// Makes source and relays safe, with retries: a 6221 may keep its only connection slot occupied for a while.
async fn last_resort(rig: &RigPlan) {
    let mut pause = RETRY_INTERVALS.0;
    loop {
        let outcomes = make_safe_each(rig, &None).await;
        let done = outcomes.iter().all(Result::is_ok);
        for outcome in outcomes {
            match outcome {
                Ok(line) => tracing::warn!("{line}"),
                Err(error) => tracing::error!("{}", chain(&error)),
            }
        }
        if done || pause > RETRY_INTERVALS.1 {
            return;
        }
        tokio::time::sleep(pause).await;
        pause *= 2;
    }
}
