//! Cut pursuit (L. Landrieu, G. Obozinski, SIAM J. Imaging Sci. 10 (2017) 1724) with bounds: solves total variation on
//! the few constant regions of the map.
//!
//! F(x) = |J x - d|^2 / 2 + sum W_e |x_i - x_j|  over  low <= x <= high. One round: compute the gradient at the current
//! map; find the steepest split of the regions by a minimum cut over the edges inside them; solve the problem on the
//! regions exactly; merge adjacent regions of equal value.
//!
//! The cut also bounds the minimum. F is convex, so for any x + h within the bounds F(x + h) >= F(x) + F'(x; h), and
//! over all such h, taken region by region, the smallest F'(x; h) is a minimum cut: (low - c) g(R) + (high - low) min_S
//! [g(S) + W(border of S in R)]. The stated gap is F minus the largest such bound; it is computed, not estimated.

use nalgebra::DVector;

use crate::inverse::tv::mehrotra::Quadratic;
use crate::inverse::tv::problem::Problem;
use crate::inverse::tv::regions::Regions;
use crate::linear_algebra::dense;

/// Rounds after which the current map is returned with its gap.
const MOST_ROUNDS: usize = 120;
/// Parts whose gain is below this share of the largest gain wait for a later round.
const WORTHWHILE: f64 = 0.02;
/// Gap of the solution on the regions, as a share of the objective. It does not depend on the requested gap: with a
/// looser one, regions that only appear equal would be merged and split for ever.
const INNER: f64 = 1e-13;
/// Share of the objective at zero below which a gap is rounding error.
const ROUNDING: f64 = 1e-15;

/// A map and its accuracy.
pub(crate) struct Outcome {
    pub(crate) x: Vec<f64>,
    /// The region of each unknown.
    pub(crate) label: Vec<usize>,
    pub(crate) objective: f64,
    /// Upper limit of the objective's distance from the minimum.
    pub(crate) gap: f64,
    pub(crate) rounds: usize,
}

/// A split of the regions, and the bound from the cut.
struct Split {
    label: Vec<usize>,
    count: usize,
    /// One unknown of each part.
    first: Vec<usize>,
    /// Direction of each unknown.
    up: Vec<bool>,
    gap: f64,
}

