//! Explains a frame by a few discs.
//!
//! A frame of few presses has few unknowns: place, radius and loss of each. They are fitted with the full forward model,
//! starting from the peaks of a map of another method. What the fit leaves unexplained tells whether discs explain the frame.
//!
//! - [`disc`]: a disc as free parameters with a prior; [`starts`]: discs at the peaks of a map
//! - [`coverage`]: the share of each triangle that an outline covers; [`model`]: readings and their derivatives
//! - [`fit`]: Levenberg and Marquardt; [`posterior`]: draws of what they may be

mod coverage;
mod disc;
mod fit;
mod model;
mod posterior;
mod starts;

use std::sync::Arc;

use survey::Protocol;

use self::coverage::Cover;
use self::disc::{Kind, Shape};
use self::fit::{Data, Fit, Problem};
use self::model::SheetModel;
use self::starts::Peaks;
use crate::inverse::reciprocity::Seen;
use crate::{ForwardError, Mesh};

/// One disc is taken as it is if it leaves at most this share of what may be left; else other shapes are tried too.
const PLAIN: f64 = 0.9;
/// A disc that leaves more than this many times what may be left is neither a ring nor a disc with a soft edge.
const NEAR: f64 = 300.0;

/// Fits discs to frames of a sheet.
pub(crate) struct Discs {
    model: SheetModel,
    cover: Cover,
    peaks: Peaks,
    shown: Vec<usize>,
}

/// A frame as discs.
pub(crate) struct Explained {
    /// Maps of the region of what the discs may be.
    pub(crate) maps: Vec<Vec<f64>>,
    /// Its shapes.
    pub(crate) name: String,
}

impl Discs {
    /// `questions`: those of the folded readings; `factors`: of each.
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
            shown: mesh.region().to_vec(),
        })
    }

    /// Fits discs that start at the largest peaks of a map (relative changes of the region): the fewest that leave a mean square
    /// of at most `most`; `deviation`: of a reading. `None` if one disc and all peaks together leave more.
    pub(crate) fn explain(
        &self,
        seen: &Seen,
        deviation: f64,
        most: f64,
        map: &[f64],
    ) -> Result<Option<Explained>, ForwardError> {
        let rows = self.model.baseline.len();
        let problem = Problem {
            model: &self.model,
            cover: &self.cover,
        };
        let data = Data {
            white: seen.spread(rows) / deviation,
            weights: seen.shares(rows) / deviation,
        };
        let wanted = 0.5 * most * seen.data.len() as f64 / (deviation * deviation);
        let peaks = self.peaks.of(map);
        let Some(first) = peaks.first() else {
            return Ok(None);
        };
        let explains = |fit: &Fit| fit.misfit <= wanted;
        let fitted = |shape: Shape| problem.fit(&data, &[shape], wanted);
        let disc = fitted(first.disc.clone())?;
        let mut likely = Some(disc.clone()).filter(explains);
        if disc.misfit > PLAIN * wanted {
            let own = &disc.shapes[0];
            let round = [own.soft(), own.ring()];
            let round = round.into_iter().filter(|_| disc.misfit < NEAR * wanted);
            for shape in first.bar.clone().into_iter().chain(round) {
                let fit = fitted(shape)?;
                if explains(&fit) && likely.as_ref().is_none_or(|than| fit.cost() < than.cost()) {
                    likely = Some(fit);
                }
            }
        }
        if likely.is_none() && peaks.len() > 1 {
            let together = |count: usize| {
                let start: Vec<Shape> = peaks[..count].iter().map(|at| at.disc.clone()).collect();
                let fit = problem.fit(&data, &start, wanted)?;
                Ok::<_, ForwardError>(Some(fit).filter(explains))
            };
            // a frame that all peaks do not explain is given up at once
            let all = together(peaks.len())?;
            for count in 2..peaks.len() {
                if all.is_none() || likely.is_some() {
                    break;
                }
                likely = together(count)?;
            }
            likely = likely.or(all);
        }
        Ok(likely.map(|fit| {
            let shown = |map: Vec<f64>| self.shown.iter().map(|&t| map[t]).collect();
            let maps = posterior::maps(&problem, &fit);
            Explained {
                maps: maps.into_iter().map(shown).collect(),
                name: match fit.shapes.as_slice() {
                    [shape] if shape.kind != Kind::Disc => shape.kind.name().to_owned(),
                    discs => format!("discs ({})", discs.len()),
                },
            }
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Case;
    use crate::DiscTank;
    use nalgebra::DMatrix;
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
        let model = SheetModel::new(
            &case.mesh,
            &case.contact_ohm_m,
            &case.sigma["homog"],
            &case.protocol,
            &case.currents,
        )
        .unwrap();
        let unknowns = case.mesh.region().len();
        let map: Vec<f64> = (0..unknowns)
            .map(|k| -0.5 * f64::from(u8::from(k % 3 == 0)))
            .collect();
        let direction: Vec<f64> = (0..unknowns).map(|k| ((k * 7) % 5) as f64 - 2.0).collect();
        let solved = model.solve(&map).unwrap();
        let listed = direction
            .iter()
            .enumerate()
            .map(|(k, d)| (k as u32, vec![(0, *d)]))
            .collect();
        let along: DMatrix<f64> = model.along(&solved, &listed, 1).unwrap();
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
