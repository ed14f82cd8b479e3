//! Gauss-Newton method for total variation of the logarithm of conductance, with a penalty on gains.
//!
//! f(u) = |d - c(u)|^2 / 2 s^2 + alpha sum L_e sqrt((u_a - u_b)^2 + b^2) + k sum A_i max(u_i, 0)^2 / 2 + r |u|^2 / 2
//!
//! with u the change of ln sigma of each cell, c(u) the change of the readings by the forward model, s the deviation of a
//! reading, L_e the length of a border and A_i the size of a cell. The square root is replaced by its tangent parabola
//! at each step (lagged diffusivity: C. Vogel, M. Oman, SIAM J. Sci. Comput. 17 (1996) 227), so that a step solves a
//! least-squares problem with a sparse penalty, in the space of the readings. For a load that changes slowly with
//! position the square root is replaced by (u_a - u_b)^2 / 2 c.

use nalgebra::{DMatrix, DVector};
use survey::Protocol;

use super::cells::Cells;
use super::penalty::{Differences, GAIN_PENALTY, LEVEL, Linearised, Penalty, Solution};
use crate::inverse::learned::linear::scale_rows;
use crate::inverse::prior::Half;
use crate::inverse::reciprocity::Seen;
use crate::{Forward, ForwardError, Mesh, OneStepError, Parameters};

/// Fewest and most steps with few unknowns, and after them with the unknowns of the map, starting at a map of squares.
const COARSE_STEPS: [usize; 2] = [1, 12];
const FINE_STEPS: [usize; 2] = [3, 8];
/// Values of c for smooth loads; the first one that explains a frame is used. Chosen on ramps and fields of seed 61
/// (`tactus-lab honesty --maps`).
const SLOPES: [f64; 2] = [0.006, 0.02];
/// Fewest and most steps for each value of c.
const SMOOTH_STEPS: [usize; 2] = [2, 4];
const SMOOTH_DONE: f64 = 0.1;
/// The sensitivity of a smooth load is reused in later steps while the root mean square of the change of ln sigma since
/// its computation is less than this. Total variation recomputes it, because reuse lowers the correlation by 0.005 in
/// the mean of six crescents, feet or seven discs of seeds 19 and 61.
const KEPT_WITHIN: f64 = 0.03;
/// Largest change of ln sigma in a step.
const LONGEST: f64 = 1.5;
/// Lowest ln sigma: a cell below it is effectively an insulator.
const LOWEST: f64 = -6.0;
/// The search ends when a step improves the objective by less than this share: with few unknowns, and with the unknowns
/// of the map.
const COARSE_DONE: f64 = 0.2;
const DONE: f64 = 0.05;
/// Most halvings of a step.
const HALVINGS: usize = 4;
/// The deviation is lowered to the unexplained rest of the map, if that is less than this share of the deviation.
const KEPT: f64 = 0.8;
/// The step after which the deviation may also be raised, e.g. if losses cannot explain a frame: otherwise later steps
/// would explain the frame by gains at any penalty.
const RAISED: usize = 4;

/// The sheet and the penalties.
pub(super) struct Sheet {
    pub(super) forward: Forward,
    /// Measurements of the folded readings, and the factor of each.
    pub(super) questions: Protocol,
    pub(super) factors: DVector<f64>,
    pub(super) sigma0: Vec<f64>,
    /// Unknowns of the first steps (few), and unknowns of the map.
    coarse: Level,
    pub(super) fine: Level,
    /// Folded readings of the unloaded sheet.
    pub(super) unloaded: DVector<f64>,
    /// alpha, 1/m.
    pub(super) alpha: f64,
}

/// A division of the sheet into unknowns.
pub(super) struct Level {
    pub(super) cells: Cells,
    parameters: Parameters,
    /// The pattern of the penalty's factor.
    pattern: Half,
    /// Sensitivity of the folded readings of the unloaded sheet to ln sigma of the cells.
    pub(super) sensitivity: DMatrix<f64>,
}

