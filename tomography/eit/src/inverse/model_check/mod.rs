//! Checks whether a frame agrees with the model: finds the change that no map explains, and identifies the faulty
//! electrode or pair. Independent of the reconstruction methods.
//!
//! A reading and its reciprocal twin change by the same amount for any load. Their rotated sum is the data of maps;
//! their rotated difference contains only noise and measures it. Noise that is neither white nor proportional to the
//! reading indicates a faulty source or voltmeter. The sums are compared with the most probable map of the whole sheet:
//! x ~ N(0, g^2 / area) for each triangle, white errors of deviation t, g and t by maximum likelihood. If t exceeds the
//! noise, no map explains the excess.

mod outside;
mod own_misfit;
mod reciprocal;
mod spectrum;

use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{DMatrix, DVector};
use survey::{Doubt, Electrode, Map, MapQuality, Protocol, Reading};

use self::outside::Outside;
pub use self::own_misfit::{Leftover, MisfitClass, OwnMisfit};
use self::reciprocal::{Found, Reciprocal};
use self::spectrum::{Fit, Spectrum};
use crate::inverse::error::OneStepError;
use crate::inverse::learned::linear::Linear;
use crate::inverse::options::{OneStepOptions, Scale};
use crate::inverse::prior::Prior;
use crate::linear_algebra::dense;
use crate::{Forward, Mesh};

/// The measured and the stated noise of the readings contradict each other if their ratio is above this value or below
/// its inverse.
const NOISE_RATIO: f64 = 2.0;
/// Noise of the most precise instruments, as a share of the readings' rms; smaller values are rounding errors.
const RESOLUTION: f64 = 1e-7;
/// Ratio of the best map's error to the noise below which the error is attributed to noise.
const UNEXPLAINED_NOISE: f64 = 2.0;
/// Share of the change that a valid linear model may leave unexplained, because it does not describe strong loads
/// exactly. Healthy frames of `tactus-lab honesty` have up to 4 %.
const UNEXPLAINED_SHARE: f64 = 0.1;
/// Improvement of the fit (chi squared of one degree of freedom) by one contact impedance above which the change is
/// attributed to that electrode. Loads that end 16 mm from the electrode reach 16; a contact of ten times its impedance
/// reaches 33 or more.
const AT_ELECTRODE: f64 = 40.0;
/// Regression coefficient of an electrode's readings on their reference, relative to the median electrode's, below
/// which the electrode is dead. The neighbours of a dead electrode, which share half of its pairs, have 0.5.
const DEAD: f64 = 0.2;
/// Largest relative loss that linear maps of real loads show because of the linearisation error.
const MOST_LOSS: f64 = 1.2;
/// Share of the region that must exceed that loss: linear maps overshoot in single triangles beside electrodes.
const LOSS_AREA: f64 = 2e-3;

/// Checks frames of one sheet and protocol against the model of the whole sheet.
pub struct ModelCheck {
    protocol: Protocol,
    linear: Linear,
    /// The model's readings, in the scale of the data.
    model: Vec<f64>,
    /// The largest magnitude of the model's readings.
    largest: f64,
    /// The smallest noise that exceeds rounding errors, in the scale of the data.
    least_noise: f64,
    /// Forward model of the whole sheet, for predictions.
    forward: Forward,
    /// Conductance of the sheet without load.
    sigma0: Vec<f64>,
    /// Triangles shown by maps, and their areas, m2.
    region: Vec<usize>,
    areas: Vec<f64>,
    /// Covariance of the folded data of a white map of size 1, per area.
    gram: DMatrix<f64>,
    /// Change of the folded data per relative change of each contact impedance.
    contacts: DMatrix<f64>,
    /// The sheet outside of the region; `None` if maps show all of it.
    outside: Option<Outside>,
    /// Standard deviation of one reading in the unit of the model's data; `None` if unknown.
    noise: Option<f64>,
    /// Prepared for the missing readings of the last frame; they seldom change.
    prepared: Mutex<Option<Arc<Prepared>>>,
}

/// Quantities that depend only on which readings are missing.
struct Prepared {
    missing: Vec<usize>,
    reciprocal: Reciprocal,
    spectrum: Spectrum,
    outside: Option<Outside>,
}

/// The change of the readings of one frame.
struct Change {
    /// The change, folded, in the scale of the model.
    data: DVector<f64>,
    /// Root mean square of the change.
    size: f64,
    /// Standard deviation of each datum according to the stated noise.
    stated: Option<f64>,
    /// Standard deviation of each datum according to the measured noise, or else the stated noise.
    noise: f64,
    /// The noise including the part proportional to the reading.
    expected: f64,
    found: Found,
    /// The best map of the whole sheet; `None` if the readings allow none.
    fit: Option<Fit>,
    prepared: Arc<Prepared>,
}

impl Change {
    /// The share of the change that corresponds to an error of this size (rms) after subtraction of the noise.
    fn share(&self, error: f64) -> f64 {
        (error.powi(2) - self.expected.powi(2)).max(0.0).sqrt() / self.size
    }
}

