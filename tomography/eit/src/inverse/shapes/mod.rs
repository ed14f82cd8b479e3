//! Explains a frame by a few shapes.
//!
//! A frame of few presses has few unknowns: position, size and loss of each. They are fitted with the full forward
//! model, starting from the peaks of another method's map. The residual of the fit shows whether shapes explain the
//! frame.
//!
//! - [`shape`]: shapes as free parameters with a prior; [`starts`]: shapes at the peaks of a map
//! - [`coverage`]: the share of each triangle that an outline covers; [`model`]: readings and their derivatives
//! - [`fit`]: Levenberg-Marquardt; [`rest`]: finds another disc in the residual of a fit; [`posterior`]: draws of the
//!   probable shapes

mod coverage;
mod fit;
mod model;
mod posterior;
mod rest;
mod shape;
mod starts;

use std::sync::Arc;

use survey::{Evidence, NextKind, Protocol};

use self::coverage::Cover;
use self::fit::{Data, Fit, Hopeless, Problem};
use self::model::SheetModel;
use self::rest::Grid;
use self::shape::{Kind, Shape};
use self::starts::{MOST, Peak, Peaks};
use crate::inverse::reciprocity::Seen;
use crate::{ForwardError, Mesh};

/// One disc is accepted without further tests if it leaves at most this share of the allowed residual; otherwise other
/// shapes are tried too.
const PLAIN: f64 = 0.9;
/// If a disc leaves more than this multiple of the allowed residual, the load is neither a ring nor a disc with a soft
/// edge.
const NEAR: f64 = 1000.0;
/// If one disc leaves more than this multiple of the allowed residual after its first step, its fit is abandoned if a
/// smooth load is more probable.
const HOPELESS: f64 = 100.0;
/// The fit of a disc with a soft edge is abandoned if, after its first three steps, it leaves more than this multiple
/// of the disc's residual.
const WORSE: f64 = 1.2;
/// Ratio of inner to outer radius of a ring above which it cannot be confused with a soft edge.
const HOLE: f64 = 0.5;
/// Radius, m, below which readings do not distinguish a disc from a ring or a soft edge, because model errors dominate.
const RESOLVED: f64 = 0.010;
/// Discs are added to those at the peaks if these leave less than this multiple of the allowed residual, and if each
/// added disc leaves at most this share of the previous residual (decision 194).
const FEW: f64 = 50.0;
const HELPS: f64 = 0.5;

/// Fits shapes to frames of a sheet.
pub(crate) struct Shapes {
    model: SheetModel,
    cover: Cover,
    peaks: Peaks,
    grid: Grid,
    shown: Vec<usize>,
}

/// A frame explained by shapes.
pub(crate) struct Explained {
    /// Maps of the region, drawn from the posterior of the shapes.
    pub(crate) maps: Vec<Vec<f64>>,
    /// Name of the shapes.
    pub(crate) name: String,
    pub(crate) evidence: Evidence,
}

/// Result of fitting shapes to a frame.
pub(crate) enum Attempt {
    Explained(Explained),
    /// No shapes explain the frame; contains the best of the shapes that were tried, if any.
    Unexplained(Option<NextKind>),
}

impl Shapes {
    /// `questions`: measurements of the folded readings; `factors`: factor of each.
    pub(crate) fn new(
        mesh: &Arc<Mesh>,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        questions: &Protocol,
        factors: &[f64],
    ) -> Result<Self, ForwardError> {
        let whole = Arc::new(mesh.whole());
        Ok(Self {
            model: SheetModel::new(&whole, contact_ohm_m, sigma0, questions, factors)?,
            cover: Cover::new(&whole),
            peaks: Peaks::new(mesh),
            grid: Grid::default(),
            shown: mesh.region().to_vec(),
        })
    }

