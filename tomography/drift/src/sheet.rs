//! Fits gain, contacts and an uneven conductance of the sheet to the absolute readings of a baseline.
//!
//! Maps compare frames with this fitted sheet instead of the nominal one. The fitted contacts also absorb all effects
//! that the model omits; they are not measured contact resistances.

use std::f64::consts::PI;
use std::sync::Arc;

use eit::linear_algebra::{Definite, product, view};
use eit::{Forward, Mesh, Parameters, bounding_box};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::DriftError;
use crate::pairs::Pairs;

/// Prior standard deviation of ln gain: nearly free.
const GAIN_SD: f64 = 1.0;
/// A fitted contact is implausible if it deviates by more than this many prior standard deviations.
const IMPLAUSIBLE: f64 = 2.0;

/// Prior assumptions and settings of the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FitOptions {
    /// Current of every injection, A.
    pub current_a: f64,
    /// Standard deviation of ln contact resistance.
    pub contact_sd: f64,
    /// Standard deviation of ln conductance.
    pub field_sd: f64,
    /// Correlation length of ln conductance (Matern, smoothness 3/2), m.
    pub field_length_m: f64,
    /// Number of cosine modes that represent ln conductance.
    pub modes: usize,
    /// Gauss-Newton steps.
    pub steps: usize,
    /// Model error, as a share of each reading.
    pub error_share: f64,
    /// Additional error of each reading, V.
    pub error_v: f64,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            current_a: 1e-3,
            contact_sd: 0.4,
            field_sd: 0.15,
            field_length_m: 0.030,
            modes: 120,
            steps: 4,
            error_share: 2e-3,
            error_v: 5e-6,
        }
    }
}

/// A sheet fitted to a baseline.
#[derive(Debug, Clone)]
pub struct SheetFit {
    /// Conductance of each triangle, S per square, gain included.
    pub sigma: Vec<f64>,
    /// Contact impedance of each electrode, ohm m.
    pub contact_ohm_m: Vec<f64>,
    /// Ratio of the fitted model's readings to those of the nominal sheet; includes conductance and contacts.
    pub gain: f64,
    /// ln of the ratio of each contact impedance to its nominal value.
    pub contacts: Vec<f64>,
    /// Root mean square of the relative error of the fitted readings.
    pub misfit: f64,
    /// Root mean square of the relative error of the nominal sheet's readings.
    pub nominal_misfit: f64,
    /// Root mean square over the sheet of the fitted ln conductance about its mean.
    pub unevenness: f64,
    /// Electrodes (from 0) whose contact is implausible.
    pub implausible: Vec<usize>,
    /// Mean of each reciprocal pair of the model's readings at the stated current, V.
    pub readings: DVector<f64>,
}

impl SheetFit {
    /// Fits the sheet to a baseline of a protocol; the whole mesh is fitted, not only its region.
    ///
    /// # Errors
    /// A baseline with missing readings, or a model that cannot be solved.
    pub fn of_baseline(
        mesh: &Mesh,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        protocol: &survey::Protocol,
        baseline: &[survey::Reading],
        options: &FitOptions,
    ) -> Result<Self, DriftError> {
        let pairs = Pairs::new(protocol);
        let baseline = crate::pairs::baseline_volts(&pairs, baseline)?;
        let mesh = Arc::new(mesh.whole());
        Self::new(&mesh, contact_ohm_m, sigma0, &pairs, &baseline, options)
    }

    /// Fits the sheet to the readings of a baseline (V, one for each reading of the protocol).
    ///
    /// # Errors
    /// A model that cannot be solved.
    pub fn new(
        mesh: &Arc<Mesh>,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        pairs: &Pairs,
        baseline: &[f64],
        options: &FitOptions,
    ) -> Result<Self, DriftError> {
        let measured = pairs.mean(baseline);
        let deviation = measured.map(|volts| (options.error_share * volts).hypot(options.error_v));
        let (modes, variances) = cosine_modes(mesh, options);
        let electrodes = contact_ohm_m.len();
        let unknowns = 1 + electrodes + variances.len();
        let precision = DVector::from_fn(unknowns, |k, _| match k {
            0 => GAIN_SD.powi(-2),
            k if k <= electrodes => options.contact_sd.powi(-2),
            k => 1.0 / variances[k - 1 - electrodes],
        });
        let mut theta = DVector::<f64>::zeros(unknowns);
        let mut forward = Forward::new(Arc::clone(mesh), contact_ohm_m)?;
        let at = |theta: &DVector<f64>| {
            let field = &modes * theta.rows(1 + electrodes, variances.len());
            // the gain scales conductances and contacts alike
            let gain = theta[0].exp();
            let sigma: Vec<f64> = sigma0
                .iter()
                .zip(&field)
                .map(|(sigma, field)| sigma * field.exp() / gain)
                .collect();
            let contacts: Vec<f64> = (0..electrodes)
                .map(|e| contact_ohm_m[e] * theta[1 + e].exp() * gain)
                .collect();
            (sigma, contacts)
        };
        let readings = |forward: &Forward, sigma: &[f64]| -> Result<DVector<f64>, DriftError> {
            Ok(forward.readings(sigma, pairs.half())? * options.current_a)
        };
        let mut volts = readings(&forward, sigma0)?;
        let nominal_misfit = misfit(&measured, &volts);
        for _ in 0..options.steps {
            let (sigma, contacts) = at(&theta);
            forward.set_contact_ohm_m(&contacts)?;
            volts = readings(&forward, &sigma)?;
            let jacobian = jacobian(&forward, &sigma, &contacts, pairs, &modes, &volts, options)?;
            let mut white = jacobian;
            for (mut row, deviation) in white.row_iter_mut().zip(&deviation) {
                row /= *deviation;
            }
            let residual = (&measured - &volts).component_div(&deviation);
            let mut normal = product(view(&white.transpose()), view(&white));
            for k in 0..unknowns {
                normal[(k, k)] += precision[k];
            }
            let right = white.tr_mul(&residual) - precision.component_mul(&theta);
            let factor = Definite::new(&normal).ok_or(DriftError::Covariance)?;
            theta += factor.solve(&right);
        }
        let (sigma, contacts) = at(&theta);
        forward.set_contact_ohm_m(&contacts)?;
        let volts = readings(&forward, &sigma)?;
        let field = &modes * theta.rows(1 + electrodes, variances.len());
        let ln_contacts: Vec<f64> = theta.rows(1, electrodes).iter().copied().collect();
        Ok(Self {
            gain: theta[0].exp(),
            misfit: misfit(&measured, &volts),
            nominal_misfit,
            unevenness: unevenness(mesh, &field),
            implausible: (0..electrodes)
                .filter(|&e| ln_contacts[e].abs() > IMPLAUSIBLE * options.contact_sd)
                .collect(),
            contacts: ln_contacts,
            sigma,
            contact_ohm_m: contacts,
            readings: volts,
        })
    }
}

