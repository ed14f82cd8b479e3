//! Draws meshes and maps by `render`: terminal cells, PNG, SVG; and finds the position of a map's load.

use std::io::Write;

use eit::Mesh;
use render::{Sheet, Style, TerminalStyle};
use survey::Map;

use crate::failure::Failure;
use crate::options::choices::Scale;
use crate::output::Printer;

/// The region of a map: the part of its mesh that a picture and [`Map::found`] need.
pub(crate) struct Field {
    mesh_hash: String,
    pub(crate) sheet: Sheet,
    centroids: Vec<[f64; 2]>,
    areas: Vec<f64>,
}

impl Field {
    pub(crate) fn from_mesh(mesh: &Mesh) -> Self {
        Self {
            mesh_hash: mesh.hash().to_owned(),
            sheet: Sheet {
                triangles: mesh
                    .region()
                    .iter()
                    .map(|&triangle| mesh.corners(triangle))
                    .collect(),
                outline: mesh.outline(),
                electrodes: mesh.electrode_centres(),
            },
            centroids: mesh.region_centroids(),
            areas: mesh.region_areas(),
        }
    }

    /// The region from the daemon's D-Bus message.
    ///
    /// # Errors
    /// Inconsistent indices or counts.
    pub(crate) fn from_bus(geometry: dbus::Geometry) -> Result<Self, Failure> {
        let (Some(triangles), Some(outline)) = (geometry.corners(), geometry.loops()) else {
            return Err(Failure::Failed(
                "the daemon's geometry does not fit together; is it of another version than this tactus?".to_owned(),
            ));
        };
        let centroids = triangles
            .iter()
            .map(|[a, b, c]| [(a[0] + b[0] + c[0]) / 3.0, (a[1] + b[1] + c[1]) / 3.0])
            .collect();
        let areas = triangles
            .iter()
            .map(|[a, b, c]| {
                0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])).abs()
            })
            .collect();
        Ok(Self {
            sheet: Sheet {
                triangles,
                outline,
                electrodes: geometry.electrode_centres(),
            },
            mesh_hash: geometry.mesh_hash,
            centroids,
            areas,
        })
    }

    /// Whether the map is of this mesh.
    pub(crate) fn fits(&self, map: &Map) -> bool {
        map.mesh_hash == self.mesh_hash && map.values.len() == self.areas.len()
    }

    /// Position of the load, m: [`Map::found_above`].
    pub(crate) fn found(&self, map: &Map, noise: Option<f64>) -> Option<[f64; 2]> {
        map.found_above(noise, &self.centroids, &self.areas)
    }
}

fn scale(scale: Scale) -> render::Scale {
    match scale {
        Scale::Own => render::Scale::Own,
        Scale::Fixed(low, high) => render::Scale::Fixed(low, high),
    }
}

/// Title, scale and marks for the picture of one map; `noise` is the largest loss by noise alone.
pub(crate) fn style(
    title: String,
    wanted: Scale,
    simulated: bool,
    found: Option<[f64; 2]>,
    map: &Map,
    noise: Option<f64>,
) -> Style {
    Style {
        title,
        scale: scale(wanted),
        simulated,
        found,
        nothing_above: nothing_above(map, noise),
        ..Style::default()
    }
}

/// A style with the terminal's width and colours.
pub(crate) fn terminal_style(printer: &Printer<impl Write>, style: Style) -> TerminalStyle {
    TerminalStyle {
        width: printer.width(),
        height: None,
        colour: printer.map_colour(),
        style,
    }
}

pub(crate) fn png(field: &Field, map: &Map, style: &Style) -> Result<Vec<u8>, Failure> {
    render::png(&field.sheet, map, style)
        .map_err(|error| Failure::failed("the picture cannot be drawn", &error))
}

pub(crate) fn svg(field: &Field, map: &Map, style: &Style) -> Result<String, Failure> {
    render::svg(&field.sheet, map, style)
        .map_err(|error| Failure::failed("the picture cannot be drawn", &error))
}

/// The map as terminal cells.
pub(crate) fn terminal(field: &Field, map: &Map, style: &TerminalStyle) -> Result<String, Failure> {
    render::terminal(&field.sheet, map, style)
        .map_err(|error| Failure::failed("the map cannot be drawn", &error))
}

/// `(129.3, 44.0) mm`, or that nothing was found; the position is in millimetres.
pub(crate) fn place(found_mm: Option<[f64; 2]>) -> String {
    match found_mm {
        Some([x, y]) => format!("({x:.1}, {y:.1}) mm"),
        None => "nothing".to_owned(),
    }
}

/// Metres to millimetres.
pub(crate) fn millimetres(found: Option<[f64; 2]>) -> Option<[f64; 2]> {
    found.map(|place| place.map(|metres| metres * 1e3))
}

/// The noise, if no loss of the map exceeds it, as a relative loss; `None` if the map shows more, or the noise is
/// unknown.
pub(crate) fn nothing_above(map: &Map, noise: Option<f64>) -> Option<f64> {
    noise.filter(|_| map.is_significant(noise) == Some(false))
}

/// The map in words: newtons and kPa only with a calibration; and that it shows nothing, if no loss exceeds the noise.
pub(crate) fn map_summary(
    largest_loss: f64,
    pressed: Option<(f64, f64)>,
    noise: Option<f64>,
) -> String {
    if let Some(noise) = noise.filter(|noise| largest_loss <= *noise) {
        return render::nothing_above(noise);
    }
    match pressed {
        Some((newtons, kpa)) => format!("{newtons:.1} N, largest pressure {kpa:.1} kPa"),
        None => format!("largest relative loss of conductance {largest_loss:.3}"),
    }
}

#[cfg(test)]
mod tests {
    use survey::MapUnit;

    use crate::maps::drawing::*;

    fn geometry() -> dbus::Geometry {
        dbus::Geometry {
            mesh_hash: "m".into(),
            nodes: vec![0.0, 0.0, 0.03, 0.0, 0.0, 0.03],
            triangles: vec![0, 1, 2],
            outline: vec![0.0, 0.0, 0.03, 0.0, 0.0, 0.03],
            outline_lengths: vec![3],
            electrodes: vec![0.0, 0.0],
            more: dbus::GeometryDetails::default(),
        }
    }

    #[test]
    fn a_geometry_from_the_bus_finds_a_load() {
        let field = Field::from_bus(geometry()).unwrap();
        let map = Map {
            mesh_hash: "m".into(),
            values: vec![-0.5],
            unit: MapUnit::RelativeConductance,
            method: "test".into(),
            masked: 0,
        };
        assert!(field.fits(&map));
        assert_eq!(
            place(millimetres(field.found(&map, None))),
            "(10.0, 10.0) mm"
        );
        assert_eq!(field.found(&map, Some(0.6)), None);
        assert_eq!(nothing_above(&map, Some(0.6)), Some(0.6));
        assert_eq!(nothing_above(&map, Some(0.4)), None);
        assert_eq!(place(None), "nothing");
        assert!(!field.fits(&Map {
            mesh_hash: "other".into(),
            ..map
        }));
    }

    #[test]
    fn a_geometry_that_does_not_fit_together_is_refused() {
        let wrong = dbus::Geometry {
            triangles: vec![0, 1, 7],
            ..geometry()
        };
        assert!(Field::from_bus(wrong).is_err());
    }
}
