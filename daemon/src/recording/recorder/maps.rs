//! Maps of frames: requested with each frame, awaited briefly, and written later if they are late.

use std::sync::Arc;

use crate::events::kind::EventKind;
use imaging::tracking::{RecordedOrder, TrackingOrder};
use logbook::LogbookError;
use survey::Frame;

use crate::recording::frame_sink::FrameSink;
use crate::recording::published::Published;
use crate::recording::reconstruction_worker::{Failure, MapOutcome, TimedOutcome};
use crate::recording::recorder::{Recorder, Task};

impl Recorder {
    pub(super) fn ask_for_map(
        &mut self,
        frame: &Frame,
        busy: impl Fn() -> bool,
    ) -> Option<MapOutcome> {
        match &mut self.task {
            Task::Baseline { .. } => None,
            Task::Maps {
                worker, settings, ..
            } => {
                if settings.has_map(frame.sequence) {
                    return Some(worker.make(frame, busy));
                }
                worker.follow(frame);
                None
            }
        }
    }

    /// Adds the result to its frame, and reports errors.
    pub(super) fn made(
        &mut self,
        made: TimedOutcome,
        frame: &mut Published,
    ) -> Result<(), LogbookError> {
        frame.reconstruction = made.took;
        for text in &made.remarks {
            self.logbook.write_event(EventKind::Tracking, text)?;
        }
        for text in &made.quantity_remarks {
            self.logbook.write_event(EventKind::Quantities, text)?;
        }
        self.not_followed()?;
        frame.quantities = made.quantities;
        match made.outcome {
            Ok(mapped) => {
                let refused = mapped.refused.as_deref().unwrap_or_default();
                self.status.set_last_error(refused);
                if let Some(noise) = mapped.noise {
                    self.status.map_noise.get_or_init(|| noise);
                }
                frame.noise = mapped.noise;
                frame.found = mapped.found;
                frame.pressure = mapped.pressure;
                frame.record = Some(mapped.record);
                frame.map = Some(mapped.map);
                frame.tracked = mapped.tracked;
            }
            Err(Failure::Refused(why)) => self.status.set_last_error(&why),
            Err(Failure::Broken(why)) => {
                let text = format!(
                    "the code of method {} failed ({why}); frames are recorded, and have no maps until the next session; \
                     please report it",
                    self.status.facts.method
                );
                self.status.set_last_error(&text);
                self.logbook
                    .write_event(EventKind::MethodSuspended, &text)?;
            }
        }
        Ok(())
    }

    /// Records the late map, if it is ready.
    pub(super) fn late_map(&mut self) -> Result<(), LogbookError> {
        match self.late_outcome() {
            Some(made) => self.arrived(made),
            None => Ok(()),
        }
    }

    /// The late map, if it is ready.
    pub(super) fn late_outcome(&mut self) -> Option<TimedOutcome> {
        match &mut self.task {
            Task::Maps { worker, .. } => worker.late(),
            Task::Baseline { .. } => None,
        }
    }

    fn arrived(&mut self, made: TimedOutcome) -> Result<(), LogbookError> {
        let Task::Maps { late, .. } = &mut self.task else {
            return Ok(());
        };
        let Some(without_map) = late.take() else {
            return Ok(());
        };
        let mut frame = Published::clone(&without_map);
        self.made(made, &mut frame)?;
        if frame.map.is_some() {
            let frame = Arc::new(frame);
            self.logbook.late_map(&frame)?;
            for sink in &mut self.sinks {
                sink.late_map(&frame)?;
            }
        }
        Ok(())
    }

    /// Records the late map, if there is one, at the end of the session.
    pub(super) fn last_map(&mut self) -> Result<(), LogbookError> {
        let Task::Maps { worker, .. } = &mut self.task else {
            return Ok(());
        };
        let last = worker.finish();
        last.map_or(Ok(()), |made| self.arrived(made))
    }

    /// Reports frames that the tracked baseline could not follow.
    fn not_followed(&mut self) -> Result<(), LogbookError> {
        let Task::Maps { worker, .. } = &mut self.task else {
            return Ok(());
        };
        let missed = worker.take_not_followed();
        if missed == 0 {
            return Ok(());
        }
        let text = format!(
            "the tracked baseline left out {missed} frames, because maps took too long: `tactus replay --tracked` follows \
             all, and its maps differ"
        );
        self.logbook.write_event(EventKind::Tracking, &text)
    }

    /// Records an order to the tracked baseline, which applies to the next frame. Returns the number of that frame, or
    /// why the order cannot be carried out.
    pub(super) fn order_tracking(
        &mut self,
        order: TrackingOrder,
        by: String,
    ) -> Result<Result<u64, String>, LogbookError> {
        let Task::Maps { worker, .. } = &mut self.task else {
            return Ok(Err("the session records a baseline".to_owned()));
        };
        if !worker.follows() {
            return Ok(Err(
                "the session does not track its baseline: see `tracking` in [model], and `tactus events`".to_owned(),
            ));
        }
        let from = self.logbook.acknowledged() + 1;
        let recorded = RecordedOrder { order, from, by };
        let text = recorded.to_string();
        self.logbook
            .write_event(EventKind::TrackingOrdered, &text)?;
        if let Task::Maps { worker, .. } = &mut self.task {
            worker.order(order);
        }
        Ok(Ok(from))
    }

    pub(super) fn missed_a_map(&mut self) -> Result<(), LogbookError> {
        let Task::Maps { missed, .. } = &mut self.task else {
            return Ok(());
        };
        *missed += 1;
        let missed = *missed;
        if !missed.is_power_of_two() {
            return Ok(());
        }
        let text = format!(
            "method {} is slower than frames come: {missed} recorded without a map so far (`tactus replay` makes them)",
            self.status.facts.method
        );
        self.logbook.write_event(EventKind::MapsMissed, &text)
    }
}
