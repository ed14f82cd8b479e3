//! Searches for another disc in the residual of a fit.

use std::sync::OnceLock;

use nalgebra::DMatrix;

use super::fit::{Data, Fit, Problem};
use super::shape::Shape;
use crate::linear_algebra::dense;
use crate::{ForwardError, bounding_box};

/// Grid spacing of the positions that are tried, m, and the largest number of them along the longer side of the sheet.
const PITCH: f64 = 8e-3;
const MOST_ALONG: f64 = 40.0;
/// Radii that are tried, m.
const RADII: [f64; 2] = [6e-3, 15e-3];
/// Range of the loss with which a disc starts.
const LOSSES: [f64; 2] = [0.05, 0.9];
/// Share of a disc's data that the shapes of the fit do not explain, below which the disc is not a new one.
const LEAST_NEW: f64 = 1e-3;

/// A grid of discs, with the linear change of the readings caused by each.
#[derive(Default)]
pub(super) struct Grid {
    once: OnceLock<Discs>,
}

struct Discs {
    discs: Vec<([f64; 2], f64)>,
    /// A column per disc: change of the readings if it loses all conductance, V.
    columns: DMatrix<f64>,
}

impl Grid {
    fn of(&self, problem: &Problem<'_>) -> Result<&Discs, ForwardError> {
        if let Some(discs) = self.once.get() {
            return Ok(discs);
        }
        let discs = Discs::new(problem)?;
        Ok(self.once.get_or_init(|| discs))
    }

    /// The disc that explains most of a fit's residual, apart from what a change of the fit's own shapes explains.
    pub(super) fn another(
        &self,
        problem: &Problem<'_>,
        data: &Data,
        fit: &Fit,
    ) -> Result<Option<Shape>, ForwardError> {
        let all = self.of(problem)?;
        let (mut rest, slopes) = problem.rest(data, &fit.shapes)?;
        // the residual that a change of the shapes does not explain, weighted like the columns of the grid
        let mut own = slopes.qr().q();
        rest -= &own * own.tr_mul(&rest);
        rest.component_mul_assign(&data.weights);
        for mut column in own.column_iter_mut() {
            column.component_mul_assign(&data.weights);
        }
        let squares = data.weights.map(|weight| weight * weight);
        let explained = dense::product(dense::view(&own).transpose(), dense::view(&all.columns));
        let mut best: Option<(f64, usize, f64)> = None;
        for (k, column) in all.columns.column_iter().enumerate() {
            let whole = column.component_mul(&column).dot(&squares);
            let new = whole - explained.column(k).norm_squared();
            let change = column.dot(&rest) / new;
            let gain = change * change * new;
            if new > LEAST_NEW * whole && change > 0.0 && best.is_none_or(|(most, ..)| gain > most)
            {
                best = Some((gain, k, change));
            }
        }
        Ok(best.map(|(_, k, change)| {
            let (centre, radius) = all.discs[k];
            let loss = 2.0 * change / (2.0 + change);
            Shape::disc(centre, radius, loss.clamp(LOSSES[0], LOSSES[1]))
        }))
    }
}

impl Discs {
    fn new(problem: &Problem<'_>) -> Result<Self, ForwardError> {
        let mesh = &problem.model.mesh;
        let [low, high] = bounding_box(mesh.nodes().iter().copied());
        let longest = (high[0] - low[0]).max(high[1] - low[1]);
        let pitch = PITCH.max(longest / MOST_ALONG);
        let along = |axis: usize| {
            let count = ((high[axis] - low[axis]) / pitch) as usize;
            (0..count).map(move |k| low[axis] + (k as f64 + 0.5) * pitch)
        };
        let mut discs = Vec::new();
        let mut directions = Vec::new();
        for radius in RADII {
            for y in along(1) {
                for x in along(0) {
                    let covered = problem.covered(&Shape::disc([x, y], radius, 0.5));
                    if !covered.is_empty() {
                        discs.push(([x, y], radius));
                        directions.push(covered);
                    }
                }
            }
        }
        let unloaded = problem.model.solve(&vec![0.0; mesh.region().len()])?;
        Ok(Self {
            columns: problem.model.along(&unloaded, &directions)?,
            discs,
        })
    }
}