impl ModelCheck {
    /// For readings at `sigma0` (S per square, one per triangle of the mesh). `noise`: standard deviation of one reading, V
    /// with [`Scale::Currents`], otherwise V at 1 A; `None` if it is neither stated nor measured.
    ///
    /// # Errors
    /// As [`crate::OneStep::new`].
    pub fn new(
        mesh: &Mesh,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        protocol: &Protocol,
        scale: Scale,
        noise: Option<f64>,
    ) -> Result<Self, OneStepError> {
        let whole = Arc::new(mesh.whole());
        let options = OneStepOptions {
            prior: Prior::Tikhonov,
            scale,
            ..OneStepOptions::default()
        };
        let (linear, sensitivity, _) =
            Linear::new(&whole, contact_ohm_m, sigma0, protocol, &options)?;
        let areas = whole.region_areas();
        let gram = dense::gram(&sensitivity, |triangle| Some(1.0 / areas[triangle]));
        let forward = Forward::new(Arc::clone(&whole), contact_ohm_m)?;
        let half = linear.fold.half(protocol)?;
        let mut contacts = forward.contact_jacobian(sigma0, &half)?;
        for (electrode, mut column) in contacts.column_iter_mut().enumerate() {
            for (value, norm) in column.iter_mut().zip(linear.fold.norm()) {
                *value *= norm * contact_ohm_m[electrode];
            }
        }
        let model = linear.readings();
        let square: f64 = model.iter().map(|v| v * v).sum();
        Ok(Self {
            protocol: protocol.clone(),
            least_noise: RESOLUTION * (square / model.len() as f64).sqrt(),
            largest: linear.largest(),
            linear,
            model,
            forward,
            sigma0: sigma0.to_vec(),
            region: mesh.region().to_vec(),
            areas: mesh.region_areas(),
            gram,
            contacts,
            outside: Outside::new(mesh, &sensitivity),
            noise,
            prepared: Mutex::new(None),
        })
    }

    /// Adds the quality to a map that a method made of these readings: the doubts of this check, and those that the method itself
    /// reported. `usual`: unexplained shares of a learned method on held-out cases; `None` if unknown, or if the method is not learned.
    pub fn judged(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
        map: Map,
        usual: Option<&OwnMisfit>,
    ) -> Map {
        // nothing else can be concluded from the readings of dead electrodes
        let mut doubts = self.dead(baseline, frame);
        if doubts.is_empty()
            && let Some(mut change) = self.change(baseline, frame)
        {
            doubts.append(&mut change.found.doubts);
            doubts.extend(self.of_change(&change));
            doubts.extend(usual.and_then(|usual| self.own_doubt(&change, &map.values, usual)));
        }
        doubts.extend(impossible(&map.values, &self.areas));
        let quality = MapQuality::of(&doubts);
        Map {
            quality: Some(match map.quality {
                Some(own) => quality.and(own),
                None => quality,
            }),
            ..map
        }
    }

    /// The change of these readings and its noise. `None` for the baseline itself, and for readings that cannot be
    /// compared (wrong counts, a dead baseline), which the method refuses.
    fn change(&self, baseline: &[Reading], frame: &[Reading]) -> Option<Change> {
        let compared = self
            .linear
            .change_as_read(baseline, frame, "check of the model");
        let (change, missing) = compared.ok()?;
        if change.iter().all(|value| *value == 0.0) {
            return None;
        }
        let prepared = self.prepared(missing)?;
        let data = self.linear.fold.seen(&change, &prepared.missing).data;
        let size = (data.norm_squared() / data.len() as f64).sqrt();
        // baseline and frame both contribute noise
        let stated = self.noise.map(|noise| std::f64::consts::SQRT_2 * noise);
        let found = prepared
            .reciprocal
            .of(&change, stated, self.least_noise, size);
        let fit = prepared.spectrum.fit(&data);
        let left_by_fit = fit.as_ref().map(|fit| fit.error);
        // without twins, the error of the fit is the only estimate of the noise
        let noise = found
            .noise
            .or(stated)
            .or(left_by_fit)
            .unwrap_or_default()
            .max(self.least_noise);
        Some(Change {
            data,
            size,
            stated,
            noise,
            expected: noise.hypot(found.proportional),
            found,
            fit,
            prepared,
        })
    }

    /// Reasons why the map of a change is unreliable, independent of the method, except those found from reciprocal
    /// twins.
    fn of_change(&self, change: &Change) -> Vec<Doubt> {
        let mut doubts = Vec::new();
        let Change {
            fit: Some(fit),
            noise,
            prepared,
            ..
        } = change
        else {
            return doubts;
        };
        if change.found.noise.is_none()
            && let Some(stated) = change.stated
            && fit.error * NOISE_RATIO < stated
        {
            doubts.push(Doubt::Noise {
                ratio: fit.error / stated,
            });
        }
        let share = change.share(fit.error);
        if fit.error > UNEXPLAINED_NOISE * change.expected && share > UNEXPLAINED_SHARE {
            doubts.push(Doubt::Unexplained { share });
        }
        let (electrode, improvement) = prepared.spectrum.contact(fit, *noise);
        if improvement > AT_ELECTRODE {
            doubts.push(Doubt::AtElectrode {
                electrode: Electrode(electrode),
            });
        }
        if let Some(outside) = &prepared.outside {
            doubts.extend(outside.load(&prepared.spectrum.explained(fit), *noise));
        }
        doubts
    }

