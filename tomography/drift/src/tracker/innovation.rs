//! The covariance of an innovation, and the tests of one frame against it: events, and faults of electrodes.

use std::sync::{Arc, OnceLock};

use eit::linear_algebra::{Definite, product, times, view};
use nalgebra::{DMatrix, DVector};
use survey::Reading;

use super::{SAME_INTERVAL, Tracker};
use crate::DriftError;
use crate::basis::PER_DAY;
use crate::electrodes::{Allowed, ElectrodeFault};
use crate::whitened::{Atoms, LOADED, LoadTest, Whitened, factor};

/// An electrode that was faulty counts as healthy again if chi squared per row of its readings is at most this: they
/// then agree with the other readings within twice the standard deviation, even before the pace is learnt.
const HEALTHY: f64 = 4.0;

/// Standard deviation of the logarithm of the contact impedance of an electrode that was masked for any time: contacts
/// vary about a mean.
pub(super) const CONTACT_SD: f64 = 0.4;

/// A frame being processed.
pub(super) struct Frame {
    /// Change since the first baseline, V.
    pub(super) data: DVector<f64>,
    /// The change since the first baseline in the coordinates of the basis.
    pub(super) in_basis: DVector<f64>,
    /// Change since the tracked baseline, V.
    pub(super) e: DVector<f64>,
    /// Change since the last frame, V.
    pub(super) step: Option<DVector<f64>>,
    /// Usable rows.
    pub(super) rows: Vec<usize>,
    /// Usable rows of this frame that were also usable in the last frame; the step is defined only for these.
    pub(super) step_rows: Vec<usize>,
    /// Days since the last frame.
    pub(super) days: f64,
}

impl Frame {
    /// Sets the innovation to zero in rows that are not usable, and the step in rows that have none.
    pub(super) fn clear_lost_rows(&mut self) {
        for row in 0..self.e.len() {
            if self.rows.binary_search(&row).is_err() {
                self.e[row] = 0.0;
            }
            if let Some(step) = &mut self.step
                && self.step_rows.binary_search(&row).is_err()
            {
                step[row] = 0.0;
            }
        }
    }
}

/// Covariance of an innovation and what is computed from it.
pub(super) struct Steady {
    pub(super) days: f64,
    pub(super) pace: f64,
    pub(super) rows: Vec<usize>,
    pub(super) predicted: DMatrix<f64>,
    pub(super) covariance: DMatrix<f64>,
    pub(super) factor: Arc<Definite>,
    pub(super) atoms: Atoms,
    /// Test of the electrodes; computed when it is first needed.
    allowed: OnceLock<Allowed>,
    gain: OnceLock<DMatrix<f64>>,
    /// `gain` in single precision: half the memory traffic per frame.
    single_gain: OnceLock<DMatrix<f32>>,
}

impl Steady {
    /// The correction of the state by whitened data.
    pub(super) fn correction(&self, white: &DVector<f64>) -> DVector<f64> {
        let gain = self
            .single_gain
            .get_or_init(|| self.gain().map(|value| value as f32));
        DVector::from_vec(times(gain, white))
    }

    /// The gain P L'^-1, restricted to the usable rows; computed once.
    fn gain(&self) -> &DMatrix<f64> {
        self.gain.get_or_init(|| {
            let mut half = match self.rows.len() == self.predicted.nrows() {
                true => self.predicted.clone(),
                false => self.predicted.select_rows(&self.rows),
            };
            self.factor.whiten(&mut half);
            half.transpose()
        })
    }

    /// The corrected covariance P - P S^-1 P, using only the usable rows.
    pub(super) fn corrected(&self) -> DMatrix<f64> {
        let gain = view(self.gain());
        let mut out = &self.predicted - product(gain, gain.transpose());
        out.fill_upper_triangle_with_lower_triangle();
        out
    }
}

