//! How much of each triangle of the region a convex outline covers.

use crate::{Mesh, bounding_box};

/// The region's triangles, indexed by position.
pub(crate) struct Cover {
    corners: Vec<[[f64; 2]; 3]>,
    areas: Vec<f64>,
    low: [f64; 2],
    cell: f64,
    columns: usize,
    rows: usize,
    /// Triangles whose bounding box overlaps each cell.
    cells: Vec<Vec<u32>>,
}

impl Cover {
    /// Sorts the region's triangles into cells of twice their mean size.
    pub(crate) fn new(mesh: &Mesh) -> Self {
        let corners: Vec<[[f64; 2]; 3]> = mesh.region().iter().map(|&t| mesh.corners(t)).collect();
        let areas = mesh.region_areas();
        let [low, high] = bounding_box(corners.iter().flatten().copied());
        let mean = areas.iter().sum::<f64>() / areas.len() as f64;
        let cell = 2.0 * mean.sqrt();
        let columns = ((high[0] - low[0]) / cell) as usize + 1;
        let rows = ((high[1] - low[1]) / cell) as usize + 1;
        let mut cells = vec![Vec::new(); columns * rows];
        for (t, corners) in corners.iter().enumerate() {
            let [from, to] = bounding_box(*corners);
            let at = |p: [f64; 2], axis: usize| ((p[axis] - low[axis]) / cell) as usize;
            for row in at(from, 1)..=at(to, 1) {
                for column in at(from, 0)..=at(to, 0) {
                    cells[row * columns + column].push(t as u32);
                }
            }
        }
        Self {
            corners,
            areas,
            low,
            cell,
            columns,
            rows,
            cells,
        }
    }

    /// (triangle of the region, share covered), ascending; the outline is convex and counter-clockwise.
    pub(crate) fn of(&self, outline: &[[f64; 2]]) -> Vec<(u32, f64)> {
        if outline.len() < 3 {
            return Vec::new();
        }
        let [from, to] = bounding_box(outline.iter().copied());
        let range = |axis: usize, count: usize| {
            let first = ((from[axis] - self.low[axis]) / self.cell).floor().max(0.0);
            let last = ((to[axis] - self.low[axis]) / self.cell).floor();
            let last = last.min(count as f64 - 1.0);
            (first, last)
        };
        let ((c0, c1), (r0, r1)) = (range(0, self.columns), range(1, self.rows));
        if c1 < c0 || r1 < r0 {
            return Vec::new();
        }
        let mut near: Vec<u32> = (r0 as usize..=r1 as usize)
            .flat_map(|row| (c0 as usize..=c1 as usize).map(move |column| (row, column)))
            .flat_map(|(row, column)| self.cells[row * self.columns + column].iter().copied())
            .collect();
        near.sort_unstable();
        near.dedup();
        near.into_iter()
            .filter_map(|t| {
                let share = self.share(t as usize, outline);
                (share > 0.0).then_some((t, share))
            })
            .collect()
    }

    fn share(&self, t: usize, outline: &[[f64; 2]]) -> f64 {
        let corners = self.corners[t];
        let count = outline.len();
        let mut whole = true;
        for k in 0..count {
            let (a, b) = (outline[k], outline[(k + 1) % count]);
            let inside = corners.map(|p| left(a, b, p) >= 0.0);
            if !inside[0] && !inside[1] && !inside[2] {
                return 0.0;
            }
            whole &= inside[0] && inside[1] && inside[2];
        }
        if whole {
            return 1.0;
        }
        // clips the triangle by the sides of the outline
        let mut points: Vec<[f64; 2]> = corners.to_vec();
        let mut kept: Vec<[f64; 2]> = Vec::with_capacity(12);
        for k in 0..count {
            let (a, b) = (outline[k], outline[(k + 1) % count]);
            kept.clear();
            let n = points.len();
            if n == 0 {
                return 0.0;
            }
            let mut previous = (points[n - 1], left(a, b, points[n - 1]));
            for &p in &points {
                let side = left(a, b, p);
                if (side >= 0.0) != (previous.1 >= 0.0) {
                    let s = previous.1 / (previous.1 - side);
                    kept.push([0, 1].map(|i| previous.0[i] + s * (p[i] - previous.0[i])));
                }
                if side >= 0.0 {
                    kept.push(p);
                }
                previous = (p, side);
            }
            std::mem::swap(&mut points, &mut kept);
        }
        (area(&points) / self.areas[t]).clamp(0.0, 1.0)
    }
}

fn left(a: [f64; 2], b: [f64; 2], p: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
}

fn area(points: &[[f64; 2]]) -> f64 {
    if points.len() < 3 {
        return 0.0;
    }
    let o = points[0];
    0.5 * points
        .windows(2)
        .map(|w| (w[0][0] - o[0]) * (w[1][1] - o[1]) - (w[0][1] - o[1]) * (w[1][0] - o[0]))
        .sum::<f64>()
}
