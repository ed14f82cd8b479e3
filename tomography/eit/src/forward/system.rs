//! One conductance: the forms of its electrodes, its ground, its matrix and its residuals.

use nalgebra::DMatrix;

use super::Forward;
use super::layout::{NONE, PAIRS};
use crate::sparse::{Row, WIDTH};

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Form {
    Difference,
    Eliminated,
    Shunt,
}
/// One conductance: forms, ground and weights.
pub(super) struct System<'a> {
    forward: &'a Forward,
    weights: Vec<f64>,
    pub(super) forms: Vec<Form>,
    /// Unknown that is kept at zero.
    ground: usize,
    /// For each node whether its own unknown takes part (neither grounded nor d = 0).
    free: Vec<bool>,
    /// For each node the unknown of its electrode, where that takes part.
    joined: Vec<usize>,
}

impl<'a> System<'a> {
    pub(super) fn new(forward: &'a Forward, sigma: &[f64]) -> Self {
        let nodes = forward.mesh.nodes().len();
        let weights = forward
            .edges
            .iter()
            .map(|edge| edge.terms.iter().map(|(t, c)| sigma[*t] * c).sum())
            .collect();
        let forms: Vec<Form> = forward
            .electrodes
            .iter()
            .zip(&forward.contact)
            .map(|(contact, &z)| {
                let mean = contact.triangles.iter().map(|&t| sigma[t]).sum::<f64>()
                    / contact.triangles.len() as f64;
                if z == 0.0 {
                    Form::Shunt
                } else if z / contact.length < 1.0 / mean {
                    Form::Difference
                } else {
                    Form::Eliminated
                }
            })
            .collect();
        let ground_node = forward.ground(sigma);
        let electrode_ground = |e: usize| match forms[e] {
            Form::Eliminated => forward.unknown[forward.electrodes[e].nodes[0]],
            Form::Difference | Form::Shunt => forward.unknown[nodes + e],
        };
        let ground = ground_node.map_or_else(|| electrode_ground(0), |node| forward.unknown[node]);
        let free = (0..nodes)
            .map(|node| {
                forward.unknown[node] != ground
                    && forward.on[node].is_none_or(|e| forms[e] != Form::Shunt)
            })
            .collect();
        let joined = (0..nodes)
            .map(|node| match forward.on[node] {
                Some(e) if forms[e] != Form::Eliminated => {
                    let unknown = forward.unknown[nodes + e];
                    if unknown == ground { NONE } else { unknown }
                }
                _ => NONE,
            })
            .collect();
        Self {
            forward,
            weights,
            forms,
            ground,
            free,
            joined,
        }
    }

    pub(super) fn assemble(&self) -> Vec<f64> {
        let forward = self.forward;
        let nodes = forward.mesh.nodes().len();
        let mut values = vec![0.0; forward.pattern.entries()];
        // K = Σ w g gᵀ with g = a + U(a) - b - U(b)
        for (edge, &w) in forward.edges.iter().zip(&self.weights) {
            let [a, b] = edge.ends;
            let same = self.joined[a] == self.joined[b];
            let sign = [
                f64::from(u8::from(self.free[a])),
                f64::from(u8::from(self.joined[a] != NONE && !same)),
                -f64::from(u8::from(self.free[b])),
                -f64::from(u8::from(self.joined[b] != NONE && !same)),
            ];
            for (&at, [i, j]) in edge.at.iter().zip(PAIRS) {
                if at != NONE {
                    values[at] += w * sign[i] * sign[j];
                }
            }
        }
        let mut one = |unknown: usize| {
            let at = forward
                .pattern
                .entry(unknown, unknown)
                .expect("the diagonal is always in the pattern");
            values[at] = 1.0;
        };
        for (e, contact) in forward.electrodes.iter().enumerate() {
            match self.forms[e] {
                Form::Shunt => contact
                    .nodes
                    .iter()
                    .for_each(|&node| one(forward.unknown[node])),
                Form::Eliminated => one(forward.unknown[nodes + e]),
                Form::Difference => {}
            }
        }
        for (e, contact) in forward.electrodes.iter().enumerate() {
            if self.forms[e] == Form::Shunt {
                continue;
            }
            let z = forward.contact[e];
            let count = contact.nodes.len();
            let free = |i: usize| self.free[contact.nodes[i]];
            // rows of an upper triangle one after the other
            let at = |i: usize, j: usize| {
                let (i, j) = (i.min(j), i.max(j));
                contact.at[i * count - i * (i + 1) / 2 + j]
            };
            for &([i, j], h) in &contact.edges {
                for (i, j, share) in [(i, i, 2.0), (j, j, 2.0), (i, j, 1.0)] {
                    if free(i) && free(j) {
                        values[at(i, j)] += share * h / (6.0 * z);
                    }
                }
            }
            if self.forms[e] == Form::Eliminated {
                for i in (0..count).filter(|&i| free(i)) {
                    for j in (i..count).filter(|&j| free(j)) {
                        values[at(i, j)] -=
                            contact.weights[i] * contact.weights[j] / (z * contact.length);
                    }
                }
            }
        }
        let at = forward
            .pattern
            .entry(self.ground, self.ground)
            .expect("the diagonal is always in the pattern");
        values[at] = 1.0;
        values
    }