impl Tracker {
    /// Covariance of the step between two frames without load.
    pub(super) fn of_step(&self, days: f64) -> DMatrix<f64> {
        let rate = self.state.pace.pace.powi(2) * days;
        let mut covariance = &self.model.noise * 2.0 + &self.prepared.per_day * rate;
        self.allow_lost_contacts(&mut covariance, None);
        covariance
    }

    /// The step from the last frame, if it exceeds noise and drift.
    pub(super) fn event(&mut self, frame: &Frame) -> Result<Option<LoadTest>, DriftError> {
        let Some(step) = &frame.step else {
            return Ok(None);
        };
        let complete = |rows: &[usize]| rows.len() == self.prepared.rows.len();
        let tests = if complete(&frame.rows) && complete(&self.state.last_rows) {
            let basis = &self.prepared.basis;
            let rate = self.state.pace.pace.powi(2) * frame.days;
            let variances = basis.growth.map(|growth| 2.0 + rate * growth);
            let squares = match &self.of_steps {
                Some((kept, squares)) if *kept == rate => Arc::clone(squares),
                _ => {
                    let squares = Arc::new(basis.squares(&variances));
                    self.of_steps = Some((rate, Arc::clone(&squares)));
                    squares
                }
            };
            let before = self.last_in_basis.take();
            let before =
                before.unwrap_or_else(|| basis.of(&DVector::from_column_slice(&self.state.last)));
            let step = &frame.in_basis - before;
            basis.load_tests(&self.model, &step, &variances, &squares, 1)
        } else {
            Whitened::new(&self.of_step(frame.days), step, &frame.step_rows)?
                .load_tests(&self.model, 1)
        };
        Ok(tests.into_iter().next().filter(|test| test.score > LOADED))
    }

    /// The covariance of the tracked baseline after this time. The drift of a masked electrode's contact is not
    /// included: it is bounded by [`CONTACT_SD`], which is added when the electrode is judged and used again.
    pub(super) fn predicted(&self, days: f64) -> DMatrix<f64> {
        let rate = self.state.pace.pace.powi(2) * days;
        let mut out = self.state.covariance() + &self.prepared.per_day * rate;
        for electrode in self.state.masked() {
            out -= self.of_contact(electrode, PER_DAY.contact * rate.sqrt());
        }
        out
    }

    /// The covariance of the data if the logarithm of this contact impedance has this standard deviation.
    pub(super) fn of_contact(&self, electrode: usize, deviation: f64) -> DMatrix<f64> {
        let column = self.model.contacts.column(electrode) * deviation;
        &column * column.transpose()
    }

    /// The covariance of the innovation after this time.
    pub(super) fn innovation(&self, days: f64, rows: &[usize]) -> Result<Arc<Steady>, DriftError> {
        let pace = self.state.pace.pace;
        // intervals that differ little share one covariance, so that it can be reused
        let days = match self.state.kept_days {
            Some(kept) if (days - kept).abs() <= SAME_INTERVAL * kept => kept,
            _ => days,
        };
        if let Some(steady) = &self.steady
            && steady.days == days
            && steady.pace == pace
            && steady.rows == rows
        {
            return Ok(Arc::clone(steady));
        }
        let predicted = self.predicted(days);
        let covariance = self.of_frame(&predicted);
        let factor = factor(&covariance, rows)?;
        let mut atoms = match rows.len() == self.prepared.rows.len() {
            true => self.model.atoms.clone(),
            false => self.model.atoms.select_rows(rows),
        };
        factor.whiten(&mut atoms);
        Ok(Arc::new(Steady {
            allowed: OnceLock::new(),
            gain: OnceLock::new(),
            single_gain: OnceLock::new(),
            days,
            pace,
            rows: rows.to_vec(),
            predicted,
            covariance,
            factor: Arc::new(factor),
            atoms: Atoms::new(&atoms),
        }))
    }

    /// The covariance of a frame without load about the tracked baseline, whose covariance is `of_baseline`.
    pub(super) fn of_frame(&self, of_baseline: &DMatrix<f64>) -> DMatrix<f64> {
        let mut covariance = of_baseline + &self.model.noise;
        self.allow_lost_contacts(&mut covariance, None);
        covariance
    }