    /// Fits shapes that start at the largest peaks of a map (relative changes of the region), and returns the fewest
    /// whose mean square residual is at most `most`. `deviation`: standard deviation of a reading.
    pub(crate) fn explain(
        &self,
        seen: &Seen,
        deviation: f64,
        most: f64,
        map: &[f64],
    ) -> Result<Attempt, ForwardError> {
        let frame = self.frame(seen, deviation, most);
        let peaks = self.peaks.of(map);
        let Some(first) = peaks.first() else {
            return Ok(Attempt::Unexplained(None));
        };
        let singles = frame.one_shape(first)?;
        // only the most probable single shape, even if a less probable one explains the frame: a disc that nearly
        // explains it is evidence against a shape that barely does
        let one = Some(&singles[0]).filter(|fit| frame.explained_by(fit));
        let several = match one {
            Some(one) if one.shapes[0].kind == Kind::Disc => None,
            Some(_) => frame.discs(&peaks)?,
            None => {
                let discs = singles
                    .iter()
                    .filter(|fit| fit.shapes[0].kind == Kind::Disc);
                let several = discs.cloned().chain(frame.discs(&peaks)?);
                several
                    .min_by(|a, b| a.misfit.total_cmp(&b.misfit))
                    .map(|fit| frame.more_discs(fit, &self.grid))
                    .transpose()?
            }
        };
        let explains = several.as_ref().filter(|fit| frame.explained_by(fit));
        let tried = || singles.iter().chain(&several);
        let Some(chosen) = likeliest(one.into_iter().chain(explains)) else {
            let nearest = tried().min_by(|a, b| a.misfit.total_cmp(&b.misfit));
            let next = nearest.map(|fit| frame.described(fit, None));
            return Ok(Attempt::Unexplained(next));
        };
        let next = likeliest(tried().filter(|fit| !std::ptr::eq(*fit, chosen)));
        let shown = |map: Vec<f64>| self.shown.iter().map(|&t| map[t]).collect();
        let maps = posterior::maps(&frame.problem, chosen);
        Ok(Attempt::Explained(Explained {
            maps: maps.into_iter().map(shown).collect(),
            name: chosen.name(),
            evidence: Evidence {
                left: Some(frame.left(chosen)),
                next: next.map(|fit| frame.described(fit, Some(fit.cost() - chosen.cost()))),
            },
        }))
    }

    /// Fits one disc at the largest peak of a map, with the arguments of [`Self::explain`]; it explains the frame if
    /// its relative residual is at most 1. `None` for a map without losses.
    pub(crate) fn one_disc(
        &self,
        seen: &Seen,
        deviation: f64,
        most: f64,
        map: &[f64],
    ) -> Result<Option<NextKind>, ForwardError> {
        let frame = self.frame(seen, deviation, most);
        let described = |peak: &Peak| {
            let start = std::slice::from_ref(&peak.disc);
            let fit = frame.fit_unless(
                start,
                Hopeless {
                    after: 1,
                    misfit: HOPELESS * frame.wanted,
                },
            )?;
            Ok(frame.described(&fit, None))
        };
        self.peaks.of(map).first().map(described).transpose()
    }

    fn frame(&self, seen: &Seen, deviation: f64, most: f64) -> Frame<'_> {
        let rows = self.model.baseline.len();
        Frame {
            problem: Problem {
                model: &self.model,
                cover: &self.cover,
            },
            data: Data {
                white: seen.spread(rows) / deviation,
                weights: seen.shares(rows) / deviation,
            },
            wanted: 0.5 * most * seen.data.len() as f64 / (deviation * deviation),
        }
    }
}

/// Whether the last disc touches no other disc: discs that touch represent another shape.
fn lies_apart(discs: &[Shape]) -> bool {
    let Some((last, others)) = discs.split_last() else {
        return true;
    };
    others.iter().all(|other| {
        let [a, b] = [last, other].map(Shape::centre);
        (a[0] - b[0]).hypot(a[1] - b[1]) > last.radius() + other.radius()
    })
}

fn likeliest<'a>(fits: impl Iterator<Item = &'a Fit>) -> Option<&'a Fit> {
    fits.min_by(|a, b| a.cost().total_cmp(&b.cost()))
}

/// A frame to be explained.
struct Frame<'a> {
    problem: Problem<'a>,
    data: Data,
    /// Largest misfit of shapes that explain the frame.
    wanted: f64,
}

