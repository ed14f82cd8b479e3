//! Total variation with the full forward model: large and wide loads cause no linearisation error, and loads only
//! reduce conductance.
//!
//! - [`cells`]: the unknowns, ln sigma of the triangles of the region and of larger cells outside of it; the first
//!   steps use larger cells in the region too
//! - [`penalty`]: the least-squares problem of a step
//! - [`solver`]: Gauss-Newton method, first with few unknowns; a load that covers most of the sheet and changes slowly
//!   needs only these

mod cells;
mod penalty;
mod solver;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use survey::{Doubt, Evidence, Map, MapQuality, NextKind, Protocol, Reading};

use self::solver::{Found, Sheet};
use crate::inverse::frame_rule::{FrameRule, SIGNIFICANT};
use crate::inverse::learned::linear::Linear;
use crate::inverse::prior::Penalty;
use crate::inverse::reciprocity::Seen;
use crate::inverse::shapes::{Attempt, Explained, Shapes};
use crate::metrics::likeness;
use crate::{
    DEFAULT_NOISE_V, Forward, ForwardError, HyperRule, Mesh, OneStepError, OneStepOptions,
    ReconstructError, Reconstructor, Scale,
};

/// alpha times the square root of the region's area: the penalty of a border whose length is the region's width and
/// where ln sigma jumps by 1, in squared deviations of a reading. Chosen on loads of seed 7 (`tactus-lab honesty
/// --maps`): with a third of it, presses get sharper edges but wide loads get steps; three times as much blurs presses.
const STRENGTH: f64 = 11.0;
/// Standard deviation of the model's error as a share of the root mean square of a change: the unexplained share for
/// the true outlines of discs and rings, with data from a finer mesh.
const MODEL_ERROR: f64 = 0.004;
/// Error share at the start of the search, which includes the linearisation error. It is then lowered to the share that
/// the map leaves unexplained.
const FIRST_ERROR: f64 = 0.05;
/// Shapes explain a frame if their mean square residual is at most this multiple of the variance of the errors, plus
/// the variance of the model's error.
const ACCEPTED: f64 = 1.25;
/// Smallest mean correlation between a map and draws from its posterior; below it the map is doubtful. One limit for
/// shapes, whose posterior is too narrow, and one for total variation, whose draws are rougher than loads. Chosen on
/// loads of seed 31 (`tactus-lab honesty --maps`), where no map above these limits correlates with its load by less
/// than 0.5: decision 183.
const LEAST_OF_SHAPES: f64 = 0.95;
const LEAST_OF_VARIATION: f64 = 0.3;
/// Spread of the losses of the linear map above which a load may be smooth. Chosen on loads of seed 61 (`tactus-lab honesty --maps`):
/// ramps and fields have at least 0.5, all others at 2 and 20 uV at most 0.5.
const WIDE: f64 = 0.5;
/// Power of the sensitivity in the linear prior used to distinguish a frame from noise.
const NOSER_POWER: f64 = 0.25;

/// Settings of a [`NonlinearTv`].
#[derive(Debug, Clone, PartialEq)]
pub struct NonlinearTvOptions {
    /// Standard deviation of one reading, V, the same on baseline and frame. If `None`, the errors are estimated from
    /// the residual of each frame's map.
    pub noise_v: Option<f64>,
    /// Injected current to which `noise_v` refers, A.
    pub current_a: f64,
    /// Largest share of a frame's squared change that a map of losses alone may leave unexplained, in addition to the
    /// share left by a map with gains. If it leaves more, gains are not penalised. `None`: maps show losses only.
    pub most_gain: Option<f64>,
    /// The baseline's scale.
    pub scale: Scale,
}

impl Default for NonlinearTvOptions {
    /// 2 uV of noise at 1 mA, no gains.
    fn default() -> Self {
        Self {
            noise_v: Some(DEFAULT_NOISE_V),
            current_a: 1e-3,
            most_gain: None,
            scale: Scale::default(),
        }
    }
}

/// Reconstructs maps by total variation of the logarithm of conductance on the whole sheet, with the full forward model.
///
/// The errors of a reading are the noise, or 0.4 % of the change if that is larger; they are raised to the unexplained
/// rest of the map.
pub struct NonlinearTv {
    linear: Linear,
    sheet: Sheet,
    /// Judges whether a frame shows more than noise.
    rule: FrameRule,
    shapes: Shapes,
    /// Standard deviation of a change due to noise, in the unit of the data; `None` if unknown.
    noise: Option<f64>,
    protocol: Protocol,
    most_gain: Option<f64>,
}

const METHOD: &str = "nonlinear total variation";
const SMOOTH: &str = "smooth load, loss only";
/// [`Map::method`] of a frame that a linear map explains no better than noise does.
pub const NOISE_ONLY: &str = "nothing but noise";

