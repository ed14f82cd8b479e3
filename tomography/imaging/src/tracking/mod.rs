//! The tracked baseline: it follows the drift of the sheet, so that maps are free of drift. Readings of faulty
//! electrodes are not used, and each frame reports whether its map can be relied on, or why not.

mod kept;
mod moving;
mod orders;
#[cfg(test)]
mod tests;
mod tracked;

use std::sync::Arc;

use drift::{
    AnchorAlarm, Answer, DiscFit, DriftError, DriftModel, FitOptions, Noise, SheetFit, Tracker,
    TrackerState,
};
use eit::Mesh;
use serde::{Deserialize, Serialize};
use survey::{Electrode, Reading};

use crate::conditions::Conditions;
pub use drift::{Disc, Injection, Judgement, TimedReading, TrackingOrder};
pub use kept::{DriftSummary, KeptTracking, TrackingSummary, keep, kept};
pub(crate) use kept::{keep_as, kept_as};
pub use moving::{AfterInjection, InjectionWindow, MovingPlace};
pub use orders::{ORDERED, Orders, RecordedOrder};
pub(crate) use tracked::principal_axes;
pub use tracked::{Doubtful, PlaceRegion, Tracked};

/// Assumed thermal voltage of a sensing pair, V: copper against carbon at some tenths of a degree.
const EMF_V: f64 = 0.9e-6;

/// The time of a frame for [`Tracking`], s since the Unix epoch, in whole microseconds like the times of a session.
pub fn seconds(wall: chrono::DateTime<chrono::Utc>) -> f64 {
    1e-6 * wall.timestamp_micros() as f64
}

/// Fits gain, contacts and uneven conductance of the sheet to a baseline. `noise_v`: standard deviation of a reading of
/// the baseline, V, if it may exceed the errors that the fit assumes; otherwise 0.
///
/// # Errors
/// A baseline with missing readings, or a sheet that cannot be solved.
pub fn sheet_fit(
    conditions: &Conditions<'_>,
    baseline: &[Reading],
    noise_v: f64,
) -> Result<SheetFit, DriftError> {
    let geometry = conditions.geometry;
    let mut options = options(conditions);
    options.error_v = options.error_v.max(noise_v);
    SheetFit::of_baseline(
        &geometry.mesh,
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        conditions.protocol,
        baseline,
        &options,
    )
}

/// The sheet fitted to a baseline, with the covariance of its drift. `noise_v`: standard deviation of one reading, in
/// the unit of the baseline.
pub(crate) fn drift_model(
    conditions: &Conditions<'_>,
    baseline: &[Reading],
    noise_v: f64,
) -> Result<DriftModel, DriftError> {
    let geometry = conditions.geometry;
    DriftModel::new(
        &geometry.mesh,
        &geometry.contact_ohm_m,
        &geometry.sigma0,
        conditions.protocol,
        baseline,
        Noise {
            reading_v: noise_v,
            emf_v: EMF_V,
        },
        &options(conditions),
    )
}

fn options(conditions: &Conditions<'_>) -> FitOptions {
    FitOptions {
        current_a: conditions.current.0,
        ..FitOptions::default()
    }
}

/// Electrode numbers, from 1.
fn numbers(electrodes: &[usize]) -> Vec<usize> {
    electrodes
        .iter()
        .map(|&electrode| Electrode(electrode).number())
        .collect()
}

/// Tracks the drift of one sheet through a series of frames, from its first baseline on.
#[derive(Clone)]
pub struct Tracking {
    tracker: Tracker,
    began_s: f64,
    alarm: Option<AnchorAlarm>,
    /// Baseline of the last frame's map, if it differs from the tracked baseline (see [`TrackedFrame::baseline`]).
    with_unlearnt: Option<Vec<Reading>>,
}

/// The state of [`Tracking`]: stored with a session, and restored to the same bits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrackingState {
    /// Time of the first baseline, s.
    began_s: f64,
    /// The slow change found by the last comparison with earlier baselines.
    alarm: Option<AnchorAlarm>,
    tracker: TrackerState,
}

