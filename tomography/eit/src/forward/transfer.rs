//! Transfer impedance and transfer admittance between the electrodes (paper, Eq. 2).

use nalgebra::DMatrix;

use super::{Forward, ForwardError};
use crate::linear_algebra::dense;

impl Forward {
    /// The matrix Z with U = Z I for every I that sums to zero: electrodes x electrodes, ohm, symmetric, rows and
    /// columns sum to zero.
    ///
    /// # Errors
    /// Conductances that are refused.
    pub fn transfer_impedance(&self, sigma: &[f64]) -> Result<DMatrix<f64>, ForwardError> {
        let count = self.layout.electrodes.len();
        let share = 1.0 / count as f64;
        let currents = DMatrix::from_fn(
            count,
            count,
            |i, j| if i == j { 1.0 - share } else { -share },
        );
        let mut voltages =
            self.with_solution(sigma, &currents, |solution| self.electrodes(&solution))?;
        if let Some(added) = self.depth_voltages(sigma, &currents)? {
            voltages += added;
        }
        // reciprocity holds to rounding; made exact so that a frame does not depend on which triangle is read
        Ok(DMatrix::from_fn(count, count, |i, j| {
            0.5 * (voltages[(i, j)] + voltages[(j, i)])
        }))
    }

    /// The matrix Y with I = Y U for every U (paper, Eq. 2): electrodes x electrodes, siemens, symmetric, rows and
    /// columns sum to zero. On vectors that sum to zero it is the inverse of [`Forward::transfer_impedance`].
    ///
    /// # Errors
    /// Conductances that are refused, or contacts of so different size that the inverse is lost to rounding.
    pub fn transfer_admittance(&self, sigma: &[f64]) -> Result<DMatrix<f64>, ForwardError> {
        let mut impedance = self.transfer_impedance(sigma)?;
        let count = impedance.nrows();
        // the constant vector gets the size of the other eigenvalues, to lose no digits; the row sums remove it again
        let level = impedance.trace() / (count * count) as f64;
        impedance.add_scalar_mut(level);
        let mut admittance =
            dense::inverse_of_definite(&impedance).ok_or(ForwardError::NotDefinite {
                smallest: sigma.iter().copied().fold(f64::INFINITY, f64::min),
                largest: sigma.iter().copied().fold(0.0, f64::max),
            })?;
        admittance.add_scalar_mut(-1.0 / (level * (count * count) as f64));
        for row in 0..count {
            let others: f64 = (0..count)
                .filter(|&column| column != row)
                .map(|column| admittance[(row, column)])
                .sum();
            admittance[(row, row)] = -others;
        }
        Ok(admittance)
    }
}
