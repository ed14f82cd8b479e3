//! Detects the faulty electrode that a frame shows: shorted to its neighbour, open, floating, or shorted to a distant
//! electrode.
//!
//! The tests use innovations (changes since the tracked baseline) and allow for local loads of 30 %, so that neither
//! months of drift nor a load is taken for a contact fault.

use std::sync::Arc;

use eit::linear_algebra::{Definite, product, view};
use nalgebra::{DMatrix, DVector};
use survey::Reading;

use crate::DriftError;
use crate::model::DriftModel;
use crate::pairs::NEARLY_ZERO;
use crate::whitened::{Whitened, factor};

/// Standard deviation of the local change allowed for.
const LOAD: f64 = 0.3;
/// Prior standard deviation of ln contact impedance, and the estimate above which a contact counts as risen.
const CONTACT_SD: f64 = 1.0;
const RISEN: f64 = 1.0;
/// Chi squared per row above which a faulty electrode is searched for, and the largest share of it that may remain
/// without the electrode.
const UNEXPLAINED: f64 = 10.0;
const LEFT: f64 = 0.05;
/// Estimate above which a contact change is not the cause: the estimates of open contacts saturate below it.
const NO_CONTACT: f64 = 3.0;

/// A fault of electrodes, counted from 0.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ElectrodeFault {
    /// The pair of an electrode and the next one reads almost nothing.
    Shorted {
        /// The first electrode of the pair.
        electrode: usize,
    },
    /// The contact impedance has risen by a factor: open, or nearly.
    Risen {
        /// The electrode.
        electrode: usize,
        /// The estimate of the change of ln impedance; it saturates near 2.
        by: f64,
    },
    /// The readings of the electrode are arbitrary: all other readings agree with the model.
    Floating {
        /// The electrode.
        electrode: usize,
    },
    /// Two electrodes are connected.
    DistantShort {
        /// The electrodes, ascending.
        electrodes: [usize; 2],
    },
}

impl ElectrodeFault {
    /// The electrodes whose readings must not be used.
    pub fn electrodes(&self, count: usize) -> Vec<usize> {
        match *self {
            Self::Shorted { electrode } => vec![electrode, (electrode + 1) % count],
            Self::Risen { electrode, .. } | Self::Floating { electrode } => vec![electrode],
            Self::DistantShort { electrodes } => electrodes.to_vec(),
        }
    }
}

/// Covariance of innovations that allows for loads, and the estimator of ln contact impedances from its usable rows.
#[derive(Debug)]
pub struct Allowed {
    covariance: DMatrix<f64>,
    factor: Arc<Definite>,
    rows: Vec<usize>,
    estimate: DMatrix<f64>,
}

impl Allowed {
    fn new(
        model: &DriftModel,
        covariance: DMatrix<f64>,
        rows: &[usize],
    ) -> Result<Self, DriftError> {
        let factor = Arc::new(factor(&covariance, rows)?);
        let contacts = model.contacts.select_rows(rows);
        let mut weights = contacts.clone();
        factor.solve_columns(&mut weights);
        let mut normal = product(view(&contacts).transpose(), view(&weights));
        for k in 0..normal.nrows() {
            normal[(k, k)] += CONTACT_SD.powi(-2);
        }
        let mut estimate = weights.transpose();
        Definite::new(&normal)
            .ok_or(DriftError::Covariance)?
            .solve_columns(&mut estimate);
        Ok(Self {
            covariance,
            factor,
            rows: rows.to_vec(),
            estimate,
        })
    }

    /// The electrode with the largest estimated rise of contact impedance, and the change of ln impedance.
    fn most_risen(&self, data: &DVector<f64>) -> (usize, f64) {
        (&self.estimate * data.select_rows(&self.rows)).argmax()
    }

    /// Whether drift and loads do not explain the data, or a contact is estimated as risen.
    fn shows_fault(&self, data: &DVector<f64>) -> bool {
        let white = Whitened::with(Arc::clone(&self.factor), data, &self.rows);
        white.chi_per_row() > UNEXPLAINED || self.most_risen(data).1 >= RISEN
    }
}

/// The tests, prepared for one sheet.
pub struct ElectrodeCheck {
    /// Electrodes used by each pair of readings.
    uses: Vec<[usize; 4]>,
    /// Change of the data caused by a connection of two electrodes, up to a factor; and these electrodes.
    shorts: DMatrix<f64>,
    of_short: Vec<[usize; 2]>,
    /// Readings that drive or sense between each electrode and the next one.
    between_neighbours: Vec<Vec<usize>>,
    /// Index of the injection of each reading, and the number of injections.
    injection_of: Vec<usize>,
    injections: usize,
}