    pub(super) fn right_side(
        &self,
        currents: &DMatrix<f64>,
        first: usize,
        width: usize,
        block: &mut [Row],
    ) {
        let forward = self.forward;
        let nodes = forward.mesh.nodes().len();
        block.fill([0.0; WIDTH]);
        for (e, contact) in forward.electrodes.iter().enumerate() {
            for column in 0..width {
                let current = currents[(e, first + column)];
                match self.forms[e] {
                    Form::Difference | Form::Shunt => {
                        block[forward.unknown[nodes + e]][column] = current;
                    }
                    Form::Eliminated => {
                        for (&node, weight) in contact.nodes.iter().zip(&contact.weights) {
                            block[forward.unknown[node]][column] =
                                current * weight / contact.length;
                        }
                    }
                }
            }
        }
        block[self.ground] = [0.0; WIDTH];
    }

    /// rest -= K x, as currents along edges and through contacts.
    pub(super) fn subtract_product(&self, x: &[Row], rest: &mut [Row]) {
        let forward = self.forward;
        let unknown = &forward.unknown;
        for (edge, &w) in forward.edges.iter().zip(&self.weights) {
            let [a, b] = edge.ends;
            let (xa, xb) = (x[unknown[a]], x[unknown[b]]);
            let mut flow = [0.0; WIDTH];
            let (ja, jb) = (self.joined[a], self.joined[b]);
            if ja == jb {
                for k in 0..WIDTH {
                    flow[k] = w * (xa[k] - xb[k]);
                }
            } else {
                let ua = if ja == NONE { [0.0; WIDTH] } else { x[ja] };
                let ub = if jb == NONE { [0.0; WIDTH] } else { x[jb] };
                for k in 0..WIDTH {
                    flow[k] = w * ((ua[k] - ub[k]) + (xa[k] - xb[k]));
                }
                if ja != NONE {
                    (0..WIDTH).for_each(|k| rest[ja][k] -= flow[k]);
                }
                if jb != NONE {
                    (0..WIDTH).for_each(|k| rest[jb][k] += flow[k]);
                }
            }
            (0..WIDTH).for_each(|k| rest[unknown[a]][k] -= flow[k]);
            (0..WIDTH).for_each(|k| rest[unknown[b]][k] += flow[k]);
        }
        for (e, contact) in forward.electrodes.iter().enumerate() {
            let z = forward.contact[e];
            match self.forms[e] {
                Form::Shunt => {
                    for &node in &contact.nodes {
                        rest[unknown[node]] = [0.0; WIDTH];
                    }
                }
                form => {
                    let mut mean = [0.0; WIDTH];
                    if form == Form::Eliminated {
                        for (k, mean) in mean.iter_mut().enumerate() {
                            *mean = contact.mean(|node| x[unknown[node]][k]);
                        }
                    }
                    for &([i, j], h) in &contact.edges {
                        let (i, j) = (unknown[contact.nodes[i]], unknown[contact.nodes[j]]);
                        for k in 0..WIDTH {
                            let (di, dj) = (x[i][k] - mean[k], x[j][k] - mean[k]);
                            rest[i][k] -= h / (6.0 * z) * (2.0 * di + dj);
                            rest[j][k] -= h / (6.0 * z) * (di + 2.0 * dj);
                        }
                    }
                }
            }
        }
        rest[self.ground] = [0.0; WIDTH];
    }
}

impl Forward {
    /// The node to ground: the farthest from the electrodes that does not lie in an isolated patch.
    fn ground(&self, sigma: &[f64]) -> Option<usize> {
        let mut sorted = sigma.to_vec();
        let middle = sorted.len() / 2;
        let median = *sorted.select_nth_unstable_by(middle, f64::total_cmp).1;
        self.grounds
            .iter()
            .copied()
            .find(|&node| self.around[node].iter().any(|&t| sigma[t] >= 1e-2 * median))
            .or(self.grounds.first().copied())
    }
}
