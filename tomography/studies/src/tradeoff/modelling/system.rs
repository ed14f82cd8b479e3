//! The discrete system as an assembled matrix, for other solvers.

use eit::Mesh;

/// A symmetric positive definite matrix as rows of (column, value); the last electrode is the ground.
pub(crate) struct System {
    pub(crate) rows: Vec<Vec<(usize, f64)>>,
    /// For each row the entry in the column of the ground, which `rows` does not contain.
    pub(crate) ground: Vec<f64>,
    /// Index of the unknown of electrode 0; those of the others follow, except for the last electrode.
    pub(crate) first_electrode: usize,
    pub(crate) electrodes: usize,
}

impl System {
    /// Linear elements and the complete electrode model with one unknown per node and per electrode (fact sheet,
    /// section 1); `contact` in ohm m.
    pub(crate) fn new(mesh: &Mesh, contact: &[f64], sigma: &[f64]) -> Self {
        let nodes = mesh.nodes();
        let electrodes = mesh.electrode_edges().len();
        let mut entries: Vec<std::collections::BTreeMap<usize, f64>> =
            vec![Default::default(); nodes.len() + electrodes];
        let mut add = |i: usize, j: usize, value: f64| {
            *entries[i].entry(j).or_insert(0.0) += value;
        };
        for (triangle, conductance) in mesh.triangles().iter().zip(sigma) {
            let [a, b, c] = triangle.map(|node| nodes[node]);
            let area2 = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
            let opposite =
                [[c, b], [a, c], [b, a]].map(|[to, from]| [to[0] - from[0], to[1] - from[1]]);
            for i in 0..3 {
                for j in 0..3 {
                    let dot = opposite[i][0] * opposite[j][0] + opposite[i][1] * opposite[j][1];
                    add(
                        triangle[i],
                        triangle[j],
                        conductance * dot / (2.0 * area2.abs()),
                    );
                }
            }
        }
        for (electrode, edges) in mesh.electrode_edges().iter().enumerate() {
            let z = contact[electrode];
            let own = nodes.len() + electrode;
            for &[p, q] in edges {
                let length = (nodes[p][0] - nodes[q][0]).hypot(nodes[p][1] - nodes[q][1]);
                for (i, j) in [(p, p), (q, q)] {
                    add(i, j, length / (3.0 * z));
                }
                for (i, j) in [(p, q), (q, p)] {
                    add(i, j, length / (6.0 * z));
                }
                for node in [p, q] {
                    add(node, own, -length / (2.0 * z));
                    add(own, node, -length / (2.0 * z));
                }
                add(own, own, length / z);
            }
        }
        let last = entries.len() - 1;
        entries.truncate(last);
        let ground = entries
            .iter()
            .map(|row| row.get(&last).copied().unwrap_or(0.0))
            .collect();
        let rows = entries
            .into_iter()
            .map(|row| row.into_iter().filter(|(j, _)| *j != last).collect())
            .collect();
        Self {
            rows,
            ground,
            first_electrode: nodes.len(),
            electrodes,
        }
    }

    pub(crate) fn size(&self) -> usize {
        self.rows.len()
    }

    /// The right side for 1 A into an electrode and out of the next one.
    pub(crate) fn drive(&self, electrode: usize) -> Vec<f64> {
        let mut right = vec![0.0; self.size()];
        let mut put = |electrode: usize, amps: f64| {
            if electrode + 1 < self.electrodes {
                right[self.first_electrode + electrode] = amps;
            }
        };
        put(electrode, 1.0);
        put((electrode + 1) % self.electrodes, -1.0);
        right
    }

    /// Voltage of an electrode, V.
    pub(crate) fn voltage(&self, solution: &[f64], electrode: usize) -> f64 {
        match electrode + 1 < self.electrodes {
            true => solution[self.first_electrode + electrode],
            false => 0.0,
        }
    }

    /// b - A x, with every sum in about twice the precision (Ogita, Rump, Oishi 2005); x is the sum of `x` and `rest`.
    /// The rows of A are assumed to sum to zero exactly, and the diagonal is not used: at a contrast of 1e6 its
    /// rounding error would act as a leak to ground.
    pub(crate) fn residual(&self, right: &[f64], x: &[f64], rest: &[f64]) -> Vec<f64> {
        (0..self.size())
            .map(|i| {
                let (mut sum, mut lost) = (right[i], 0.0);
                let mut subtract = |a: f64, part: f64| {
                    let product = -a * part;
                    let rounded = (-a).mul_add(part, -product);
                    let new = sum + product;
                    let seen = new - sum;
                    lost += (sum - (new - seen)) + (product - seen) + rounded;
                    sum = new;
                };
                for &(j, a) in self.rows[i].iter().filter(|(j, _)| *j != i) {
                    for part in [x[j], rest[j], -x[i], -rest[i]] {
                        subtract(a, part);
                    }
                }
                for part in [-x[i], -rest[i]] {
                    subtract(self.ground[i], part);
                }
                sum + lost
            })
            .collect()
    }

    /// Writes A x to `out`.
    pub(crate) fn times(&self, x: &[f64], out: &mut [f64]) {
        for (row, out) in self.rows.iter().zip(out) {
            *out = row.iter().map(|(j, a)| a * x[*j]).sum();
        }
    }
}
