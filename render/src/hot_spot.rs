//! Connected patches of the largest loss or pressure.

use survey::{Adjacency, HotSpot, Map};

use crate::{PictureError, Sheet};

/// The connected patches that have lost at least half of the loss of the worst triangle, the worst first; empty if
/// nothing is lost.
///
/// # Errors
/// A map of another sheet.
pub fn hot_spots(sheet: &Sheet, map: &Map) -> Result<Vec<HotSpot>, PictureError> {
    sheet.check(map)?;
    let loads: Vec<f64> = map
        .values
        .iter()
        .map(|value| map.unit.load(*value))
        .collect();
    let largest = loads.iter().copied().fold(0.0, f64::max);
    Ok(Adjacency::new(&sheet.triangles).hot_spots(&loads, 0.5 * largest))
}

#[cfg(test)]
mod tests {
    use survey::Map;

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
        let mut map = Map::relative("m", values, "test");
        let spots = hot_spots(&sheet, &map).unwrap();
        assert_eq!(spots.len(), 2);
        assert_eq!(spots[0].peak, 0.5);
        assert!((spots[0].centre[0] - 0.025).abs() < 1e-6, "{spots:?}");
        assert!((spots[1].centre[0] - 0.075).abs() < 1e-6, "{spots:?}");
        assert!((spots[1].area - 0.0002).abs() < 2e-5, "{spots:?}");
        map.values.fill(0.2);
        assert!(hot_spots(&sheet, &map).unwrap().is_empty());
    }
}
