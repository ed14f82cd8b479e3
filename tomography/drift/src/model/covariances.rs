//! Covariances of the readings' noise, of second-order contact effects, and of fields.

use std::sync::Arc;

use eit::linear_algebra::{product, view};
use eit::{Forward, Mesh};
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::DriftError;
use crate::model::Noise;
use crate::pairs::Pairs;
use crate::sheet::SheetFit;

/// Standard deviation of ln contact impedance used to draw second-order effects, and the number of draws.
pub(crate) const SECOND_ORDER_SD: f64 = 0.1;
const DRAWS: usize = 240;

/// R: independent noise of each reading, and one thermal voltage for each sensing pair.
pub(crate) fn noise_covariance(pairs: &Pairs, ratios: &[f64], noise: Noise) -> DMatrix<f64> {
    let rows = pairs.len();
    let mut out = DMatrix::zeros(rows, rows);
    let mut emf = DMatrix::zeros(rows, pairs.protocol().electrodes());
    for row in 0..rows {
        let [a, b] = pairs.readings(row);
        let weight = if a == b { 1.0 } else { 0.5 };
        let both = if a == b { vec![a] } else { vec![a, b] };
        for reading in both {
            let share = weight * ratios[reading];
            out[(row, row)] += (share * noise.reading_v).powi(2);
            let sense = pairs.protocol().measurements()[reading].sense;
            emf[(row, sense.plus.0)] += share * noise.emf_v;
        }
    }
    out + product(view(&emf), view(&emf.transpose()))
}

/// Covariance of the contacts' effect beyond first order, from nonlinear draws.
pub(crate) fn second_order(
    mesh: &Arc<Mesh>,
    fit: &SheetFit,
    pairs: &Pairs,
    contacts: &DMatrix<f64>,
    current_a: f64,
) -> Result<DMatrix<f64>, DriftError> {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let draws: Vec<DVector<f64>> = (0..DRAWS)
        .map(|_| {
            DVector::from_fn(fit.contact_ohm_m.len(), |_, _| {
                let normal: f64 = StandardNormal.sample(&mut random);
                SECOND_ORDER_SD * normal
            })
        })
        .collect();
    let left: Vec<Vec<DVector<f64>>> = draws
        .par_chunks(DRAWS / 8)
        .map(|draws| {
            let mut forward = Forward::new(Arc::clone(mesh), &fit.contact_ohm_m)?;
            draws
                .iter()
                .map(|draw| {
                    let drawn: Vec<f64> = fit
                        .contact_ohm_m
                        .iter()
                        .zip(draw)
                        .map(|(contact, draw)| contact * draw.exp())
                        .collect();
                    forward.set_contact_ohm_m(&drawn)?;
                    let volts = forward
                        .workspace(pairs.half())?
                        .plain()
                        .readings(&fit.sigma)?;
                    Ok(volts * current_a - &fit.readings - contacts * draw)
                })
                .collect::<Result<_, DriftError>>()
        })
        .collect::<Result<_, _>>()?;
    let columns: Vec<DVector<f64>> = left.into_iter().flatten().collect();
    let left = DMatrix::from_columns(&columns) / (DRAWS as f64).sqrt();
    Ok(product(view(&left), view(&left.transpose())))
}

/// Correlation of a Matern field of smoothness 3/2 between all positions.
pub(crate) fn matern(places: &[[f64; 2]], length: f64) -> DMatrix<f64> {
    DMatrix::from_fn(places.len(), places.len(), |i, j| {
        let (p, q) = (places[i], places[j]);
        let scaled = 3_f64.sqrt() * (p[0] - q[0]).hypot(p[1] - q[1]) / length;
        (1.0 + scaled) * (-scaled).exp()
    })
}
