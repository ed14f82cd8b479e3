//! The radial-basis-function network of the paper (section 4.3).
//!
//! phi_n = exp(-|dv - c_n|^2 / 2 b^2)  (Eq. 12),  x = sum_n w_n phi_n  (Eq. 14),  W = dSigma Phi^+  (Eq. 15).
//!
//! With b well above the distances of the centres (as Eq. 13 gives) the phi are almost parallel and W is huge: its digits
//! would be lost in f32. W is therefore kept as a product: the singular value decomposition Phi' = Q S V' gives
//! `mixing` = S^-1 V' (small, f64) and `weights` = Q' dSigma (f32, of the size of the maps).

use std::sync::Arc;

use faer::linalg::solvers::Svd;
use nalgebra::DMatrix;
use rayon::prelude::*;
use survey::{Map, Protocol, Reading};

use crate::inverse::learned::kmeans::Rows;
use crate::inverse::learned::network::FAMILIAR_SHARE;
use crate::inverse::learned::trained::Trained;
use crate::linear_algebra::dense;
use crate::linear_algebra::simd::{add_four, dot, squared_distance};
use crate::{Mesh, Novelty, ReconstructError, Reconstructor};

/// Singular values of Phi below this share of the largest are cut (Moore-Penrose).
const CUT: f64 = 1e-10;

/// Distance to the nearest centre, in spreads, beyond which nothing is said: every phi is below 2e-8 there, and "no load"
/// would be the answer to anything.
pub const NOVELTY_LIMIT: f64 = 6.0;

/// A trained network: f32 centres and weights.
#[derive(Debug, Clone, PartialEq)]
pub struct RbfNetwork {
    /// Readings of the input.
    pub(crate) inputs: usize,
    /// Triangles of the output.
    pub(crate) outputs: usize,
    /// b of Eq. 13.
    pub(crate) spread: f64,
    /// One row of `inputs` a neuron.
    pub(crate) centres: Vec<f32>,
    /// One row of as many entries as neurons for each direction kept.
    pub(crate) mixing: Vec<f64>,
    /// One row of `outputs` for each direction kept.
    pub(crate) weights: Vec<f32>,
}

/// How well the least-squares problem of Eq. 15 is posed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Conditioning {
    /// Distance from the nearest centre, in spreads, within which 99.9 % of the samples lie.
    pub(crate) familiar: f64,
    /// Directions kept.
    pub(crate) rank: usize,
    /// Largest over smallest singular value of Phi, cut ones included.
    pub(crate) condition: f64,
    /// Largest entry of W.
    pub(crate) largest_weight: f64,
}

/// What a change of each sample is: (unknown, relative change) where it is not zero.
pub(crate) type Sparse = Vec<(u32, f32)>;

impl RbfNetwork {
    /// Readings of the input.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Triangles of the output.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Number of neurons.
    pub fn neurons(&self) -> usize {
        self.centres.len() / self.inputs
    }

    /// The spread b of Eq. 13, in units of the normalised input.
    pub fn spread(&self) -> f64 {
        self.spread
    }

    /// Distance of a normalised input from each centre; missing readings are left out, and the others stand for them.
    fn distances(&self, input: &[f64], missing: &[usize]) -> Vec<f64> {
        let valid = self.inputs as f64 / (self.inputs - missing.len()) as f64;
        self.centres
            .chunks(self.inputs)
            .map(|centre| {
                let mut square = squared_distance(centre, input);
                for &reading in missing {
                    square -= (f64::from(centre[reading]) - input[reading]).powi(2);
                }
                (square.max(0.0) * valid).sqrt()
            })
            .collect()
    }

    /// The map of a normalised input (Eq. 6).
    pub fn predict(&self, input: &[f64]) -> Vec<f64> {
        self.respond(&self.distances(input, &[]))
    }

    /// Distance to the nearest centre in spreads: how far an input is from what the network has seen.
    pub fn novelty(&self, input: &[f64]) -> f64 {
        self.nearest(&self.distances(input, &[]))
    }

