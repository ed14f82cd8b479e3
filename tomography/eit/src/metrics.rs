//! Figures of merit: those of GREIT for raster images, and comparisons of a map with the true change.
//!
//! GREIT (Adler and others, Physiol. Meas. 30 (2009) S35), as EIDORS computes them. q is the set of pixels at or above
//! 25 % of the image's maximum; pixels outside of the sheet are NaN. The raster covers the bounding box scaled to [-1,
//! 1], x along rows (the first index), y along columns (the second); first and last pixel centres at -1 and 1.

/// Least value of a pixel of q, as a share of the maximum.
pub const QUARTER: f64 = 0.25;

/// A raster of values; NaN outside of the sheet.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

/// Why the figures of an image are undefined, in words.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct MeritError(String);

/// The five figures of GREIT, and the centroid of q.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Greit {
    /// Sum over the pixels of the image.
    pub amplitude: f64,
    /// |target| - |centroid of q|, in units of half the bounding box.
    pub position_error: f64,
    /// sqrt(#q / #inside).
    pub resolution: f64,
    /// Share of q outside of the circle of equal area around its centroid.
    pub shape_deformation: f64,
    /// Absolute sum of the negative pixels (none is in q) over the sum of q.
    pub ringing: f64,
    /// Unweighted centroid of q, in [-1, 1].
    pub centroid: [f64; 2],
}

impl Image {
    /// An image from rows of values; NaN outside of the sheet.
    ///
    /// # Errors
    /// Rows of different lengths, fewer than two rows or columns, an infinite pixel, or none inside of the sheet.
    pub fn new(rows: &[Vec<f64>]) -> Result<Self, MeritError> {
        let columns = rows.first().map_or(0, Vec::len);
        for (row, values) in rows.iter().enumerate() {
            if values.len() != columns {
                return Err(MeritError(format!(
                    "row {row} of the image has {} values, the first has {columns}",
                    values.len()
                )));
            }
            if let Some(column) = values.iter().position(|value| value.is_infinite()) {
                return Err(MeritError(format!("pixel {row}, {column} is infinite")));
            }
        }
        if rows.len() < 2 || columns < 2 {
            return Err(MeritError(format!(
                "an image of {} x {columns} pixels has no coordinates; 2 x 2 is the least",
                rows.len()
            )));
        }
        let values: Vec<f64> = rows.iter().flatten().copied().collect();
        if values.iter().all(|value| value.is_nan()) {
            let fault = "no pixel of the image is inside: all are NaN";
            return Err(MeritError(fault.to_owned()));
        }
        Ok(Self {
            rows: rows.len(),
            columns,
            values,
        })
    }

    /// The image with opposite sign.
    #[must_use]
    pub fn negated(&self) -> Self {
        Self {
            values: self.values.iter().map(|value| -value).collect(),
            ..*self
        }
    }

    /// Number of rows and columns.
    pub fn shape(&self) -> [usize; 2] {
        [self.rows, self.columns]
    }

    /// The values in row-major order; NaN outside of the sheet.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Position of a pixel's centre, in [-1, 1].
    fn place(&self, pixel: usize) -> [f64; 2] {
        let at = |k: usize, count: usize| -1.0 + 2.0 * k as f64 / (count - 1) as f64;
        [
            at(pixel / self.columns, self.rows),
            at(pixel % self.columns, self.columns),
        ]
    }

    /// The figures, for a target at this position in the same coordinates.
    ///
    /// # Errors
    /// No pixel is above zero.
    ///
    /// ```
    /// use eit::metrics::Image;
    /// let rows = [vec![0.0, 0.0, 0.0], vec![0.0, 4.0, 1.0], vec![0.0, -1.0, 0.0]];
    /// let merit = Image::new(&rows)?.greit([0.0, 1.0])?;
    /// assert_eq!(merit.amplitude, 4.0);
    /// assert_eq!(merit.centroid, [0.0, 0.5]); // two pixels are at or above 1
    /// assert_eq!(merit.position_error, 0.5);
    /// assert_eq!(merit.ringing, 0.2);
    /// # Ok::<(), eit::metrics::MeritError>(())
    /// ```
    pub fn greit(&self, target: [f64; 2]) -> Result<Greit, MeritError> {
        let inside = || {
            (0..self.values.len())
                .map(|pixel| (pixel, self.values[pixel]))
                .filter(|(_, value)| !value.is_nan())
        };
        let largest = inside().map(|(_, value)| value).fold(0.0, f64::max);
        if largest <= 0.0 {
            let fault = "no pixel of the image is above zero; images of losses are negative: negate them before they are evaluated";
            return Err(MeritError(fault.to_owned()));
        }
        let q: Vec<usize> = inside()
            .filter(|(_, value)| *value >= QUARTER * largest)
            .map(|(pixel, _)| pixel)
            .collect();
        let count = q.len() as f64;
        let centroid =
            [0, 1].map(|axis| q.iter().map(|&pixel| self.place(pixel)[axis]).sum::<f64>() / count);
        let pixel_area = 4.0 / self.values.len() as f64;
        let radius_squared = pixel_area * count / std::f64::consts::PI;
        let outside = q
            .iter()
            .filter(|&&pixel| {
                let at = self.place(pixel);
                (at[0] - centroid[0]).powi(2) + (at[1] - centroid[1]).powi(2) >= radius_squared
            })
            .count();
        let negative: f64 = inside()
            .map(|(_, value)| value)
            .filter(|value| *value < 0.0)
            .sum();
        let strong: f64 = q.iter().map(|&pixel| self.values[pixel]).sum();
        Ok(Greit {
            amplitude: inside().map(|(_, value)| value).sum(),
            position_error: target[0].hypot(target[1]) - centroid[0].hypot(centroid[1]),
            resolution: (count / inside().count() as f64).sqrt(),
            shape_deformation: outside as f64 / count,
            ringing: -negative / strong,
            centroid,
        })
    }

