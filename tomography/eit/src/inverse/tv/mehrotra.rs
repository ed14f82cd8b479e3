//! A primal-dual interior method for  min x'Hx / 2 - b'x + sum W_e |x_i - x_j|  over  low <= x <= high, with Mehrotra's
//! predictor and corrector (J. Nocedal, S. Wright, Numerical Optimization, 2nd ed., section 16.6).
//!
//! |t| is the largest p t with |p| <= 1, so an edge carries a flow p_e between -W_e and W_e, and its difference is
//! split into a rise and a fall: (W - p) rise = mu, (W + p) fall = mu. Only H + D'TD + a positive diagonal is factored.

use nalgebra::{DMatrix, DVector};

use crate::linear_algebra::dense;

const MOST_STEPS: usize = 80;
/// Fraction of the distance to the nearest bound that a step may take.
const STEP: f64 = 0.995;

/// A problem with few unknowns: regions, or all triangles if time does not matter.
pub(crate) struct Quadratic<'a> {
    pub(crate) hessian: &'a DMatrix<f64>,
    pub(crate) linear: &'a DVector<f64>,
    pub(crate) edges: &'a [[usize; 2]],
    pub(crate) weights: &'a [f64],
    pub(crate) bounds: [f64; 2],
}

/// Result of the method.
pub(crate) struct Solution {
    pub(crate) x: DVector<f64>,
    /// Edges whose ends have the same value at the minimum.
    pub(crate) tied: Vec<bool>,
}

