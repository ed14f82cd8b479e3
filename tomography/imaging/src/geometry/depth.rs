//! The depth of a tank: its settings, and whether a baseline contradicts it.

use std::sync::Arc;

use eit::{Depth, Forward, MeshError};
use serde::{Deserialize, Serialize};
use survey::{Protocol, Reading};

use super::Geometry;
use crate::noise::factor;

/// Ratio of the misfits above which a baseline contradicts a depth.
const CONTRADICTION: f64 = 1.1;

/// The table `[geometry.depth]` of a configuration: the geometry is a tank of this depth, not a sheet. See [`Depth`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DepthSettings {
    /// Depth of the liquid, mm.
    pub depth_mm: f64,
    /// Height of an electrode's contact, mm.
    pub electrode_height_mm: f64,
    /// Height of the electrodes' centres above the bottom, mm; default half of the depth.
    pub electrode_centre_mm: Option<f64>,
    /// Height of the targets, a layer about the electrodes' centres, mm; default the depth.
    pub target_height_mm: Option<f64>,
    /// Number of cosine modes over the depth; default [`Depth::MODES`].
    pub modes: Option<usize>,
}

impl DepthSettings {
    /// The depth in metres.
    ///
    /// # Errors
    /// As [`Depth::new`].
    pub fn depth(&self) -> Result<Depth, MeshError> {
        let centre = self.electrode_centre_mm.unwrap_or(0.5 * self.depth_mm);
        let depth = Depth::new(
            1e-3 * self.depth_mm,
            1e-3 * self.electrode_height_mm,
            1e-3 * centre,
            self.modes.unwrap_or(Depth::MODES),
        )?;
        match self.target_height_mm {
            Some(height) => depth.with_target_height(1e-3 * height),
            None => Ok(depth),
        }
    }
}

/// Lengths of a tank on the command line, mm.
#[cfg(feature = "arguments")]
const MILLIMETRES: survey::Bounds = survey::Bounds::Within(0.01, 10e3);

/// The depth of a tank on the command line.
#[cfg(feature = "arguments")]
#[derive(Debug, Clone, Default, PartialEq, clap::Args)]
#[command(next_help_heading = "Depth of a tank")]
pub struct DepthArguments {
    /// Depth of the liquid of a tank, mm [default: what the case folder or session says, else a sheet]
    #[arg(long, value_name = "MM", requires = "electrode_height_mm", value_parser = MILLIMETRES.parser(), allow_hyphen_values = true)]
    pub depth_mm: Option<f64>,
    /// Height of an electrode's contact with the liquid, mm [default: none; needed with --depth-mm]
    #[arg(long, value_name = "MM", requires = "depth_mm", value_parser = MILLIMETRES.parser(), allow_hyphen_values = true)]
    pub electrode_height_mm: Option<f64>,
    /// Height of the electrodes' centres above the bottom, mm [default: half of the depth]
    #[arg(long, value_name = "MM", requires = "depth_mm", value_parser = MILLIMETRES.parser(), allow_hyphen_values = true)]
    pub electrode_centre_mm: Option<f64>,
    /// Height of the targets, a layer about the electrodes' centres, mm: for one-step and tv [default: the depth]
    #[arg(long, value_name = "MM", requires = "depth_mm", value_parser = MILLIMETRES.parser(), allow_hyphen_values = true)]
    pub target_height_mm: Option<f64>,
}

#[cfg(feature = "arguments")]
impl DepthArguments {
    /// The settings; `None` without a depth.
    pub fn settings(&self) -> Option<DepthSettings> {
        Some(DepthSettings {
            depth_mm: self.depth_mm?,
            electrode_height_mm: self.electrode_height_mm?,
            electrode_centre_mm: self.electrode_centre_mm,
            target_height_mm: self.target_height_mm,
            modes: None,
        })
    }
}

impl Geometry {
    /// The same geometry as the cross-section of a tank; unchanged if `depth` is `None`.
    ///
    /// # Errors
    /// As [`Depth::new`].
    pub fn with_depth(mut self, depth: Option<&DepthSettings>) -> Result<Self, MeshError> {
        if let Some(settings) = depth {
            self.mesh = Arc::new(self.mesh.with_depth(Some(settings.depth()?)));
        }
        Ok(self)
    }