impl ElectrodeCheck {
    /// Prepares the tests for a sheet.
    pub fn new(model: &DriftModel) -> Self {
        let count = model.potentials.nrows();
        let questions = model.pairs().half().measurements();
        let uses: Vec<[usize; 4]> = questions
            .iter()
            .map(|q| q.electrodes().map(|electrode| electrode.0))
            .collect();
        // column e: potentials for 1 A from electrode e to e + 1; sums of columns give any pair
        let between = |a: usize, b: usize| -> DVector<f64> {
            let mut out = DVector::zeros(count);
            let (low, high, sign) = if a < b { (a, b, 1.0) } else { (b, a, -1.0) };
            for e in low..high {
                out.axpy(sign, &model.potentials.column(e), 1.0);
            }
            out
        };
        let of_short: Vec<[usize; 2]> = (0..count)
            .flat_map(|a| (a + 1..count).map(move |b| [a, b]))
            .collect();
        let columns: Vec<DVector<f64>> = of_short
            .iter()
            .map(|&[a, b]| {
                let field = between(a, b);
                DVector::from_iterator(
                    uses.len(),
                    uses.iter()
                        .map(|[p, q, r, s]| -(field[*p] - field[*q]) * (field[*r] - field[*s])),
                )
            })
            .collect();
        let measurements = model.pairs().protocol().measurements();
        let between_neighbours = (0..count).map(|electrode| {
            let next = (electrode + 1) % count;
            let is = |pair: survey::Dipole| {
                let ends = [pair.plus.0, pair.minus.0];
                ends.iter().all(|e| [electrode, next].contains(e))
            };
            let readings = measurements.iter().enumerate();
            let of = readings.filter(|(_, q)| is(q.sense) || is(q.drive));
            of.map(|(reading, _)| reading).collect()
        });
        let mut drives = Vec::new();
        let injection_of = measurements.iter().map(|q| {
            let known = drives.iter().position(|drive| *drive == q.drive);
            known.unwrap_or_else(|| {
                drives.push(q.drive);
                drives.len() - 1
            })
        });
        let injection_of = injection_of.collect();
        Self {
            injection_of,
            injections: drives.len(),
            between_neighbours: between_neighbours.collect(),
            uses,
            shorts: DMatrix::from_columns(&columns),
            of_short,
        }
    }

    /// The rows that use none of these electrodes.
    pub fn without(&self, rows: &[usize], electrodes: &[usize]) -> Vec<usize> {
        let healthy = |row: &&usize| self.uses[**row].iter().all(|e| !electrodes.contains(e));
        rows.iter().filter(healthy).copied().collect()
    }

    /// Prepares the test of innovations with this covariance (without load, V2), using only `rows`.
    ///
    /// # Errors
    /// A covariance that is not positive definite.
    pub fn allow(
        &self,
        model: &DriftModel,
        covariance: &DMatrix<f64>,
        rows: &[usize],
    ) -> Result<Allowed, DriftError> {
        Allowed::new(model, covariance + &model.local_gram * LOAD.powi(2), rows)
    }

    /// The fault that a frame shows, if any. Faults other than shorted neighbours are confirmed: if the readings before
    /// or after some injection show no fault, the sheet changed during the frame and the result is `None`. `data`: the
    /// data of the frame; `innovation`: the data minus the tracked baseline, V.
    ///
    /// # Errors
    /// A covariance that is not positive definite.
    pub fn confirmed_fault(
        &self,
        model: &DriftModel,
        frame: &[Reading],
        data: &DVector<f64>,
        innovation: &DVector<f64>,
        allowed: &Allowed,
    ) -> Result<Option<ElectrodeFault>, DriftError> {
        let Some(fault) = self.fault(model, frame, innovation, allowed)? else {
            return Ok(None);
        };
        if matches!(fault, ElectrodeFault::Shorted { .. }) {
            return Ok(Some(fault));
        }
        let reference = data - innovation;
        for change in 1..self.injections {
            // the longer part of the frame contains more of the pairs
            let later = 2 * change <= self.injections;
            let is_of_part = |reading: &usize| (self.injection_of[*reading] >= change) == later;
            let mut part = DVector::zeros(data.len());
            let mut rows = Vec::with_capacity(allowed.rows.len());
            for &row in &allowed.rows {
                let of_part = model.pairs().readings(row).into_iter().find(is_of_part);
                if let Some(volts) = of_part.and_then(|reading| frame[reading].volts())
                    && let Some(reading) = of_part
                {
                    part[row] = model.change_of(reading, volts.0) - reference[row];
                    rows.push(row);
                }
            }
            let of_part = Allowed::new(model, allowed.covariance.clone(), &rows)?;
            if !of_part.shows_fault(&part) {
                return Ok(None);
            }
        }
        Ok(Some(fault))
    }