    /// Structural similarity (Wang and others 2004) with another image of the same raster: Gaussian windows with a
    /// standard deviation of 1.5 pixels and a reach of 5, constants (0.01 `range`)^2 and (0.03 `range`)^2, mean over
    /// the pixels that are inside of both images. Windows are cut at the border and their weights normalised again.
    /// `None` if shapes differ or no pixel is inside of both.
    pub fn ssim(&self, other: &Self, range: f64) -> Option<f64> {
        const REACH: usize = 5;
        if self.shape() != other.shape() {
            return None;
        }
        let (c1, c2) = ((0.01 * range).powi(2), (0.03 * range).powi(2));
        let valid = |pixel: usize| !(self.values[pixel].is_nan() || other.values[pixel].is_nan());
        let (mut sum, mut count) = (0.0, 0.0);
        for pixel in (0..self.values.len()).filter(|&pixel| valid(pixel)) {
            let (r, c) = (pixel / self.columns, pixel % self.columns);
            let (mut w, mut x, mut y, mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
            for i in r.saturating_sub(REACH)..(r + REACH + 1).min(self.rows) {
                for j in c.saturating_sub(REACH)..(c + REACH + 1).min(self.columns) {
                    let at = i * self.columns + j;
                    if !valid(at) {
                        continue;
                    }
                    let square = (i.abs_diff(r).pow(2) + j.abs_diff(c).pow(2)) as f64;
                    let g = (-square / (2.0 * 1.5 * 1.5)).exp();
                    let (a, b) = (self.values[at], other.values[at]);
                    w += g;
                    x += g * a;
                    y += g * b;
                    xx += g * a * a;
                    yy += g * b * b;
                    xy += g * a * b;
                }
            }
            let (x, y) = (x / w, y / w);
            let (vx, vy, cov) = (xx / w - x * x, yy / w - y * y, xy / w - x * y);
            sum += (2.0 * x * y + c1) * (2.0 * cov + c2) / ((x * x + y * y + c1) * (vx + vy + c2));
            count += 1.0;
        }
        (count > 0.0).then(|| sum / count)
    }
}

/// Comparison of a map with the true change; both are losses, or both gains. All figures are NaN (undefined) for a truth
/// without a load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Likeness {
    /// Pearson's correlation, weighted by area; 0 if either is constant.
    pub correlation: f64,
    /// |map - truth| / |truth|, Euclidean norms weighted by area.
    pub relative_error: f64,
    /// Dice coefficient of the areas in which map and truth are at or above half of their own largest absolute value:
    /// twice the overlap over the sum of both areas.
    pub dice: f64,
}

/// Compares a map with the true change. `map`, `truth` and `areas` have one entry for each triangle or pixel.
pub fn likeness(map: &[f64], truth: &[f64], areas: &[f64]) -> Likeness {
    let total: f64 = areas.iter().sum();
    let mean = |values: &[f64]| values.iter().zip(areas).map(|(v, a)| v * a).sum::<f64>() / total;
    let (m, t) = (mean(map), mean(truth));
    let (mut cross, mut own, mut other) = (0.0, 0.0, 0.0);
    let (mut error, mut size) = (0.0, 0.0);
    for ((&x, &y), &a) in map.iter().zip(truth).zip(areas) {
        cross += a * (x - m) * (y - t);
        own += a * (x - m) * (x - m);
        other += a * (y - t) * (y - t);
        error += a * (x - y) * (x - y);
        size += a * y * y;
    }
    let upper = |values: &[f64]| -> Vec<bool> {
        let half = 0.5 * values.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
        values
            .iter()
            .map(|v| half > 0.0 && v.abs() >= half)
            .collect()
    };
    let (a, b) = (upper(map), upper(truth));
    let (mut both, mut sum) = (0.0, 0.0);
    for ((&a, &b), &area) in a.iter().zip(&b).zip(areas) {
        both += if a && b { area } else { 0.0 };
        sum += f64::from(u8::from(a) + u8::from(b)) * area;
    }
    // without a load there is nothing to be like: 0 would look like a perfect or a useless map
    let known = |value: f64| if size > 0.0 { value } else { f64::NAN };
    let ratio = |up: f64, down: f64| known(if down > 0.0 { up / down } else { 0.0 });
    Likeness {
        correlation: ratio(cross, (own * other).sqrt()),
        relative_error: known(error.sqrt() / size.sqrt()),
        dice: ratio(2.0 * both, sum),
    }
}

