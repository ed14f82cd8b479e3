//! Quantities of the maps of a session, computed in the thread that computes maps. Next to the session file, one row
//! for each minute is stored, and the state of the quantities over time, which a resumed session continues.

use std::path::PathBuf;

use imaging::Model;
use imaging::quantities::{
    ComparedReadings, Deviation, FrameQuantities, JudgedMap, KeptCourse, Quantifier, QuantityRow,
    QuantitySettings, RegionSettings, Rows, STORED_S, keep_course, kept_course, store,
};
use logbook::LogbookError;
use survey::error_chain as chain;

use super::{Failure, Mapped};

/// Time between two stored states, s: dose and unrelieved time of this time are lost in a power cut.
const KEPT_EVERY_S: f64 = 300.0;
/// Minimum time between two frames with standard deviations, s: they cost the time of 16 maps, which delays the frame.
const DEVIATION_EVERY_S: f64 = 1.0;

/// Inputs for the quantities of a session.
pub(crate) struct QuantityContext {
    pub settings: QuantitySettings,
    pub regions: Vec<RegionSettings>,
    /// Folder of the sessions.
    pub folder: PathBuf,
    /// Id of the session, without the number of its part.
    pub session: String,
    /// Sequence of its last frame if it is resumed; otherwise 0.
    pub after: u64,
    /// Settings of the standard deviations of quantities; `None` if the noise is not known, or 16 maps take too long.
    pub deviation: Option<Deviation>,
}

/// Computes the quantities of each frame in turn.
pub(super) struct Quantified {
    quantifier: Quantifier,
    rows: Rows,
    folder: PathBuf,
    session: String,
    /// Sequence of the last frame.
    sequence: u64,
    kept_s: Option<f64>,
    /// Time of the last frame with standard deviations, s.
    deviation_s: Option<f64>,
    /// Whether something could not be stored, which is reported once.
    failed: bool,
}

impl Quantified {
    /// Restores the stored state if the session is resumed. Adds remarks for the record.
    ///
    /// # Errors
    /// A region does not overlap the maps of the session's model.
    pub(super) fn new(
        context: QuantityContext,
        model: &Model,
        remarks: &mut Vec<String>,
    ) -> Result<Self, String> {
        let quantifier = Quantifier::new(model, &context.settings, &context.regions);
        let mut quantified = Self {
            quantifier: quantifier
                .map_err(|error| chain(&error))?
                .with_deviation(context.deviation),
            rows: Rows::new(STORED_S),
            folder: context.folder,
            session: context.session,
            sequence: 0,
            kept_s: None,
            deviation_s: None,
            failed: false,
        };
        if context.after > 0 {
            let without = match quantified.restore() {
                Ok(()) => context.after.saturating_sub(quantified.sequence),
                Err(why) => {
                    remarks.push(format!(
                        "dose, unrelieved time and hot spots begin again: {why}"
                    ));
                    0
                }
            };
            if without > 0 {
                remarks.push(format!(
                    "dose and unrelieved time leave out the last {without} frames before the restart; `tactus quantities \
                     --recompute` includes them"
                ));
            }
        }
        Ok(quantified)
    }

    fn restore(&mut self) -> Result<(), String> {
        let kept = kept_course(&self.folder, &self.session).map_err(|error| chain(&error))?;
        let kept = kept.ok_or("their state was not stored")?;
        self.quantifier.restore(&kept.state)?;
        self.sequence = kept.sequence;
        Ok(())
    }

    /// The quantities of the next frame for which a map was wanted; `at_s` is its time, s of the Unix epoch.
    pub(super) fn take(
        &mut self,
        sequence: u64,
        at_s: f64,
        outcome: &Result<Mapped, Failure>,
        remarks: &mut Vec<String>,
    ) -> FrameQuantities {
        let found = match outcome {
            Ok(mapped) => {
                let since = self.deviation_s.map(|last| (at_s - last).abs());
                let compared = since
                    .is_none_or(|since| since >= DEVIATION_EVERY_S)
                    .then_some(ComparedReadings {
                        baseline: &mapped.baseline,
                        readings: &mapped.readings,
                    });
                if compared.is_some() {
                    self.deviation_s = Some(at_s);
                }
                let judged = JudgedMap {
                    map: &mapped.map,
                    pressure: mapped.pressure.as_ref(),
                    noise: mapped.noise,
                    tracked: mapped.tracked.as_ref(),
                    compared,
                };
                self.quantifier.take(at_s, Some(&judged))
            }
            Err(Failure::Refused(why) | Failure::Broken(why)) => FrameQuantities {
                reason: Some(why.clone()),
                ..self.quantifier.take(at_s, None)
            },
        };
        self.sequence = sequence;
        let ended = self.rows.take(at_s, &found);
        self.store(&ended, remarks);
        let kept_s = *self.kept_s.get_or_insert(at_s);
        if (at_s - kept_s).abs() >= KEPT_EVERY_S {
            self.kept_s = Some(at_s);
            self.keep(remarks);
        }
        found
    }

    /// Stores the rows of the last minute, and the state.
    pub(super) fn finish(mut self) {
        let ended = self.rows.end();
        self.store(&ended, &mut Vec::new());
        self.keep(&mut Vec::new());
    }

    fn keep(&mut self, remarks: &mut Vec<String>) {
        let kept = KeptCourse {
            sequence: self.sequence,
            state: self.quantifier.state(),
        };
        let kept = keep_course(&self.folder, &self.session, &kept);
        self.reported(
            kept,
            "a restart would begin dose and unrelieved time again",
            remarks,
        );
    }

    fn store(&mut self, rows: &[QuantityRow], remarks: &mut Vec<String>) {
        let stored = store(&self.folder, &self.session, rows);
        let instead = "`tactus quantities --recompute` computes them from the frames";
        self.reported(stored, instead, remarks);
    }

    fn reported(
        &mut self,
        stored: Result<(), LogbookError>,
        instead: &str,
        remarks: &mut Vec<String>,
    ) {
        let Err(error) = stored else {
            return;
        };
        if !std::mem::replace(&mut self.failed, true) {
            remarks.push(format!(
                "quantities cannot be stored with the session; {instead}: {}",
                chain(&error)
            ));
        }
    }
}
