//! Loads: a shape at a position, and the share of conductance lost under it.

#[cfg(test)]
mod tests;

use std::f64::consts::TAU;

use eit::{Mesh, bounding_box, clip_by, left_of, polygon_area};
use serde::{Deserialize, Serialize};

/// Number of corners of the polygon that approximates a circle; its area is exactly that of the circle.
const ROUND: usize = 360;

/// Standard gravity, m/s2.
pub const GRAVITY: f64 = 9.806_65;

/// The outline of a load about its centre, mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shape {
    /// A disc.
    Disc {
        /// Diameter, mm.
        diameter_mm: f64,
    },
    /// A rectangle.
    Rectangle {
        /// Width along x, mm.
        width_mm: f64,
        /// Height along y, mm.
        height_mm: f64,
    },
    /// An equilateral triangle with its centroid at the centre and one corner up.
    Triangle {
        /// Side, mm.
        side_mm: f64,
    },
    /// Two overlapping discs next to each other along x.
    FigureEight {
        /// Diameter of each, mm.
        diameter_mm: f64,
        /// Distance of their centres, mm.
        distance_mm: f64,
    },
    /// Any simple polygon.
    Polygon {
        /// Its corners relative to the centre, mm.
        points_mm: Vec<[f64; 2]>,
    },
}

/// A shape at a position, with its loss.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Load {
    /// Displayed name.
    pub name: String,
    /// Its outline.
    pub shape: Shape,
    /// Position of its centre, mm from the sheet's origin.
    pub centre_mm: [f64; 2],
    /// Rotation counter-clockwise about its centre, degrees.
    pub turn_deg: f64,
    /// Share of the conductance lost under it, 0 to 1.
    pub loss: f64,
}

/// Errors of loads.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LoadError {
    /// A dimension that is not a positive number.
    #[error("load '{load}': {key} is {value}, it must be a positive number")]
    Measure {
        /// Name of the load.
        load: String,
        /// Which dimension.
        key: &'static str,
        /// Its value.
        value: f64,
    },
    /// A position or angle that is not a number.
    #[error("load '{load}': {key} is not a finite number")]
    Place {
        /// Name of the load.
        load: String,
        /// Which.
        key: &'static str,
    },
    /// A loss outside 0 to 1.
    #[error("load '{load}': its loss of {} % is not 0 to 100 %", .loss * 100.0)]
    Loss {
        /// Name of the load.
        load: String,
        /// The loss as a share.
        loss: f64,
    },
    /// Discs of a figure-eight that do not overlap.
    #[error(
        "load '{load}': discs of {diameter_mm} mm, {distance_mm} mm apart, do not make a figure-eight"
    )]
    Apart {
        /// Name of the load.
        load: String,
        /// Diameter, mm.
        diameter_mm: f64,
        /// Distance, mm.
        distance_mm: f64,
    },
    /// A polygon with fewer than three corners.
    #[error("load '{load}': a polygon of {corners} corners has no area")]
    Corners {
        /// Name of the load.
        load: String,
        /// Number of corners.
        corners: usize,
    },
    /// A polygon whose sides cross.
    #[error("load '{load}': sides {first} and {second} of the polygon cross (counted from 0)")]
    Crossing {
        /// Name of the load.
        load: String,
        /// One side.
        first: usize,
        /// Another.
        second: usize,
    },
    /// A load outside the sheet.
    #[error("load '{load}' at {x_mm}, {y_mm} mm covers no part of the sheet")]
    Beside {
        /// Name of the load.
        load: String,
        /// Position, mm.
        x_mm: f64,
        /// Position, mm.
        y_mm: f64,
    },
}

impl Load {
    /// A disc at a position (mm) with a diameter (mm) and a loss (0 to 1).
    pub fn disc(centre_mm: [f64; 2], diameter_mm: f64, loss: f64) -> Self {
        Self {
            name: "disc".to_owned(),
            shape: Shape::Disc { diameter_mm },
            centre_mm,
            turn_deg: 0.0,
            loss,
        }
    }

    /// Checks the dimensions, position and loss.
    ///
    /// # Errors
    /// The first error, which names load and dimension.
    pub fn check(&self) -> Result<(), LoadError> {
        self.check_outline()?;
        if !(0.0..=1.0).contains(&self.loss) {
            return Err(LoadError::Loss {
                load: self.name.clone(),
                loss: self.loss,
            });
        }
        Ok(())
    }

