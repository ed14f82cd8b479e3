//! The problem on a partition: one value per region, and the weights of the borders between regions.

use nalgebra::{DMatrix, DVector};

use crate::inverse::tv::mehrotra::Quadratic;
use crate::inverse::tv::problem::Problem;
use crate::linear_algebra::dense;

/// Maximum steps of Newton's method on one partition.
const MOST_DESCENTS: usize = 60;

/// A partition of the unknowns with the solution of the problem on it.
pub(crate) struct Regions {
    /// The region of each unknown.
    pub(crate) label: Vec<usize>,
    /// The value of each region.
    pub(crate) value: DVector<f64>,
    /// The sensitivity to each region: a column per region.
    pub(crate) columns: DMatrix<f64>,
}

/// Borders between regions, each pair once.
struct Borders {
    edges: Vec<[usize; 2]>,
    weights: Vec<f64>,
}

impl Regions {
    /// Solves the problem on a partition into `count` regions; regions of equal value at the minimum are merged.
    /// `before`: the partition that this one refines, if any.
    pub(crate) fn solve(
        problem: &Problem<'_>,
        label: Vec<usize>,
        count: usize,
        before: Option<&Self>,
        goal: f64,
    ) -> Option<Self> {
        let columns = match before {
            Some(before) => before.split_columns(problem.sensitivity, &label, count),
            None => sums(problem.sensitivity, &label, count),
        };
        let borders = Borders::of(problem, &label, count);
        let hessian = dense::gram_of_columns(&columns);
        let linear = columns.tr_mul(&problem.data);
        let quadratic = Quadratic {
            hessian: &hessian,
            linear: &linear,
            edges: &borders.edges,
            weights: &borders.weights,
            bounds: problem.bounds,
        };
        let solution = quadratic.solve(goal)?;
        let mut regions = Self {
            label,
            value: solution.x,
            columns,
        };
        let tied = |edge: usize, regions: &Self| {
            let [a, b] = borders.edges[edge];
            solution.tied[edge] || regions.value[a] == regions.value[b]
        };
        let ties: Vec<[usize; 2]> = (0..borders.edges.len())
            .filter(|&edge| tied(edge, &regions))
            .map(|edge| borders.edges[edge])
            .collect();
        let borders = if ties.is_empty() {
            borders
        } else {
            regions.merge(&ties);
            Borders::of(problem, &regions.label, regions.value.len())
        };
        regions.polish(problem, &borders);
        Some(regions)
    }

    /// Solves the problem on a partition by Newton steps from the present values. Each part may only move in its
    /// direction in `up` relative to the parts it was split from. This still lowers the objective if the minimum on the
    /// regions is closer than the interior method can resolve.
    pub(crate) fn descend(
        problem: &Problem<'_>,
        label: Vec<usize>,
        value: DVector<f64>,
        up: &[bool],
    ) -> Option<Self> {
        let [low, high] = problem.bounds;
        let columns = sums(problem.sensitivity, &label, value.len());
        // the constraints of each part: its order relative to its neighbours, and its bound
        let mut free: Vec<bool> = value
            .iter()
            .zip(up)
            .map(|(&v, &up)| (v > low || up) && (v < high || !up))
            .collect();
        let mut borders = Borders::of(problem, &label, value.len());
        let mut sign: Vec<f64> = borders
            .edges
            .iter()
            .map(|&[a, b]| match value[a] - value[b] {
                0.0 if up[a] => 1.0,
                0.0 => -1.0,
                difference => difference.signum(),
            })
            .collect();
        let mut regions = Self {
            label,
            value,
            columns,
        };
        for _ in 0..MOST_DESCENTS {
            let count = regions.value.len();
            let target = regions.newton(problem, &borders, &sign, &free)?;
            let way = &target - &regions.value;
            let mut length = 1.0;
            let mut tie = None;
            for (edge, &[a, b]) in borders.edges.iter().enumerate() {
                let (now, change) = (
                    (regions.value[a] - regions.value[b]) * sign[edge],
                    (way[a] - way[b]) * sign[edge],
                );
                if change < 0.0 && now < -length * change {
                    length = now / -change;
                    tie = Some(edge);
                }
            }
            let mut stopped = None;
            for region in 0..count {
                let distance = if way[region] > 0.0 {
                    high - regions.value[region]
                } else {
                    regions.value[region] - low
                };
                if distance < length * way[region].abs() {
                    length = distance / way[region].abs();
                    stopped = Some(region);
                }
            }
            regions.value += &way * length;
            if let Some(region) = stopped {
                regions.value[region] = if way[region] > 0.0 { high } else { low };
                free[region] = false;
            } else if let Some(edge) = tie {
                let [a, b] = borders.edges[edge];
                let (old, both) = (regions.value.clone(), free[a] && free[b]);
                let name = regions.merge(&[[a, b]]);
                let mut held = vec![true; regions.value.len()];
                for region in 0..count {
                    held[name[region]] = free[region];
                    regions.value[name[region]] = old[region];
                }
                held[name[a]] = both;
                regions.value[name[a]] = if free[a] { old[b] } else { old[a] };
                free = held;
                let before: std::collections::HashMap<[usize; 2], f64> = borders
                    .edges
                    .iter()
                    .zip(&sign)
                    .flat_map(|(&[a, b], &sign)| {
                        [([name[a], name[b]], sign), ([name[b], name[a]], -sign)]
                    })
                    .collect();
                borders = Borders::of(problem, &regions.label, regions.value.len());
                sign = borders.edges.iter().map(|edge| before[edge]).collect();
            } else {
                break;
            }
        }
        Some(regions)
    }

