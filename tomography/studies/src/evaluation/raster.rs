//! Maps as raster images, for SSIM and the figures of GREIT.

use eit::metrics::Image;
use eit::{Case, bounding_box};

use crate::failure::{Attempt, Failure};

/// Number of pixels along the longer side.
const PIXELS: usize = 64;

/// A raster over the sheet's bounding box. On the sheet outside of the region the map is 0.
pub(super) struct Raster {
    rows: usize,
    columns: usize,
    low: [f64; 2],
    high: [f64; 2],
    /// For each pixel: `None` outside of the sheet, `Some(None)` on the sheet outside of the region, otherwise the
    /// index of its triangle in the region.
    pixels: Vec<Option<Option<usize>>>,
}

impl Raster {
    pub(super) fn new(case: &Case) -> Self {
        let mesh = &case.mesh;
        let [low, high] = bounding_box(mesh.nodes().iter().copied());
        let longer = (high[0] - low[0]).max(high[1] - low[1]);
        let count = |axis: usize| {
            ((PIXELS as f64 * (high[axis] - low[axis]) / longer).round() as usize).max(2)
        };
        // x along the first index
        let (rows, columns) = (count(0), count(1));
        let mut unknown = vec![None; mesh.triangles().len()];
        for (k, &t) in mesh.region().iter().enumerate() {
            unknown[t] = Some(k);
        }
        let at = |k: usize, n: usize, axis: usize| {
            low[axis] + (high[axis] - low[axis]) * k as f64 / (n - 1) as f64
        };
        let mut pixels = vec![None; rows * columns];
        for (t, unknown) in unknown.iter().enumerate() {
            let c = mesh.corners(t);
            let range = |axis: usize, n: usize| {
                let step = (high[axis] - low[axis]) / (n - 1) as f64;
                let from = c.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
                let to = c.iter().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max);
                let first = ((from - low[axis]) / step).floor().max(0.0) as usize;
                let last = ((to - low[axis]) / step).ceil() as usize;
                first..=last.min(n - 1)
            };
            for i in range(0, rows) {
                for j in range(1, columns) {
                    let p = [at(i, rows, 0), at(j, columns, 1)];
                    let holds = (0..3).all(|k| {
                        let (a, b) = (c[k], c[(k + 1) % 3]);
                        (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) >= -1e-15
                    });
                    if holds {
                        pixels[i * columns + j] = Some(*unknown);
                    }
                }
            }
        }
        Self {
            rows,
            columns,
            low,
            high,
            pixels,
        }
    }

    /// The image of a map, with losses as positive values.
    pub(super) fn image(&self, map: &[f64]) -> Result<Image, Failure> {
        let values: Vec<Vec<f64>> = (0..self.rows)
            .map(|i| {
                (0..self.columns)
                    .map(|j| match self.pixels[i * self.columns + j] {
                        None => f64::NAN,
                        Some(None) => 0.0,
                        Some(Some(unknown)) => -map[unknown],
                    })
                    .collect()
            })
            .collect();
        Image::new(&values).attempt("the raster")
    }

    /// A position on the sheet (m) in the raster's coordinates, -1 to 1.
    pub(super) fn place(&self, at: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| {
            2.0 * (at[axis] - self.low[axis]) / (self.high[axis] - self.low[axis]) - 1.0
        })
    }
}
