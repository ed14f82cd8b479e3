//! Checks before the start of a session that its method is as fast as the frames, by timing a map of a frame with a
//! load.

use std::sync::Arc;
use std::time::{Duration, Instant};

use dbus::Fault;
use imaging::{BuildError, Model};
use survey::{Baseline, Reading, error_chain as chain};

use crate::acquisition::schedule::Schedule;
use crate::instruments::rig_plan::RigPlan;
use crate::panics::containment;
use crate::session::controller::Controller;

/// Maximum number of attempts, of which the fastest counts: the machine may be busy.
const TRIES: usize = 3;

impl Controller {
    /// Refuses a method that is slower than its frames. Frames of a recording wait for their maps.
    pub(super) async fn check_map_time(
        self: &Arc<Self>,
        model: &Model,
        baseline: &Arc<Baseline>,
        plan: Option<&Arc<RigPlan>>,
        schedule: &Schedule,
    ) -> Result<(), Fault> {
        let runtime = self.runtime();
        let Some(plan) = plan.cloned().or_else(|| runtime.plan.clone()) else {
            return Ok(());
        };
        let period = plan.plan.duration(&plan.timing).max(schedule.every);
        let every = runtime.setup.config.model.map_every.unwrap_or(1);
        let (model, baseline) = (model.clone(), Arc::clone(baseline));
        let refused = containment::blocking(move || {
            let readings = &baseline.readings;
            let frame =
                imaging::trial_frame(&runtime.setup.geometry, &plan.plan.protocol, readings)?;
            let within = period.saturating_mul(u32::try_from(every).unwrap_or(u32::MAX));
            let took = map_time(&model, readings, &frame, within);
            Ok::<_, BuildError>(refusal(model.reconstructor.method(), took, period, every))
        });
        match refused.await {
            Ok(Ok(None)) => Ok(()),
            Ok(Ok(Some(text))) => Err(Fault::Configuration(text)),
            Ok(Err(fault)) => Err(Fault::Failed(chain(&fault))),
            Err(_) => Err(Fault::Failed(
                "the computing time of a map could not be measured".into(),
            )),
        }
    }
}

/// Measures the computing time of a map; stops once it is at most `within`. Takes long: must not be called in an async
/// task.
fn map_time(model: &Model, baseline: &[Reading], frame: &[Reading], within: Duration) -> Duration {
    let map = || model.reconstruct(baseline, frame);
    let mut least = Duration::MAX;
    for _ in 0..TRIES {
        let begun = Instant::now();
        let _ = map();
        least = least.min(begun.elapsed());
        if least <= within {
            break;
        }
    }
    least
}

/// Why a session with this method is refused, and what would be accepted; `None` if the method is fast enough. A frame
/// is measured every `period`, and every `every`-th frame gets a map.
fn refusal(method: &str, took: Duration, period: Duration, every: u64) -> Option<String> {
    let (took, period) = (took.as_secs_f64(), period.as_secs_f64());
    if took <= period * every as f64 {
        return None;
    }
    let enough = (took / period).ceil();
    let of_each = match every {
        1 => String::new(),
        every => format!(" and map_every is {every}"),
    };
    Some(format!(
        "method {method} takes {took:.3} s for a map (measured now), a frame comes every {period:.3} s{of_each}; set \
         map_every = {enough} in [model] for one map per {enough} frames, choose a faster method, or measure less often \
         (every_s)"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_method_is_refused_with_what_would_do() {
        let ms = Duration::from_millis;
        assert_eq!(refusal("tv", ms(90), ms(100), 1), None);
        assert_eq!(refusal("tv", ms(290), ms(100), 3), None);
        let text = refusal("tv", ms(290), ms(100), 1).unwrap();
        assert!(text.contains("takes 0.290 s for a map"), "{text}");
        assert!(text.contains("every 0.100 s; set map_every = 3"), "{text}");
        let text = refusal("tv", ms(290), ms(100), 2).unwrap();
        assert!(text.contains("map_every is 2; set map_every = 3"), "{text}");
    }
}
