//! How a session's frames are measured: its ranges, which follow from its baseline and from overloads, and its
//! zero-current frames.

use std::sync::Arc;

use rig::{AcquireError, Clock, Stop};
use survey::{Baseline, Frame, Plan, RangeRule, Reading};

use crate::events::kind::EventKind;
use crate::instruments::assembly::AnyRig;
use crate::instruments::rig_plan::RigPlan;

/// What changes from frame to frame. It survives the loss of the rig.
#[derive(Default)]
pub(crate) struct Measuring {
    /// What was asked for, its ranges from the session's baseline; `None` for a recording.
    requested: Option<Arc<RigPlan>>,
    /// The last zero-current frame, and how many frames it has served.
    zero: Option<(Frame, u64)>,
    /// What a person should find in the record, a kind and a sentence each.
    events: Vec<(EventKind, String)>,
}

impl Measuring {
    /// Ranges from the baseline that the session measures against, where the rig plans them.
    pub(crate) fn of(requested: Option<Arc<RigPlan>>, baseline: Option<&Baseline>) -> Self {
        let requested = requested.map(|mut requested| {
            if let Some((rule, baseline)) = requested.ranges.clone().zip(baseline) {
                let own = Arc::make_mut(&mut requested);
                own.plan = from_baseline(own.plan.clone(), &rule, baseline);
            }
            requested
        });
        Self {
            requested,
            ..Self::default()
        }
    }

    /// How the session measures now.
    pub(crate) fn now(&self) -> Option<Arc<RigPlan>> {
        self.requested.clone()
    }

    /// Takes one frame; before it, where it is time, one at zero current, which is subtracted from those that follow.
    pub(crate) async fn frame(
        &mut self,
        rig: &AnyRig,
        configured: &Arc<RigPlan>,
        clock: impl Clock + Copy,
        stop: &Stop,
    ) -> Result<Frame, AcquireError> {
        let requested = self.requested.get_or_insert_with(|| Arc::clone(configured));
        let (plan, meter) = (&requested.plan, requested.meter);
        if let Some(every) = requested.zero_every
            && self
                .zero
                .as_ref()
                .is_none_or(|(_, served)| *served >= every)
        {
            let at_zero = plan.at_zero_current();
            let zero = rig.acquire(&at_zero, meter, clock, stop).await?;
            self.events.push((EventKind::Zero, reported(&zero)));
            self.zero = Some((zero, 0));
        }
        let mut frame = rig.acquire(plan, meter, clock, stop).await?;
        if let Some(rule) = requested.ranges.clone() {
            let overloaded: Vec<usize> = frame
                .readings
                .iter()
                .enumerate()
                .filter(|(_, reading)| **reading == Reading::Overload)
                .map(|(index, _)| index)
                .collect();
            let widened = match overloaded.is_empty() {
                true => Vec::new(),
                false => Arc::make_mut(requested).plan.widen(&rule, &overloaded),
            };
            if let Some(most) = widened.iter().map(|(_, range)| range.0).reduce(f64::max) {
                let text = format!(
                    "{} of {} overloaded readings have the next larger range from the next frame on (up to {})",
                    widened.len(),
                    overloaded.len(),
                    survey::Volts(most)
                );
                tracing::warn!("{text}");
                self.events.push((EventKind::Ranges, text));
            }
        }
        if let Some((zero, served)) = &mut self.zero {
            *served += 1;
            if let Err(error) = frame.subtract(zero) {
                // both come of one plan
                tracing::error!("{error}");
            }
        }
        Ok(frame)
    }

    /// What has happened since the last call.
    pub(crate) fn take_events(&mut self) -> Vec<(EventKind, String)> {
        std::mem::take(&mut self.events)
    }
}

/// The plan with ranges from a baseline; what the baseline does not know keeps its range.
pub(crate) fn from_baseline(plan: Plan, rule: &RangeRule, baseline: &Baseline) -> Plan {
    let identities: std::collections::BTreeMap<_, _> = plan
        .protocol
        .measurements()
        .iter()
        .copied()
        .zip(&baseline.readings)
        .filter_map(|(question, reading)| Some((question, reading.volts()?)))
        .collect();
    plan.with_ranges(rule, |question| identities.get(&question).copied())
}

fn reported(zero: &Frame) -> String {
    let volts: Vec<f64> = zero
        .readings
        .iter()
        .filter_map(|reading| Some(reading.volts()?.0))
        .collect();
    let most = volts
        .iter()
        .fold(0.0_f64, |most, volts| most.max(volts.abs()));
    let squares: f64 = volts.iter().map(|volts| volts * volts).sum();
    let rms = (squares / volts.len().max(1) as f64).sqrt();
    format!(
        "zero-current frame: {} of {} readings, rms {}, at most {}",
        volts.len(),
        zero.readings.len(),
        survey::Volts(rms),
        survey::Volts(most)
    )
}
