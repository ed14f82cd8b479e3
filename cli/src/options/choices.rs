//! Values of options, each parsed into its type; and options shared by several commands.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
pub use imaging::recorded::BaselineRule;
pub use imaging::{DepthArguments, MethodArguments, PresetName, TrackedArguments};
use survey::MapUnit;

use crate::options::numbers::{DEGREES, ELECTRODES, MILLIMETRES};

/// The sheet or tank, if neither the record nor a model file specifies it.
#[derive(Debug, Clone, Default, PartialEq, Args)]
#[command(next_help_heading = "Geometry")]
pub struct GeometryChoice {
    /// Built-in geometry (default: that of the session or folder)
    #[arg(long, value_enum, value_name = "NAME")]
    pub preset: Option<PresetName>,
    /// Number of electrodes (default: that of the protocol)
    #[arg(long, value_name = "N", requires = "preset", value_parser = ELECTRODES.counter())]
    pub electrodes: Option<usize>,
    /// Diameter of a disc tank, mm [default: 300]
    #[arg(long, value_name = "MM", requires = "preset", value_parser = MILLIMETRES.parser(), allow_hyphen_values = true)]
    pub diameter_mm: Option<f64>,
    /// Width of an electrode of a disc tank as seen from the centre, degrees [default: 5]
    #[arg(long, value_name = "DEG", requires = "preset", value_parser = DEGREES.parser(), allow_hyphen_values = true)]
    pub arc_deg: Option<f64>,
    /// Direction of a disc tank's first electrode, degrees counter-clockwise from +x [default: 0]
    #[arg(
        long,
        value_name = "DEG",
        requires = "preset",
        value_parser = DEGREES.parser(),
        allow_hyphen_values = true
    )]
    pub first_deg: Option<f64>,
    /// Case folder that holds the mesh
    #[arg(long, value_name = "DIR", conflicts_with = "preset")]
    pub case: Option<PathBuf>,
    #[command(flatten)]
    pub depth: DepthArguments,
}

/// Formats of `export`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// One row per frame, one column per reading.
    Csv,
    /// A netCDF file (classic, 64-bit offset) with voltages, quality, baseline and protocol; with --maps also the maps.
    Nc,
    /// A MAT-file for EIDORS with voltages, stimulation, forward model and baseline; and a script that loads it.
    Mat,
    /// Parquet files: frames, and beside them events and stored quantities (NAME.events.parquet, NAME.quantities.parquet). Not in
    /// every build.
    Parquet,
    /// A picture of one map.
    Png,
    /// A film of the session as an animated PNG; see --every and --speed.
    Apng,
    /// A drawing of one map.
    Svg,
    /// One map as pixels by GREIT's convention: CSV, one line per row of pixels, the top row first, `nan` outside.
    Raster,
}

impl Format {
    /// The name on the command line.
    pub(crate) fn name(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// Whether the format shows one map.
    pub(crate) fn is_picture(self) -> bool {
        matches!(self, Self::Png | Self::Svg | Self::Raster)
    }
}

/// Scale of a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// Each map's own extremes.
    Own,
    /// Fixed, in the unit and sign of the axis: per cent of conductance lost, or kPa with a calibration.
    Fixed {
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
        /// The unit that was written; without one it is the axis's.
        unit: Option<MapUnit>,
    },
}

impl Scale {
    /// The ends as values of a map in the unit `shown`.
    ///
    /// # Errors
    /// The scale was given in another unit.
    pub fn of(self, shown: MapUnit) -> Result<render::Scale, String> {
        let Self::Fixed { low, high, unit } = self else {
            return Ok(render::Scale::Own);
        };
        let (per, axis) = shown.shown();
        match unit {
            Some(MapUnit::Pressure) if shown != MapUnit::Pressure => Err(format!(
                "--scale {low},{high}kPa: the map is in {axis}, because no calibration applies; write --scale LOW,HIGH in {axis}, or \
                 give a calibration"
            )),
            Some(other) if other != shown => Err(format!(
                "--scale {low},{high}%: the map is in {axis}; write --scale LOW,HIGH in {axis}"
            )),
            _ => {
                let (one, other) = (low / per, high / per);
                Ok(render::Scale::Fixed(one.min(other), one.max(other)))
            }
        }
    }
}

impl std::str::FromStr for Scale {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "own" {
            return Ok(Self::Own);
        }
        let wrong = || {
            format!(
                "'{text}' is not a scale; write own, or two numbers, the lower first, as the axis shows them: 0,50 or 0,50% for losses, \
                 0,20kPa for pressure"
            )
        };
        let (numbers, unit) = match (text.strip_suffix('%'), text.strip_suffix("kPa")) {
            (Some(numbers), _) => (numbers, Some(MapUnit::RelativeConductance)),
            (_, Some(numbers)) => (numbers, Some(MapUnit::Pressure)),
            (None, None) => (text, None),
        };
        let (low, high) = numbers.split_once(',').ok_or_else(wrong)?;
        let (low, high): (f64, f64) = (
            low.trim().parse().map_err(|_| wrong())?,
            high.trim().parse().map_err(|_| wrong())?,
        );
        if low.is_finite() && high.is_finite() && low < high {
            Ok(Self::Fixed { low, high, unit })
        } else {
            Err(wrong())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends(text: &str, unit: MapUnit) -> Result<render::Scale, String> {
        text.parse::<Scale>().unwrap().of(unit)
    }

    #[test]
    fn a_scale_is_in_unit_and_sign_of_the_axis() {
        let (loss, pressure) = (MapUnit::RelativeConductance, MapUnit::Pressure);
        assert_eq!(ends("own", loss), Ok(render::Scale::Own));
        for text in ["-10,50", "-10,50%", "-10, 50 %"] {
            assert_eq!(
                ends(text, loss),
                Ok(render::Scale::Fixed(-0.5, 0.1)),
                "{text}"
            );
        }
        for text in ["0,20", "0,20kPa"] {
            assert_eq!(
                ends(text, pressure),
                Ok(render::Scale::Fixed(0.0, 20.0)),
                "{text}"
            );
        }
        let error = ends("0,20kPa", loss).unwrap_err();
        assert!(error.contains("calibration"), "{error}");
        let error = ends("0,20%", pressure).unwrap_err();
        assert!(error.contains("in kPa"), "{error}");
        assert!("0,20mmHg".parse::<Scale>().is_err());
    }
}
