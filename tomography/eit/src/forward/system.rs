//! The linear system of one conductance: electrode forms, ground, matrix and residuals.

use nalgebra::DMatrix;

use super::Forward;
use super::layout::{NONE, PAIRS};
use crate::linear_algebra::sparse::Block;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Form {
    Difference,
    Eliminated,
    Shunt,
}

/// The linear system of one conductance.
#[derive(Clone, Default)]
pub(super) struct System {
    /// Conductance of each edge.
    pub(super) weights: Vec<f64>,
    pub(super) forms: Vec<Form>,
    /// Unknown held at zero.
    ground: usize,
    /// For each node: whether it has an unknown (it is neither grounded nor d = 0).
    free: Vec<bool>,
    /// For each node: the unknown of its electrode, if it takes part.
    joined: Vec<usize>,
    /// Entries of the matrix, in the order of the analysis.
    pub(super) values: Vec<f64>,
}

impl System {
    /// Sets a conductance.
    pub(super) fn set(&mut self, forward: &Forward, sigma: &[f64]) {
        let nodes = forward.mesh.nodes().len();
        let weight = |triangles: [u32; 2], shares: [f64; 2]| {
            let [s, t] = triangles.map(|t| sigma[t as usize]);
            s * shares[0] + t * shares[1]
        };
        self.weights.clear();
        let plain = forward.layout.edges.iter();
        self.weights
            .extend(plain.map(|edge| weight(edge.triangles, edge.shares)));
        let special = forward.layout.special.iter();
        self.weights
            .extend(special.map(|edge| weight(edge.triangles, edge.shares)));
        let forms = forward
            .layout
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
            .collect::<Vec<_>>();
        let electrode_ground = |e: usize| match forms[e] {
            Form::Eliminated => forward.layout.unknown[forward.layout.electrodes[e].nodes[0]],
            Form::Difference | Form::Shunt => forward.layout.unknown[nodes + e],
        };
        let ground = forward
            .ground(sigma)
            .map_or_else(|| electrode_ground(0), |node| forward.layout.unknown[node]);
        if forms != self.forms || ground != self.ground {
            self.free = (0..nodes)
                .map(|node| {
                    forward.layout.unknown[node] != ground
                        && forward.layout.on[node].is_none_or(|e| forms[e] != Form::Shunt)
                })
                .collect();
            self.joined = (0..nodes)
                .map(|node| match forward.layout.on[node] {
                    Some(e) if forms[e] != Form::Eliminated => {
                        let unknown = forward.layout.unknown[nodes + e];
                        if unknown == ground { NONE } else { unknown }
                    }
                    _ => NONE,
                })
                .collect();
            self.forms = forms;
            self.ground = ground;
        }
        self.assemble(forward);
    }