fn misfit(measured: &DVector<f64>, model: &DVector<f64>) -> f64 {
    let squares = measured.zip_map(model, |measured, model| (model / measured - 1.0).powi(2));
    squares.mean().sqrt()
}

/// Root mean square of a field about its mean, weighted by area.
fn unevenness(mesh: &Mesh, field: &DVector<f64>) -> f64 {
    let (mut area, mut sum, mut square) = (0.0, 0.0, 0.0);
    for (triangle, value) in field.iter().enumerate() {
        let share = mesh.area(triangle);
        area += share;
        sum += share * value;
        square += share * value * value;
    }
    (square / area - (sum / area).powi(2)).max(0.0).sqrt()
}

/// Derivatives of the readings with respect to ln gain, ln contacts and the amplitudes of the modes, V.
fn jacobian(
    forward: &Forward,
    sigma: &[f64],
    contacts: &[f64],
    pairs: &Pairs,
    modes: &DMatrix<f64>,
    volts: &DVector<f64>,
    options: &FitOptions,
) -> Result<DMatrix<f64>, DriftError> {
    let current = options.current_a;
    let elements = Parameters::elements().logarithmic();
    let sensitivity = forward.sensitivity(sigma, pairs.half(), &elements)?;
    let fields = product(view(&sensitivity), view(modes)) * current;
    let by_contact = forward.contact_jacobian(sigma, pairs.half())?;
    let mut out = DMatrix::zeros(volts.len(), 1 + contacts.len() + modes.ncols());
    out.column_mut(0).copy_from(volts);
    for (electrode, contact) in contacts.iter().enumerate() {
        let column = by_contact.column(electrode) * (contact * current);
        out.column_mut(1 + electrode).copy_from(&column);
    }
    out.columns_mut(1 + contacts.len(), modes.ncols())
        .copy_from(&fields);
    Ok(out)
}

/// Cosines over the mesh's bounding box at the centroid of each triangle (row), lowest wave numbers first, without the
/// constant; and the prior variance of each amplitude from the spectrum of a Matern field.
fn cosine_modes(mesh: &Mesh, options: &FitOptions) -> (DMatrix<f64>, Vec<f64>) {
    let [low, high] = bounding_box(mesh.nodes().iter().copied());
    let size = [high[0] - low[0], high[1] - low[1]];
    let most = options.modes + 1;
    let mut numbers: Vec<([usize; 2], f64)> = (0..most)
        .flat_map(|k| (0..=(most / (k + 1))).map(move |l| [k, l]))
        .filter(|number| *number != [0, 0])
        .map(|number| {
            let along = |axis: usize| (PI * number[axis] as f64 / size[axis]).powi(2);
            (number, along(0) + along(1))
        })
        .collect();
    numbers.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    numbers.truncate(options.modes);
    let modes = DMatrix::from_fn(mesh.triangles().len(), numbers.len(), |triangle, mode| {
        let centre = mesh.centroid(triangle);
        let along = |axis: usize| {
            let number = numbers[mode].0[axis] as f64;
            (PI * number * (centre[axis] - low[axis]) / size[axis]).cos()
        };
        along(0) * along(1)
    });
    let corner = 3.0 / options.field_length_m.powi(2);
    let spectrum: Vec<f64> = numbers
        .iter()
        .map(|(_, square)| (corner + square).powf(-2.5))
        .collect();
    // the mean of a squared mode over the sheet is 1/4, or 1/2 if it varies along one axis only
    let total: f64 = numbers
        .iter()
        .zip(&spectrum)
        .map(|((number, _), value)| match number {
            [0, _] | [_, 0] => 0.5 * value,
            _ => 0.25 * value,
        })
        .sum();
    let scale = options.field_sd.powi(2) / total;
    (modes, spectrum.iter().map(|value| scale * value).collect())
}
