//! Connected patches of the largest loss or pressure.

use std::collections::VecDeque;

use survey::Map;

use crate::{PictureError, Sheet, raster};

/// A connected patch that has lost at least half of what the worst triangle has lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HotSpot {
    /// Its centroid, weighted by loss, m.
    pub place: [f64; 2],
    /// Its largest loss (or pressure, in a map of pressure), a positive number in the map's unit.
    pub loss: f64,
    /// Its area, m2.
    pub area: f64,
}

/// Pixels across the longer side in the search for patches.
const FINENESS: f64 = 200.0;

/// Patches below this share of the largest product of area and loss are dropped.
const SPECK: f64 = 0.02;

/// The hot spots of a map, the worst first; empty if nothing is lost.
///
/// # Errors
/// A map of another sheet, or a sheet without area.
pub fn hot_spots(sheet: &Sheet, map: &Map) -> Result<Vec<HotSpot>, PictureError> {
    let extent = sheet.extent()?;
    let pixel = extent.width().max(extent.height()) / FINENESS;
    let width = (extent.width() / pixel).round().max(1.0) as usize;
    let height = (extent.height() / pixel).round().max(1.0) as usize;
    let values = raster(sheet, map, width, height)?;
    let largest = values
        .iter()
        .flatten()
        .fold(0.0_f64, |most, value| most.max(map.unit.load(*value)));
    if largest <= 0.0 {
        return Ok(Vec::new());
    }
    let step = [
        extent.width() / width as f64,
        extent.height() / height as f64,
    ];
    let mut open: Vec<bool> = values
        .iter()
        .map(|value| value.is_some_and(|value| map.unit.load(value) >= 0.5 * largest))
        .collect();
    let mut spots: Vec<HotSpot> = Vec::new();
    for seed in 0..open.len() {
        if !std::mem::take(&mut open[seed]) {
            continue;
        }
        let (mut weight, mut sum, mut worst, mut pixels) = (0.0, [0.0; 2], 0.0_f64, 0);
        let mut waiting = VecDeque::from([seed]);
        while let Some(at) = waiting.pop_front() {
            let (column, row) = (at % width, at / width);
            let loss = map.unit.load(values[at].unwrap_or(0.0));
            weight += loss;
            sum[0] += loss * (extent.low[0] + (column as f64 + 0.5) * step[0]);
            sum[1] += loss * (extent.high[1] - (row as f64 + 0.5) * step[1]);
            worst = worst.max(loss);
            pixels += 1;
            for row in row.saturating_sub(1)..=(row + 1).min(height - 1) {
                for column in column.saturating_sub(1)..=(column + 1).min(width - 1) {
                    let next = row * width + column;
                    if std::mem::take(&mut open[next]) {
                        waiting.push_back(next);
                    }
                }
            }
        }
        spots.push(HotSpot {
            place: sum.map(|sum| sum / weight),
            loss: worst,
            area: f64::from(pixels) * step[0] * step[1],
        });
    }
    // The ragged edge of a patch is not a separate patch.
    let least = SPECK
        * spots
            .iter()
            .map(|spot| spot.area * spot.loss)
            .fold(0.0, f64::max);
    spots.retain(|spot| spot.area * spot.loss >= least);
    spots.sort_by(|a, b| b.loss.total_cmp(&a.loss));
    Ok(spots)
}

#[cfg(test)]
mod tests {
    use survey::MapUnit;

    use super::*;

    #[test]
    fn two_presses_are_two_hot_spots_and_a_flat_map_has_none() {
        let mut sheet = Sheet::default();
        let mut values = Vec::new();
        for column in 0..10 {
            let (left, right) = (f64::from(column) * 0.01, f64::from(column + 1) * 0.01);
            sheet
                .triangles
                .push([[left, 0.0], [right, 0.0], [right, 0.02]]);
            sheet
                .triangles
                .push([[left, 0.0], [right, 0.02], [left, 0.02]]);
            values.extend(
                [match column {
                    2 => -0.5,
                    7 => -0.3,
                    4 => -0.2,
                    _ => 0.01,
                }; 2],
            );
        }
        let mut map = Map {
            mesh_hash: "m".into(),
            values,
            unit: MapUnit::RelativeConductance,
            method: "test".into(),
            masked: 0,
            quality: None,
        };
        let spots = hot_spots(&sheet, &map).unwrap();
        assert_eq!(spots.len(), 2);
        assert_eq!(spots[0].loss, 0.5);
        assert!((spots[0].place[0] - 0.025).abs() < 1e-6, "{spots:?}");
        assert!((spots[1].place[0] - 0.075).abs() < 1e-6, "{spots:?}");
        assert!((spots[1].area - 0.0002).abs() < 2e-5, "{spots:?}");
        map.values.fill(0.2);
        assert_eq!(hot_spots(&sheet, &map), Ok(Vec::new()));
    }
}