    /// The columns of a refinement: the parts of each region are summed, except the largest, which is the remainder.
    fn split_columns(
        &self,
        sensitivity: &DMatrix<f64>,
        label: &[usize],
        count: usize,
    ) -> DMatrix<f64> {
        let mut home = vec![0; count];
        let mut size = vec![0_usize; count];
        for (unknown, &part) in label.iter().enumerate() {
            home[part] = self.label[unknown];
            size[part] += 1;
        }
        let mut largest = vec![usize::MAX; self.value.len()];
        for part in 0..count {
            let other = &mut largest[home[part]];
            if *other == usize::MAX || size[part] > size[*other] {
                *other = part;
            }
        }
        let rows = sensitivity.nrows();
        let mut columns = DMatrix::zeros(rows, count);
        let out = columns.as_mut_slice();
        for (region, &part) in largest.iter().enumerate() {
            out[rows * part..][..rows].copy_from_slice(self.columns.column(region).as_slice());
        }
        let small: Vec<bool> = (0..count).map(|part| largest[home[part]] != part).collect();
        for (column, &part) in sensitivity.as_slice().chunks_exact(rows).zip(label) {
            if small[part] {
                add(&mut out[rows * part..][..rows], column, 1.0);
            }
        }
        for part in (0..count).filter(|&part| small[part]) {
            let own = out[rows * part..][..rows].to_vec();
            add(&mut out[rows * largest[home[part]]..][..rows], &own, -1.0);
        }
        columns
    }

    /// The minimum for given signs of the borders' jumps, with the regions that are not free held.
    fn newton(
        &self,
        problem: &Problem<'_>,
        borders: &Borders,
        sign: &[f64],
        free: &[bool],
    ) -> Option<DVector<f64>> {
        let chosen: Vec<usize> = (0..free.len()).filter(|&region| free[region]).collect();
        let mut next = self.value.clone();
        if chosen.is_empty() {
            return Some(next);
        }
        let columns = self.columns.select_columns(&chosen);
        let mut held = self.value.clone();
        for &region in &chosen {
            held[region] = 0.0;
        }
        let mut pull = DVector::<f64>::zeros(self.value.len());
        for ((&[a, b], weight), sign) in borders.edges.iter().zip(&borders.weights).zip(sign) {
            pull[a] += weight * sign;
            pull[b] -= weight * sign;
        }
        let right = columns.tr_mul(&(&problem.data - &self.columns * &held));
        let right: Vec<f64> = right
            .iter()
            .zip(&chosen)
            .map(|(right, &region)| right - pull[region])
            .collect();
        let solved = dense::solve_definite(&dense::gram_of_columns(&columns), &right)?;
        for (&region, value) in chosen.iter().zip(solved) {
            next[region] = value;
        }
        Some(next)
    }

