//! Cut pursuit (L. Landrieu, G. Obozinski, SIAM J. Imaging Sci. 10 (2017) 1724) with bounds: total variation by working
//! on the few constant regions of the map.
//!
//! F(x) = |J x - d|^2 / 2 + sum W_e |x_i - x_j|  over  low <= x <= high. One round: the gradient at the present map; a
//! minimum cut over the edges inside regions finds the steepest split; the problem on the regions is solved exactly;
//! regions that stick are merged.
//!
//! The cut is also the certificate. F is convex, so for any x + h within the bounds F(x + h) >= F(x) + F'(x; h), and over
//! all such h, taken region by region, the least F'(x; h) is a minimum cut: (low - c) g(R) + (high - low) min_S [g(S) +
//! W(border of S in R)]. The gap that is stated is F less the largest bound so found; it is computed, not estimated.

use nalgebra::DVector;

use crate::inverse::tv::mehrotra::Quadratic;
use crate::inverse::tv::problem::Problem;
use crate::inverse::tv::regions::Regions;
use crate::linear_algebra::dense;

/// Rounds after which what there is is given, with its gap.
const MOST_ROUNDS: usize = 120;
/// Parts whose gain is below this share of the best one's wait for a later round.
const WORTHWHILE: f64 = 0.02;
/// Gap of the solution on the regions, as a share of the objective: regions that only seem to stick would be split and
/// merged for ever, so it does not follow the gap that is asked for.
const INNER: f64 = 1e-13;
/// Share of the objective at zero below which gaps are rounding.
const ROUNDING: f64 = 1e-15;

/// A map and how good it is.
pub(crate) struct Outcome {
    pub(crate) x: Vec<f64>,
    /// The region of each unknown.
    pub(crate) label: Vec<usize>,
    pub(crate) objective: f64,
    /// By how much the objective may exceed the minimum.
    pub(crate) gap: f64,
    pub(crate) rounds: usize,
}

/// A split of the regions, and what the cut says of the minimum.
struct Split {
    label: Vec<usize>,
    count: usize,
    /// An unknown of each part.
    first: Vec<usize>,
    /// Which way each unknown goes.
    up: Vec<bool>,
    gap: f64,
}

impl Problem<'_> {
    /// The least objective by an interior method over all unknowns, with a gap of at most `share` of it.
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

    /// The minimum, to a gap of at most `goal` of the objective where that can be reached. `None` where the numbers
    /// gave out.
    pub(crate) fn minimise(&self, goal: f64) -> Option<Outcome> {
        let (label, count) = self.graph.parts(|_, _| true);
        let at_zero = 0.5 * self.data.norm_squared() + self.constant;
        // the objective is at most that at zero: a first goal for the regions' own problem
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
                // the interior method cannot tell the parts from what they were split from
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
        // the certificate
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
        // what each part gains by being one, and the largest part of each region
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
            // a part inside another gains against it, not against staying
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
        // never at the price of the split itself
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
