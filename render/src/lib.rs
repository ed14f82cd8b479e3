//! A map made visible: raster, PNG and SVG, terminal cells.
//!
//! Every picture states its units, numbers its electrodes from 1, and says SIMULATED when the voltages were. Zero has
//! one colour everywhere, loss goes to blue, gain to brown, lightness falls with the amount on both sides: readable
//! without red and green, and in grey. A value that is not a number has no colour. The crate knows no
//! files, clocks or meshes, and refuses a map that does not fit its sheet.
//!
//! - **sheet**: what is drawn on: triangles of the region in the order of the map's values, outline, electrodes, in metres
//! - **style**: what is said beside it: title, scale, the true load if one is known, what was found
//! - **hot spot**: a connected patch that has lost at least half of what the worst triangle has lost
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
//!     method: "by hand".into(), masked: 0 };
//! let style = Style { title: "half pressed".into(), ..Style::default() };
//! assert!(render::svg(&sheet, &map, &style)?.contains("half pressed"));
//! let seen = render::terminal(&sheet, &map, &TerminalStyle { width: 40, colour: TerminalColour::Plain, style })?;
//! assert!(seen.contains('%'));
//! # Ok::<(), render::PictureError>(())
//! ```

mod chart;
pub(crate) mod charts;
pub(crate) mod drawing;
mod hot_spot;
mod image;
mod mesh;
mod raster;
mod terminal;

pub use crate::chart::nothing_above;
pub use crate::charts::curves::{Axis, Curve, Curves, curves_png, curves_svg};
pub use crate::charts::work_precision::{WorkPoint, work_precision_png};
pub use crate::drawing::colour::{Rgb, colour};
pub use crate::drawing::scale::Range;
pub use hot_spot::{HotSpot, hot_spots};
pub use image::{png, png_grid, svg, svg_grid};
pub use mesh::{mesh_png, mesh_svg};
pub use raster::raster;
pub use terminal::{TerminalColour, TerminalStyle, terminal};

use survey::Map;

/// What a map is drawn on. All coordinates in metres, y upwards.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sheet {
    /// Triangles of the region, in the order of the map's values.
    pub triangles: Vec<[[f64; 2]; 3]>,
    /// Closed loops of the sheet's boundary: the outer edge, and holes such as void electrodes.
    pub outline: Vec<Vec<[f64; 2]>>,
    /// Centres of the electrodes, electrode 1 first.
    pub electrodes: Vec<[f64; 2]>,
}

/// What the ends of the colour scale are. Zero is always on the scale and always has the same colour.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Scale {
    /// From the smallest to the largest value of what is drawn.
    #[default]
    Own,
    /// From the first to the second, in the map's unit (-0.5 is half the conductance lost); what lies beyond takes the
    /// colour of the end, and the end is marked.
    Fixed(f64, f64),
}

/// Where a load really was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruePlace {
    /// Its centre, m.
    pub centre: [f64; 2],
    /// Radius of the circle to draw, m; where that is smaller than 8 points, 8 points are drawn.
    pub radius: f64,
}

/// What is said beside a map.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Style {
    /// First line.
    pub title: String,
    /// Ends of the colour scale.
    pub scale: Scale,
    /// Whether the voltages come from a simulated sheet; then the picture says so.
    pub simulated: bool,
    /// Where the load really was: a dashed circle.
    pub true_position: Option<TruePlace>,
    /// The outline of a load that is no disc, m: a dashed line.
    pub true_outline: Vec<[f64; 2]>,
    /// Where it was found, m: a cross.
    pub found: Option<[f64; 2]>,
    /// Where nothing of the map is above its noise: the noise, as a relative loss. The picture is then grey, on a scale
    /// that does not depend on the map unless one is fixed, and says so.
    pub nothing_above: Option<f64>,
}

/// How the colours of a grid's maps are scaled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Scales {
    /// One scale that serves all maps, with one bar: amounts can be compared.
    #[default]
    Common,
    /// A scale and a bar for each map: shapes can be compared.
    Each,
}

/// How a grid of maps is laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid<'a> {
    /// Maps in a row.
    pub columns: usize,
    /// First line.
    pub title: &'a str,
    /// Whose colours can be compared.
    pub scales: Scales,
}

/// Why there is no picture.
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
    /// The scale's ends are not in order or not numbers.
    #[error("a colour scale from {low} to {high} cannot be drawn; the first end must be the lower")]
    Scale {
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
    },
    /// The picture has no room or far too much.
    #[error("a picture of {width} x {height} cannot be drawn; {limit}")]
    Size {
        /// Width asked for.
        width: usize,
        /// Height asked for.
        height: usize,
        /// What is possible.
        limit: &'static str,
    },
    /// A point that is nowhere on its chart.
    #[error("a point at {across} across and {up} up cannot be drawn")]
    Point {
        /// Its place across.
        across: f64,
        /// Its place up.
        up: f64,
    },
    /// Maps on one scale whose values do not mean the same.
    #[error("maps in per cent, in siemens and in kPa cannot share one colour scale")]
    Units,
    /// A grid without maps.
    #[error("a grid needs at least one map and one column")]
    EmptyGrid,
    /// The drawing library failed.
    #[error("the picture cannot be drawn: {0}")]
    Draw(String),
}

/// Smallest box round a sheet.
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
    /// The box of outline and triangles; refuses what cannot be drawn.
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
        // Not `<=`: an empty sheet gives NaN or -infinity here.
        if !(width > 0.0 && height > 0.0 && width / height < 1e3 && height / width < 1e3) {
            return Err(PictureError::Sheet("it has no area, or is a mere line"));
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