    /// Checks dimensions and position only, because the loss given by a law may be negative.
    pub(crate) fn check_outline(&self) -> Result<(), LoadError> {
        for (key, value) in [
            ("x_mm", self.centre_mm[0]),
            ("y_mm", self.centre_mm[1]),
            ("turn_deg", self.turn_deg),
        ] {
            if !value.is_finite() {
                return Err(LoadError::Place {
                    load: self.name.clone(),
                    key,
                });
            }
        }
        self.shape.check(&self.name)
    }

    /// The outline on the sheet, m, counter-clockwise.
    pub fn outline(&self) -> Vec<[f64; 2]> {
        let (sin, cos) = self.turn_deg.to_radians().sin_cos();
        self.shape
            .outline_mm()
            .into_iter()
            .map(|[x, y]| {
                [
                    (self.centre_mm[0] + cos * x - sin * y) * 1e-3,
                    (self.centre_mm[1] + sin * x + cos * y) * 1e-3,
                ]
            })
            .collect()
    }

    /// Covered share of each triangle, by clipping the outline with the triangle: exact for polygons. Uncovered
    /// triangles are omitted.
    ///
    /// # Errors
    /// An invalid load, or one outside the mesh.
    pub fn coverage(&self, mesh: &Mesh) -> Result<Vec<(usize, f64)>, LoadError> {
        self.check()?;
        self.covered(mesh)
    }

    /// As [`Load::coverage`], for any loss.
    pub(crate) fn covered(&self, mesh: &Mesh) -> Result<Vec<(usize, f64)>, LoadError> {
        self.check_outline()?;
        let outline = self.outline();
        let [low, high] = bounding_box(outline.iter().copied());
        let covered: Vec<(usize, f64)> = (0..mesh.triangles().len())
            .filter_map(|t| {
                let corners = mesh.corners(t);
                let [from, to] = bounding_box(corners);
                let apart = (0..2).any(|i| from[i] >= high[i] || to[i] <= low[i]);
                if apart {
                    return None;
                }
                let share =
                    (polygon_area(&clip(&outline, corners)).abs() / mesh.area(t)).clamp(0.0, 1.0);
                (share > 0.0).then_some((t, share))
            })
            .collect();
        if covered.is_empty() {
            return Err(LoadError::Beside {
                load: self.name.clone(),
                x_mm: self.centre_mm[0],
                y_mm: self.centre_mm[1],
            });
        }
        Ok(covered)
    }
}

impl Shape {
    /// Area, m2.
    pub fn area(&self) -> f64 {
        polygon_area(&self.outline_mm()).abs() * 1e-6
    }

