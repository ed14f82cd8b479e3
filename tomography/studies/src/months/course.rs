//! Evaluates the same frames of a drifting scene by four approaches: the baseline of day 0 alone, gain and contacts
//! projected out, sizes of the drift by evidence, and the tracked baseline. For the diagrams of `tactus-lab tradeoff`.

use std::sync::Arc;

use drift::{DiscFit, Tracker, Whitened};
use imaging::{Geometry, Model};
use phantom::Load;
use rayon::prelude::*;
use survey::Reading;

use super::simulated::{Simulated, away_mm, model};
use super::single::{Locator, distance, locate, shipped};
use super::tracked::{DIAMETERS_MM, LongScene, MAP_SIZE};
use crate::failure::Attempt;
use crate::{Failure, progress, sheet};

const DAY_S: f64 = 86_400.0;
/// Interval of the frames of a judged day, s: empty sheet, press, empty sheet.
const STEP_S: f64 = 600.0;
/// Error assigned to a press that is not detected, mm: half the diagonal of the sheet.
const NOT_SEEN_MM: f64 = 157.0;

/// How frames are compared with the baseline.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Approach {
    Untracked,
    Projection,
    Evidence,
    Tracked,
}

impl Approach {
    pub(crate) const ALL: [Self; 4] = [
        Self::Untracked,
        Self::Projection,
        Self::Evidence,
        Self::Tracked,
    ];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Untracked => "no tracking",
            Self::Projection => "projection",
            Self::Evidence => "evidence",
            Self::Tracked => "tracker",
        }
    }
}

/// Extent of the comparison.
#[derive(Debug, Clone)]
pub(crate) struct Request<'a> {
    pub(crate) scenes: &'a [LongScene],
    /// Days of the judged frames, ascending, at times without a load.
    pub(crate) days: &'a [f64],
    /// Interval of the frames between the judged days, s; the tracker follows all of them.
    pub(crate) every_s: f64,
    /// Number of presses of each diameter on each of these days.
    pub(crate) presses: usize,
    pub(crate) seed: u64,
}

/// Result of one approach for one judged frame.
#[derive(Debug, Clone)]
pub(crate) struct Sample {
    pub(crate) scene: LongScene,
    pub(crate) approach: Approach,
    pub(crate) day: f64,
    pub(crate) result: Outcome,
}

#[derive(Debug, Clone, Copy)]
pub(crate) enum Outcome {
    /// Rms of the map of an empty sheet, %.
    Zero(f64),
    Press {
        diameter_mm: f64,
        error_mm: f64,
        /// Whether the fitted disc is accepted, and the squared distance of its centre from the truth in units of its
        /// covariance; `None` for an approach without a fit.
        disc: Option<(bool, f64)>,
    },
}

/// All samples, scene by scene.
pub(crate) fn samples(request: &Request<'_>) -> Result<Vec<Sample>, Failure> {
    let geometry = sheet::geometry()?;
    let one_step = shipped(&geometry)?;
    let bar = progress::bar(request.scenes.len() * request.days.len(), "months");
    let each: Vec<Vec<Sample>> = request
        .scenes
        .par_iter()
        .map(|&scene| of_scene(scene, request, &geometry, &one_step, &bar))
        .collect::<Result<_, _>>()?;
    bar.finish_and_clear();
    Ok(each.into_iter().flatten().collect())
}

/// A scene with its tracker.
struct Course<'a> {
    simulated: Simulated,
    baseline: Vec<Reading>,
    tracker: Tracker,
    geometry: &'a Geometry,
    one_step: &'a Model,
}