impl NonlinearTv {
    /// Solves the forward model at `sigma0` (S per square, one per triangle of the mesh). Maps show the region of the mesh.
    ///
    /// # Errors
    /// A setting that is not a positive number, or a geometry that cannot be solved.
    pub fn new(
        mesh: Arc<Mesh>,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        protocol: &Protocol,
        options: NonlinearTvOptions,
    ) -> Result<Self, OneStepError> {
        let noise = options.noise_v.map(|volts| ("noise", volts));
        for (what, value) in noise.into_iter().chain([("current", options.current_a)]) {
            OneStepError::positive(what, value)?;
        }
        let shared = OneStepOptions {
            scale: options.scale.clone(),
            ..OneStepOptions::default()
        };
        let forward = Forward::new(Arc::clone(&mesh), contact_ohm_m)?;
        let linear = Linear::without_sensitivity(&forward, sigma0, protocol, &shared)?;
        let questions = linear.fold.half(protocol)?;
        let area: f64 = mesh.region_areas().iter().sum();
        let deviation = |volts| options.scale.deviation(volts, options.current_a);
        let noise = options.noise_v.map(deviation);
        let shapes = Shapes::new(&mesh, contact_ohm_m, sigma0, &questions, linear.fold.norm())?;
        let sheet = Sheet::new(
            forward,
            questions,
            linear.fold.norm(),
            sigma0,
            STRENGTH / area.sqrt(),
        )?;
        let sensitivity = sheet.fine.sensitivity.clone();
        let penalty = Penalty::noser(&sensitivity, NOSER_POWER);
        let rule = FrameRule::new(HyperRule::Evidence, noise, &linear, sensitivity, &penalty)?;
        Ok(Self {
            noise,
            protocol: protocol.clone(),
            most_gain: options.most_gain,
            linear,
            sheet,
            rule,
            shapes,
        })
    }

