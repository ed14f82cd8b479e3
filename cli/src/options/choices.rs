//! Values of options, each parsed into its type; and options shared by several commands.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
pub use imaging::recorded::BaselineRule;
pub use imaging::{MethodArguments, PresetName};

use crate::options::numbers::{degrees, electrodes, millimetres};

/// The sheet or tank, where neither the record nor a model file says it.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Geometry")]
pub struct GeometryChoice {
    /// Built-in geometry (default: what the session or the folder says)
    #[arg(long, value_enum, value_name = "NAME")]
    pub preset: Option<PresetName>,
    /// Number of electrodes (default: what the protocol says)
    #[arg(long, value_name = "N", requires = "preset", value_parser = electrodes)]
    pub electrodes: Option<usize>,
    /// Width of a disc tank, mm
    #[arg(long, value_name = "MM", requires = "preset", value_parser = millimetres, allow_hyphen_values = true)]
    pub diameter_mm: Option<f64>,
    /// Width of an electrode of a disc tank as seen from the centre, degrees (assumed where nobody tells it)
    #[arg(long, value_name = "DEG", requires = "preset", value_parser = degrees, allow_hyphen_values = true)]
    pub arc_deg: Option<f64>,
    /// Direction of a disc tank's first electrode, degrees counter-clockwise from +x
    #[arg(
        long,
        value_name = "DEG",
        requires = "preset",
        value_parser = degrees,
        allow_hyphen_values = true
    )]
    pub first_deg: Option<f64>,
    /// Case folder that holds the mesh
    #[arg(long, value_name = "DIR", conflicts_with = "preset")]
    pub case: Option<PathBuf>,
}

/// What `export` writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// A row a frame, a column a reading.
    Csv,
    /// A picture of one map.
    Png,
    /// A drawing of one map.
    Svg,
}

/// Scale of a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// Each map's own extremes.
    Own,
    /// Fixed, lowest and highest value.
    Fixed(f64, f64),
}

impl std::str::FromStr for Scale {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "own" {
            return Ok(Self::Own);
        }
        let wrong = || format!("'{text}' is not a scale; write own, or two numbers as in -0.5,0");
        let (low, high) = text.split_once(',').ok_or_else(wrong)?;
        let (low, high): (f64, f64) = (
            low.trim().parse().map_err(|_| wrong())?,
            high.trim().parse().map_err(|_| wrong())?,
        );
        if low.is_finite() && high.is_finite() && low < high {
            Ok(Self::Fixed(low, high))
        } else {
            Err(wrong())
        }
    }
}