/// A frame with the baseline to compare it with.
#[derive(Debug, Clone)]
pub struct TrackedFrame {
    /// Baseline of its map: the first baseline plus the tracked drift. The most probable value of changes that the
    /// tracked baseline does not contain is added: the drift since a load was placed long ago, and the effect of lost
    /// contacts on readings of other electrodes.
    pub baseline: Vec<Reading>,
    /// The first baseline plus the tracked drift alone; constant while a load is on the sheet.
    pub tracked_baseline: Vec<Reading>,
    /// The frame without the readings of faulty electrodes and those that are nearly 0 V.
    pub readings: Vec<Reading>,
    /// Result for the frame.
    pub tracked: Tracked,
    /// Orders of users that were carried out with this frame.
    pub orders: Vec<TrackingOrder>,
}

impl Tracking {
    /// Fits the sheet to its first baseline, recorded without load at `at_s` (s, on any clock that frames have too).
    /// `noise_v`: standard deviation of one reading, in the unit of the baseline.
    ///
    /// # Errors
    /// A baseline with missing readings, or a sheet that cannot be solved.
    pub fn new(
        conditions: &Conditions<'_>,
        baseline: &[Reading],
        noise_v: f64,
        at_s: f64,
    ) -> Result<Self, DriftError> {
        let model = drift_model(conditions, baseline, noise_v)?;
        Ok(Self {
            tracker: Tracker::new(Arc::new(model), at_s)?,
            began_s: at_s,
            alarm: None,
            with_unlearnt: None,
        })
    }

    /// Continues from a stored state of the same sheet: later results have the same bits as without the interruption.
    ///
    /// # Errors
    /// A state of another mesh, baseline or build.
    pub fn restore(&mut self, state: TrackingState) -> Result<(), DriftError> {
        self.tracker = Tracker::restore(Arc::clone(self.tracker.model()), state.tracker)?;
        (self.began_s, self.alarm) = (state.began_s, state.alarm);
        self.with_unlearnt = None;
        Ok(())
    }

    /// The state to store for [`Tracking::restore`]; it does not contain the sheet.
    pub fn state(&self) -> TrackingState {
        TrackingState {
            began_s: self.began_s,
            alarm: self.alarm,
            tracker: self.tracker.state().clone(),
        }
    }

    /// The sheet as it was fitted to the first baseline.
    pub fn model(&self) -> &DriftModel {
        self.tracker.model()
    }

    /// Accepts an order of a user; it is carried out with the next frame that can be judged.
    pub fn order(&mut self, order: TrackingOrder) {
        self.tracker.order(order);
    }

    /// The tracked drift since the first baseline, by kind.
    ///
    /// # Errors
    /// A covariance that cannot be factored.
    pub fn drift(&self) -> Result<DriftSummary, DriftError> {
        let days = (self.tracker.state().at_s() - self.began_s).max(0.0) / 86_400.0;
        Ok(DriftSummary::new(&self.tracker.kinds(days)?))
    }

    /// Updates the tracked baseline with a frame taken at `at_s`, s. Every frame must be given, in order, because each
    /// update starts from the previous one.
    ///
    /// # Errors
    /// A covariance that cannot be factored; a frame of another length. A frame with too few readings is not
    /// an error: its [`Tracked::known`] is false.
    pub fn follow(&mut self, frame: &[Reading], at_s: f64) -> Result<TrackedFrame, DriftError> {
        let mut followed = self.judge(frame, at_s)?;
        // without an estimate the frame is compared with the tracked baseline, which keeps the update by this frame
        if let Ok(Some(unlearnt)) = self.tracker.unlearnt() {
            let change = self.tracker.baseline() + unlearnt;
            followed.baseline = self.model().baseline_with(&change);
            self.with_unlearnt = Some(followed.baseline.clone());
        }
        Ok(followed)
    }

