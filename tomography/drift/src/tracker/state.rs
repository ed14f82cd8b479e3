//! The complete state of a tracker; it is stored and restored bit for bit.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::anchors::Anchors;
use super::load::Ledger;
use super::orders::TrackingOrder;
use super::pace::Pace;
use super::{HEALED_S, bits};
use crate::DriftError;
use crate::basis::Basis;
use crate::model::DriftModel;

/// All data that later results depend on, except the sheet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrackerState {
    /// Identity of the mesh, baseline and build for which the state is valid.
    sheet: String,
    /// Change of the data since the first baseline, V.
    #[serde(with = "bits")]
    baseline: Vec<f64>,
    /// Lower triangle of its covariance, column by column, V2.
    #[serde(with = "bits")]
    covariance: Vec<f64>,
    /// Data of the last frame, V.
    #[serde(with = "bits")]
    pub(super) last: Vec<f64>,
    /// Rows of the last frame that were usable.
    pub(super) last_rows: Vec<usize>,
    /// Time of the last frame, and of the last one without load, s.
    #[serde(with = "bits::number")]
    pub(super) at_s: f64,
    #[serde(with = "bits::number")]
    pub(super) empty_s: f64,
    /// Frames without load since the covariance was changed by anything else.
    pub(super) run: u32,
    /// Interval for which the covariance is reused, days.
    #[serde(with = "bits::option")]
    pub(super) kept_days: Option<f64>,
    /// Frames since the load came.
    pub(super) loaded_frames: u32,
    pub(super) ledger: Ledger,
    pub(super) pace: Pace,
    pub(super) anchors: Anchors,
    faults: Vec<Fault>,
    /// Pending user orders.
    #[serde(default)]
    pub(super) orders: Vec<TrackingOrder>,
    /// Noise of a reading and thermal voltage of a sensing pair, V, for which the coordinates of the pace filters hold;
    /// empty in states stored by older versions.
    #[serde(default, with = "bits")]
    noise: Vec<f64>,
}

/// A faulty electrode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Fault {
    electrode: usize,
    #[serde(with = "bits::number")]
    last_s: f64,
}

impl TrackerState {
    /// The state at the first baseline, which has the noise of one frame.
    pub(super) fn new(model: &DriftModel, at_s: f64) -> Self {
        let rows = model.pairs().len();
        let mut state = Self {
            sheet: identity(model),
            baseline: vec![0.0; rows],
            covariance: Vec::new(),
            last: Vec::new(),
            last_rows: Vec::new(),
            at_s,
            empty_s: at_s,
            run: 0,
            kept_days: None,
            loaded_frames: 0,
            ledger: Ledger::default(),
            pace: Pace::new(rows, at_s),
            anchors: Anchors::default(),
            faults: Vec::new(),
            orders: Vec::new(),
            noise: noise_of(model),
        };
        state.set_covariance(&model.noise);
        state.anchors.keep(&DVector::zeros(rows), at_s);
        state
    }

    /// Refuses a state of another sheet, and a state with an array length or an index that does not fit this sheet.
    pub(super) fn check(&self, model: &DriftModel) -> Result<(), DriftError> {
        let wants = identity(model);
        if self.sheet != wants {
            return Err(DriftError::State {
                has: self.sheet.clone(),
                wants,
            });
        }
        let rows = model.pairs().len();
        let electrodes = model.mesh().electrodes();
        let ascending = self.last_rows.is_sorted_by(|a, b| a < b);
        let fitting = [
            ("baseline", self.baseline.len() == rows),
            ("covariance", self.covariance.len() == rows * (rows + 1) / 2),
            ("last", [0, rows].contains(&self.last.len())),
            (
                "last_rows",
                ascending && self.last_rows.last().is_none_or(|&row| row < rows),
            ),
            ("ledger", self.ledger.fits(rows)),
            ("pace", self.pace.fits(rows)),
            ("anchors", self.anchors.fits(rows)),
            (
                "faults",
                self.faults.iter().all(|fault| fault.electrode < electrodes),
            ),
        ];
        match fitting.into_iter().find(|(_, fits)| !fits) {
            Some((field, _)) => Err(DriftError::DamagedState { field }),
            None => Ok(()),
        }
    }

    /// Continues with the noise of this model: if the noise changed, the pace filters restart at the tracked baseline.
    pub(super) fn take_noise(&mut self, model: &DriftModel, basis: &Basis) {
        let noise = noise_of(model);
        if !self.noise.is_empty() && self.noise != noise {
            let baseline = basis.of(&self.baseline());
            self.pace.begin_again(&baseline, self.empty_s);
            self.restart();
        }
        self.noise = noise;
    }

    pub(super) fn baseline(&self) -> DVector<f64> {
        DVector::from_column_slice(&self.baseline)
    }

