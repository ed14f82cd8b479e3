//! The share of each triangle of the region that a convex outline covers.

use crate::{Mesh, bounding_box, clip_by, polygon_area};

/// The region's triangles, indexed by position.
pub(crate) struct Cover {
    corners: Vec<[[f64; 2]; 3]>,
    /// Centre of each triangle, and the largest distance of its corners from it, m.
    circles: Vec<([f64; 2], f64)>,
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
        let circle = |corners: &[[f64; 2]; 3]| {
            let centre = [0, 1].map(|axis| corners.iter().map(|p| p[axis]).sum::<f64>() / 3.0);
            let away = |p: &[f64; 2]| (p[0] - centre[0]).hypot(p[1] - centre[1]);
            (centre, corners.iter().map(away).fold(0.0, f64::max))
        };
        let circles = corners.iter().map(circle).collect();
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
            circles,
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
        let sides: Vec<Side> = (0..outline.len())
            .map(|k| Side::new(outline[k], outline[(k + 1) % outline.len()]))
            .collect();
        // the clipped triangle, and memory for its next cut
        let mut buffers = [Vec::new(), Vec::new()];
        near.into_iter()
            .filter_map(|t| {
                let share = self.share(t as usize, &sides, &mut buffers);
                (share > 0.0).then_some((t, share))
            })
            .collect()
    }

    /// The share of a triangle on the inner side of all sides.
    fn share(&self, t: usize, sides: &[Side], [points, spare]: &mut [Vec<[f64; 2]>; 2]) -> f64 {
        let (centre, reach) = self.circles[t];
        points.clear();
        for side in sides {
            let depth = side.depth(centre);
            if depth <= -reach {
                return 0.0;
            }
            // sides with a larger depth do not intersect the triangle
            if depth < reach {
                if points.is_empty() {
                    points.extend(self.corners[t]);
                }
                clip_by(side.ends, points, spare);
                if points.is_empty() {
                    return 0.0;
                }
            }
        }
        match points.is_empty() {
            true => 1.0,
            false => (polygon_area(points) / self.areas[t]).clamp(0.0, 1.0),
        }
    }
}

/// A side of an outline.
struct Side {
    ends: [[f64; 2]; 2],
    /// The unit vector towards the inner side.
    normal: [f64; 2],
}

impl Side {
    fn new(a: [f64; 2], b: [f64; 2]) -> Self {
        let [x, y] = [b[0] - a[0], b[1] - a[1]];
        let length = x.hypot(y).max(f64::MIN_POSITIVE);
        Self {
            ends: [a, b],
            normal: [-y / length, x / length],
        }
    }

    /// Distance of a point from the side, positive on the inner side, m.
    fn depth(&self, [x, y]: [f64; 2]) -> f64 {
        let [a, _] = self.ends;
        self.normal[0] * (x - a[0]) + self.normal[1] * (y - a[1])
    }
}