impl Level {
    /// Creates the level without its sensitivity.
    fn new(mesh: &Mesh, cells: Cells) -> Result<Self, OneStepError> {
        Ok(Self {
            parameters: cells.parameters(mesh),
            pattern: cells.neighbours.pattern().ok_or(OneStepError::Prior)?,
            cells,
            sensitivity: DMatrix::zeros(0, 0),
        })
    }

    /// Whether the sensitivity at the changes `of` of the cells is accurate enough for a step from `at`.
    fn is_near(&self, of: &[f64], at: &[f64]) -> bool {
        let cells = of.iter().zip(at).zip(&self.cells.sizes);
        let sum: f64 = cells.map(|((a, b), size)| size * (a - b).powi(2)).sum();
        let sizes: f64 = self.cells.sizes.iter().sum();
        of.len() == at.len() && sum < KEPT_WITHIN * KEPT_WITHIN * sizes
    }
}

/// A minimum of the objective.
pub(super) struct Found<'a> {
    /// Change of ln sigma of each cell.
    pub(super) change: Vec<f64>,
    /// Share of the squared change of the readings that remains unexplained.
    pub(super) left: f64,
    /// Standard deviation of the errors of a reading, from the residual.
    pub(super) error: f64,
    /// The last step, used for draws from the posterior.
    penalty: Penalty<'a>,
    last: Solution,
}

impl Found<'_> {
    /// Changes of ln sigma of each cell, drawn from the posterior of the linearised problem of the last step.
    pub(super) fn possible(&self) -> Vec<Vec<f64>> {
        self.penalty.possible(&self.last, &self.change)
    }
}

/// A point of the search.
struct Point {
    change: Vec<f64>,
    /// d - c(u)
    residual: DVector<f64>,
    sigma: Vec<f64>,
}

impl Point {
    /// Standard deviation of the errors of a reading, from the residual of a map with this number of degrees of
    /// freedom.
    fn error(&self, degrees: f64) -> f64 {
        (self.residual.norm_squared() / (self.residual.len() as f64 - degrees)).sqrt()
    }

    fn mean_square(&self) -> f64 {
        self.residual.norm_squared() / self.residual.len() as f64
    }
}

impl Sheet {
    pub(super) fn new(
        forward: Forward,
        questions: Protocol,
        factors: &[f64],
        sigma0: &[f64],
        alpha: f64,
    ) -> Result<Self, OneStepError> {
        let mesh = forward.mesh();
        let mut sheet = Self {
            coarse: Level::new(mesh, Cells::coarse(mesh))?,
            fine: Level::new(mesh, Cells::fine(mesh))?,
            unloaded: DVector::zeros(questions.len()),
            sigma0: sigma0.to_vec(),
            forward,
            questions,
            factors: DVector::from_column_slice(factors),
            alpha,
        };
        sheet.unloaded = sheet.readings(sigma0)?;
        let sensitivity = |level| {
            let mut sensitivity = DMatrix::zeros(0, 0);
            sheet.sensitivity_into(level, sigma0, &mut sensitivity)?;
            Ok::<_, ForwardError>(sensitivity)
        };
        let [coarse, fine] = [sensitivity(&sheet.coarse)?, sensitivity(&sheet.fine)?];
        (sheet.coarse.sensitivity, sheet.fine.sensitivity) = (coarse, fine);
        Ok(sheet)
    }

    fn readings(&self, sigma: &[f64]) -> Result<DVector<f64>, ForwardError> {
        let readings = self.forward.readings(sigma, &self.questions)?;
        Ok(readings.zip_map(&self.factors, |value, factor| value * factor))
    }

    fn sensitivity_into(
        &self,
        level: &Level,
        sigma: &[f64],
        sensitivity: &mut DMatrix<f64>,
    ) -> Result<(), ForwardError> {
        let (forward, questions) = (&self.forward, &self.questions);
        forward.sensitivity_into(sigma, questions, &level.parameters, sensitivity)?;
        scale_rows(sensitivity, self.factors.as_slice());
        Ok(())
    }

