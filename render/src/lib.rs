//! Draws maps: raster, PNG and SVG, terminal cells.
//!
//! Every picture shows its units, numbers its electrodes from 1, and is labelled SIMULATED if the voltages were. Zero
//! has the same colour everywhere, losses are blue, gains brown, and lightness decreases with the amount on both sides:
//! readable without distinguishing red and green, and in grey. NaN has no colour. The crate uses no files, clocks or
//! meshes, and refuses a map that does not fit its sheet.
//!
//! - **sheet**: the geometry of a picture: triangles of the region in the order of the map's values, outline,
//!   electrodes, in metres
//! - **style**: title, scale, the true position of the load if known, the position found
//! - **hot spot**: a connected patch that has lost at least half of the loss of the worst triangle
//!
//! ```
//! use render::{Sheet, Style, TerminalColour, TerminalStyle};
//! # use survey::{Map, MapUnit};
//! let corners = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]];
//! let sheet = Sheet {
//!     triangles: vec![[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]],
//!     outline: vec![corners.to_vec()],
//!     electrodes: vec![[0.05, 0.0], [0.1, 0.05], [0.05, 0.1], [0.0, 0.05]],
//! };
//! let map = Map { mesh_hash: "m".into(), values: vec![-0.4, 0.0], unit: MapUnit::RelativeConductance,
//!     method: "by hand".into(), masked: 0, evidence: None, quality: None };
//! let style = Style { title: "half pressed".into(), ..Style::default() };
//! assert!(render::svg(&sheet, &map, &style)?.contains("half pressed"));
//! let seen = render::terminal(&sheet, &map, &TerminalStyle { width: 40, height: None, colour: TerminalColour::Plain, style })?;
//! assert!(seen.contains('%'));
//! # Ok::<(), render::PictureError>(())
//! ```

mod chart;
pub(crate) mod charts;
pub(crate) mod drawing;
mod film;
mod hot_spot;
mod image;
mod marks;
mod mesh;
mod page;
mod raster;
mod rim;
mod terminal;

pub use crate::chart::nothing_above;
pub use crate::charts::course::{Course, CourseLine, course_svg};
pub use crate::charts::curves::{Axis, Curve, Curves, curves_png, curves_svg};
pub use crate::charts::work_precision::{WorkPoint, work_precision_png};
pub use crate::drawing::colour::{Rgb, colour};
pub use crate::drawing::scale::Range;
pub use film::{Film, Pace};
pub use hot_spot::hot_spots;
pub use image::{png, png_grid, svg, svg_grid};
pub use mesh::{mesh_png, mesh_svg};
pub use raster::raster;
pub use terminal::{
    CellColour, TerminalCell, TerminalColour, TerminalMap, TerminalScale, TerminalStyle, terminal,
    terminal_map,
};

use survey::Map;

/// The geometry of a picture. All coordinates in metres, y upwards.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sheet {
    /// Triangles of the region, in the order of the map's values.
    pub triangles: Vec<[[f64; 2]; 3]>,
    /// Closed loops of the sheet's boundary: the outer edge, and holes such as void electrodes.
    pub outline: Vec<Vec<[f64; 2]>>,
    /// Centres of the electrodes, electrode 1 first.
    pub electrodes: Vec<[f64; 2]>,
}

/// Ends of the colour scale. Zero is always on the scale and always has the same colour.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Scale {
    /// The smallest and the largest value in the picture.
    #[default]
    Own,
    /// The given ends, in the map's unit (-0.5 is half the conductance lost); values beyond them take the colour of the
    /// end, and the end is marked.
    Fixed(f64, f64),
}

/// True position of a load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruePlace {
    /// Its centre, m.
    pub centre: [f64; 2],
    /// Radius of the circle, m; at least 8 points are drawn.
    pub radius: f64,
}

/// A hot spot, drawn as a ring of the size of its area.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpotMark {
    /// Its number.
    pub number: u64,
    /// Its centre, m.
    pub centre: [f64; 2],
    /// Its area, m2; a ring has a radius of at least 5 points.
    pub area: f64,
}

