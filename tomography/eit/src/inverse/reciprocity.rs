//! Folds reciprocal twins into one reading: half the data carry all information.
//!
//! A reading does not change if driving and sensing pair are exchanged, so twins have the same sensitivity up to the
//! factors of their readings: rows a r and b r of the linear problem. A rotation of the two data by the angle of (a, b)
//! gives one row sqrt(a^2 + b^2) r and one of zeros. A rotation keeps white noise white, so the folded problem has the
//! same map up to rounding, with half the readings.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector};
use survey::Protocol;

use crate::OneStepError;

/// Maps readings to folded rows.
#[derive(Debug, Clone)]
pub(crate) struct Fold {
    /// The reading whose sensitivity each row has.
    first: Vec<usize>,
    /// Norm of the factors of each row's readings.
    norm: Vec<f64>,
    /// Row of each reading, and the reading's share in it: the squared shares of a row sum to 1.
    of: Vec<(usize, f64)>,
}

/// Folded data; if readings are missing, also the remaining rows with their remaining norms.
#[derive(Debug, Clone)]
pub(crate) struct Seen {
    pub(crate) data: DVector<f64>,
    left: Option<Vec<(usize, f64)>>,
}

impl Fold {
    /// `factors`: the factor applied to each reading.
    pub(crate) fn new(protocol: &Protocol, factors: &[f64]) -> Self {
        let twins = protocol.reciprocal_twins();
        let (mut first, mut norm) = (Vec::new(), Vec::new());
        let mut of = vec![(usize::MAX, 1.0); protocol.len()];
        for reading in 0..protocol.len() {
            if of[reading].0 != usize::MAX {
                continue;
            }
            let row = first.len();
            first.push(reading);
            match twins[reading].filter(|&twin| twin > reading && twins[twin] == Some(reading)) {
                Some(twin) => {
                    let (a, b) = (factors[reading], factors[twin]);
                    let both = a.hypot(b);
                    let shares = if both > 0.0 {
                        [a / both, b / both]
                    } else {
                        [1.0, 0.0]
                    };
                    of[reading] = (row, shares[0]);
                    of[twin] = (row, shares[1]);
                    norm.push(both);
                }
                None => {
                    of[reading] = (row, factors[reading].signum());
                    norm.push(factors[reading].abs());
                }
            }
        }
        Self { first, norm, of }
    }

    /// For a protocol without twins.
    #[cfg(test)]
    pub(crate) fn none(readings: usize) -> Self {
        Self {
            first: (0..readings).collect(),
            norm: vec![1.0; readings],
            of: (0..readings).map(|reading| (reading, 1.0)).collect(),
        }
    }

    /// Number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.first.len()
    }

    /// The measurements whose sensitivity the rows have.
    ///
    /// # Errors
    /// None in practice: they are a subset of the protocol's measurements.
    pub(crate) fn half(&self, protocol: &Protocol) -> Result<Protocol, OneStepError> {
        let questions = self.first.iter();
        Protocol::new(
            protocol.electrodes(),
            questions
                .map(|&reading| protocol.measurements()[reading])
                .collect(),
        )
        .map_err(|_| OneStepError::Prior)
    }

    /// The factor of each row's sensitivity.
    pub(crate) fn norm(&self) -> &[f64] {
        &self.norm
    }

    /// Row of a reading, and the reading's share of it.
    pub(crate) fn row(&self, reading: usize) -> (usize, f64) {
        self.of[reading]
    }

    /// Folds readings into rows.
    pub(crate) fn data(&self, readings: &[f64]) -> DVector<f64> {
        let mut data = DVector::zeros(self.rows());
        for (value, &(row, share)) in readings.iter().zip(&self.of) {
            data[row] += share * value;
        }
        data
    }

    /// The readings that correspond to folded model data.
    pub(crate) fn readings_of(&self, rows: &DVector<f64>) -> DVector<f64> {
        DVector::from_iterator(
            self.of.len(),
            self.of.iter().map(|&(row, share)| share * rows[row]),
        )
    }

    /// Unfolds every column.
    pub(crate) fn unfold(&self, rows: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(self.of.len(), rows.ncols(), |reading, column| {
            let (row, share) = self.of[reading];
            share * rows[(row, column)]
        })
    }

    /// Folds the valid readings; entries of `missing` (ascending) are ignored.
    pub(crate) fn seen(&self, readings: &[f64], missing: &[usize]) -> Seen {
        if missing.is_empty() {
            return Seen {
                data: self.data(readings),
                left: None,
            };
        }
        let mut squares = vec![0.0; self.rows()];
        let mut sums = vec![0.0; self.rows()];
        for (reading, &(row, share)) in self.of.iter().enumerate() {
            if missing.binary_search(&reading).is_err() {
                squares[row] += share * share;
                sums[row] += share * readings[reading];
            }
        }
        let kept: Vec<usize> = (0..self.rows()).filter(|&row| squares[row] > 0.0).collect();
        Seen {
            data: DVector::from_iterator(
                kept.len(),
                kept.iter().map(|&row| sums[row] / squares[row].sqrt()),
            ),
            left: Some(kept.iter().map(|&row| (row, squares[row].sqrt())).collect()),
        }
    }
}

