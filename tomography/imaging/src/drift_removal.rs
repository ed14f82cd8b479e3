//! Removal of drift from single frames: the drift since the baseline is estimated in each frame and added to the
//! baseline, so that the map of any method shows the load alone.

use std::borrow::Cow;
use std::sync::{Arc, Mutex, PoisonError};

use drift::{DriftError, DriftModel, FrameDrift, MapDeviation, Relative, Sizes};
use eit::{Forward, Mesh, Novelty, ReconstructError, Reconstructor};
use survey::{Amps, Map, Protocol, Reading};

use crate::conditions::Conditions;
use crate::geometry::Geometry;
use crate::tracking::drift_model;

/// The sheet fitted to a baseline, computed with the first frame that is compared with this baseline and kept until
/// another baseline is used.
pub(crate) struct FittedSheet {
    geometry: Geometry,
    protocol: Protocol,
    current: Amps,
    noise_v: f64,
    last: Mutex<Option<Arc<Fit>>>,
}

/// The drift model fitted to one baseline.
struct Fit {
    baseline: Vec<Reading>,
    model: DriftModel,
}

impl FittedSheet {
    /// `noise_v`: standard deviation of one reading, in the unit of the baselines.
    pub(crate) fn new(conditions: &Conditions<'_>, noise_v: f64) -> Self {
        Self {
            geometry: conditions.geometry.clone(),
            protocol: conditions.protocol.clone(),
            current: conditions.current,
            noise_v,
            last: Mutex::new(None),
        }
    }

    /// The drift model of a baseline; fitted unless the last call had the same baseline.
    fn fit(&self, baseline: &[Reading]) -> Result<Arc<Fit>, ReconstructError> {
        // the lock is held during the fit: other threads wait for the result, because the frames of a recording have
        // the same baseline
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(fit) = last.as_ref().filter(|fit| fit.baseline == baseline) {
            return Ok(Arc::clone(fit));
        }
        let conditions = Conditions::live(&self.geometry, &self.protocol, self.current);
        let model = drift_model(&conditions, baseline, self.noise_v).map_err(refused)?;
        let fit = Arc::new(Fit {
            baseline: baseline.to_vec(),
            model,
        });
        *last = Some(Arc::clone(&fit));
        Ok(fit)
    }

    /// The baseline plus the drift estimated in a frame, and the frame without readings that are nearly 0 V.
    fn drifted(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<(Vec<Reading>, Vec<Reading>), ReconstructError> {
        let fit = self.fit(baseline)?;
        let (_, drift) = fit.drift(frame)?;
        let drifted = fit.model.baseline_with(&drift.change);
        Ok((drifted, fit.model.without_zeros(frame)))
    }

    /// Standard deviation of ln conductance of each triangle of the region, and whether the frame determines the
    /// triangle.
    pub(crate) fn deviation(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<MapDeviation, ReconstructError> {
        let fit = self.fit(baseline)?;
        let (relative, drift) = fit.drift(frame)?;
        let whole = fit.model.map_deviation(&drift, &relative.rows);
        let whole = whole.map_err(refused)?;
        let region = self.geometry.mesh.region().iter();
        Ok(MapDeviation {
            deviation: region.clone().map(|&t| whole.deviation[t]).collect(),
            resolved: region.map(|&t| whole.resolved[t]).collect(),
        })
    }
}

impl Fit {
    fn drift(&self, frame: &[Reading]) -> Result<(Relative, FrameDrift), ReconstructError> {
        let relative = self.model.relative(frame).map_err(refused)?;
        let drift = self.model.frame_drift(&relative.data, &relative.rows);
        Ok((relative, drift.map_err(refused)?))
    }
}

/// Changes of the readings, V, whose random combinations model months of drift of a uniform sheet; one row per change,
/// one value per reading. Training sets contain them.
///
/// # Errors
/// A sheet that cannot be solved.
pub fn months_of_drift(
    conditions: &Conditions<'_>,
    noise_v: f64,
) -> Result<Vec<Vec<f64>>, DriftError> {
    let geometry = conditions.geometry;
    let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m)?;
    let ohms = forward.readings(&geometry.sigma0, conditions.protocol)?;
    let baseline = Reading::of_volts(ohms.iter().map(|ohms| conditions.current.0 * ohms));
    // components below 0.3 of the noise have no effect on a training
    drift_model(conditions, &baseline, noise_v)?.drift_rows(&Sizes::MONTHS, 0.3 * noise_v)
}

fn refused(cause: DriftError) -> ReconstructError {
    ReconstructError::Numerical {
        method: "drift of a frame".to_owned(),
        cause: survey::error_chain(&cause),
    }
}

/// A method whose frames are compared with the baseline plus their own drift.
pub(crate) struct DriftRemoved {
    pub(crate) inner: Arc<dyn Reconstructor>,
    pub(crate) sheet: Arc<FittedSheet>,
}

impl DriftRemoved {
    /// The baseline to compare a frame with, and the frame without readings that are nearly 0 V. Readings of a wrong
    /// number are passed on, so that the method reports the error.
    pub(crate) fn compare<'a>(
        &self,
        baseline: &'a [Reading],
        frame: &'a [Reading],
    ) -> Result<[Cow<'a, [Reading]>; 2], ReconstructError> {
        let wants = self.inner.protocol().len();
        if baseline.len() != wants || frame.len() != wants {
            return Ok([baseline, frame].map(Cow::Borrowed));
        }
        let (baseline, frame) = self.sheet.drifted(baseline, frame)?;
        Ok([baseline, frame].map(Cow::Owned))
    }
}