    /// The rows that were also usable in the last frame; none if there is no last frame to compute a step from.
    pub(super) fn step_rows(&self, rows: &[usize]) -> Vec<usize> {
        let state = &self.state;
        let has =
            |row: &&usize| !state.last.is_empty() && state.last_rows.binary_search(row).is_ok();
        rows.iter().filter(has).copied().collect()
    }

    /// Rows of healthy electrodes.
    pub(super) fn usable(&self, rows: &[usize]) -> Vec<usize> {
        self.prepared.check.without(rows, &self.state.masked())
    }

    /// The masked electrodes whose readings do not agree with the other readings yet. `rows`: the rows with a value.
    pub(super) fn still_ill(
        &self,
        frame: &Frame,
        rows: &[usize],
    ) -> Result<Vec<usize>, DriftError> {
        let masked = self.state.masked();
        if masked.is_empty() {
            return Ok(masked);
        }
        let whole = self.predicted(frame.days) + &self.model.noise;
        let mut ill = Vec::new();
        for &electrode in &masked {
            let others: Vec<usize> = masked.iter().copied().filter(|e| *e != electrode).collect();
            let with = self.prepared.check.without(rows, &others);
            let without = self.prepared.check.without(&with, &[electrode]);
            let own = with
                .iter()
                .filter(|row| without.binary_search(row).is_err());
            let order: Vec<usize> = without.iter().chain(own).copied().collect();
            let mut covariance = &whole + self.of_contact(electrode, CONTACT_SD);
            self.allow_lost_contacts(&mut covariance, Some(electrode));
            let ordered = covariance.select_rows(&order).select_columns(&order);
            let factor = Definite::new(&ordered).ok_or(DriftError::Covariance)?;
            // the last rows are whitened conditionally on the preceding rows
            let whitened = |data: &dyn Fn(usize) -> f64| {
                let mut white = DMatrix::from_fn(order.len(), 1, |row, _| data(order[row]));
                factor.whiten(&mut white);
                white
            };
            let white = whitened(&|row| frame.e[row]);
            let own = white.rows_range(without.len()..);
            let agrees = !own.is_empty() && own.norm_squared() <= HEALTHY * own.len() as f64;
            // after weeks the covariance is so large that readings of a lost contact agree too; the lost contact then
            // fits better
            let lost = self.lost_contacts.get(&electrode);
            let is_lost = lost.is_some_and(|lost| {
                let lost = whitened(&|row| lost[(row, 0)]);
                2.0 * white.dot(&lost) > lost.norm_squared()
            });
            if !agrees || is_lost {
                ill.push(electrode);
            }
        }
        Ok(ill)
    }

    /// The fault that a frame shows relative to the tracked baseline, or, while loaded, relative to the previous frame.
    /// `white`: the whitened innovation.
    pub(super) fn fault(
        &self,
        readings: &[Reading],
        frame: &Frame,
        now: &Steady,
        white: &Whitened,
    ) -> Result<Option<ElectrodeFault>, DriftError> {
        let check = &self.prepared.check;
        let find = |innovation: &DVector<f64>, allowed: &Allowed| {
            check.confirmed_fault(&self.model, readings, &frame.data, innovation, allowed)
        };
        if let (true, Some(step)) = (self.state.ledger.loaded(), &frame.step) {
            let covariance = self.of_step(frame.days);
            let allowed = check.allow(&self.model, &covariance, &frame.step_rows)?;
            return find(step, &allowed);
        }
        let allowed = match now.allowed.get() {
            Some(allowed) => allowed,
            None => {
                let allowed = check.allow(&self.model, &now.covariance, &frame.rows)?;
                now.allowed.get_or_init(|| allowed)
            }
        };
        if check.is_healthy(&self.model, readings, white, allowed) {
            return Ok(None);
        }
        find(&frame.e, allowed)
    }
}
