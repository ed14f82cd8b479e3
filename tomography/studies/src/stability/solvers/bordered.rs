//! The complete electrode model in its textbook form: one dense bordered matrix, in any precision.
//!
//! [S, -B/z; -B'/z, |e|/z] with S = A + sum M/z. In f32 and f64 it is the naive implementation; in twice the precision
//! of f64 it is the reference.

use std::ops::{Add, Div, Mul, Sub};

use eit::Mesh;
use qd::Quad;
use survey::{Dipole, Protocol};

/// Number type of a matrix.
pub(crate) trait Number:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Send
    + Sync
{
    fn of(value: f64) -> Self;
    fn plain(self) -> f64;
    fn root(self) -> Self;
}

impl Number for f32 {
    fn of(value: f64) -> Self {
        value as f32
    }
    fn plain(self) -> f64 {
        f64::from(self)
    }
    fn root(self) -> Self {
        self.sqrt()
    }
}

impl Number for f64 {
    fn of(value: f64) -> Self {
        value
    }
    fn plain(self) -> f64 {
        self
    }
    fn root(self) -> Self {
        self.sqrt()
    }
}

impl Number for Quad {
    fn of(value: f64) -> Self {
        Self::from_f64(value)
    }
    fn plain(self) -> f64 {
        self.0 + self.1
    }
    fn root(self) -> Self {
        self.sqrt()
    }
}

/// How the constant of the potential is fixed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Ground {
    /// A mesh node away from the electrodes.
    Node,
    /// The mesh node with this index.
    NodeAt(usize),
    /// The voltage of an electrode.
    Electrode(usize),
    /// The constant is not fixed.
    Nothing,
    /// A conductance to ground at every unknown, as a share of the largest diagonal entry.
    Everywhere(f64),
}

/// A symmetric matrix with the indices of nodes and electrodes.
pub(crate) struct Bordered<T> {
    pub(crate) size: usize,
    /// Row-major, both triangles.
    pub(crate) entries: Vec<T>,
    pub(crate) electrode: Vec<usize>,
}

impl<T: Number> Bordered<T> {
    /// An electrode with a contact impedance of zero and its nodes are one unknown; so are the `merged` nodes.
    pub(crate) fn new(
        mesh: &Mesh,
        contact: &[f64],
        sigma: &[f64],
        merged: &[usize],
        ground: Ground,
    ) -> Self {
        let nodes = mesh.nodes().len();
        let mut joined: Vec<usize> = (0..nodes + contact.len()).collect();
        for &node in merged {
            joined[node] = merged[0];
        }
        for (e, edges) in mesh.electrode_edges().iter().enumerate() {
            if contact[e] == 0.0 {
                edges.iter().flatten().for_each(|&k| joined[k] = nodes + e);
            }
        }
        let mut place = vec![usize::MAX; joined.len()];
        let mut size = 0;
        for k in 0..joined.len() {
            if joined[k] == k {
                place[k] = size;
                size += 1;
            }
        }
        let at = |k: usize| place[joined[k]];
        let zero = T::of(0.0);
        let mut entries = vec![zero; size * size];
        let mut add = |i: usize, j: usize, value: T| {
            let entry = &mut entries[i * size + j];
            *entry = *entry + value;
        };
        let node = |k: usize| mesh.nodes()[k].map(T::of);
        for (&triangle, &sigma) in mesh.triangles().iter().zip(sigma) {
            let [a, b, c] = triangle.map(node);
            let sides = [[b, c], [c, a], [a, b]].map(|[p, q]| [q[0] - p[0], q[1] - p[1]]);
            let twice_area = sides[0][0] * sides[1][1] - sides[0][1] * sides[1][0];
            let factor = T::of(sigma) / (T::of(2.0) * twice_area);
            for i in 0..3 {
                for j in 0..3 {
                    let dot = sides[i][0] * sides[j][0] + sides[i][1] * sides[j][1];
                    add(at(triangle[i]), at(triangle[j]), dot * factor);
                }
            }
        }
        for (e, edges) in mesh.electrode_edges().iter().enumerate() {
            if contact[e] == 0.0 {
                continue;
            }
            let electrode = at(nodes + e);
            for &[p, q] in edges {
                let [a, b] = [p, q].map(node);
                let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
                let share = (dx * dx + dy * dy).root() / (T::of(6.0) * T::of(contact[e]));
                let (p, q) = (at(p), at(q));
                let (two, three) = (T::of(2.0) * share, T::of(3.0) * share);
                for (i, j, value) in [(p, p, two), (q, q, two), (p, q, share), (q, p, share)] {
                    add(i, j, value);
                }
                for i in [p, q] {
                    add(i, electrode, zero - three);
                    add(electrode, i, zero - three);
                    add(electrode, electrode, three);
                }
            }
        }
        let electrode: Vec<usize> = (0..contact.len()).map(|e| at(nodes + e)).collect();
        let mut matrix = Self {
            size,
            entries,
            electrode,
        };
        match ground {
            Ground::Nothing => {}
            Ground::Node => matrix.hold(at(middle(mesh))),
            Ground::NodeAt(node) => matrix.hold(at(node)),
            Ground::Electrode(e) => matrix.hold(matrix.electrode[e]),
            Ground::Everywhere(share) => {
                let largest = (0..size)
                    .map(|i| matrix.entries[i * size + i].plain())
                    .fold(0.0, f64::max);
                for i in 0..size {
                    let entry = &mut matrix.entries[i * size + i];
                    *entry = *entry + T::of(share * largest);
                }
            }
        }
        matrix
    }