    fn prepared(&self, missing: Vec<usize>) -> Option<Arc<Prepared>> {
        let mut kept = self.prepared.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(prepared) = kept.as_ref().filter(|one| one.missing == missing) {
            return Some(Arc::clone(prepared));
        }
        let rows = self
            .linear
            .fold
            .seen(&vec![0.0; self.protocol.len()], &missing);
        let one_side = rows.rows(&self.gram).transpose();
        let gram = rows.rows(&one_side);
        let contacts = rows.rows(&self.contacts);
        let prepared = Arc::new(Prepared {
            reciprocal: Reciprocal::new(&self.protocol, &self.linear.fold, &self.model, &missing),
            spectrum: Spectrum::new(gram.as_ref(), contacts.as_ref())?,
            outside: self.outside.as_ref().map(|outside| outside.of(&rows)),
            missing,
        });
        *kept = Some(Arc::clone(&prepared));
        Some(prepared)
    }

    /// Electrodes whose readings do not follow the model's in the baseline, or the baseline's in the frame.
    fn dead(&self, baseline: &[Reading], frame: &[Reading]) -> Vec<Doubt> {
        let count = self.model.len();
        if baseline.len() != count || frame.len() != count {
            return Vec::new();
        }
        let volts = |readings: &[Reading]| -> Vec<Option<f64>> {
            readings
                .iter()
                .map(|reading| reading.volts().map(|volts| volts.0))
                .collect()
        };
        let (before, now) = (volts(baseline), volts(frame));
        let model: Vec<Option<f64>> = self.model.iter().copied().map(Some).collect();
        let (mut doubts, mut dead) = (Vec::new(), Vec::new());
        for (in_baseline, readings, reference) in [(true, &before, &model), (false, &now, &before)]
        {
            // one at a time, because a dead electrode shares readings with its neighbours
            while let Some(electrode) = self.first_dead(readings, reference, &dead) {
                dead.push(electrode);
                doubts.push(Doubt::DeadElectrode {
                    electrode,
                    in_baseline,
                });
            }
        }
        doubts
    }

    /// The electrode with the smallest regression on the reference, if it is dead; readings that use `others` are
    /// excluded.
    fn first_dead(
        &self,
        readings: &[Option<f64>],
        reference: &[Option<f64>],
        others: &[Electrode],
    ) -> Option<Electrode> {
        let mut follows: Vec<(usize, f64)> = self
            .follows(readings, reference, others)
            .into_iter()
            .enumerate()
            .filter_map(|(electrode, follows)| Some((electrode, follows?)))
            .collect();
        follows.sort_unstable_by(|a, b| a.1.total_cmp(&b.1));
        let (_, usual) = *follows.get(follows.len() / 2)?;
        let &(electrode, least) = follows.first()?;
        (least < DEAD * usual).then_some(Electrode(electrode))
    }

    /// For each electrode the regression of its readings on the reference; `None` without readings.
    fn follows(
        &self,
        readings: &[Option<f64>],
        reference: &[Option<f64>],
        others: &[Electrode],
    ) -> Vec<Option<f64>> {
        let mut sums = vec![[0.0; 2]; self.protocol.electrodes()];
        for ((question, reading), reference) in self
            .protocol
            .measurements()
            .iter()
            .zip(readings)
            .zip(reference)
        {
            let (Some(reading), Some(reference)) = (reading, reference) else {
                continue;
            };
            let dipoles = [question.drive, question.sense];
            let used =
                |electrode: &Electrode| dipoles.iter().any(|dipole| dipole.contains(*electrode));
            if others.iter().any(used) {
                continue;
            }
            for dipole in dipoles {
                for electrode in [dipole.plus, dipole.minus] {
                    sums[electrode.0][0] += reading * reference;
                    sums[electrode.0][1] += reference * reference;
                }
            }
        }
        sums.into_iter()
            .map(|[cross, square]| (square > 0.0).then(|| cross / square))
            .collect()
    }
}

/// The doubt raised by a map's values themselves, if any; `areas`: areas of its triangles.
fn impossible(values: &[f64], areas: &[f64]) -> Option<Doubt> {
    let mut losses: Vec<(f64, f64)> = values
        .iter()
        .map(|v| -v)
        .zip(areas.iter().copied())
        .collect();
    losses.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
    let mut left = LOSS_AREA * areas.iter().sum::<f64>();
    let (loss, _) = losses.into_iter().find(|(_, area)| {
        left -= area;
        left <= 0.0
    })?;
    (loss > MOST_LOSS).then_some(Doubt::LossAboveOne { loss })
}
