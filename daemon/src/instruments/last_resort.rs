//! Where the daemon's own task fails, nobody is left who holds the instruments: they are connected again and switched off.

use std::panic::AssertUnwindSafe;
use std::time::Duration;

use tokio::runtime::{Builder, Runtime};

use crate::instruments::assembly::make_safe_each;
use crate::instruments::rig_plan::RigPlan;
use survey::error_chain as chain;

/// The last resort is tried again after so long, then after twice that, up to the second.
const AGAIN: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));

/// Runs `life` to its end; `None` where it panicked and the instruments of `rig`, if there are any, have been switched off
/// over new connections.
pub(crate) fn run<T>(
    runtime: Runtime,
    rig: Option<&RigPlan>,
    life: impl Future<Output = T>,
) -> Option<T> {
    let life = AssertUnwindSafe(|| runtime.block_on(life));
    if let Ok(outcome) = std::panic::catch_unwind(life) {
        // a reader that never reads must not keep the process
        runtime.shutdown_timeout(Duration::from_secs(2));
        return Some(outcome);
    }
    // its connections go with it, so that the instruments can be reached anew; a task that does not end is not waited for
    runtime.shutdown_timeout(Duration::from_secs(1));
    if let (Some(rig), Ok(fresh)) = (rig, Builder::new_current_thread().enable_all().build()) {
        fresh.block_on(last_resort(rig));
    }
    None
}

/// Makes both halves safe; a 6221 may keep its one place taken for a while.
async fn last_resort(rig: &RigPlan) {
    let mut pause = AGAIN.0;
    loop {
        let outcomes = make_safe_each(rig, &None).await;
        let done = outcomes.iter().all(Result::is_ok);
        for outcome in outcomes {
            match outcome {
                Ok(line) => tracing::warn!("{line}"),
                Err(error) => tracing::error!("{}", chain(&error)),
            }
        }
        if done || pause > AGAIN.1 {
            return;
        }
        tokio::time::sleep(pause).await;
        pause *= 2;
    }
}