    /// Like [`Tracking::follow`], for a frame without a map: skips the estimate of changes that the tracked baseline
    /// does not contain.
    ///
    /// # Errors
    /// As [`Tracking::follow`].
    pub fn judge(&mut self, frame: &[Reading], at_s: f64) -> Result<TrackedFrame, DriftError> {
        let mut orders = Vec::new();
        let (readings, tracked) = match self.learn(frame, at_s)? {
            Some(mut answer) => {
                orders = std::mem::take(&mut answer.orders);
                let load = self.load(&answer)?;
                let (state, began_s) = (self.tracker.state(), self.began_s);
                let times = (began_s, at_s);
                let tracked = Tracked::new(&answer, load.as_ref(), state, self.alarm, times);
                (self.without(frame, &answer.masked), tracked)
            }
            None => {
                let state = self.tracker.state();
                let tracked = Tracked::unanswered(state, at_s);
                (self.without(frame, &state.masked()), tracked)
            }
        };
        let baseline = self.baseline();
        Ok(TrackedFrame {
            tracked_baseline: baseline.clone(),
            baseline,
            readings,
            tracked,
            orders,
        })
    }

    /// Returns the present tracked baseline, and the frame without the readings of faulty electrodes. The frame should
    /// be close in time to the last tracked one. It does not change the tracked baseline and is not judged.
    pub fn compare(&self, frame: &[Reading]) -> (Vec<Reading>, Vec<Reading>) {
        let masked = self.tracker.state().masked();
        let baseline = self.with_unlearnt.clone();
        let baseline = baseline.unwrap_or_else(|| self.baseline());
        (baseline, self.without(frame, &masked))
    }

    /// Standard deviation of the change of ln conductance of each triangle of the mesh's region, for the last tracked
    /// frame; NaN for triangles that the frame does not determine. Computed with the linear model, whatever the method.
    ///
    /// # Errors
    /// The frame was not judged, or a covariance that cannot be factored.
    pub fn map_deviation(&self, mesh: &Mesh) -> Result<Vec<f64>, DriftError> {
        let whole = self.tracker.map_deviation()?.values();
        let of_region = mesh.region().iter();
        Ok(of_region.map(|&triangle| whole[triangle]).collect())
    }

    /// The first baseline plus the tracked drift.
    fn baseline(&self) -> Vec<Reading> {
        self.model().baseline_with(&self.tracker.baseline())
    }

    /// Like [`Tracking::judge`], without a result.
    ///
    /// # Errors
    /// As [`Tracking::judge`].
    pub fn pass(&mut self, frame: &[Reading], at_s: f64) -> Result<(), DriftError> {
        self.learn(frame, at_s).map(drop)
    }

    /// Updates the tracker with a frame; `None` if the frame has too few readings.
    fn learn(&mut self, frame: &[Reading], at_s: f64) -> Result<Option<Answer>, DriftError> {
        self.with_unlearnt = None;
        match self.tracker.follow(frame, at_s) {
            Ok(answer) => {
                if answer.clock_went_back {
                    self.began_s = self.began_s.min(at_s);
                }
                if !answer.orders.is_empty() {
                    // each order decides whether a slow change is a load or ageing
                    self.alarm = None;
                }
                if answer.compared {
                    self.alarm = answer.anchor;
                }
                Ok(Some(answer))
            }
            Err(DriftError::TooFew { .. }) => Ok(None),
            Err(other) => Err(other),
        }
    }

    /// The load on the sheet, if there is exactly one: the disc that fits it best, and the fit of its position.
    fn load(&self, answer: &Answer) -> Result<Option<[DiscFit; 2]>, DriftError> {
        if answer.judgement != Judgement::Loaded || answer.loads != 1 {
            return Ok(None);
        }
        let white = self.tracker.whitened()?;
        let came = answer.event.as_ref();
        let came = came.filter(|event| event.came && !event.same_load);
        let disc = match came {
            Some(event) => event.fit.clone(),
            None => white.fit_disc(self.model())?,
        };
        // a load declared by a user may be too small to be detected
        if answer.held && came.is_none() && !disc.is_load() {
            return Ok(None);
        }
        let place = white.fit_place(self.model(), &disc)?;
        Ok(Some([disc, place]))
    }

    /// The frame without the readings of these electrodes, counted from 0, and without readings that are nearly 0 V.
    fn without(&self, frame: &[Reading], masked: &[usize]) -> Vec<Reading> {
        let measurements = self.model().pairs().protocol().measurements();
        let mut readings = self.model().without_zeros(frame);
        for (reading, measurement) in readings.iter_mut().zip(measurements) {
            let used = measurement.electrodes();
            if used.iter().any(|electrode| masked.contains(&electrode.0)) {
                *reading = Reading::NotMeasured;
            }
        }
        readings
    }
}
