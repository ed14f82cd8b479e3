//! How a session's frames are measured: ranges, from its baseline and after overloads, and zero-current frames.

use std::sync::Arc;

use rig::{AcquireError, Clock, InjectionSink, Stop, acquire_reporting};
use survey::{Baseline, Frame, Plan, RangeRule, Reading};

use crate::events::kind::EventKind;
use crate::instruments::assembly::AnyRig;
use crate::instruments::rig_plan::RigPlan;

/// State kept from frame to frame, also when the connection to the rig is lost.
#[derive(Default)]
pub(crate) struct Measuring {
    /// The requested plan, with ranges from the session's baseline; `None` for a recording.
    requested: Option<Arc<RigPlan>>,
    /// The last zero-current frame, and the number of frames that used it.
    zero: Option<(Frame, u64)>,
    /// Events for the record, a kind and a text each.
    events: Vec<(EventKind, String)>,
}

impl Measuring {
    /// Sets the ranges from the session's baseline, if the rig plan has a rule for ranges.
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

    /// The current plan of the session.
    pub(crate) fn now(&self) -> Option<Arc<RigPlan>> {
        self.requested.clone()
    }

    /// Takes one frame; if one is due, first takes a zero-current frame, which is subtracted from the following frames.
    /// The readings sent to `injections` are not corrected.
    pub(crate) async fn frame(
        &mut self,
        rig: &AnyRig,
        configured: &Arc<RigPlan>,
        clock: impl Clock + Copy,
        stop: &Stop,
        injections: Option<InjectionSink>,
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
            let zero = acquire_reporting(rig, &at_zero, meter, clock, stop, None).await?;
            self.events.push((EventKind::Zero, reported(&zero)));
            self.zero = Some((zero, 0));
        }
        let frame = acquire_reporting(rig, plan, meter, clock, stop, injections).await?;
        Ok(self.corrected(frame))
    }

    /// Subtracts the last zero-current frame. Readings over range get wider ranges from the next frame on; a new
    /// zero-current frame is taken first, because an offset is valid only for its range.
    fn corrected(&mut self, mut frame: Frame) -> Frame {
        let widened = self.widen(&frame);
        if let Some((zero, served)) = &mut self.zero {
            *served += 1;
            if let Err(error) = frame.subtract(zero) {
                // not expected: both frames have the same plan
                tracing::error!("{error}");
            }
        }
        if widened {
            self.zero = None;
        }
        frame
    }

    /// Gives readings over range the next larger range, if the rig plan has a rule for ranges; returns whether any
    /// range has changed.
    fn widen(&mut self, frame: &Frame) -> bool {
        let overloaded: Vec<usize> = frame
            .readings
            .iter()
            .enumerate()
            .filter(|(_, reading)| **reading == Reading::Overload)
            .map(|(index, _)| index)
            .collect();
        let requested = self.requested.as_mut().filter(|_| !overloaded.is_empty());
        let Some((requested, rule)) = requested.and_then(|requested| {
            let rule = requested.ranges.clone()?;
            Some((requested, rule))
        }) else {
            return false;
        };
        let widened = Arc::make_mut(requested).plan.widen(&rule, &overloaded);
        let Some(most) = widened.iter().map(|(_, range)| range.0).reduce(f64::max) else {
            return false;
        };
        let text = format!(
            "{} of {} overloaded readings have the next larger range from the next frame on (up to {})",
            widened.len(),
            overloaded.len(),
            survey::Volts(most)
        );
        tracing::warn!("{text}");
        self.events.push((EventKind::Ranges, text));
        true
    }

    /// Events since the last call.
    pub(crate) fn take_events(&mut self) -> Vec<(EventKind, String)> {
        std::mem::take(&mut self.events)
    }
}

/// The plan with ranges from a baseline; readings that the baseline lacks keep their range.
pub(crate) fn from_baseline(plan: Plan, rule: &RangeRule, baseline: &Baseline) -> Plan {
    let identities: std::collections::BTreeMap<_, _> = plan
        .protocol
        .measurements()
        .iter()
        .copied()
        .zip(&baseline.readings)
        .filter_map(|(measurement, reading)| Some((measurement, reading.volts()?)))
        .collect();
    plan.with_ranges(rule, |measurement| identities.get(&measurement).copied())
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

#[cfg(test)]
mod tests {
    use survey::Volts;

    use super::*;
    use crate::preparation::{FramesFrom, prepare};

    const CONFIG: &str = "[geometry]\npreset = \"disc-tank\"\n[geometry.disc-tank]\nelectrodes = 16\n[survey]\n\
                          zero_every = 100\nranges = \"planned\"\n[record]\ndirectory = \"state\"\n";

    /// A frame with the same voltage at each reading.
    fn frame(plan: &RigPlan, volts: f64) -> Frame {
        Frame {
            sequence: 1,
            readings: vec![Reading::Ok(Volts(volts)); plan.plan.protocol.len()],
            monotonic: Default::default(),
            wall: Default::default(),
            duration: Default::default(),
            settings: plan.settings(),
            extra: Vec::new(),
            compliance: Vec::new(),
            simulated: true,
        }
    }

    #[test]
    fn a_wider_range_needs_a_new_zero_current_frame() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        std::fs::write(&path, CONFIG).unwrap();
        let prepared = prepare(&path).unwrap_or_else(|problems| panic!("{problems:?}"));
        let FramesFrom::Rig(plan) = &prepared.frames else {
            panic!("it is a rig");
        };
        let mut measuring = Measuring::of(Some(Arc::clone(plan)), None);
        measuring.zero = Some((frame(plan, 0.25), 0));
        let good = measuring.corrected(frame(plan, 1.0));
        assert_eq!(good.readings[0], Reading::Ok(Volts(0.75)));
        assert!(measuring.zero.is_some());
        let mut over = frame(plan, 1.0);
        over.readings[3] = Reading::Overload;
        let over = measuring.corrected(over);
        assert_eq!(over.readings[0], Reading::Ok(Volts(0.75)));
        let events = measuring.take_events();
        assert_eq!(events.len(), 1, "{events:?}");
        assert!(measuring.zero.is_none(), "it was measured in the old range");
    }
}
