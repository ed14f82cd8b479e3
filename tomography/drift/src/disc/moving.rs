//! A load that moves during a frame, updated after every injection: a disc with a velocity, fitted to the readings of
//! the last injections. A frame takes seconds; a model of a load at rest locates a moving load millimetres behind its
//! present position.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector, SVector};

use super::descent::{Axis, Problem, descend};
use super::{Disc, MODEL_SHARE, REFUSED, place_covariance};
use crate::DriftError;
use crate::model::DriftModel;
use crate::whitened::{Atoms, LOADED, Whitened, factor};

/// Fewest and most injections used to fit a moving load.
pub const INJECTIONS: std::ops::RangeInclusive<usize> = FIRST..=LONGER[0];
/// Injections of the first fit, and of the longer fits that include them, longest first.
const FIRST: usize = 7;
const LONGER: [usize; 2] = [26, 13];
/// Prior of each component of the velocity, m/s.
const VELOCITY_SD: f64 = 20e-3;
const STEPS: usize = 40;
/// Parameters: x, y, their velocities, ln diameter, change.
const N: usize = 6;

/// One reading of an injection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedReading {
    /// Index of the reading in the protocol.
    pub reading: usize,
    /// Voltage, V; NaN if the reading has no value.
    pub volts: f64,
}

/// The readings of one injection.
#[derive(Debug, Clone, PartialEq)]
pub struct Injection {
    /// Time of the injection, s.
    pub at_s: f64,
    /// Readings of the injection.
    pub readings: Vec<TimedReading>,
}

/// A load at the time of the last injection.
#[derive(Debug, Clone, PartialEq)]
pub struct MovingLoad {
    /// The disc at that time.
    pub disc: Disc,
    /// Its velocity, m/s.
    pub velocity: [f64; 2],
    /// Covariance of the centre, m2.
    pub covariance: [[f64; 2]; 2],
    /// Improvement of chi squared over an empty sheet.
    pub score: f64,
    /// Number of injections used.
    pub injections: usize,
    /// Chi squared per reading after the fit, with 1 % of the disc's signal as model error.
    pub chi: f64,
    /// Whether one disc at a constant velocity explains the readings; only then the covariance is valid.
    pub accepted: bool,
}

/// Readings of a window with their covariance.
#[derive(Clone)]
struct Window {
    /// Row of each reading, its factor, and its time relative to the last injection, s (at most 0).
    rows: Vec<usize>,
    after_s: Vec<f64>,
    white: Whitened,
}

impl DriftModel {
    /// The load on the sheet after the last of these injections, which are in order of time; `None` if the readings
    /// agree with an empty sheet. `baseline` (V) and `covariance` (V2) are those of the tracked baseline. Readings that
    /// have no value or are nearly 0 V are not used.
    ///
    /// # Errors
    /// A reading that is not in the protocol; fewer than half of the readings of the last injections left; a covariance
    /// that cannot be factored.
    pub fn moving_load(
        &self,
        injections: &[Injection],
        baseline: &DVector<f64>,
        covariance: &DMatrix<f64>,
    ) -> Result<Option<MovingLoad>, DriftError> {
        let last = |count: usize| &injections[injections.len().saturating_sub(count)..];
        let window = self.window(last(FIRST), baseline, covariance)?;
        let wants = last(FIRST).iter().map(|one| one.readings.len()).sum();
        let has = window.as_ref().map_or(0, |window| window.rows.len());
        let Some(window) = window.filter(|_| 2 * has >= wants) else {
            return match injections.is_empty() {
                true => Ok(None),
                false => Err(DriftError::FewReadings { has, wants }),
            };
        };
        let Some((theta, score)) = self.search_moving(&window, 0.0) else {
            // a weak load may be detectable in more injections
            let more = last(LONGER[0]);
            let longest = match more.len() > FIRST {
                true => self.window(more, baseline, covariance)?,
                false => None,
            };
            let found = longest.and_then(|longest| {
                let (theta, score) = self.search_moving(&longest, LOADED)?;
                Some(self.described_moving(&longest, &theta, score, more.len()))
            });
            return found.transpose();
        };
        let first = self.described_moving(&window, &theta, score, last(FIRST).len())?;
        for count in LONGER {
            let more = last(count);
            if more.len() <= FIRST {
                continue;
            }
            let Some(longer) = self.window(more, baseline, covariance)? else {
                continue;
            };
            let (theta, cost) = self.descend_moving(&longer, theta);
            let score = longer.white.data().norm_squared() - cost;
            let fit = self.described_moving(&longer, &theta, score, more.len())?;
            // a longer window may begin before the load came or changed direction
            if fit.accepted {
                return Ok(Some(fit));
            }
        }
        Ok(Some(first))
    }