    fn nearest(&self, distances: &[f64]) -> f64 {
        distances.iter().copied().fold(f64::INFINITY, f64::min) / self.spread
    }

    fn respond(&self, distances: &[f64]) -> Vec<f64> {
        let phi: Vec<f64> = distances
            .iter()
            .map(|distance| (-0.5 * (distance / self.spread).powi(2)).exp())
            .collect();
        // four directions a pass, in f32: the map is then read and written a quarter as often
        let mut map = vec![0.0_f32; self.outputs];
        let mut directions = self
            .mixing
            .chunks(phi.len())
            .zip(self.weights.chunks(self.outputs))
            .map(|(mixing, weights)| (dot(mixing, &phi) as f32, weights));
        while let Some(first) = directions.next() {
            let mut more = || directions.next().unwrap_or((0.0, first.1));
            let four = [first, more(), more(), more()];
            add_four(
                &mut map,
                four.map(|(_, weights)| weights),
                four.map(|(amount, _)| amount),
            );
        }
        map.into_iter().map(f64::from).collect()
    }

    /// Solves Eq. 15 for given centres and spread. `inputs` are `repeats` copies of the cases one after the other, each
    /// with its own jitter; `targets` one for each case.
    pub(crate) fn fit(
        inputs: Rows<'_>,
        centres: &[f64],
        spread: f64,
        targets: &[Sparse],
        outputs: usize,
    ) -> Option<(Self, Conditioning)> {
        let centres: Vec<f32> = centres.iter().map(|value| *value as f32).collect();
        let wide: Vec<f64> = centres.iter().map(|value| f64::from(*value)).collect();
        let neurons = centres.len() / inputs.width;
        let mut rows = vec![0.0; inputs.len() * neurons];
        let mut nearest: Vec<f64> = rows
            .par_chunks_mut(neurons)
            .enumerate()
            .map(|(sample, phi)| {
                let row = inputs.row(sample);
                let mut least = f64::INFINITY;
                for (phi, centre) in phi.iter_mut().zip(wide.chunks(inputs.width)) {
                    let square = squared_distance(row, centre);
                    least = least.min(square);
                    *phi = (-0.5 * square / (spread * spread)).exp();
                }
                least.sqrt() / spread
            })
            .collect();
        nearest.sort_by(f64::total_cmp);
        let last = (nearest.len() as f64 * FAMILIAR_SHARE) as usize;
        let familiar = nearest[last.min(nearest.len() - 1)];
        let phi = faer::MatRef::from_row_major_slice(&rows, inputs.len(), neurons);
        let qr = phi.qr();
        let svd = Svd::new(qr.thin_R()).ok()?;
        let (u, s, v) = (svd.U(), svd.S(), svd.V());
        let rank = (0..neurons).filter(|&i| s[i] > CUT * s[0]).count();
        if rank == 0 {
            return None;
        }
        // coordinates of every case in the directions kept, its repeats added: they share one target
        let q = qr.compute_thin_Q();
        let cases = targets.len();
        let coordinates: Vec<f64> = (0..cases)
            .into_par_iter()
            .flat_map_iter(|case| {
                let mut sum = vec![0.0; neurons];
                for sample in (case..inputs.len()).step_by(cases) {
                    for (j, sum) in sum.iter_mut().enumerate() {
                        *sum += q[(sample, j)];
                    }
                }
                (0..rank)
                    .map(|direction| (0..neurons).map(|j| sum[j] * u[(j, direction)]).sum())
                    .collect::<Vec<f64>>()
            })
            .collect();
        let weights: Vec<Vec<f64>> = (0..rank)
            .into_par_iter()
            .map(|direction| {
                let mut row = vec![0.0; outputs];
                for (case, target) in targets.iter().enumerate() {
                    let along = coordinates[case * rank + direction];
                    for &(unknown, change) in target {
                        row[unknown as usize] += along * f64::from(change);
                    }
                }
                row
            })
            .collect();
        let mixing: Vec<f64> = (0..rank)
            .flat_map(|direction| (0..neurons).map(move |n| v[(n, direction)] / s[direction]))
            .collect();
        let largest_weight = largest_product(&mixing, &weights, neurons);
        let network = Self {
            inputs: inputs.width,
            outputs,
            spread,
            centres,
            mixing,
            weights: weights
                .iter()
                .flatten()
                .map(|value| *value as f32)
                .collect(),
        };
        network.is_finite().then_some((
            network,
            Conditioning {
                familiar,
                rank,
                condition: (s[0] / s[neurons - 1]).min(f64::MAX),
                largest_weight,
            },
        ))
    }