    pub(super) fn set_baseline(&mut self, baseline: &DVector<f64>) {
        self.baseline = baseline.as_slice().to_vec();
    }

    pub(super) fn correct(&mut self, by: &DVector<f64>) {
        for (value, by) in self.baseline.iter_mut().zip(by) {
            *value += by;
        }
    }

    pub(super) fn covariance(&self) -> DMatrix<f64> {
        let n = self.baseline.len();
        let mut values = self.covariance.iter();
        let mut out = DMatrix::zeros(n, n);
        for column in 0..n {
            for row in column..n {
                let value = values.next().copied().unwrap_or_default();
                out[(row, column)] = value;
                out[(column, row)] = value;
            }
        }
        out
    }

    pub(super) fn set_covariance(&mut self, covariance: &DMatrix<f64>) {
        let n = self.baseline.len();
        self.covariance = (0..n)
            .flat_map(|column| (column..n).map(move |row| covariance[(row, column)]))
            .collect();
    }

    pub(super) fn add_covariance(&mut self, gram: &DMatrix<f64>, factor: f64) {
        let wider = self.covariance() + gram * factor;
        self.set_covariance(&wider);
    }

    /// Sets another pace and rescales the covariance as if the sheet had always drifted at it.
    pub(super) fn raise_pace(&mut self, pace: f64) {
        let factor = (pace / self.pace.pace).powi(2);
        for value in &mut self.covariance {
            *value *= factor;
        }
        self.pace.pace = pace;
        self.restart();
    }

    /// Marks the covariance as no longer steady.
    pub(super) fn restart(&mut self) {
        self.run = 0;
        self.kept_days = None;
    }

    pub(super) fn mask(&mut self, electrodes: &[usize]) {
        let last_s = self.at_s;
        for &electrode in electrodes {
            match self
                .faults
                .iter_mut()
                .find(|fault| fault.electrode == electrode)
            {
                Some(fault) => fault.last_s = last_s,
                None => self.faults.push(Fault { electrode, last_s }),
            }
        }
    }

    /// The clock was set back to this time: later times are limited to it, so that nothing waits until the clock
    /// reaches them again.
    pub(super) fn set_back(&mut self, at_s: f64) {
        let masked = self.masked();
        self.faults
            .retain(|fault| masked.contains(&fault.electrode));
        for fault in &mut self.faults {
            fault.last_s = fault.last_s.min(at_s);
        }
        self.empty_s = self.empty_s.min(at_s);
        self.pace.set_back(at_s);
        self.anchors.set_back(at_s);
    }

    /// Electrodes that were faulty within the last hour, from 0, ascending.
    pub fn masked(&self) -> Vec<usize> {
        let recent = |fault: &&Fault| (self.at_s - fault.last_s).abs() < HEALED_S;
        let mut masked: Vec<usize> = self
            .faults
            .iter()
            .filter(recent)
            .map(|fault| fault.electrode)
            .collect();
        masked.sort_unstable();
        masked
    }

    /// Root mean square over the data of the standard deviation of the tracked baseline, V.
    pub fn deviation(&self) -> f64 {
        let n = self.baseline.len();
        let trace: f64 = (0..n)
            .scan(0, |at, column| {
                let value = self.covariance[*at];
                *at += n - column;
                Some(value)
            })
            .sum();
        (trace / n as f64).sqrt()
    }

    /// Root mean square over the data of the change since the first baseline, V.
    pub fn change(&self) -> f64 {
        let squares: f64 = self.baseline.iter().map(|value| value * value).sum();
        (squares / self.baseline.len() as f64).sqrt()
    }

    /// Time of the last frame, s.
    pub fn at_s(&self) -> f64 {
        self.at_s
    }

    /// Loads that lie on the sheet.
    pub fn loads(&self) -> usize {
        self.ledger.loads()
    }

    /// Whether the sheet counts as loaded because of a user's order.
    pub fn held(&self) -> bool {
        self.ledger.held
    }

    /// Seconds from the last frame without load to this time.
    pub fn since_empty_s(&self, at_s: f64) -> f64 {
        at_s - self.empty_s
    }

    /// Pace of the drift relative to the built-in rates.
    pub fn pace(&self) -> f64 {
        self.pace.pace
    }
}

fn noise_of(model: &DriftModel) -> Vec<f64> {
    let noise = model.instruments();
    vec![noise.reading_v, noise.emf_v]
}

/// Identity of mesh, baseline and build: FNV-1a hash of the numbers that the data depend on.
fn identity(model: &DriftModel) -> String {
    let numbers = model.baseline().iter().chain(model.fit().readings.iter());
    let hash = numbers
        .flat_map(|value| value.to_bits().to_le_bytes())
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        });
    let mesh = model.mesh().hash();
    let version = env!("CARGO_PKG_VERSION");
    format!("mesh {mesh}, baseline {hash:016x}, build {version}")
}