    /// Whether an innovation certainly shows no fault, without solving a system: `white` is whitened by the covariance
    /// without loads, so its chi squared is at least that with loads allowed for.
    pub(crate) fn is_healthy(
        &self,
        model: &DriftModel,
        frame: &[Reading],
        white: &Whitened,
        allowed: &Allowed,
    ) -> bool {
        white.chi_per_row() <= UNEXPLAINED
            && allowed.most_risen(&white.raw()).1 < RISEN
            && self.shorted(model, frame).is_none()
    }

    /// The fault that a frame shows, if any. `innovation` is the data minus the tracked baseline, V.
    ///
    /// # Errors
    /// A covariance that is not positive definite.
    pub fn fault(
        &self,
        model: &DriftModel,
        frame: &[Reading],
        innovation: &DVector<f64>,
        allowed: &Allowed,
    ) -> Result<Option<ElectrodeFault>, DriftError> {
        if let Some(electrode) = self.shorted(model, frame) {
            return Ok(Some(ElectrodeFault::Shorted { electrode }));
        }
        let (wider, rows) = (&allowed.covariance, &allowed.rows);
        let white = Whitened::with(Arc::clone(&allowed.factor), innovation, rows);
        let chi = white.data().norm_squared();
        let (electrode, by) = allowed.most_risen(innovation);
        let risen = (RISEN..NO_CONTACT).contains(&by);
        if white.chi_per_row() > UNEXPLAINED {
            if let Some(electrodes) = self.short(&white, chi) {
                return Ok(Some(ElectrodeFault::DistantShort { electrodes }));
            }
            if risen && self.left(wider, innovation, rows, electrode)? < LEFT * chi {
                return Ok(Some(ElectrodeFault::Risen { electrode, by }));
            }
            let culprit = self.culprit(wider, innovation, rows, chi)?;
            return Ok(culprit.map(|electrode| ElectrodeFault::Floating { electrode }));
        }
        Ok(risen.then_some(ElectrodeFault::Risen { electrode, by }))
    }

    /// The first electrode of a pair whose readings, driven or sensed, are almost zero.
    fn shorted(&self, model: &DriftModel, frame: &[Reading]) -> Option<usize> {
        let almost_nothing = |readings: &Vec<usize>| {
            let shares = readings.iter().filter_map(|&reading| {
                let volts = frame[reading].volts()?.0;
                Some((volts / model.baseline()[reading]).abs())
            });
            // the median is below the threshold
            let (mut count, mut below) = (0, 0);
            for share in shares {
                count += 1;
                below += usize::from(share < NEARLY_ZERO);
            }
            below > count / 2
        };
        self.between_neighbours.iter().position(almost_nothing)
    }

    /// Two electrodes whose connection explains the data.
    fn short(&self, white: &Whitened, chi: f64) -> Option<[usize; 2]> {
        let signatures = white.sensitivity(&self.shorts);
        let dots = signatures.tr_mul(white.data());
        let explained = signatures
            .column_iter()
            .zip(dots.iter())
            .map(|(column, dot)| dot * dot / column.norm_squared());
        let (best, most) = explained.enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
        (chi - most < LEFT * chi).then(|| self.of_short[best])
    }

    /// Chi squared without the readings of an electrode.
    fn left(
        &self,
        covariance: &DMatrix<f64>,
        innovation: &DVector<f64>,
        rows: &[usize],
        electrode: usize,
    ) -> Result<f64, DriftError> {
        let rows = self.without(rows, &[electrode]);
        Ok(Whitened::new(covariance, innovation, &rows)?
            .data()
            .norm_squared())
    }

    /// The electrode without whose readings the model explains the data.
    fn culprit(
        &self,
        covariance: &DMatrix<f64>,
        innovation: &DVector<f64>,
        rows: &[usize],
        chi: f64,
    ) -> Result<Option<usize>, DriftError> {
        let count = self.of_short.last().map_or(0, |[_, b]| b + 1);
        let mut best = (0, f64::INFINITY);
        for electrode in 0..count {
            let left = self.left(covariance, innovation, rows, electrode)?;
            if left < best.1 {
                best = (electrode, left);
            }
        }
        let (electrode, left) = best;
        Ok((left < LEFT * chi).then_some(electrode))
    }
}