    /// Whether its parts fit each other, every number is finite and the spread positive.
    pub(crate) fn is_sound(&self) -> Result<(), String> {
        let neurons = self.neurons();
        if neurons == 0
            || self.mixing.is_empty()
            || self.mixing.len() / neurons != self.weights.len() / self.outputs
        {
            return Err("its mixing and weights have different ranks".to_owned());
        }
        if self.is_finite() {
            Ok(())
        } else {
            Err("it has numbers that are not finite".to_owned())
        }
    }

    fn is_finite(&self) -> bool {
        self.spread > 0.0
            && self.spread.is_finite()
            && self.mixing.iter().all(|value| value.is_finite())
            && self
                .centres
                .iter()
                .chain(&self.weights)
                .all(|value| value.is_finite())
    }
}

/// Largest entry of W = weights' mixing.
fn largest_product(mixing: &[f64], weights: &[Vec<f64>], neurons: usize) -> f64 {
    let rank = weights.len();
    let weights = DMatrix::from_fn(weights[0].len(), rank, |i, j| weights[j][i]);
    let mixing = faer::MatRef::from_row_major_slice(mixing, rank, neurons);
    dense::product(dense::view(&weights), mixing).amax()
}

/// The network as a reconstructor: normalises by Eq. 6, refuses what is far from its training.
#[derive(Debug, Clone)]
pub struct RbfReconstructor {
    network: RbfNetwork,
    /// Distance from the nearest centre, in spreads, within which nearly all training inputs lie.
    familiar: f64,
    trained: Trained,
}

impl RbfReconstructor {
    /// `network` must take the protocol's readings and give the mesh's region, which a loaded model's does.
    pub(crate) fn new(network: RbfNetwork, familiar: f64, trained: Trained) -> Self {
        Self {
            network,
            familiar,
            trained,
        }
    }

    /// The network.
    pub fn network(&self) -> &RbfNetwork {
        &self.network
    }

    fn distances(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<(Vec<f64>, usize), ReconstructError> {
        let (change, left, masked) = self.trained.change(baseline, frame)?;
        Ok((self.network.distances(&change, &left), masked))
    }
}

impl Reconstructor for RbfReconstructor {
    fn method(&self) -> &str {
        &self.trained.method
    }

    fn protocol(&self) -> &Protocol {
        &self.trained.protocol
    }

    fn mesh(&self) -> &Arc<Mesh> {
        &self.trained.mesh
    }

    fn assumptions(&self) -> Vec<String> {
        self.trained.assumptions.clone()
    }

    fn noise_figure(&self) -> Option<f64> {
        self.trained.noise_figure
    }

    fn novelty(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Option<Novelty>, ReconstructError> {
        let (distances, _) = self.distances(baseline, frame)?;
        Ok(Some(Novelty {
            value: self.network.nearest(&distances),
            limit: self.familiar,
            measure: "distance to the nearest centre of the network, in spreads",
        }))
    }

    fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        let (distances, masked) = self.distances(baseline, frame)?;
        let novelty = self.network.nearest(&distances);
        self.trained.refuse_far(novelty, NOVELTY_LIMIT)?;
        Ok(self.trained.map(self.network.respond(&distances), masked))
    }
}