impl Quadratic<'_> {
    /// Stops when the gap is below `goal`, or when a factorisation fails; `None` if the first one fails.
    pub(crate) fn solve(&self, goal: f64) -> Option<Solution> {
        let n = self.linear.len();
        let edges = self.edges.len();
        let [low, high] = self.bounds;
        let width = high - low;
        let difference = |x: &DVector<f64>, edge: usize| {
            let [a, b] = self.edges[edge];
            x[a] - x[b]
        };
        let spread = |into: &mut DVector<f64>, edge: usize, amount: f64| {
            let [a, b] = self.edges[edge];
            into[a] += amount;
            into[b] -= amount;
        };
        // units: the width of the bounds for the unknowns, the largest gradient at their middle for the multipliers
        let mut x = DVector::from_element(n, 0.5 * (low + high));
        let pull = self.hessian * &x - self.linear;
        let unit = pull.amax().max(f64::MIN_POSITIVE);
        let mut lower = DVector::from_element(n, unit);
        let mut upper = DVector::from_element(n, unit);
        let mut flow = vec![0.0; edges];
        let mut rise = vec![0.1 * width; edges];
        let mut fall = vec![0.1 * width; edges];
        let parts = (2 * n + 2 * edges) as f64;
        let mut reached = f64::INFINITY;
        for _ in 0..MOST_STEPS {
            let gradient = self.hessian * &x - self.linear;
            let mut dual = &gradient - &lower + &upper;
            for (edge, &amount) in flow.iter().enumerate() {
                spread(&mut dual, edge, amount);
            }
            let lack: Vec<f64> = (0..edges)
                .map(|e| difference(&x, e) - rise[e] + fall[e])
                .collect();
            let low_slack = x.add_scalar(-low);
            let high_slack = -x.add_scalar(-high);
            let mut products = low_slack.dot(&lower) + high_slack.dot(&upper);
            for e in 0..edges {
                products +=
                    rise[e] * (self.weights[e] - flow[e]) + fall[e] * (self.weights[e] + flow[e]);
            }
            let infeasible = width * dual.abs().sum()
                + lack
                    .iter()
                    .zip(self.weights)
                    .map(|(l, w)| 2.0 * l.abs() * w)
                    .sum::<f64>();
            reached = products + infeasible;
            if reached <= goal {
                break;
            }
            let mu = products / parts;
            let theta: Vec<f64> = (0..edges)
                .map(|e| {
                    let w = self.weights[e];
                    1.0 / (rise[e] / (w - flow[e]) + fall[e] / (w + flow[e]))
                })
                .collect();
            let mut system = self.hessian.clone();
            for (e, &[a, b]) in self.edges.iter().enumerate() {
                system[(a, a)] += theta[e];
                system[(b, b)] += theta[e];
                system[(a, b)] -= theta[e];
                system[(b, a)] -= theta[e];
            }
            for i in 0..n {
                system[(i, i)] += lower[i] / low_slack[i] + upper[i] / high_slack[i];
            }
            let Some(factor) = dense::Definite::new(&system) else {
                break;
            };
            // the desired change of each product, then the direction that achieves it to first order
            let direction = |aim: &dyn Fn(usize) -> [f64; 2],
                             edge_aim: &dyn Fn(usize) -> [f64; 2]| {
                let mut right = -&dual;
                for i in 0..n {
                    let [l, u] = aim(i);
                    right[i] += l / low_slack[i] - u / high_slack[i];
                }
                let held: Vec<f64> = (0..edges)
                    .map(|e| {
                        let [r, f] = edge_aim(e);
                        let w = self.weights[e];
                        lack[e] - r / (w - flow[e]) + f / (w + flow[e])
                    })
                    .collect();
                for e in 0..edges {
                    spread(&mut right, e, -theta[e] * held[e]);
                }
                let dx = factor.solve(&right);
                let dflow: Vec<f64> = (0..edges)
                    .map(|e| theta[e] * (difference(&dx, e) + held[e]))
                    .collect();
                let (mut drise, mut dfall) = (vec![0.0; edges], vec![0.0; edges]);
                for e in 0..edges {
                    let [r, f] = edge_aim(e);
                    let w = self.weights[e];
                    drise[e] = (r + rise[e] * dflow[e]) / (w - flow[e]);
                    dfall[e] = (f - fall[e] * dflow[e]) / (w + flow[e]);
                }
                let (mut dlower, mut dupper) = (DVector::zeros(n), DVector::zeros(n));
                for i in 0..n {
                    let [l, u] = aim(i);
                    dlower[i] = (l - lower[i] * dx[i]) / low_slack[i];
                    dupper[i] = (u + upper[i] * dx[i]) / high_slack[i];
                }
                Direction {
                    dx,
                    dflow,
                    drise,
                    dfall,
                    dlower,
                    dupper,
                }
            };
            let longest = |d: &Direction| {
                let mut length = 1.0_f64;
                let mut keep = |value: f64, change: f64| {
                    if change < 0.0 {
                        length = length.min(-value / change);
                    }
                };
                for i in 0..n {
                    keep(low_slack[i], d.dx[i]);
                    keep(high_slack[i], -d.dx[i]);
                    keep(lower[i], d.dlower[i]);
                    keep(upper[i], d.dupper[i]);
                }
                for e in 0..edges {
                    keep(self.weights[e] - flow[e], -d.dflow[e]);
                    keep(self.weights[e] + flow[e], d.dflow[e]);
                    keep(rise[e], d.drise[e]);
                    keep(fall[e], d.dfall[e]);
                }
                length
            };
            let now = |i: usize| [low_slack[i] * lower[i], high_slack[i] * upper[i]];
            let edge_now = |e: usize| {
                [
                    rise[e] * (self.weights[e] - flow[e]),
                    fall[e] * (self.weights[e] + flow[e]),
                ]
            };
            let first = direction(&|i| now(i).map(|v| -v), &|e| edge_now(e).map(|v| -v));
            let length = longest(&first);
            let mut ahead = 0.0;
            for i in 0..n {
                ahead += (low_slack[i] + length * first.dx[i])
                    * (lower[i] + length * first.dlower[i])
                    + (high_slack[i] - length * first.dx[i])
                        * (upper[i] + length * first.dupper[i]);
            }
            for e in 0..edges {
                let flow = flow[e] + length * first.dflow[e];
                ahead += (rise[e] + length * first.drise[e]) * (self.weights[e] - flow)
                    + (fall[e] + length * first.dfall[e]) * (self.weights[e] + flow);
            }
            let aim = mu * (ahead / products).powi(3);
            let second = direction(
                &|i| {
                    let [l, u] = now(i);
                    [
                        aim - l - first.dx[i] * first.dlower[i],
                        aim - u + first.dx[i] * first.dupper[i],
                    ]
                },
                &|e| {
                    let [r, f] = edge_now(e);
                    [
                        aim - r + first.drise[e] * first.dflow[e],
                        aim - f - first.dfall[e] * first.dflow[e],
                    ]
                },
            );
            let length = STEP * longest(&second);
            if !(length > 1e-10 && second.dx.iter().all(|v| v.is_finite())) {
                break;
            }
            let next = &x + &second.dx * length;
            let flows: Vec<f64> = (0..edges)
                .map(|e| flow[e] + length * second.dflow[e])
                .collect();
            // rounding near convergence
            let inside = next.iter().all(|x| *x > low && *x < high)
                && flows.iter().zip(self.weights).all(|(f, w)| f.abs() < *w);
            if !inside {
                break;
            }
            x = next;
            flow = flows;
            lower += &second.dlower * length;
            upper += &second.dupper * length;
            for e in 0..edges {
                rise[e] += length * second.drise[e];
                fall[e] += length * second.dfall[e];
            }
        }
        if !reached.is_finite() {
            return None;
        }
        // the ends of an edge are equal if its flow is farther from its limits than its difference is from zero
        let tied = (0..edges)
            .map(|e| {
                let w = self.weights[e];
                (rise[e] + fall[e]) / width < (w - flow[e].abs()) / w
            })
            .collect();
        // an unknown is on its bound if the multiplier is larger than the slack
        let x = DVector::from_fn(n, |i, _| {
            if lower[i] / unit > (x[i] - low) / width {
                low
            } else if upper[i] / unit > (high - x[i]) / width {
                high
            } else {
                x[i]
            }
        });
        Some(Solution { x, tied })
    }
}

struct Direction {
    dx: DVector<f64>,
    dflow: Vec<f64>,
    drise: Vec<f64>,
    dfall: Vec<f64>,
    dlower: DVector<f64>,
    dupper: DVector<f64>,
}