impl Frame<'_> {
    fn fit(&self, start: &[Shape]) -> Result<Fit, ForwardError> {
        self.fit_unless(start, Hopeless::NEVER)
    }

    fn fit_unless(&self, start: &[Shape], hopeless: Hopeless) -> Result<Fit, ForwardError> {
        self.problem.fit(&self.data, start, self.wanted, hopeless)
    }

    fn explained_by(&self, fit: &Fit) -> bool {
        fit.misfit <= self.wanted
    }

    /// Mean square residual of a fit relative to the allowed one.
    fn left(&self, fit: &Fit) -> f64 {
        fit.misfit / self.wanted
    }

    fn described(&self, fit: &Fit, ln_odds: Option<f64>) -> NextKind {
        NextKind {
            method: fit.name(),
            left: self.left(fit),
            ln_odds,
        }
    }

    /// The kinds of single shapes that were tried, most probable first.
    fn one_shape(&self, at: &Peak) -> Result<Vec<Fit>, ForwardError> {
        let disc = self.fit(std::slice::from_ref(&at.disc))?;
        if self.left(&disc) <= PLAIN {
            return Ok(vec![disc]);
        }
        let mut fits = vec![];
        if let Some(bar) = at.bar.clone() {
            fits.push(self.fit(&[bar])?);
        }
        let own = &disc.shapes[0];
        if self.left(&disc) < NEAR && own.radius() > RESOLVED {
            let ring = self.fit(&[own.ring()])?;
            let has_hole = ring.shapes[0].hole() > HOLE && ring.misfit < HELPS * disc.misfit;
            if !(has_hole && self.explained_by(&ring)) {
                let hopeless = Hopeless {
                    after: 3,
                    misfit: WORSE * disc.misfit,
                };
                fits.push(self.fit_unless(&[own.soft()], hopeless)?);
            }
            fits.push(ring);
        }
        fits.push(disc);
        fits.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
        Ok(fits)
    }

    /// Adds discs found in the residual until they explain the frame or another disc does not help.
    fn more_discs(&self, mut fit: Fit, grid: &Grid) -> Result<Fit, ForwardError> {
        while !self.explained_by(&fit) && self.left(&fit) < FEW && fit.shapes.len() < MOST {
            let Some(disc) = grid.another(&self.problem, &self.data, &fit)? else {
                break;
            };
            let mut start = fit.shapes.clone();
            start.push(disc);
            let more = self.fit(&start)?;
            if more.misfit > HELPS * fit.misfit || !lies_apart(&more.shapes) {
                break;
            }
            fit = more;
        }
        Ok(fit)
    }

    /// The fewest discs (two or more) at peaks that explain the frame; discs at all peaks if these do not explain it.
    /// `None` with fewer than two peaks.
    fn discs(&self, peaks: &[Peak]) -> Result<Option<Fit>, ForwardError> {
        let together = |count: usize| {
            let start: Vec<Shape> = peaks[..count].iter().map(|at| at.disc.clone()).collect();
            self.fit(&start)
        };
        if peaks.len() < 2 {
            return Ok(None);
        }
        // if discs at all peaks do not explain the frame, fewer discs are not tried
        let all = together(peaks.len())?;
        if !self.explained_by(&all) {
            return Ok(Some(all));
        }
        for count in 2..peaks.len() {
            let fewer = together(count)?;
            if self.explained_by(&fewer) {
                return Ok(Some(fewer));
            }
        }
        Ok(Some(all))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Case;
    use crate::DiscTank;
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn tank() -> Case {
        let tank = DiscTank {
            radius_mm: 100.0,
            fineness: 0.7,
            ..DiscTank::default()
        };
        let mesh = tank.mesh().unwrap();
        let protocol = Protocol::sheffield(16).unwrap();
        Case {
            contact_ohm_m: tank.contact_ohm_m(),
            currents: vec![1e-3; protocol.len()],
            has_region: false,
            protocol,
            sigma: [("homog".to_owned(), vec![1e-3; mesh.triangles().len()])].into(),
            mesh: Arc::new(mesh),
        }
    }

    fn model_of(case: &Case) -> SheetModel {
        SheetModel::new(
            &case.mesh,
            &case.contact_ohm_m,
            &case.sigma["homog"],
            &case.protocol,
            &case.currents,
        )
        .unwrap()
    }

    #[test]
    fn the_area_covered_is_the_outlines_own() {
        let case = tank();
        let cover = Cover::new(&case.mesh);
        let areas = case.mesh.region_areas();
        let mut random = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..50 {
            // well inside of the tank
            let place = [0, 1].map(|_| random.random_range(-0.02..0.02));
            let shape = Shape::disc(place, random.random_range(0.002..0.06), 0.5);
            let outline = shape.layers().remove(0).0;
            let o = outline[0];
            let own: f64 = outline
                .windows(2)
                .map(|w| {
                    let (p, q) = (
                        [w[0][0] - o[0], w[0][1] - o[1]],
                        [w[1][0] - o[0], w[1][1] - o[1]],
                    );
                    0.5 * (p[0] * q[1] - p[1] * q[0])
                })
                .sum();
            let covered: f64 = cover
                .of(&outline)
                .iter()
                .map(|&(t, share)| share * areas[t as usize])
                .sum();
            assert!((covered - own).abs() < 1e-12, "{covered} {own}");
        }
    }

    #[test]
    fn sensitivities_of_every_kind_are_slopes_of_the_readings() {
        let case = tank();
        let model = model_of(&case);
        let cover = Cover::new(&case.mesh);
        let problem = Problem {
            model: &model,
            cover: &cover,
        };
        let disc = Shape::disc([0.02, -0.01], 0.03, 0.6);
        let bar = Shape::bar([0.02, -0.01], [0.03, 0.01], 0.01, 0.6);
        let readings = |shape: &Shape| {
            let solved = model.solve(&problem.map(std::slice::from_ref(shape)));
            DVector::from_vec(solved.unwrap().change)
        };
        for shape in [disc.soft(), disc.ring(), disc, bar] {
            let weights = DVector::from_element(case.protocol.len(), 1.0);
            let data = Data {
                white: weights.clone(),
                weights,
            };
            let (_, j) = problem.rest(&data, std::slice::from_ref(&shape)).unwrap();
            for parameter in 0..shape.theta.len() {
                let moved = |step: f64| {
                    let mut moved = shape.clone();
                    moved.theta[parameter] += step;
                    readings(&moved)
                };
                let slope = (moved(1e-3) - moved(-1e-3)) / 2e-3;
                let wrong = (&slope - j.column(parameter)).norm() / slope.norm();
                assert!(wrong < 1e-3, "{:?} {parameter}: {wrong:e}", shape.kind);
            }
        }
    }

    #[test]
    fn derivatives_are_those_of_the_forward_model() {
        let flat = tank();
        let depth = crate::Depth::new(0.2, 0.02, 0.07, 12).unwrap();
        let deep = Arc::new(flat.mesh.with_depth(Some(depth)));
        for mesh in [Arc::clone(&flat.mesh), deep] {
            check_derivatives(&Case {
                mesh,
                ..flat.clone()
            });
        }
    }

    fn check_derivatives(case: &Case) {
        let model = model_of(case);
        let unknowns = case.mesh.region().len();
        let map: Vec<f64> = (0..unknowns)
            .map(|k| -0.5 * f64::from(u8::from(k % 3 == 0)))
            .collect();
        let direction: Vec<f64> = (0..unknowns).map(|k| ((k * 7) % 5) as f64 - 2.0).collect();
        let solved = model.solve(&map).unwrap();
        let listed = direction
            .iter()
            .enumerate()
            .map(|(k, d)| (k as u32, *d))
            .collect();
        let along: DMatrix<f64> = model.along(&solved, &[listed]).unwrap();
        let moved = |step: f64| {
            let map: Vec<f64> = map
                .iter()
                .zip(&direction)
                .map(|(x, d)| x + step * d)
                .collect();
            model.solve(&map).unwrap().change
        };
        let (up, down) = (moved(1e-5), moved(-1e-5));
        let size = along.amax();
        for reading in 0..up.len() {
            let difference = (up[reading] - down[reading]) / 2e-5;
            assert!((difference - along[(reading, 0)]).abs() < 1e-6 * size);
        }
    }
}
