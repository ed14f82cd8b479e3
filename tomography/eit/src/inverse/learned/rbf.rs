//! The radial-basis-function network of the paper (section 4.3).
//!
//! phi_n = exp(-|dv - c_n|^2 / 2 b^2)  (Eq. 12),  x = sum_n w_n phi_n  (Eq. 14),  W = dSigma Phi^+  (Eq. 15).
//!
//! With b well above the distances of the centres (as Eq. 13 gives) the phi are almost parallel and W is huge: f32
//! would lose its digits. W is therefore stored as a product: the singular value decomposition Phi' = Q S V' gives
//! `mixing` = S^-1 V' (small, f64) and `weights` = Q' dSigma (f32, of the size of the maps).

use crate::Novelty;
use crate::inverse::learned::trained::Respond;
use crate::linear_algebra::simd::{add_four, dot, squared_distance};

/// Distance to the nearest centre, in spreads, beyond which a frame is refused: every phi is below 2e-8 there, so that
/// any such frame would give a map without loads.
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
    /// A row of `inputs` entries per neuron.
    pub(crate) centres: Vec<f32>,
    /// A row for each direction kept, with one entry per neuron.
    pub(crate) mixing: Vec<f64>,
    /// A row of `outputs` entries for each direction kept.
    pub(crate) weights: Vec<f32>,
}

impl RbfNetwork {
    /// Combines centres, mixing and weights, each row-major like the fields of a model file, for the given numbers of
    /// readings and triangles of the region; `spread` is b of Eq. 13.
    ///
    /// # Errors
    /// Parts that do not fit each other, or numbers that are not finite, in words.
    pub fn new(
        [inputs, outputs]: [usize; 2],
        spread: f64,
        centres: Vec<f32>,
        mixing: Vec<f64>,
        weights: Vec<f32>,
    ) -> Result<Self, String> {
        let network = Self {
            inputs,
            outputs,
            spread,
            centres,
            mixing,
            weights,
        };
        network.is_sound()?;
        Ok(network)
    }

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

    /// Distance of a normalised input from each centre; missing readings are skipped and the sum is scaled up.
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

    /// Distance to the nearest centre in spreads: how far an input is from the training inputs.
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
        // four directions per pass, in f32: the map is read and written a quarter as often
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

    /// Checks that the parts have consistent sizes, that every number is finite and the spread positive.
    fn is_sound(&self) -> Result<(), String> {
        // number of rows of this width; `None` where they are not whole, or there are none
        let rows = |values: usize, width: usize| {
            let rows = values.checked_div(width)?;
            (rows > 0 && rows * width == values).then_some(rows)
        };
        let neurons = rows(self.centres.len(), self.inputs)
            .ok_or("its centres do not fit its readings, or there are none")?;
        let rank = rows(self.mixing.len(), neurons);
        if rank.is_none() || rank != rows(self.weights.len(), self.outputs) {
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

/// A network and the distance of its training inputs.
pub(crate) struct FamiliarRbf {
    pub(crate) network: RbfNetwork,
    /// Distance from the nearest centre, in spreads, within which nearly all training inputs lie.
    pub(crate) familiar: f64,
}

impl Respond for FamiliarRbf {
    /// Distance from each centre.
    type Input = Vec<f64>;

    fn input(&self, change: Vec<f64>, left: &[usize]) -> Vec<f64> {
        self.network.distances(&change, left)
    }

    fn novelty(&self, distances: &Vec<f64>) -> Option<(Novelty, f64)> {
        let novelty = Novelty {
            value: self.network.nearest(distances),
            limit: self.familiar,
            measure: "distance to the nearest centre of the network, in spreads",
        };
        Some((novelty, NOVELTY_LIMIT))
    }

    fn respond(&self, distances: Vec<f64>) -> Result<Vec<f64>, String> {
        Ok(self.network.respond(&distances))
    }
}