    /// A load found in the window, starting at the best places of the load test with scores of at least `least`: its
    /// parameters and score.
    fn search_moving(&self, window: &Window, least: f64) -> Option<(SVector<f64, N>, f64)> {
        let atoms = self.atoms.select_rows(&window.rows);
        let atoms = Atoms::new(&window.white.sensitivity(&atoms));
        let starts = atoms.best(window.white.data(), self, 3);
        let fits = starts
            .iter()
            .filter(|start| start.score >= least)
            .map(|start| {
                let [x, y] = start.place.centre;
                let ln = start.place.diameter.ln();
                self.descend_moving(window, SVector::from([x, y, 0.0, 0.0, ln, start.change]))
            });
        let (theta, cost) = fits.min_by(|a, b| a.1.total_cmp(&b.1))?;
        let score = window.white.data().norm_squared() - cost;
        (score >= LOADED).then_some((theta, score))
    }

    /// The fit with its covariance, which includes the model error.
    fn described_moving(
        &self,
        window: &Window,
        theta: &SVector<f64, N>,
        score: f64,
        injections: usize,
    ) -> Result<MovingLoad, DriftError> {
        let signal = self.readings_moving(window, theta);
        let wider = Window {
            white: window.white.with_error(&(&signal * MODEL_SHARE))?,
            ..window.clone()
        };
        let left = wider.white.data() - wider.white.column(&signal);
        let chi = left.norm_squared() / wider.rows.len() as f64;
        let spread = self
            .moving_problem(&wider, theta[4])
            .information(theta)
            .try_inverse();
        let spread = spread.ok_or(DriftError::Covariance)?;
        let place = [
            [spread[(0, 0)], spread[(0, 1)]],
            [spread[(1, 0)], spread[(1, 1)]],
        ];
        Ok(MovingLoad {
            disc: Disc::new([theta[0], theta[1]], theta[4].exp(), theta[5]),
            velocity: [theta[2], theta[3]],
            covariance: place_covariance(self, place, chi),
            score,
            injections,
            chi,
            accepted: chi <= REFUSED,
        })
    }

    /// The usable readings of these injections, whitened; `None` if there are none.
    fn window(
        &self,
        injections: &[Injection],
        baseline: &DVector<f64>,
        covariance: &DMatrix<f64>,
    ) -> Result<Option<Window>, DriftError> {
        let now_s = injections.last().map_or(0.0, |last| last.at_s);
        let wants = self.pairs().protocol().len();
        let (mut rows, mut after_s, mut data, mut numbers) = (vec![], vec![], vec![], vec![]);
        for injection in injections {
            for one in &injection.readings {
                if one.reading >= wants {
                    let has = one.reading + 1;
                    return Err(DriftError::Readings { has, wants });
                }
                if !one.volts.is_finite() || self.is_nearly_zero(one.reading, one.volts) {
                    continue;
                }
                let row = self.row_of(one.reading);
                rows.push(row);
                after_s.push(injection.at_s - now_s);
                data.push(self.change_of(one.reading, one.volts) - baseline[row]);
                numbers.push(one.reading);
            }
        }
        if rows.is_empty() {
            return Ok(None);
        }
        let n = rows.len();
        let whole = DMatrix::from_fn(n, n, |i, j| {
            covariance[(rows[i], rows[j])] + self.noise_between(numbers[i], numbers[j], i == j)
        });
        let all: Vec<usize> = (0..n).collect();
        let factor = Arc::new(factor(&whole, &all)?);
        let white = Whitened::with(factor, &DVector::from_vec(data), &all);
        Ok(Some(Window {
            rows,
            after_s,
            white,
        }))
    }

    /// Changes of the readings caused by a moving disc.
    fn readings_moving(&self, window: &Window, theta: &SVector<f64, N>) -> DVector<f64> {
        let mut out = DVector::zeros(window.rows.len());
        let mut at = 0;
        while at < window.rows.len() {
            let after = window.after_s[at];
            let same = window.after_s[at..].iter().take_while(|s| **s == after);
            let end = at + same.count();
            let centre = [theta[0] + theta[2] * after, theta[1] + theta[3] * after];
            let readings = self.disc_in(centre, theta[4].exp(), &window.rows[at..end]);
            out.rows_mut(at, end - at).copy_from(&(readings * theta[5]));
            at = end;
        }
        out
    }

    /// The least-squares problem of a moving disc with this prior mean of ln diameter.
    fn moving_problem<'a>(
        &'a self,
        window: &'a Window,
        mean: f64,
    ) -> Problem<'a, N, impl Fn(&SVector<f64, N>) -> DVector<f64> + 'a> {
        let [x, y] = Axis::centre(self);
        let speed = Axis::small([f64::NEG_INFINITY, f64::INFINITY], 0.1e-3, VELOCITY_SD);
        let size = Axis::ln_diameter(mean);
        Problem {
            data: window.white.data(),
            of: move |theta: &SVector<f64, N>| {
                window.white.column(&self.readings_moving(window, theta))
            },
            axes: [x, y, speed, speed, size, Axis::change()],
        }
    }

    /// Levenberg-Marquardt fit: the parameters and their cost.
    fn descend_moving(&self, window: &Window, start: SVector<f64, N>) -> (SVector<f64, N>, f64) {
        descend(&self.moving_problem(window, start[4]), start, STEPS)
    }
}