    /// A sentence with the misfits of the model with depth and of the flat model, and a warning if the flat model fits
    /// the baseline better. `None` without a depth, or if the baseline does not match the geometry at all.
    pub fn depth_remark(&self, protocol: &Protocol, baseline: &[Reading]) -> Option<DepthRemark> {
        let depth = self.mesh.depth()?;
        let flat = Arc::new(self.mesh.with_depth(None));
        let misfit = |mesh| {
            let forward = Forward::new(mesh, &self.contact_ohm_m).ok()?;
            let model = forward.readings(&self.sigma0, protocol).ok()?;
            misfit(model.as_slice(), baseline)
        };
        let (deep, flat) = (misfit(Arc::clone(&self.mesh))?, misfit(flat)?);
        let contradicted = deep > CONTRADICTION * flat;
        let mut text = format!(
            "depth {:.1} mm, electrodes {:.1} mm high at {:.1} mm: the baseline differs by {:.1} % (rms) from the model of \
             the empty tank, by {:.1} % from one without depth",
            1e3 * depth.depth_m(),
            1e3 * depth.electrode_height_m(),
            1e3 * depth.electrode_centre_m(),
            100.0 * deep,
            100.0 * flat
        );
        if contradicted {
            text += ": the data contradict this depth; measure the liquid and the height of the electrodes again, or \
                     omit the depth";
        }
        Some(DepthRemark { text, contradicted })
    }
}

/// How well the depth fits a baseline.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthRemark {
    /// The sentence.
    pub text: String,
    /// Whether the flat model fits the baseline better.
    pub contradicted: bool,
}

/// Rms difference between a baseline and the model scaled to it, as a share of the baseline's rms; `None` if they have
/// opposite signs or no reading is valid.
pub(super) fn misfit(model: &[f64], baseline: &[Reading]) -> Option<f64> {
    let gain = factor(model.iter().copied(), baseline)?;
    let (mut rest, mut own) = (0.0, 0.0);
    for (reading, ohms) in baseline.iter().zip(model) {
        if let Some(volts) = reading.volts() {
            rest += (volts.0 - gain * ohms).powi(2);
            own += volts.0 * volts.0;
        }
    }
    (own > 0.0).then(|| (rest / own).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use eit::{DiscTank, Preset};
    use survey::Volts;

    fn settings(depth_mm: f64) -> DepthSettings {
        DepthSettings {
            depth_mm,
            electrode_height_mm: 10.0,
            electrode_centre_mm: None,
            target_height_mm: None,
            modes: None,
        }
    }

    fn tank() -> Geometry {
        let tank = DiscTank {
            fineness: 0.5,
            ..DiscTank::default()
        };
        Geometry::from_preset(&Preset::DiscTank(tank)).unwrap()
    }

    #[test]
    fn a_depth_that_the_baseline_contradicts_is_named() {
        let protocol = Protocol::sheffield(16).unwrap();
        let deep = tank().with_depth(Some(&settings(260.0))).unwrap();
        let forward = |geometry: &Geometry| {
            let forward =
                Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m).unwrap();
            let volts = forward.readings(&geometry.sigma0, &protocol).unwrap();
            volts
                .iter()
                .map(|ohms| Reading::Ok(Volts(1e-3 * ohms)))
                .collect::<Vec<_>>()
        };
        let (of_tank, of_sheet) = (forward(&deep), forward(&tank()));
        assert_eq!(tank().depth_remark(&protocol, &of_tank), None);
        let right = deep.depth_remark(&protocol, &of_tank).unwrap();
        assert!(!right.contradicted, "{right:?}");
        assert!(right.text.contains("differs by 0.0 %"), "{right:?}");
        let wrong = deep.depth_remark(&protocol, &of_sheet).unwrap();
        assert!(wrong.contradicted, "{wrong:?}");
        assert!(
            wrong.text.contains("by 0.0 % from one without"),
            "{wrong:?}"
        );
    }

    #[test]
    fn electrodes_above_the_liquid_are_refused() {
        let above = DepthSettings {
            electrode_centre_mm: Some(300.0),
            ..settings(260.0)
        };
        let error = tank().with_depth(Some(&above)).unwrap_err().to_string();
        assert!(error.contains("from 295.00 to 305.00 mm"), "{error}");
    }
}