impl Seen {
    /// Whether no reading is missing.
    pub(crate) fn complete(&self) -> bool {
        self.left.is_none()
    }

    /// The folded data multiplied by a factor.
    pub(crate) fn times(&self, factor: f64) -> Self {
        Self {
            data: &self.data * factor,
            left: self.left.clone(),
        }
    }

    /// The data with a row for each folded reading, 0 for those that are missing.
    pub(crate) fn spread(&self, rows: usize) -> DVector<f64> {
        let Some(left) = &self.left else {
            return self.data.clone();
        };
        let mut all = DVector::zeros(rows);
        for (value, &(row, _)) in self.data.iter().zip(left) {
            all[row] = *value;
        }
        all
    }

    /// The share of each folded reading that is not missing.
    pub(crate) fn shares(&self, rows: usize) -> DVector<f64> {
        let Some(left) = &self.left else {
            return DVector::from_element(rows, 1.0);
        };
        let mut all = DVector::zeros(rows);
        for &(row, share) in left {
            all[row] = share;
        }
        all
    }

    /// The rows of a folded matrix that correspond to the data.
    pub(crate) fn rows<'a>(&self, matrix: &'a DMatrix<f64>) -> Cow<'a, DMatrix<f64>> {
        match &self.left {
            None => Cow::Borrowed(matrix),
            Some(left) => Cow::Owned(DMatrix::from_fn(left.len(), matrix.ncols(), |i, column| {
                let (row, share) = left[i];
                share * matrix[(row, column)]
            })),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::inverse::reciprocity::*;

    /// The normal equations J'J and J'd, which determine the least-squares solution, stay the same with and without
    /// missing readings.
    #[test]
    fn folding_keeps_the_normal_equations() {
        let protocol = Protocol::sheffield(8).unwrap();
        let factors: Vec<f64> = (0..protocol.len()).map(|i| 0.5 + (i % 3) as f64).collect();
        let fold = Fold::new(&protocol, &factors);
        assert_eq!((fold.rows(), fold.of.len()), (20, 40));
        let twins = protocol.reciprocal_twins();
        // a sensitivity matrix with equal rows for reciprocal twins
        let plain = DMatrix::from_fn(40, 6, |i, k| {
            let i = i.min(twins[i].unwrap());
            ((i * 7 + k * 3) as f64).sin()
        });
        let full = DMatrix::from_fn(40, 6, |i, k| factors[i] * plain[(i, k)]);
        let folded = DMatrix::from_fn(20, 6, |row, k| {
            fold.norm()[row] * plain[(fold.first[row], k)]
        });
        let data: Vec<f64> = (0..40).map(|i| (i as f64 * 1.7).cos()).collect();
        for missing in [vec![], vec![3], vec![0, 5, twins[5].unwrap(), 39]] {
            let mut missing: Vec<usize> = missing;
            missing.sort_unstable();
            let kept: Vec<usize> = (0..40).filter(|i| !missing.contains(i)).collect();
            let (j, d) = (
                full.select_rows(&kept),
                DVector::from_iterator(kept.len(), kept.iter().map(|&i| data[i])),
            );
            let seen = fold.seen(&data, &missing);
            let rows = seen.rows(&folded);
            assert_eq!(seen.complete(), missing.is_empty());
            assert!((rows.tr_mul(rows.as_ref()) - j.tr_mul(&j)).amax() < 1e-13 * j.norm_squared());
            assert!((rows.tr_mul(&seen.data) - j.tr_mul(&d)).amax() < 1e-13 * j.norm_squared());
        }
        let model = fold.readings_of(&(&folded * DVector::from_element(6, 1.0)));
        assert!((model - &full * DVector::from_element(6, 1.0)).amax() < 1e-13);
    }
}
