//! The cost of each survey setting in time per frame, and its gain: the factor by which it reduces the noise.

use std::f64::consts::SQRT_2;
use std::time::Duration;

use dbus::SettingCost;
use survey::{Injection, Plan, Protocol, Step, Timing};

use crate::instruments::kinds;
use crate::instruments::rig_plan::RigPlan;

/// The cost of every setting that differs from the default: shortest integration, one reading, one polarity, one range,
/// a whole frame.
pub(crate) fn costs(rig: &RigPlan) -> Vec<SettingCost> {
    let (plan, timing) = (&rig.plan, &rig.timing);
    let now = plan.duration(timing).as_secs_f64();
    let timed = |timing: Timing| now - plan.duration(&timing).as_secs_f64();
    let mut costs = Vec::new();
    let mut add = |applies: bool, setting, seconds, gain: f64| {
        if applies && gain.is_finite() {
            let cost = SettingCost {
                setting,
                seconds,
                gain,
            };
            costs.push(cost);
        }
    };
    let (shortest, coarsest) = kinds::INTEGRATION[0];
    let quickest = Timing {
        nplc: shortest,
        ..*timing
    };
    let finer = coarsest / rig.meter.resolution.max(f64::MIN_POSITIVE);
    add(timing.nplc > shortest, "nplc", timed(quickest), finer);
    let once = Timing {
        averages: 1,
        ..*timing
    };
    let averages = f64::from(timing.averages);
    add(averages > 1.0, "averages", timed(once), averages.sqrt());
    let drifting = Timing {
        autozero: false,
        ..*timing
    };
    add(timing.autozero, "autozero", timed(drifting), 1.0);
    let settling = plan.steps.iter().map(|step| match step {
        Step::Settle { wait } => wait.as_secs_f64(),
        _ => 0.0,
    });
    add(!plan.settle.is_zero(), "settle", settling.sum(), 1.0);
    let at_once = Timing {
        channel_delay: Duration::ZERO,
        ..*timing
    };
    let delays = !timing.channel_delay.is_zero();
    add(delays, "channel_delay", timed(at_once), 1.0);
    let one_way = || again(plan, &plan.protocol, false);
    if let Some(one_way) = plan.reversal.then(one_way).flatten() {
        let seconds = now - one_way.duration(timing).as_secs_f64();
        add(true, "reversal", seconds, SQRT_2);
    }
    if let Some(every) = rig.zero_every {
        // the subtracted frame adds noise
        add(true, "zero_every", now / every as f64, 1.0 / SQRT_2);
    }
    if plan.has_ranges() {
        let ranges = plan.counts().range_changes as f64 * timing.range_command.as_secs_f64();
        let fraction = rig.meter.resolution;
        let planned = plan.resolution(fraction, rig.meter.range, rig.meter.averages);
        add(true, "ranges", ranges, planned.fixed.0 / planned.rms.0);
    }
    let whole = || {
        let pattern = survey::skip(plan.protocol.electrodes(), rig.skip).collect();
        let protocol = Protocol::new(plan.protocol.electrodes(), pattern).ok()?;
        again(plan, &protocol, plan.reversal)
    };
    if let Some(whole) = rig.half.then(whole).flatten() {
        // a full frame takes each reading and its reciprocal
        let seconds = now - whole.duration(timing).as_secs_f64();
        add(true, "half", seconds, 1.0 / SQRT_2);
    }
    costs
}

/// The plan of this protocol with the same injections, in one polarity or both.
fn again(plan: &Plan, protocol: &Protocol, reversal: bool) -> Option<Plan> {
    let injection = Injection {
        current: plan.current,
        compliance: plan.compliance,
        settle: plan.settle,
        reversal,
    };
    Plan::injecting(protocol, &plan.wiring, injection).ok()
}