/// The upper median; 0 for an empty slice. Sorts `values`.
pub fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use crate::metrics::*;

    /// Figures of small images, computed by hand.
    #[test]
    fn greits_figures_are_the_definitions() {
        // 4 x 5 pixels, two corners outside; x on rows at -1, -1/3, 1/3, 1, y on columns at -1, -1/2, 0, 1/2, 1
        let nan = f64::NAN;
        let rows = [
            vec![nan, 0.0, 0.5, 0.0, 0.0],
            vec![0.0, 2.0, 8.0, 2.0, -0.5],
            vec![0.0, 1.9, 4.0, 0.0, -0.25],
            vec![0.0, 0.0, 0.0, 0.0, nan],
        ];
        let merit = Image::new(&rows).unwrap().greit([0.6, 0.8]).unwrap();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-14, "{a} {b}");
        // q: 2, 8, 2 of row 1 and 4 of row 2 (a quarter of 8 belongs to it, 1.9 does not)
        close(merit.amplitude, 0.5 + 12.0 - 0.5 + 5.9 - 0.25);
        close(merit.centroid[0], (-1.0 / 3.0 * 3.0 + 1.0 / 3.0) / 4.0);
        close(merit.centroid[1], 0.0);
        close(merit.position_error, 1.0 - 1.0 / 6.0);
        close(merit.resolution, (4.0_f64 / 18.0).sqrt());
        close(merit.ringing, 0.75 / 16.0);
        // equal-area circle: r^2 = (4 / 20) 4 / pi = 0.2546; squared distances: 0.0278 + 0.25 = 0.2778 (twice), 0.0278,
        // 0.25
        close(merit.shape_deformation, 0.5);
    }

    #[test]
    fn a_disc_has_no_deformation_and_noise_no_figures() {
        let rows: Vec<Vec<f64>> = (0..61)
            .map(|i| {
                (0..61)
                    .map(|j| {
                        let (x, y) = (f64::from(i) / 30.0 - 1.0, f64::from(j) / 30.0 - 1.0);
                        f64::from(u8::from((x - 0.3).powi(2) + y * y <= 0.2_f64.powi(2)))
                    })
                    .collect()
            })
            .collect();
        let image = Image::new(&rows).unwrap();
        let merit = image.greit([0.3, 0.0]).unwrap();
        assert!(merit.position_error.abs() < 1e-12 && merit.ringing == 0.0);
        assert!(merit.shape_deformation < 0.06, "{merit:?}");
        assert!((image.ssim(&image, 1.0).unwrap() - 1.0).abs() < 1e-12);
        let refused = |fault: MeritError, wanted: &str| {
            assert!(fault.to_string().contains(wanted), "{fault}");
        };
        let nothing = image.negated().greit([0.0; 2]).unwrap_err();
        refused(nothing, "no pixel of the image is above zero");
        assert!(image.ssim(&image.negated(), 1.0).unwrap() < 0.99);
        let ragged = Image::new(&[vec![0.0, 1.0], vec![0.0]]).unwrap_err();
        refused(ragged, "row 1 of the image has 1 values, the first has 2");
        let outside = Image::new(&[vec![f64::NAN; 3], vec![f64::NAN; 3]]).unwrap_err();
        refused(outside, "no pixel of the image is inside");
    }

    #[test]
    fn likeness_of_hand_made_maps() {
        let truth = [-1.0, -1.0, 0.0, 0.0];
        let areas = [1.0, 1.0, 2.0, 2.0];
        let same = likeness(&truth, &truth, &areas);
        assert!((same.correlation - 1.0).abs() < 1e-15);
        assert_eq!((same.relative_error, same.dice), (0.0, 1.0));
        let other = likeness(&[-0.5, 0.0, -0.5, 0.0], &truth, &areas);
        // overlap 1, areas 3 and 2
        assert!((other.dice - 0.4).abs() < 1e-15);
        assert!((other.relative_error - ((0.25 + 1.0 + 0.5) / 2.0_f64).sqrt()).abs() < 1e-15);
        // means -1/4 and -1/3: cross 0.5 - 6/12 = 0
        assert!(other.correlation.abs() < 1e-15);
        assert_eq!(likeness(&[0.0; 4], &truth, &areas).dice, 0.0);
    }

    #[test]
    fn likeness_without_a_true_load_is_not_known() {
        for map in [[-0.5, 0.0, -0.5, 0.0], [0.0; 4]] {
            let like = likeness(&map, &[0.0; 4], &[1.0, 1.0, 2.0, 2.0]);
            let figures = [like.correlation, like.relative_error, like.dice];
            assert!(figures.iter().all(|figure| figure.is_nan()), "{like:?}");
        }
    }
}