/// Texts and marks of a picture.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Style {
    /// Title.
    pub title: String,
    /// Ends of the colour scale.
    pub scale: Scale,
    /// Whether the voltages are simulated; the picture then has a label.
    pub simulated: bool,
    /// True position of the load: a dashed circle.
    pub true_position: Option<TruePlace>,
    /// Outline of a load that is not a disc, m: a dashed line.
    pub true_outline: Vec<[f64; 2]>,
    /// Position found, m: a cross.
    pub found: Option<[f64; 2]>,
    /// Hot spots: numbered rings. `None` if they were not computed. With `Some`, the legend explains the marks even if
    /// there is none, so that all pictures of one session have the same size.
    pub hot_spots: Option<Vec<SpotMark>>,
    /// The noise as a relative loss, if nothing in the map is above its noise. The picture is then grey with a label,
    /// and its scale does not depend on the map unless it is fixed.
    pub nothing_above: Option<f64>,
}

/// Scaling of the colours in a grid of maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Scales {
    /// One scale with one bar for all maps: amounts can be compared.
    #[default]
    Common,
    /// A scale and a bar for each map: shapes can be compared.
    Each,
}

/// Layout of a grid of maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid<'a> {
    /// Maps per row.
    pub columns: usize,
    /// Title.
    pub title: &'a str,
    /// Scaling of the colours.
    pub scales: Scales,
}

/// Errors of drawing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PictureError {
    /// The map is of another sheet.
    #[error(
        "the map has {map} values and the sheet {sheet} triangles; draw it on the mesh it was made on"
    )]
    OtherSheet {
        /// Values of the map.
        map: usize,
        /// Triangles of the sheet.
        sheet: usize,
    },
    /// The sheet has no extent, or a coordinate that is not a number.
    #[error("the sheet cannot be drawn: {0}")]
    Sheet(&'static str),
    /// The scale's ends are not ascending or not finite.
    #[error("a colour scale from {low} to {high} cannot be drawn; the first end must be the lower")]
    Scale {
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
    },
    /// The picture is too small or far too large.
    #[error("a picture of {width} x {height} cannot be drawn; {limit}")]
    Size {
        /// Width requested.
        width: usize,
        /// Height requested.
        height: usize,
        /// What is possible.
        limit: &'static str,
    },
    /// A point that cannot be drawn on its chart.
    #[error(
        "the point ({across}, {up}) cannot be drawn; its coordinates must be finite, and above 0 on a logarithmic axis"
    )]
    Point {
        /// Its abscissa.
        across: f64,
        /// Its ordinate.
        up: f64,
    },
    /// Maps with different units on one scale.
    #[error("maps in per cent, in siemens and in kPa cannot share one colour scale")]
    Units,
    /// A grid without maps.
    #[error("a grid needs at least one map and one column")]
    EmptyGrid,
    /// The drawing library failed.
    #[error("the picture cannot be drawn: {0}")]
    Draw(String),
}

/// Bounding box of a sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Extent {
    pub(crate) low: [f64; 2],
    pub(crate) high: [f64; 2],
}

impl Extent {
    pub(crate) fn width(self) -> f64 {
        self.high[0] - self.low[0]
    }
    pub(crate) fn height(self) -> f64 {
        self.high[1] - self.low[1]
    }
}

impl Sheet {
    /// The bounding box of outline and triangles; refuses invalid sheets.
    pub(crate) fn extent(&self) -> Result<Extent, PictureError> {
        let mut extent = Extent {
            low: [f64::INFINITY; 2],
            high: [f64::NEG_INFINITY; 2],
        };
        let corners = self.triangles.iter().flatten();
        let points = self.outline.iter().flatten().chain(corners);
        for point in points.chain(&self.electrodes) {
            if !point.iter().all(|coordinate| coordinate.is_finite()) {
                return Err(PictureError::Sheet("a coordinate is not a number"));
            }
        }
        let corners = self.triangles.iter().flatten();
        for point in self.outline.iter().flatten().chain(corners) {
            for (axis, &coordinate) in point.iter().enumerate() {
                extent.low[axis] = extent.low[axis].min(coordinate);
                extent.high[axis] = extent.high[axis].max(coordinate);
            }
        }
        let (width, height) = (extent.width(), extent.height());
        // not `<=`, because an empty sheet gives NaN or -infinity here
        if !(width > 0.0 && height > 0.0 && width / height < 1e3 && height / width < 1e3) {
            return Err(PictureError::Sheet(
                "it has no area, or is more than 1000 times as long as wide",
            ));
        }
        Ok(extent)
    }

    pub(crate) fn check(&self, map: &Map) -> Result<(), PictureError> {
        if map.values.len() == self.triangles.len() {
            return Ok(());
        }
        Err(PictureError::OtherSheet {
            map: map.values.len(),
            sheet: self.triangles.len(),
        })
    }
}