impl Reconstructor for DriftRemoved {
    fn method(&self) -> &str {
        self.inner.method()
    }

    fn protocol(&self) -> &Protocol {
        self.inner.protocol()
    }

    fn mesh(&self) -> &Arc<Mesh> {
        self.inner.mesh()
    }

    fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        let [baseline, frame] = self.compare(baseline, frame)?;
        self.inner.reconstruct(&baseline, &frame)
    }

    fn assumptions(&self) -> Vec<String> {
        let mut notes = self.inner.assumptions();
        notes.push(REMARK.to_owned());
        notes
    }

    fn noise_figure(&self) -> Option<f64> {
        self.inner.noise_figure()
    }

    fn novelty(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Option<Novelty>, ReconstructError> {
        let [baseline, frame] = self.compare(baseline, frame)?;
        self.inner.novelty(&baseline, &frame)
    }
}

/// The assumption about drift, as a note of the model.
pub(crate) const REMARK: &str = "drift of gain, contacts and smooth fields since the baseline is estimated in each frame and removed; \
     a crack or compression set of the foam cannot be distinguished from a load in one frame";

#[cfg(test)]
mod tests {
    use eit::{PaperSheet, Preset};
    use survey::Volts;

    use super::*;
    use crate::conditions::trial_frame;
    use crate::reconstruction::build;
    use crate::settings::{DriftRule, ReconstructionSettings};

    #[test]
    fn readings_of_nearly_0_v_are_missing_in_a_map() {
        let sheet = PaperSheet {
            fineness: 0.5,
            ..PaperSheet::default()
        };
        let geometry = Geometry::from_preset(&Preset::PaperSheet(sheet)).unwrap();
        let protocol = Protocol::sheffield(26).unwrap();
        let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m).unwrap();
        let ohms = forward.readings(&geometry.sigma0, &protocol).unwrap();
        let baseline = Reading::of_volts(ohms.iter().map(|ohms| 1e-3 * ohms));
        let conditions = Conditions::live(&geometry, &protocol, Amps(1e-3));
        let settings = ReconstructionSettings {
            drift: Some(DriftRule::Frame),
            ..ReconstructionSettings::default()
        };
        let model = build(&settings, &conditions).unwrap();
        let loaded = trial_frame(&geometry, &protocol, &baseline).unwrap();
        // the source is off during three of the injections
        let [zeros, missing] = [Reading::Ok(Volts(1e-7)), Reading::NotMeasured].map(|off| {
            let mut frame = loaded.clone();
            for (reading, measurement) in frame.iter_mut().zip(protocol.measurements()) {
                if measurement.drive.plus.0 < 3 {
                    *reading = off;
                }
            }
            frame
        });
        let judged = |frame| model.reconstruct(&baseline, frame).unwrap();
        assert_eq!(judged(&zeros), judged(&missing));
        let bare = |frame| model.reconstructor.reconstruct(&baseline, frame).unwrap();
        assert_eq!(bare(&zeros), bare(&missing));
    }
}