    /// The minimum for the change of the readings. The standard deviation of their errors starts at `first` and is then
    /// set to the unexplained rest of the map, at least `least`. `bounded`: gains are penalised. `None` if a step
    /// cannot be solved.
    pub(super) fn minimum(
        &self,
        seen: &Seen,
        first: f64,
        least: f64,
        bounded: bool,
    ) -> Result<Option<Found<'_>>, ForwardError> {
        let mut search = self.search(seen, first, least, bounded);
        let rest = search.at.change.clone();
        let coarse = search.down(&self.coarse, &rest, COARSE_STEPS, COARSE_DONE)?;
        if coarse.is_none() {
            return Ok(None);
        }
        let cells = &self.fine.cells;
        search.at.change = cells.refined(&self.coarse.cells, &search.at.change);
        // the borders of the square cells are not borders of the load
        let borders = cells.smoothed(&search.at.change);
        let found = search.down(&self.fine, &borders, FINE_STEPS, DONE)?;
        let Some((penalty, last)) = found else {
            return Ok(None);
        };
        Ok(Some(search.found(penalty, last)))
    }

    /// The minimum for a load without gains that changes slowly with position, with few unknowns; [`Self::smooth`]
    /// gives its values in the triangles. Also the mean square residual, as a share of `most`; `None` also if it
    /// exceeds `most`.
    pub(super) fn smooth_minimum(
        &self,
        seen: &Seen,
        first: f64,
        least: f64,
        most: f64,
    ) -> Result<Option<(Found<'_>, f64)>, ForwardError> {
        let mut search = self.search(seen, first, least, true);
        for slope in SLOPES {
            search.differences = Differences::Square(slope);
            let from = search.at.change.clone();
            let Some((penalty, last)) =
                search.down(&self.coarse, &from, SMOOTH_STEPS, SMOOTH_DONE)?
            else {
                return Ok(None);
            };
            let left = search.at.mean_square() / most;
            if left <= 1.0 {
                return Ok(Some((search.found(penalty, last), left)));
            }
        }
        Ok(None)
    }

    /// The values of the triangles of a smooth map, from those of the few unknowns.
    pub(super) fn smooth(&self, change: &[f64]) -> Vec<f64> {
        let cells = &self.fine.cells;
        cells.smoothed(&cells.refined(&self.coarse.cells, change))
    }

    /// A search that starts at the unloaded sheet with few unknowns.
    fn search<'b>(&self, seen: &'b Seen, first: f64, least: f64, bounded: bool) -> Search<'_, 'b> {
        Search {
            sheet: self,
            seen,
            least,
            bounded,
            differences: Differences::Amount,
            deviation: first,
            at: Point {
                change: vec![0.0; self.coarse.cells.count()],
                residual: seen.data.clone(),
                sigma: self.sigma0.clone(),
            },
        }
    }
}

/// A search for the minimum.
struct Search<'a, 'b> {
    sheet: &'a Sheet,
    seen: &'b Seen,
    /// Smallest standard deviation of a reading.
    least: f64,
    /// Whether gains are penalised.
    bounded: bool,
    differences: Differences,
    /// Present standard deviation of a reading.
    deviation: f64,
    at: Point,
}