fn of_scene(
    scene: LongScene,
    request: &Request<'_>,
    geometry: &Geometry,
    one_step: &Model,
    bar: &indicatif::ProgressBar,
) -> Result<Vec<Sample>, Failure> {
    let mut simulated = Simulated::of(scene.name(), &scene.text(), request.seed)?;
    let baseline = simulated.frame(0.0, None)?;
    let tracker = Tracker::new(Arc::new(model(geometry, &baseline)?), 0.0).map_err(failed)?;
    let mut course = Course {
        simulated,
        baseline,
        tracker,
        geometry,
        one_step,
    };
    let (mut out, mut at_s) = (Vec::new(), 0.0);
    let most = scene.days(f64::INFINITY);
    for &day in request.days.iter().filter(|day| **day <= most) {
        while at_s + request.every_s < DAY_S * day {
            at_s += request.every_s;
            let frame = course.simulated.frame(at_s, None)?;
            course.tracker.follow(&frame, at_s).map_err(failed)?;
        }
        let mut add = |approach, result| {
            out.push(Sample {
                scene,
                approach,
                day,
                result,
            });
        };
        at_s = at_s.max(DAY_S * day) + STEP_S;
        for (approach, zero) in course.zeros(at_s)? {
            add(approach, Outcome::Zero(zero));
        }
        for _ in 0..request.presses {
            for diameter_mm in DIAMETERS_MM {
                let place = course.simulated.place();
                at_s += STEP_S;
                for (approach, error_mm, fit) in course.press(at_s, place, diameter_mm)? {
                    let disc = fit.map(|fit| (fit.accepted, distance(&fit, place)));
                    add(
                        approach,
                        Outcome::Press {
                            diameter_mm,
                            error_mm,
                            disc,
                        },
                    );
                }
                at_s += STEP_S;
                let frame = course.simulated.frame(at_s, None)?;
                course.tracker.follow(&frame, at_s).map_err(failed)?;
            }
        }
        bar.inc(1);
    }
    Ok(out)
}

fn failed(fault: drift::DriftError) -> Failure {
    Failure::of("the tracked baseline", &fault)
}

impl Course<'_> {
    /// Rms of the map of an empty sheet by each approach, %.
    fn zeros(&mut self, at_s: f64) -> Result<Vec<(Approach, f64)>, Failure> {
        let frame = self.simulated.frame(at_s, None)?;
        self.tracker.follow(&frame, at_s).map_err(failed)?;
        let model = Arc::clone(self.tracker.model());
        let relative = model.relative(&frame).map_err(failed)?;
        let (data, rows) = (&relative.data, &relative.rows);
        let whitened = |white: &Whitened| -> Result<f64, Failure> {
            let values = white.one_step(&model, MAP_SIZE).map_err(failed)?;
            let region = self.geometry.mesh.region().iter();
            Ok(self.rms(region.map(|&triangle| values[triangle])))
        };
        let shipped = |baseline: &[Reading]| -> Result<f64, Failure> {
            let map = self.one_step.reconstruct(baseline, &frame);
            let map = map.attempt("one-step")?;
            Ok(self.rms(map.values.into_iter()))
        };
        let tracked = model.baseline_with(&self.tracker.baseline());
        Ok(vec![
            (Approach::Untracked, shipped(&self.baseline)?),
            (
                Approach::Projection,
                whitened(&model.projected(data, rows).map_err(failed)?)?,
            ),
            (
                Approach::Evidence,
                whitened(&model.assess(data, rows).map_err(failed)?.whitened)?,
            ),
            (Approach::Tracked, shipped(&tracked)?),
        ])
    }

    fn rms(&self, values: impl Iterator<Item = f64>) -> f64 {
        let areas = self.geometry.mesh.region_areas();
        let (sum, all) = values
            .zip(&areas)
            .fold((0.0, 0.0), |(sum, all), (value, area)| {
                (sum + area * value * value, all + area)
            });
        100.0 * (sum / all).sqrt()
    }

    /// Evaluates a press by each approach: location error, mm, and fit.
    fn press(
        &mut self,
        at_s: f64,
        place: [f64; 2],
        diameter_mm: f64,
    ) -> Result<Vec<(Approach, f64, Option<DiscFit>)>, Failure> {
        let load = Load::disc(place, diameter_mm, 0.5);
        let frame = self.simulated.frame(at_s, Some(load))?;
        let model = Arc::clone(self.tracker.model());
        let (geometry, one_step) = (self.geometry, self.one_step);
        let mut out = Vec::new();
        for (locator, (at, fit)) in locate(&model, geometry, one_step, &self.baseline, &frame)? {
            let approach = match locator {
                Locator::OneStep => Approach::Untracked,
                Locator::Projection => Approach::Projection,
                Locator::EvidenceDisc => Approach::Evidence,
                Locator::EvidenceMap => continue,
            };
            out.push((approach, away_mm(at, place), fit));
        }
        let answer = self.tracker.follow(&frame, at_s).map_err(failed)?;
        let seen = answer.event.filter(|event| event.came);
        let error = seen
            .as_ref()
            .map_or(NOT_SEEN_MM, |event| away_mm(event.fit.disc.centre, place));
        out.push((Approach::Tracked, error, seen.map(|event| event.fit)));
        Ok(out)
    }
}