    /// The map of a change.
    fn map(&self, seen: &Seen, missing: &[usize]) -> Result<Map, String> {
        let text = |fault: OneStepError| fault.to_string();
        let forward = |fault: ForwardError| fault.to_string();
        let preference = self.rule.preference(seen, missing).map_err(text)?;
        let (_, mut linear) = self.rule.map(seen, missing).map_err(text)?;
        if preference <= SIGNIFICANT {
            linear.truncate(self.mesh().region().len());
            return Ok(self.of_values(linear, NOISE_ONLY));
        }
        let count = seen.data.len() as f64;
        let size = (seen.data.norm_squared() / count).sqrt();
        let model = MODEL_ERROR * size;
        let noise = self.noise.unwrap_or(0.0);
        let least = noise.max(model);
        let first = least.max(FIRST_ERROR * size);
        let most = |error: f64| ACCEPTED * error * error + model * model;
        // shapes take a tenth of the time of the minimum, a smooth load a fifth
        let mut next = None;
        if self.noise.is_some() {
            let start = self.shown(&linear, 0.0);
            let (shapes, most) = (&self.shapes, most(least));
            if self.spread(&start) > WIDE {
                let disc = shapes.one_disc(seen, least, most, &start);
                let disc = disc.map_err(forward)?;
                if disc.as_ref().is_none_or(|disc| disc.left > 1.0) {
                    let smooth = self.sheet.smooth_minimum(seen, first, least, most);
                    if let Some((found, left)) = smooth.map_err(forward)? {
                        return Ok(self.of_smooth(&found, left, disc));
                    }
                }
            }
            match shapes.explain(seen, least, most, &start).map_err(forward)? {
                Attempt::Explained(shapes) => return Ok(self.of_shapes(shapes)),
                Attempt::Unexplained(nearest) => next = nearest,
            }
        }
        let minimum = |bounded: bool| -> Result<Found<'_>, String> {
            let found = self.sheet.minimum(seen, first, least, bounded);
            found
                .map_err(|fault| fault.to_string())?
                .ok_or_else(|| "a step could not be solved".to_owned())
        };
        let found = minimum(true)?;
        if let Some(most) = self.most_gain.filter(|most| found.left > *most) {
            let free = minimum(false)?;
            if found.left - free.left > most {
                return Ok(self.of_minimum(&free, f64::INFINITY, METHOD, next));
            }
        }
        let map = self.shown(&found.change, 0.0);
        let error = found.error.clamp(noise, 2.0 * least);
        let deviation = found.error.max(least);
        let shapes = self.shapes.explain(seen, deviation, most(error), &map);
        Ok(match shapes.map_err(forward)? {
            Attempt::Explained(shapes) => self.of_shapes(shapes),
            Attempt::Unexplained(nearest) => {
                let method = format!("{METHOD}, loss only");
                self.of_minimum(&found, 0.0, &method, nearest.or(next))
            }
        })
    }

    /// The mean of the maps of all probable shapes.
    fn of_shapes(&self, shapes: Explained) -> Map {
        let mut values = vec![0.0; self.mesh().region().len()];
        for possible in &shapes.maps {
            for (sum, value) in values.iter_mut().zip(possible) {
                *sum += value / shapes.maps.len() as f64;
            }
        }
        Map {
            quality: self.doubt(&values, &shapes.maps, LEAST_OF_SHAPES),
            evidence: Some(shapes.evidence),
            ..self.of_values(values, &shapes.name)
        }
    }

    /// The map of a minimum; `next`: the next best explanation by shapes.
    fn of_minimum(
        &self,
        found: &Found<'_>,
        most: f64,
        method: &str,
        next: Option<NextKind>,
    ) -> Map {
        let evidence = Evidence { left: None, next };
        self.of_found(found, method, evidence, |change| self.shown(change, most))
    }

    /// The map of a smooth load with residual `left`, as a share of the accepted one; `next`: the disc, whose residual
    /// is larger.
    fn of_smooth(&self, found: &Found<'_>, left: f64, next: Option<NextKind>) -> Map {
        let evidence = Evidence {
            left: Some(left),
            next,
        };
        self.of_found(found, SMOOTH, evidence, |change| {
            self.shown(&self.sheet.smooth(change), 0.0)
        })
    }

    /// `shown`: the map of a change of the cells.
    fn of_found(
        &self,
        found: &Found<'_>,
        method: &str,
        evidence: Evidence,
        shown: impl Fn(&[f64]) -> Vec<f64>,
    ) -> Map {
        let values = shown(&found.change);
        let possible: Vec<Vec<f64>> = found.possible().iter().map(|u| shown(u)).collect();
        Map {
            quality: self.doubt(&values, &possible, LEAST_OF_VARIATION),
            evidence: Some(evidence),
            ..self.of_values(values, method)
        }
    }

    fn of_values(&self, values: Vec<f64>, method: &str) -> Map {
        Map::relative(self.mesh().hash(), values, method)
    }

    /// (sum |x|)^2 over area and sum x^2: 1 for a uniform change; for one load, the share of the area that changed.
    fn spread(&self, map: &[f64]) -> f64 {
        let areas = self.mesh().region_areas();
        let sum = |power: i32| -> f64 {
            let all = areas.iter().zip(map);
            all.map(|(area, x)| area * x.abs().powi(power)).sum()
        };
        sum(1).powi(2) / (areas.iter().sum::<f64>() * sum(2)).max(f64::MIN_POSITIVE)
    }

    /// The doubt of a map whose mean correlation with other possible maps is below `least`: the noise allows too
    /// different ones.
    fn doubt(&self, map: &[f64], possible: &[Vec<f64>], least: f64) -> Option<MapQuality> {
        let areas = self.mesh().region_areas();
        let all = possible.iter().map(|other| {
            let correlation = likeness(map, other, &areas).correlation;
            // an empty map agrees with no other one
            if correlation.is_nan() {
                0.0
            } else {
                correlation
            }
        });
        let correlation = all.sum::<f64>() / possible.len().max(1) as f64;
        (correlation < least).then(|| MapQuality::of(&[Doubt::NoiseLimit { correlation }]))
    }

    /// The relative changes in the region, limited to `most`.
    fn shown(&self, change: &[f64], most: f64) -> Vec<f64> {
        let region = self.mesh().region().len();
        let changes = change[..region].iter();
        changes.map(|change| change.exp_m1().min(most)).collect()
    }
}

impl Reconstructor for NonlinearTv {
    fn method(&self) -> &str {
        METHOD
    }

    fn protocol(&self) -> &Protocol {
        &self.protocol
    }

    fn mesh(&self) -> &Arc<Mesh> {
        self.sheet.forward.mesh()
    }

    fn assumptions(&self) -> Vec<String> {
        let mesh = self.mesh();
        vec![
            format!(
                "total variation of ln sigma on the whole sheet ({} cells; the map shows the {} of the region), with the full \
                 forward model",
                self.sheet.fine.cells.count(),
                mesh.region().len()
            ),
            match self.noise {
                Some(noise) => format!(
                    "white noise with a deviation of {noise:.2e} on each change, and an error of the model of {:.1} % of the change",
                    100.0 * MODEL_ERROR
                ),
                None => "the size of the errors is estimated from each frame".to_owned(),
            },
            match self.most_gain {
                None => "loads only reduce conductance".to_owned(),
                Some(most) => format!(
                    "loads only reduce conductance, unless that leaves more than {:.0} % of a frame's change unexplained",
                    100.0 * most
                ),
            },
        ]
    }

    fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        let (change, missing) = self.linear.change(baseline, frame, METHOD)?;
        let seen = self.linear.fold.seen(&change, &missing);
        let map = match seen.data.norm_squared() > 0.0 {
            false => self.of_values(vec![0.0; self.mesh().region().len()], METHOD),
            true => self.map(&seen, &missing).map_err(|cause| {
                let method = METHOD.to_owned();
                ReconstructError::Numerical { method, cause }
            })?,
        };
        Ok(Map {
            masked: missing.len(),
            ..map
        })
    }
}