    fn assemble(&mut self, forward: &Forward) {
        let nodes = forward.mesh.nodes().len();
        let values = &mut self.values;
        values.clear();
        values.resize(forward.layout.analysis.entries(), 0.0);
        let (plain, special) = self.weights.split_at(forward.layout.edges.len());
        for (edge, &w) in forward.layout.edges.iter().zip(plain) {
            let [a, b, ab] = edge.at;
            values[a as usize] += w;
            values[b as usize] += w;
            values[ab as usize] = -w;
        }
        for &[_, edge] in forward.layout.network.at(self.ground) {
            values[forward.layout.edges[edge as usize].at[2] as usize] = 0.0;
        }
        // K = Σ w g gᵀ with g = a + U(a) - b - U(b)
        for (edge, &w) in forward.layout.special.iter().zip(special) {
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
                .layout
                .analysis
                .entry(unknown, unknown)
                .expect("the diagonal is always in the pattern");
            values[at] = 1.0;
        };
        for (e, contact) in forward.layout.electrodes.iter().enumerate() {
            match self.forms[e] {
                Form::Shunt => contact
                    .nodes
                    .iter()
                    .for_each(|&node| one(forward.layout.unknown[node])),
                Form::Eliminated => one(forward.layout.unknown[nodes + e]),
                Form::Difference => {}
            }
        }
        for (e, contact) in forward.layout.electrodes.iter().enumerate() {
            if self.forms[e] == Form::Shunt {
                continue;
            }
            let z = forward.contact[e];
            let count = contact.nodes.len();
            let free = |i: usize| self.free[contact.nodes[i]];
            // rows of an upper triangle, one after another
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
            .layout
            .analysis
            .entry(self.ground, self.ground)
            .expect("the diagonal is always in the pattern");
        values[at] = 1.0;
    }

    /// Right side for currents (A) into the electrodes (rows), a column per pattern.
    pub(super) fn right_side(&self, forward: &Forward, currents: &DMatrix<f64>, block: &mut Block) {
        let nodes = forward.mesh.nodes().len();
        block.values.fill(0.0);
        for (e, contact) in forward.layout.electrodes.iter().enumerate() {
            for (column, &current) in currents.row(e).iter().enumerate() {
                match self.forms[e] {
                    Form::Difference | Form::Shunt => {
                        block.row_mut(forward.layout.unknown[nodes + e])[column] = current;
                    }
                    Form::Eliminated => {
                        for (&node, weight) in contact.nodes.iter().zip(&contact.weights) {
                            block.row_mut(forward.layout.unknown[node])[column] =
                                current * weight / contact.length;
                        }
                    }
                }
            }
        }
        block.row_mut(self.ground).fill(0.0);
    }

    /// rest -= K x, as currents along edges and through contacts.
    pub(super) fn subtract_product(&self, forward: &Forward, x: &Block, rest: &mut Block) {
        let unknown = &forward.layout.unknown;
        let width = x.width;
        let (plain, special) = self.weights.split_at(forward.layout.edges.len());
        forward.layout.network.subtract(plain, x, rest);
        let mut flow = vec![0.0; width];
        for (edge, &w) in forward.layout.special.iter().zip(special) {
            let [a, b] = edge.ends;
            let (xa, xb) = (x.row(unknown[a]), x.row(unknown[b]));
            let (ja, jb) = (self.joined[a], self.joined[b]);
            for ((flow, xa), xb) in flow.iter_mut().zip(xa).zip(xb) {
                *flow = xa - xb;
            }
            if ja != jb {
                if ja != NONE {
                    flow.iter_mut().zip(x.row(ja)).for_each(|(f, u)| *f += u);
                }
                if jb != NONE {
                    flow.iter_mut().zip(x.row(jb)).for_each(|(f, u)| *f -= u);
                }
            }
            flow.iter_mut().for_each(|flow| *flow *= w);
            let mut leave = |at: usize, sign: f64| {
                let row = rest.row_mut(at);
                row.iter_mut().zip(&flow).for_each(|(r, f)| *r -= sign * f);
            };
            leave(unknown[a], 1.0);
            leave(unknown[b], -1.0);
            if ja != jb {
                if ja != NONE {
                    leave(ja, 1.0);
                }
                if jb != NONE {
                    leave(jb, -1.0);
                }
            }
        }
        for (e, contact) in forward.layout.electrodes.iter().enumerate() {
            let z = forward.contact[e];
            match self.forms[e] {
                Form::Shunt => {
                    for &node in &contact.nodes {
                        rest.row_mut(unknown[node]).fill(0.0);
                    }
                }
                form => {
                    let mut mean = vec![0.0; width];
                    if form == Form::Eliminated {
                        for (k, mean) in mean.iter_mut().enumerate() {
                            *mean = contact.mean(|node| x.row(unknown[node])[k]);
                        }
                    }
                    for &([i, j], h) in &contact.edges {
                        let (i, j) = (unknown[contact.nodes[i]], unknown[contact.nodes[j]]);
                        let share = h / (6.0 * z);
                        let mut through = |at: usize, far: usize| {
                            let ends = x.row(at).iter().zip(x.row(far)).zip(&mean);
                            for (rest, ((near, far), mean)) in rest.row_mut(at).iter_mut().zip(ends)
                            {
                                *rest -= share * (2.0 * (near - mean) + (far - mean));
                            }
                        };
                        through(i, j);
                        through(j, i);
                    }
                }
            }
        }
        rest.row_mut(self.ground).fill(0.0);
    }
}

impl Forward {
    /// The node to ground: the farthest from the electrodes that is not in an isolated patch.
    fn ground(&self, sigma: &[f64]) -> Option<usize> {
        self.layout
            .grounds
            .iter()
            .copied()
            .find(|&node| {
                let near = self.layout.around[node].iter().map(|&t| sigma[t]);
                let most = 1e2 * near.fold(0.0, f64::max);
                // at least a hundredth of the median
                2 * sigma.iter().filter(|value| **value <= most).count() > sigma.len()
            })
            .or(self.layout.grounds.first().copied())
    }
}
