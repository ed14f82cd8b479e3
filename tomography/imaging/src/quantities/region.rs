//! Named regions of the sheet.

use eit::{left_of, polygon_area};
use serde::{Deserialize, Serialize};

/// Name of the whole sheet in place of a region.
pub const SHEET: &str = "sheet";

/// `[[region]]`: a named part of the sheet, a rectangle or a polygon.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegionSettings {
    /// Unique name of letters, digits, `-` and `_`.
    pub name: String,
    /// `[x, y, x, y]` of two opposite corners, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rectangle_mm: Option<[f64; 4]>,
    /// Corners `[x, y]` in order, mm; three or more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub polygon_mm: Option<Vec<[f64; 2]>>,
}

/// The shape of a named region.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RegionShape {
    /// Its name.
    pub name: String,
    /// Its corners in order, mm.
    pub corners_mm: Vec<[f64; 2]>,
}

/// Whether a text is a valid name of a region or an alarm: letters, digits, `-` and `_`, 1 to 32 characters.
pub fn is_name(text: &str) -> bool {
    let character = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    (1..=32).contains(&text.len()) && text.chars().all(character)
}

/// Why a region is invalid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RegionError {
    /// An invalid name.
    #[error(
        "region '{0}': a name has letters, digits, '-' and '_', 32 at most, and is not '{SHEET}'"
    )]
    Name(String),
    /// Two regions with the same name.
    #[error("region '{0}' is defined twice")]
    Twice(String),
    /// Neither of the shapes, or both.
    #[error("region '{0}' needs either rectangle_mm = [x, y, x, y] or polygon_mm = [[x, y], ...]")]
    Shape(String),
    /// A shape without area, or with edges that cross.
    #[error("region '{name}': {why}")]
    Corners {
        /// Its name.
        name: String,
        /// What is wrong.
        why: &'static str,
    },
    /// A shape outside of the sheet.
    #[error("region '{name}' does not touch the sheet, which extends from ({:.0}, {:.0}) to ({:.0}, {:.0}) mm", .low[0], .low[1], .high[0], .high[1])]
    Beside {
        /// Its name.
        name: String,
        /// The sheet's corner with the smallest coordinates, mm.
        low: [f64; 2],
        /// The opposite one, mm.
        high: [f64; 2],
    },
}

impl RegionSettings {
    /// Name and corners; `None` for an invalid region.
    pub fn shape(&self) -> Option<RegionShape> {
        let corners = self.corners().ok()?;
        Some(RegionShape {
            name: self.name.clone(),
            corners_mm: corners
                .iter()
                .map(|corner| corner.map(|m| 1e3 * m))
                .collect(),
        })
    }

    /// Corners of the region, m.
    ///
    /// # Errors
    /// An invalid name, no shape or two, a shape without area or with edges that cross.
    pub fn corners(&self) -> Result<Vec<[f64; 2]>, RegionError> {
        if !is_name(&self.name) || self.name == SHEET {
            return Err(RegionError::Name(self.name.clone()));
        }
        let wrong = |why| RegionError::Corners {
            name: self.name.clone(),
            why,
        };
        let corners: Vec<[f64; 2]> = match (self.rectangle_mm, &self.polygon_mm) {
            (Some([x0, y0, x1, y1]), None) => vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]],
            (None, Some(corners)) => corners.clone(),
            (Some(_), Some(_)) | (None, None) => return Err(RegionError::Shape(self.name.clone())),
        };
        if corners.len() < 3 {
            return Err(wrong("a polygon has three corners or more"));
        }
        if !corners.iter().flatten().all(|mm| mm.is_finite()) {
            return Err(wrong("a coordinate is not a finite number"));
        }
        if crosses_itself(&corners) {
            return Err(wrong("an edge of the polygon crosses another"));
        }
        if polygon_area(&corners).abs() < 1.0 {
            return Err(wrong("its area is less than 1 mm2"));
        }
        Ok(corners
            .into_iter()
            .map(|corner| corner.map(|mm| 1e-3 * mm))
            .collect())
    }
}

/// Checks names and shapes of a list of regions.
///
/// # Errors
/// The first error, with the position of its region.
pub fn check_regions(regions: &[RegionSettings]) -> Result<(), (usize, RegionError)> {
    for (index, region) in regions.iter().enumerate() {
        region.corners().map_err(|error| (index, error))?;
        if regions[..index]
            .iter()
            .any(|other| other.name == region.name)
        {
            return Err((index, RegionError::Twice(region.name.clone())));
        }
    }
    Ok(())
}

fn crosses_itself(corners: &[[f64; 2]]) -> bool {
    let count = corners.len();
    let edge = |index: usize| [corners[index], corners[(index + 1) % count]];
    (0..count).any(|i| {
        (i + 2..count).filter(|j| (j + 1) % count != i).any(|j| {
            let (first, second) = (edge(i), edge(j));
            let apart = |line, [a, b]: [[f64; 2]; 2]| left_of(line, a) * left_of(line, b) < 0.0;
            apart(first, second) && apart(second, first)
        })
    })
}

#[cfg(test)]
mod tests {
    use eit::polygon_contains;

    use super::*;

    fn polygon(name: &str, corners: &[[f64; 2]]) -> RegionSettings {
        RegionSettings {
            name: name.into(),
            rectangle_mm: None,
            polygon_mm: Some(corners.to_vec()),
        }
    }

    #[test]
    fn wrong_regions_are_refused_by_name() {
        let square = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]];
        assert_eq!(polygon("heel", &square).corners().unwrap()[2], [0.01, 0.01]);
        for (region, says) in [
            (polygon("", &square), "letters, digits"),
            (polygon("sheet", &square), "not 'sheet'"),
            (polygon("a b", &square), "'a b'"),
            (polygon("heel", &square[..2]), "three corners"),
            (
                polygon("heel", &[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]),
                "less than 1 mm2",
            ),
            (
                polygon("heel", &[[0.0, f64::NAN], [1.0, 1.0], [2.0, 2.0]]),
                "finite",
            ),
            (
                polygon("heel", &[[0.0, 0.0], [9.0, 9.0], [9.0, 0.0], [0.0, 9.0]]),
                "crosses",
            ),
            (
                RegionSettings {
                    rectangle_mm: Some([0.0; 4]),
                    ..polygon("heel", &square)
                },
                "either",
            ),
        ] {
            let refused = region.corners().unwrap_err().to_string();
            assert!(refused.contains(says), "{refused}");
        }
        let twice = [polygon("heel", &square), polygon("heel", &square)];
        assert_eq!(
            check_regions(&twice),
            Err((1, RegionError::Twice("heel".into())))
        );
    }

    #[test]
    fn a_point_in_the_notch_of_a_polygon_is_outside() {
        let notched = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]];
        assert!(polygon_contains(&notched, [0.5, 2.0]) && polygon_contains(&notched, [3.5, 2.0]));
        assert!(!polygon_contains(&notched, [2.0, 2.0]) && !polygon_contains(&notched, [5.0, 2.0]));
    }
}