impl<'a> Search<'a, '_> {
    /// The result of the search after its last step.
    fn found(self, penalty: Penalty<'a>, last: Solution) -> Found<'a> {
        Found {
            error: self.at.error(last.degrees),
            left: self.at.residual.norm_squared() / self.seen.data.norm_squared(),
            change: self.at.change,
            penalty,
            last,
        }
    }

    /// Takes at most this number of steps with the unknowns of a level; returns the last one, or `None` if a step
    /// cannot be solved. `borders`: the values whose differences determine the weights of the borders in the first
    /// step.
    fn down(
        &mut self,
        level: &'a Level,
        borders: &[f64],
        [fewest, most]: [usize; 2],
        done: f64,
    ) -> Result<Option<(Penalty<'a>, Solution)>, ForwardError> {
        let sheet = self.sheet;
        let mut penalty = Penalty::new(
            &level.cells,
            &level.pattern,
            sheet.alpha,
            self.bounded,
            self.differences,
            &self.at.change,
        );
        // if `borders` differs from the present map, the objective is not comparable with later ones
        let mut value = match borders == self.at.change {
            true => self.value(level, &self.at),
            false => f64::INFINITY,
        };
        let mut last = None;
        // reused in all steps: allocating the memory takes longer than filling it
        let mut changed = DMatrix::zeros(0, 0);
        let mut changed_at = Vec::new();
        for step in 1..=most {
            let at_rest = self.at.change.iter().all(|change| *change == 0.0);
            let sensitivity = match at_rest {
                true => &level.sensitivity,
                false => {
                    let near = level.is_near(&changed_at, &self.at.change);
                    if !(near && self.differences.are_smooth()) {
                        sheet.sensitivity_into(level, &self.at.sigma, &mut changed)?;
                        changed_at.clone_from(&self.at.change);
                    }
                    &changed
                }
            };
            let problem = Linearised::new(
                &self.seen.rows(sensitivity),
                &self.at.change,
                &self.at.residual,
                self.deviation,
            );
            let borders = match step {
                1 => borders,
                _ => &self.at.change,
            };
            let Some(solution) = penalty.minimum(&problem, borders) else {
                return Ok(None);
            };
            let solution = last.insert(solution);
            let Some(next) = self.towards(level, &solution.change, value)? else {
                break; // no step improves it further
            };
            self.at = next;
            let before = value;
            value = self.value(level, &self.at);
            let estimated = self.at.error(solution.degrees).max(self.least);
            if estimated < KEPT * self.deviation || step == RAISED && estimated > self.deviation {
                self.deviation = estimated;
                value = self.value(level, &self.at);
            } else if step >= fewest && before - value < done * value {
                break;
            }
        }
        Ok(last.map(|last| (penalty, last)))
    }

    /// The objective at a point.
    fn value(&self, level: &Level, at: &Point) -> f64 {
        let neighbours = &level.cells.neighbours;
        let edges = neighbours.edges.iter().zip(&neighbours.weights);
        let variation: f64 = edges
            .map(|(&[a, b], length)| length * self.differences.cost(at.change[a] - at.change[b]))
            .sum();
        let sizes = level.cells.sizes.iter().zip(&at.change);
        let gains: f64 = match self.bounded {
            true => sizes.map(|(size, u)| size * u.max(0.0).powi(2)).sum(),
            false => 0.0,
        };
        let mean: f64 = at.change.iter().map(|u| u * u).sum();
        0.5 * (at.residual.norm_squared() / (self.deviation * self.deviation)
            + GAIN_PENALTY * gains
            + LEVEL * mean)
            + self.sheet.alpha * variation
    }

    /// The point for a change of ln sigma: its conductance and the residual of the readings.
    fn point(&self, level: &Level, change: Vec<f64>) -> Result<Point, ForwardError> {
        let (sheet, seen) = (self.sheet, self.seen);
        let sigma = level.cells.conductances(&sheet.sigma0, &change);
        let shift = sheet.readings(&sigma)? - &sheet.unloaded;
        let shift = DMatrix::from_column_slice(shift.len(), 1, shift.as_slice());
        Ok(Point {
            residual: &seen.data - seen.rows(&shift).column(0),
            change,
            sigma,
        })
    }

    /// A point on the way to `solution` with a smaller objective; `None` if none was found.
    fn towards(
        &self,
        level: &Level,
        to: &[f64],
        value: f64,
    ) -> Result<Option<Point>, ForwardError> {
        let both = || self.at.change.iter().zip(to);
        let longest = both()
            .map(|(from, to)| (to - from).abs())
            .fold(0.0, f64::max);
        let mut share = (LONGEST / longest).min(1.0);
        for _ in 0..=HALVINGS {
            let change: Vec<f64> = both()
                .map(|(from, to)| (from + share * (to - from)).max(LOWEST))
                .collect();
            let point = self.point(level, change)?;
            if self.value(level, &point) < value {
                return Ok(Some(point));
            }
            share *= 0.5;
        }
        Ok(None)
    }
}
