//! Meshes and conductances for several tests.

use eit::Mesh;

/// A small irregular but repeatable number in -0.5..0.5.
pub fn wobble(seed: usize) -> f64 {
    let mut x = seed as u64 ^ 0x9E37_79B9_7F4A_7C15;
    for _ in 0..3 {
        x ^= x >> 30;
        x = x.wrapping_mul(0xBF58_476D_1CE4_E5B9);
        x ^= x >> 27;
    }
    (x >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
}

/// Conductances spread log-uniformly over a factor.
pub fn spread(count: usize, middle: f64, factor: f64) -> Vec<f64> {
    (0..count)
        .map(|t| middle * factor.powf(wobble(t)))
        .collect()
}

/// A rectangular grid with inner nodes displaced by `push` of a cell. Electrodes are runs of boundary edges:
/// `(side, first, count)` with sides 0 bottom, 1 right, 2 top, 3 left, counted along +x or +y.
pub fn grid(
    size: [f64; 2],
    cells: [usize; 2],
    push: f64,
    electrodes: &[(usize, usize, usize)],
) -> Mesh {
    let [nx, ny] = cells;
    let node = |i: usize, j: usize| i * (ny + 1) + j;
    let mut nodes = Vec::new();
    for i in 0..=nx {
        for j in 0..=ny {
            let inner = i > 0 && j > 0 && i < nx && j < ny;
            let moved = |seed: usize| if inner { push * wobble(seed) } else { 0.0 };
            nodes.push([
                size[0] * (i as f64 + moved(2 * node(i, j))) / nx as f64,
                size[1] * (j as f64 + moved(2 * node(i, j) + 1)) / ny as f64,
            ]);
        }
    }
    let mut triangles = Vec::new();
    for i in 0..nx {
        for j in 0..ny {
            let [a, b, c, d] = [
                node(i, j),
                node(i + 1, j),
                node(i + 1, j + 1),
                node(i, j + 1),
            ];
            if (i + j) % 2 == 0 {
                triangles.extend([[a, b, c], [a, c, d]]);
            } else {
                triangles.extend([[a, b, d], [b, c, d]]);
            }
        }
    }
    let edges = electrodes
        .iter()
        .map(|&(side, first, count)| {
            (first..first + count)
                .map(|k| match side {
                    0 => [node(k, 0), node(k + 1, 0)],
                    1 => [node(nx, k), node(nx, k + 1)],
                    2 => [node(k, ny), node(k + 1, ny)],
                    _ => [node(0, k), node(0, k + 1)],
                })
                .collect()
        })
        .collect();
    Mesh::new(nodes, triangles, edges, None).unwrap()
}

/// Eight electrodes of four edges each around a displaced grid of 40 x 40.
pub fn eight(push: f64) -> Mesh {
    grid(
        [0.2, 0.23],
        [40, 40],
        push,
        &[
            (0, 6, 4),
            (0, 28, 4),
            (1, 8, 4),
            (1, 27, 4),
            (2, 28, 4),
            (2, 6, 4),
            (3, 27, 4),
            (3, 8, 4),
        ],
    )
}