    /// Sets an unknown to zero.
    fn hold(&mut self, at: usize) {
        for k in 0..self.size {
            self.entries[k * self.size + at] = T::of(0.0);
            self.entries[at * self.size + k] = T::of(0.0);
        }
        self.entries[at * self.size + at] = T::of(1.0);
    }

    /// The right side for 1 A through a pair.
    pub(crate) fn drive(&self, pair: Dipole) -> Vec<T> {
        let mut right = vec![T::of(0.0); self.size];
        right[self.electrode[pair.plus.0]] = T::of(1.0);
        right[self.electrode[pair.minus.0]] = T::of(-1.0);
        right
    }

    /// The matrix times x.
    pub(crate) fn times(&self, x: &[T]) -> Vec<T> {
        self.entries
            .chunks_exact(self.size)
            .map(|row| {
                row.iter()
                    .zip(x)
                    .fold(T::of(0.0), |sum, (a, x)| sum + *a * *x)
            })
            .collect()
    }

    /// L D L' without pivoting, in place.
    pub(crate) fn factored(mut self) -> Factored<T> {
        let n = self.size;
        for k in 0..n {
            let pivot = self.entries[k * n + k];
            let row: Vec<T> = self.entries[k * n + k..(k + 1) * n].to_vec();
            for i in k + 1..n {
                let above = row[i - k];
                if above.plain() == 0.0 {
                    continue;
                }
                let factor = above / pivot;
                for (entry, upper) in self.entries[i * n + i..(i + 1) * n]
                    .iter_mut()
                    .zip(&row[i - k..])
                {
                    *entry = *entry - factor * *upper;
                }
            }
        }
        Factored(self)
    }

    /// The readings of a protocol at 1 A, V.
    pub(crate) fn readings(self, protocol: &Protocol) -> Vec<f64> {
        self.factored().readings(protocol)
    }
}

/// U of the factors U' D^-1 U.
pub(crate) struct Factored<T>(Bordered<T>);

impl<T: Number> Factored<T> {
    pub(crate) fn solve(&self, mut x: Vec<T>) -> Vec<T> {
        let Bordered {
            size: n, entries, ..
        } = &self.0;
        let n = *n;
        for k in 0..n {
            let scaled = x[k] / entries[k * n + k];
            for i in k + 1..n {
                x[i] = x[i] - entries[k * n + i] * scaled;
            }
        }
        for k in (0..n).rev() {
            let sum = (k + 1..n).fold(x[k], |sum, i| sum - entries[k * n + i] * x[i]);
            x[k] = sum / entries[k * n + k];
        }
        x
    }

    pub(crate) fn readings(&self, protocol: &Protocol) -> Vec<f64> {
        read(protocol, &self.0.electrode, |pair| {
            self.solve(self.0.drive(pair))
        })
    }
}

/// The readings of a protocol at 1 A, V; `solve` returns the solution for a driven pair.
pub(crate) fn read<T: Number>(
    protocol: &Protocol,
    electrode: &[usize],
    solve: impl Fn(Dipole) -> Vec<T>,
) -> Vec<f64> {
    let fields: Vec<(Dipole, Vec<T>)> = protocol
        .drives()
        .into_iter()
        .map(|pair| (pair, solve(pair)))
        .collect();
    protocol
        .measurements()
        .iter()
        .map(|question| {
            let (_, x) = fields
                .iter()
                .find(|(pair, _)| *pair == question.drive)
                .expect("every question's drive is one of the protocol's");
            (x[electrode[question.sense.plus.0]] - x[electrode[question.sense.minus.0]]).plain()
        })
        .collect()
}

/// The node nearest to the middle of a tank.
pub(crate) fn middle(mesh: &Mesh) -> usize {
    let from = |p: [f64; 2]| p[0].hypot(p[1]);
    (0..mesh.nodes().len())
        .min_by(|&a, &b| from(mesh.nodes()[a]).total_cmp(&from(mesh.nodes()[b])))
        .expect("a mesh has nodes")
}
