//! Settings of total variation, and the rule that derives the penalty from the noise.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::inverse::prior::shown_or_all;
use crate::{DEFAULT_NOISE_V, HyperRule, Mesh, OneStepError, Scale};

/// Strength of the penalty on borders.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Strength {
    /// alpha of |J x - d|^2 / 2 + alpha sum L_e |x_i - x_j| with unscaled readings: in V with [`Scale::Currents`],
    /// otherwise in V at 1 A. The noise is ignored.
    Alpha(f64),
    /// In units of the errors of a frame, see [`TV_STRENGTH`].
    Relative(f64),
}

/// The penalty in units of the noise. Alpha is chosen so that it shrinks the amplitude of a small disc (0.0543 of the
/// region's width; 10 mm on the paper's sheet) at the place of median sensitivity by this many standard deviations of
/// that amplitude's noise:
///
/// alpha = k |J 1_disc| / (length of its border), J in standard deviations of a difference.
///
/// It depends on noise and geometry. With [`TvOptions::frame_rule`] the errors of the frame replace the noise.
pub const TV_STRENGTH: f64 = 0.5;

/// Diameter of the small disc over the square root of the region's area.
const SMALL: f64 = 0.0543;
/// The border of a disc on triangles is longer than its circumference by about this factor.
const RAGGED: f64 = 1.3;

/// Settings of a [`Tv`](crate::Tv).
#[derive(Debug, Clone, PartialEq)]
pub struct TvOptions {
    /// Standard deviation of one reading, V, the same in baseline and frame. If it is `None` (unknown), a `frame_rule`
    /// or [`Strength::Alpha`] is required.
    pub noise_v: Option<f64>,
    /// Rule that estimates the errors of a frame from the frame itself; the noise is their lower limit. With
    /// [`HyperRule::LCurve`] the errors are those of the one-step map at the corner of its L-curve. `None`: the errors
    /// are the noise.
    pub frame_rule: Option<HyperRule>,
    /// Injected current to which `noise_v` refers, A.
    pub current_a: f64,
    /// The penalty.
    pub strength: Strength,
    /// Bounds the map to -1 <= x <= 0: loads only reduce conductance.
    pub loss_only: bool,
    /// Stop when the objective exceeds the minimum by at most this share.
    pub gap: f64,
    /// The baseline's scale.
    pub scale: Scale,
    /// Relative standard deviation of each reading, as in [`OneStepOptions`](crate::OneStepOptions).
    pub deviations: Option<Vec<f64>>,
    /// The unknowns that maps show, as in [`OneStepOptions`](crate::OneStepOptions); the rule for alpha uses only
    /// these.
    pub shown: Option<Vec<usize>>,
}

impl Default for TvOptions {
    /// 2 uV of noise at 1 mA, a gap of 1e-3, losses and gains.
    fn default() -> Self {
        Self {
            noise_v: Some(DEFAULT_NOISE_V),
            frame_rule: None,
            current_a: 1e-3,
            strength: Strength::Relative(TV_STRENGTH),
            loss_only: false,
            gap: 1e-3,
            scale: Scale::default(),
            deviations: None,
            shown: None,
        }
    }
}

impl TvOptions {
    pub(super) fn check(&self) -> Result<(), TvError> {
        let (what, value) = match self.strength {
            Strength::Alpha(alpha) => ("alpha", alpha),
            Strength::Relative(share) => ("strength", share),
        };
        let needs_noise =
            matches!(self.strength, Strength::Relative(_)) && self.frame_rule.is_none();
        for (what, value) in [
            (
                "noise",
                self.noise_v.unwrap_or(if needs_noise { 0.0 } else { 1.0 }),
            ),
            ("current", self.current_a),
            ("gap", self.gap),
            (what, value),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(TvError::NotPositive { what, value });
            }
        }
        Ok(())
    }
}

/// Errors in the preparation of total variation.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TvError {
    /// An error of the linear model, which total variation shares with the one-step method.
    #[error(transparent)]
    Linear(#[from] OneStepError),
    /// A setting that is not a positive number.
    #[error("the {what} of total variation is {value:e}; it must be a positive number")]
    NotPositive {
        /// Which setting.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// No reading depends on any triangle of the region.
    #[error(
        "no triangle of the region changes any reading by more than its noise; check the noise and the current"
    )]
    Blind,
}

/// |J 1_disc| over the border of a small disc, at the place of median sensitivity among the unknowns that are shown.
pub(super) fn reference(mesh: &Mesh, sensitivity: &DMatrix<f64>, shown: Option<&[usize]>) -> f64 {
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    let shown = shown_or_all(shown, areas.len());
    let area: f64 = shown.iter().map(|&unknown| areas[unknown]).sum();
    let radius = 0.5 * SMALL * area.sqrt();
    let disc = std::f64::consts::PI * radius * radius;
    let mut sizes: Vec<f64> = shown
        .iter()
        .map(|&unknown| {
            let at = centroids[unknown];
            let mut sum = DVector::zeros(sensitivity.nrows());
            let mut covered = 0.0;
            for (unknown, other) in centroids.iter().enumerate() {
                if (other[0] - at[0]).powi(2) + (other[1] - at[1]).powi(2) <= radius * radius {
                    sum += sensitivity.column(unknown);
                    covered += areas[unknown];
                }
            }
            sum.norm() * disc / covered
        })
        .collect();
    sizes.sort_by(f64::total_cmp);
    sizes[sizes.len() / 2] / (RAGGED * 2.0 * std::f64::consts::PI * radius)
}