impl Problem<'_> {
    /// The smallest objective by an interior method over all unknowns, with a gap of at most `share` of it.
    pub(crate) fn minimum_offline(&self, share: f64) -> Option<f64> {
        let exact = Quadratic {
            hessian: &dense::gram_of_columns(self.sensitivity),
            linear: &self.sensitivity.tr_mul(&self.data),
            edges: &self.graph.edges,
            weights: self.weights,
            bounds: self.bounds,
        };
        let close = self.minimise(1e-6)?.objective;
        let x = exact.solve(share * close)?.x;
        Some(self.objective(x.as_slice()))
    }

    /// The minimum, to a gap of at most `goal` of the objective if that can be reached. `None` if a factorisation
    /// failed.
    pub(crate) fn minimise(&self, goal: f64) -> Option<Outcome> {
        let (label, count) = self.graph.parts(|_, _| true);
        let at_zero = 0.5 * self.data.norm_squared() + self.constant;
        // at most the objective at zero: a first goal for the problem on the regions
        let inner = |objective: f64| (INNER * objective).max(ROUNDING * at_zero);
        let mut regions = Regions::solve(self, label, count, None, inner(at_zero))?;
        let mut best: Option<Outcome> = None;
        let mut bound = f64::NEG_INFINITY;
        let mut last: Option<Split> = None;
        let mut descended = false;
        for round in 1..=MOST_ROUNDS {
            let x: Vec<f64> = regions.label.iter().map(|&r| regions.value[r]).collect();
            let residual = &regions.columns * &regions.value - &self.data;
            let objective = 0.5 * residual.norm_squared() + self.variation(&x) + self.constant;
            if let (Some(best), Some(split)) = (&best, &last)
                && objective >= best.objective
            {
                // the interior method cannot distinguish the new parts from the regions they came from
                if std::mem::replace(&mut descended, true) {
                    break;
                }
                let value =
                    DVector::from_iterator(split.count, split.first.iter().map(|&u| best.x[u]));
                let up: Vec<bool> = split.first.iter().map(|&u| split.up[u]).collect();
                let Some(next) = Regions::descend(self, split.label.clone(), value, &up) else {
                    break;
                };
                regions = next;
                continue;
            }
            let split = self.split(&regions, &x, &residual);
            bound = bound.max(objective - split.gap);
            let gap = (objective - bound).max(0.0);
            best = Some(Outcome {
                x,
                label: regions.label.clone(),
                objective,
                gap,
                rounds: round,
            });
            let done = gap <= (goal * objective).max(ROUNDING * at_zero);
            if done || split.count == regions.value.len() {
                break;
            }
            let Some(next) = Regions::solve(
                self,
                split.label.clone(),
                split.count,
                Some(&regions),
                inner(objective),
            ) else {
                break;
            };
            regions = next;
            descended = false;
            last = Some(split);
        }
        best
    }

    /// The steepest split of the regions.
    fn split(&self, regions: &Regions, x: &[f64], residual: &DVector<f64>) -> Split {
        let graph = self.graph;
        let [low, high] = self.bounds;
        let count = regions.value.len();
        let mut cost = dense::transposed_times(self.sensitivity, residual);
        let mut capacity = vec![0.0; graph.edges.len()];
        for (edge, &[a, b]) in graph.edges.iter().enumerate() {
            if regions.label[a] == regions.label[b] {
                capacity[edge] = self.weights[edge];
            } else {
                let pull = self.weights[edge] * (x[a] - x[b]).signum();
                cost[a] += pull;
                cost[b] -= pull;
            }
        }
        let mut up = graph.cut.minimum(cost.as_slice(), &capacity);
        // the lower bound
        let (mut sum, mut least) = (vec![0.0; count], vec![0.0; count]);
        for (unknown, &region) in regions.label.iter().enumerate() {
            sum[region] += cost[unknown];
            if up[unknown] {
                least[region] += cost[unknown];
            }
        }
        for (edge, &[a, b]) in graph.edges.iter().enumerate() {
            if up[a] != up[b] {
                least[regions.label[a]] += capacity[edge];
            }
        }
        let gap = (0..count)
            .map(|r| (regions.value[r] - low) * sum[r] - (high - low) * least[r])
            .sum::<f64>()
            .max(0.0);
        let steepest = up.clone();
        // the gain of each part as a region, and the largest part of each region
        let same = |up: &[bool], a: usize, b: usize| {
            regions.label[a] == regions.label[b] && up[a] == up[b]
        };
        let (part, parts) = graph.parts(|a, b| same(&up, a, b));
        let (mut gain, mut size, mut home) =
            (vec![0.0; parts], vec![0_usize; parts], vec![0; parts]);
        for (unknown, &part) in part.iter().enumerate() {
            gain[part] += if up[unknown] {
                -cost[unknown]
            } else {
                cost[unknown]
            };
            size[part] += 1;
            home[part] = regions.label[unknown];
        }
        for (edge, &[a, b]) in graph.edges.iter().enumerate() {
            if part[a] != part[b] {
                // no capacity between regions
                gain[part[a]] -= capacity[edge];
                gain[part[b]] -= capacity[edge];
            }
        }
        let mut largest = vec![usize::MAX; count];
        for part in 0..parts {
            let other = &mut largest[home[part]];
            if *other == usize::MAX || size[part] > size[*other] {
                *other = part;
            }
        }
        let small = |part: usize| largest[home[part]] != part;
        let most = (0..parts)
            .filter(|&p| small(p))
            .map(|p| gain[p])
            .fold(0.0, f64::max)
            // if a part lies inside another, its gain is relative to that part
            .min(gap / (high - low));
        let mut flipped = false;
        for (unknown, &part) in part.iter().enumerate() {
            if small(part) && gain[part] <= WORTHWHILE * most {
                up[unknown] = !up[unknown];
                flipped = true;
            }
        }
        let (label, count) = if flipped {
            graph.parts(|a, b| same(&up, a, b))
        } else {
            (part.clone(), parts)
        };
        // not if this would undo the split
        let (label, count) = if count > regions.value.len() || parts == regions.value.len() {
            (label, count)
        } else {
            up.copy_from_slice(&steepest);
            (part, parts)
        };
        let mut first = vec![0; count];
        for (unknown, &part) in label.iter().enumerate().rev() {
            first[part] = unknown;
        }
        Split {
            label,
            count,
            first,
            up,
            gap,
        }
    }
}

#[cfg(test)]
mod tests;