    fn check(&self, load: &str) -> Result<(), LoadError> {
        let positive = |measures: &[(&'static str, f64)]| match measures
            .iter()
            .find(|(_, value)| !(*value > 0.0 && value.is_finite()))
        {
            Some(&(key, value)) => Err(LoadError::Measure {
                load: load.to_owned(),
                key,
                value,
            }),
            None => Ok(()),
        };
        match self {
            Self::Disc { diameter_mm } => positive(&[("diameter_mm", *diameter_mm)]),
            Self::Rectangle {
                width_mm,
                height_mm,
            } => positive(&[("width_mm", *width_mm), ("height_mm", *height_mm)]),
            Self::Triangle { side_mm } => positive(&[("side_mm", *side_mm)]),
            Self::FigureEight {
                diameter_mm,
                distance_mm,
            } => {
                positive(&[("diameter_mm", *diameter_mm), ("distance_mm", *distance_mm)])?;
                if distance_mm < diameter_mm {
                    Ok(())
                } else {
                    Err(LoadError::Apart {
                        load: load.to_owned(),
                        diameter_mm: *diameter_mm,
                        distance_mm: *distance_mm,
                    })
                }
            }
            Self::Polygon { points_mm } => check_polygon(load, points_mm),
        }
    }

    fn outline_mm(&self) -> Vec<[f64; 2]> {
        match self {
            Self::Disc { diameter_mm } => arc(0.0, 0.5 * diameter_mm, 0.0, TAU, ROUND),
            Self::Rectangle {
                width_mm,
                height_mm,
            } => {
                let (x, y) = (0.5 * width_mm, 0.5 * height_mm);
                vec![[-x, -y], [x, -y], [x, y], [-x, y]]
            }
            Self::Triangle { side_mm } => {
                let height = side_mm * 3.0_f64.sqrt() / 2.0;
                vec![
                    [-0.5 * side_mm, -height / 3.0],
                    [0.5 * side_mm, -height / 3.0],
                    [0.0, 2.0 * height / 3.0],
                ]
            }
            Self::FigureEight {
                diameter_mm,
                distance_mm,
            } => {
                // each disc without the part beyond the common chord
                let (radius, half) = (0.5 * diameter_mm, 0.5 * distance_mm);
                let waist = (half / radius).acos();
                let open = TAU - 2.0 * waist;
                let left = arc(-half, radius, waist, open, ROUND);
                let right = arc(half, radius, waist - TAU / 2.0, open, ROUND);
                left.into_iter().chain(right).collect()
            }
            Self::Polygon { points_mm } => {
                let mut points = points_mm.clone();
                if polygon_area(&points) < 0.0 {
                    points.reverse();
                }
                points
            }
        }
    }
}

/// Pressure under a mass, kPa (mass g, area m2).
pub fn pressure_kpa(mass_g: f64, area: f64) -> f64 {
    mass_g * 1e-3 * GRAVITY / area * 1e-3
}

/// Loss of conductance under a pressure, p / (p + p_half): 0 without pressure, 1/2 at `half_kpa`, always below 1 (fact
/// sheet, section 2.4). The paper gives no law; from its S1 (25.0 kPa, assumed to be a loss of 50 %) `half_kpa` is 25.
pub fn loss_of_pressure(kpa: f64, half_kpa: f64) -> f64 {
    kpa / (kpa + half_kpa)
}

/// Points of an arc about (x, 0), including both ends. A full circle has one end only, and its radius is enlarged so
/// that the polygon has the area of the circle.
fn arc(x: f64, radius: f64, from: f64, open: f64, pieces: usize) -> Vec<[f64; 2]> {
    let step = open / pieces as f64;
    let closed = (open - TAU).abs() < 1e-12;
    let radius = if closed {
        radius * (step / step.sin()).sqrt()
    } else {
        radius
    };
    (0..pieces + usize::from(!closed))
        .map(|k| {
            let (sin, cos) = (from + step * k as f64).sin_cos();
            [x + radius * cos, radius * sin]
        })
        .collect()
}

/// The part of a polygon in a triangle.
fn clip(polygon: &[[f64; 2]], [a, b, c]: [[f64; 2]; 3]) -> Vec<[f64; 2]> {
    let (mut points, mut spare) = (polygon.to_vec(), Vec::new());
    for side in [[a, b], [b, c], [c, a]] {
        clip_by(side, &mut points, &mut spare);
    }
    points
}

fn check_polygon(load: &str, points: &[[f64; 2]]) -> Result<(), LoadError> {
    if points.iter().flatten().any(|value| !value.is_finite()) {
        return Err(LoadError::Place {
            load: load.to_owned(),
            key: "points_mm",
        });
    }
    let count = points.len();
    if count < 3 || polygon_area(points) == 0.0 {
        return Err(LoadError::Corners {
            load: load.to_owned(),
            corners: count,
        });
    }
    let side = |k: usize| (points[k], points[(k + 1) % count]);
    for first in 0..count {
        for second in first + 2..count {
            if first == 0 && second == count - 1 {
                continue;
            }
            let ((a, b), (c, d)) = (side(first), side(second));
            let apart = left_of([a, b], c) * left_of([a, b], d) > 0.0
                || left_of([c, d], a) * left_of([c, d], b) > 0.0;
            let [[al, bl], [ah, bh]] = bounding_box([a, b]);
            let [[cl, dl], [ch, dh]] = bounding_box([c, d]);
            let beside = al > ch || cl > ah || bl > dh || dl > bh;
            if !(apart || beside) {
                return Err(LoadError::Crossing {
                    load: load.to_owned(),
                    first,
                    second,
                });
            }
        }
    }
    Ok(())
}
