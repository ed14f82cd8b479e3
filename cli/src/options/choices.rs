//! What options choose between, each parsed into its type; and the options that several commands share.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
pub use imaging::recorded::BaselineRule;
pub use imaging::{Method, PresetName, PriorName};

use crate::options::numbers::{above_zero, degrees, electrodes, exponent, millimetres};

/// How voltages become a map.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Reconstruction")]
pub struct MethodChoice {
    /// Method computed on the spot (default when no --model is given: what the session used, else one-step)
    #[arg(long, value_enum, value_name = "METHOD", conflicts_with = "model")]
    pub method: Option<Method>,
    /// Trained model file; it brings its own geometry and protocol
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Prior of the one-step method (default: what the session used, else noser)
    #[arg(long, value_enum, value_name = "PRIOR", conflicts_with = "model")]
    pub prior: Option<PriorName>,
    /// Exponent of the NOSER prior (default: what the session used, else 0.5 with --prior noser, 0.25 without)
    #[arg(long, value_name = "P", conflicts_with = "model", value_parser = exponent, allow_hyphen_values = true)]
    pub exponent: Option<f64>,
    /// Hyper-parameter of the one-step method (default: what the session used, else from the noise)
    #[arg(long, value_name = "X", conflicts_with_all = ["model", "noise_v"], value_parser = above_zero, allow_hyphen_values = true)]
    pub lambda: Option<f64>,
    /// Standard deviation of one reading, V (default: measured on the baseline's frames)
    #[arg(long, value_name = "SD", conflicts_with = "model", value_parser = above_zero, allow_hyphen_values = true)]
    pub noise_v: Option<f64>,
    /// Loads only take conductance away: bound the relative change to [-1, 0]; maps of a model are cut
    #[arg(long)]
    pub loss_only: bool,
}

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