    /// Merges the regions connected by `ties` and gives them their mean value. Returns the new index of each.
    fn merge(&mut self, ties: &[[usize; 2]]) -> Vec<usize> {
        let count = self.value.len();
        let mut root: Vec<usize> = (0..count).collect();
        let find = |root: &mut Vec<usize>, mut at: usize| {
            while root[at] != at {
                root[at] = root[root[at]];
                at = root[at];
            }
            at
        };
        for &[a, b] in ties {
            let (a, b) = (find(&mut root, a), find(&mut root, b));
            root[a.max(b)] = a.min(b);
        }
        let mut name = vec![usize::MAX; count];
        let mut kept = 0;
        for region in 0..count {
            let root = find(&mut root, region);
            if root == region {
                name[region] = kept;
                kept += 1;
            } else {
                name[region] = name[root];
            }
        }
        let mut value = DVector::zeros(kept);
        let mut members = vec![0.0; kept];
        let mut columns = DMatrix::zeros(self.columns.nrows(), kept);
        for region in 0..count {
            value[name[region]] += self.value[region];
            members[name[region]] += 1.0;
            let mut into = columns.column_mut(name[region]);
            into += self.columns.column(region);
        }
        for (value, members) in value.iter_mut().zip(members) {
            *value /= members;
        }
        for label in &mut self.label {
            *label = name[*label];
        }
        self.value = value;
        self.columns = columns;
        name
    }

    /// One exact Newton step: for given signs of all jumps and given active bounds the minimum is a linear solve. It is
    /// accepted if it keeps every sign and bound.
    fn polish(&mut self, problem: &Problem<'_>, borders: &Borders) {
        let [low, high] = problem.bounds;
        let free: Vec<bool> = self
            .value
            .iter()
            .map(|value| *value > low && *value < high)
            .collect();
        let sign: Vec<f64> = borders
            .edges
            .iter()
            .map(|&[a, b]| (self.value[a] - self.value[b]).signum())
            .collect();
        let Some(next) = self.newton(problem, borders, &sign, &free) else {
            return;
        };
        let inside = next.iter().all(|value| (low..=high).contains(value));
        let same = (borders.edges.iter().zip(&sign))
            .all(|(&[a, b], &sign)| (next[a] - next[b]) * sign > 0.0);
        if inside && same {
            self.value = next;
        }
    }
}

impl Borders {
    fn of(problem: &Problem<'_>, label: &[usize], count: usize) -> Self {
        let mut all: Vec<(usize, f64)> = problem
            .graph
            .edges
            .iter()
            .zip(problem.weights)
            .filter_map(|(&[a, b], &weight)| {
                let (a, b) = (label[a].min(label[b]), label[a].max(label[b]));
                (a != b).then_some((a * count + b, weight))
            })
            .collect();
        all.sort_by_key(|(pair, _)| *pair);
        let (mut edges, mut weights): (Vec<[usize; 2]>, Vec<f64>) = (Vec::new(), Vec::new());
        let mut last = usize::MAX;
        for (pair, weight) in all {
            if pair == last
                && let Some(sum) = weights.last_mut()
            {
                *sum += weight;
            } else {
                edges.push([pair / count, pair % count]);
                weights.push(weight);
                last = pair;
            }
        }
        Self { edges, weights }
    }
}

/// The sum of the columns of each region.
fn sums(sensitivity: &DMatrix<f64>, label: &[usize], count: usize) -> DMatrix<f64> {
    let rows = sensitivity.nrows();
    let mut out = vec![0.0; rows * count];
    for (column, &region) in sensitivity.as_slice().chunks_exact(rows).zip(label) {
        add(&mut out[rows * region..][..rows], column, 1.0);
    }
    DMatrix::from_vec(rows, count, out)
}

fn add(into: &mut [f64], from: &[f64], factor: f64) {
    for (into, from) in into.iter_mut().zip(from) {
        *into += factor * from;
    }
}
