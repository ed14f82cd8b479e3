//! Draws meshes and maps with the crate `render` (terminal cells, PNG, SVG), and finds the position of a map's load.

use std::io::Write;

use eit::Mesh;
use imaging::Tracked;
use render::{Sheet, Style, TerminalStyle};
use survey::{Map, MapUnit};

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
    pub(crate) fn from_bus(geometry: &dbus::Geometry) -> Result<Self, Failure> {
        let (Some(triangles), Some(outline)) = (geometry.corners(), geometry.loops()) else {
            return Err(Failure::Failed(
                "the daemon's geometry is inconsistent; if `tactus --version` and `tactusd --version` differ, install the same version of both"
                    .to_owned(),
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
            mesh_hash: geometry.mesh_hash.clone(),
            centroids,
            areas,
        })
    }

    /// The values, one for each triangle of the region, as a map of this mesh.
    pub(crate) fn map(&self, values: Vec<f64>, method: &str) -> Map {
        Map::relative(&self.mesh_hash, values, method)
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

/// A title, extended by the reason why the map is not reliable, if there is one.
pub(crate) fn title(text: String, tracked: Option<&Tracked>) -> String {
    match tracked.and_then(|tracked| tracked.reason) {
        Some(reason) => format!("{text}, not known: {}", reason.words()),
        None => text,
    }
}

/// Title, scale and marks of the picture of one map in this unit. `noise`: the largest loss due to noise alone.
///
/// # Errors
/// A scale in another unit.
pub(crate) fn style(
    title: String,
    (wanted, unit): (Scale, MapUnit),
    simulated: bool,
    found: Option<[f64; 2]>,
    map: &Map,
    noise: Option<f64>,
) -> Result<Style, Failure> {
    Ok(Style {
        title,
        scale: wanted.of(unit).map_err(Failure::Usage)?,
        simulated,
        found,
        nothing_above: nothing_above(map, noise),
        ..Style::default()
    })
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

/// The quantity and unit of a map's values.
pub(crate) fn unit(map: &Map) -> &'static str {
    match map.unit {
        MapUnit::Pressure => map.unit.label(),
        MapUnit::RelativeConductance | MapUnit::Conductance => map.unit.caption(),
    }
}

/// The map as pixels over the bounding box of the sheet: a row per line, the top row first, `nan` outside.
pub(crate) fn raster(field: &Field, map: &Map, side: usize) -> Result<String, Failure> {
    let pixels = render::raster(&field.sheet, map, side, side)
        .map_err(|error| Failure::failed("the raster cannot be made", &error))?;
    let rows = pixels.chunks(side).map(|row| {
        let fields: Vec<String> = row
            .iter()
            .map(|value| eit::digits(value.unwrap_or(f64::NAN)))
            .collect();
        fields.join(",") + "\n"
    });
    Ok(rows.collect())
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

/// The noise as a relative loss, if no loss of the map exceeds it; `None` if one does, or if the noise is unknown.
pub(crate) fn nothing_above(map: &Map, noise: Option<f64>) -> Option<f64> {
    noise.filter(|_| map.is_significant(noise) == Some(false))
}

/// The map as text: newtons and kPa only with a calibration; and a note if no loss exceeds the noise.
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
        let field = Field::from_bus(&geometry()).unwrap();
        let map = Map::relative("m", vec![-0.5], "test");
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
        assert!(Field::from_bus(&wrong).is_err());
    }
}
