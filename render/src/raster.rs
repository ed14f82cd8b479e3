//! Assigns triangles to pixels.

use survey::Map;

use crate::{Extent, PictureError, Sheet};

/// Most pixels of a raster.
pub(crate) const MOST_PIXELS: usize = 64 << 20;

/// The value at the centre of each pixel of the sheet's bounding box, row by row from the top (largest y), left to
/// right. `None` outside the region, and for NaN.
///
/// # Errors
/// A map of another sheet, a sheet without area, no pixel or more than 67 million.
pub fn raster(
    sheet: &Sheet,
    map: &Map,
    width: usize,
    height: usize,
) -> Result<Vec<Option<f64>>, PictureError> {
    sheet.check(map)?;
    let extent = sheet.extent()?;
    check_size(width, height)?;
    let mut pixels = vec![None; width * height];
    fill(sheet, extent, width, height, |pixel, triangle| {
        pixels[pixel] = Some(map.values[triangle]).filter(|value| value.is_finite());
    });
    Ok(pixels)
}

pub(crate) fn check_size(width: usize, height: usize) -> Result<(), PictureError> {
    if width > 0 && height > 0 && width.saturating_mul(height) <= MOST_PIXELS {
        return Ok(());
    }
    Err(PictureError::Size {
        width,
        height,
        limit: "at least one pixel and at most 64 Mi",
    })
}

/// Calls `each` with pixel and triangle for each pixel whose centre is in a triangle.
pub(crate) fn fill(
    sheet: &Sheet,
    extent: Extent,
    width: usize,
    height: usize,
    mut each: impl FnMut(usize, usize),
) {
    let across = width as f64 / extent.width();
    let down = height as f64 / extent.height();
    for (index, triangle) in sheet.triangles.iter().enumerate() {
        let [a, b, c] =
            triangle.map(|[x, y]| [(x - extent.low[0]) * across, (extent.high[1] - y) * down]);
        let cross = |o: [f64; 2], p: [f64; 2], q: [f64; 2]| {
            (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0])
        };
        let turn = cross(a, b, c);
        if turn == 0.0 {
            continue;
        }
        // tolerance, because a pixel centre on a common edge must belong to one of the triangles
        let slack = -1e-9 * turn.abs();
        let bound = |axis: usize, size: usize| {
            let low = a[axis].min(b[axis]).min(c[axis]);
            let high = a[axis].max(b[axis]).max(c[axis]);
            let first = (low - 0.5).floor().max(0.0) as usize;
            first..((high + 0.5).ceil().max(0.0) as usize).min(size)
        };
        for row in bound(1, height) {
            for column in bound(0, width) {
                let centre = [column as f64 + 0.5, row as f64 + 0.5];
                let inside = [(a, b), (b, c), (c, a)]
                    .into_iter()
                    .all(|(from, to)| cross(from, to, centre) * turn.signum() >= slack);
                if inside {
                    each(row * width + column, index);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn square() -> (Sheet, Map) {
        let corners = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];
        let sheet = Sheet {
            triangles: vec![
                [corners[0], corners[1], corners[2]],
                [corners[0], corners[2], corners[3]],
            ],
            outline: vec![corners.to_vec()],
            electrodes: vec![[1.0, 0.0], [2.0, 1.0]],
        };
        let map = Map::relative("m", vec![-0.5, 0.25], "test");
        (sheet, map)
    }

    #[test]
    fn up_is_up_and_no_pixel_falls_between_triangles() {
        let (sheet, map) = square();
        let pixels = raster(&sheet, &map, 9, 9).unwrap();
        assert!(pixels.iter().all(Option::is_some));
        assert_eq!(pixels[1], Some(0.25), "upper left");
        assert_eq!(pixels[8 * 9 + 7], Some(-0.5), "lower right");
    }

    #[test]
    fn what_is_not_a_number_or_outside_is_left_empty() {
        let (mut sheet, mut map) = square();
        map.values[0] = f64::NAN;
        sheet.outline[0][2] = [4.0, 2.0];
        let pixels = raster(&sheet, &map, 8, 4).unwrap();
        assert_eq!(pixels[7], None, "beside the region");
        assert_eq!(pixels[3 * 8 + 2], None, "not a number");
        assert_eq!(pixels[0], Some(0.25));
    }

    #[test]
    fn nonsense_is_refused() {
        let (sheet, mut map) = square();
        assert!(raster(&sheet, &map, 0, 5).is_err());
        assert!(raster(&sheet, &map, usize::MAX, 5).is_err());
        assert!(
            raster(
                &Sheet::default(),
                &Map {
                    values: vec![],
                    ..map.clone()
                },
                5,
                5
            )
            .is_err()
        );
        map.values.pop();
        let refusal = raster(&sheet, &map, 5, 5).unwrap_err().to_string();
        assert!(
            refusal.contains("1 values") && refusal.contains("2 triangles"),
            "{refusal}"
        );
        let (mut sheet, map) = square();
        sheet.electrodes[0][0] = f64::NAN;
        assert!(raster(&sheet, &map, 5, 5).is_err());
    }
}
