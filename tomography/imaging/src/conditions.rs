//! Conditions of the measurement.

use std::sync::Arc;

use eit::{Forward, ForwardError, Mesh, Scale};
use survey::{Amps, Protocol, Reading, Volts};

use crate::geometry::Geometry;

/// Conditions of the measurement that a reconstruction needs.
#[derive(Debug, Clone)]
pub struct Conditions<'a> {
    /// The sheet or tank.
    pub geometry: &'a Geometry,
    /// The readings of a frame.
    pub protocol: &'a Protocol,
    /// Current of the frames, or the factor from the model's readings at 1 A to the recording's unit.
    pub current: Amps,
    /// Standard deviation of one reading, V, if the settings do not give it. Default:
    /// [`DEFAULT_NOISE_UV`](crate::noise::DEFAULT_NOISE_UV).
    pub noise_v: Option<f64>,
    /// Whether `noise_v` is an assumption; the quality check of maps then does not use it.
    pub noise_assumed: bool,
    /// Scaling of the baseline to the model, for model-based methods.
    pub scale: Scale,
    /// The mesh with the region of the maps, if the region of `geometry` is the whole sheet; otherwise `None`.
    pub(crate) shown: Option<&'a Arc<Mesh>>,
}

impl<'a> Conditions<'a> {
    /// Conditions of a running measurement.
    pub fn live(geometry: &'a Geometry, protocol: &'a Protocol, current: Amps) -> Self {
        Self {
            geometry,
            protocol,
            current,
            noise_v: None,
            noise_assumed: false,
            scale: Scale::default(),
            shown: None,
        }
    }

    /// Positions of the unknowns that maps contain, if the whole sheet is unknown: [`eit::OneStepOptions::shown`].
    pub(crate) fn shown_unknowns(&self) -> Option<Vec<usize>> {
        self.shown.map(|mesh| mesh.region().to_vec())
    }
}

/// A simulated frame with a load, for trials before the first real one: half of the conductance is lost on a disc in
/// the middle of the region, of a tenth of its area; each reading of the baseline changes by the same ratio as the
/// model's.
///
/// # Errors
/// The forward model cannot be solved.
pub fn trial_frame(
    geometry: &Geometry,
    protocol: &Protocol,
    baseline: &[Reading],
) -> Result<Vec<Reading>, ForwardError> {
    let mesh = &geometry.mesh;
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    let area: f64 = areas.iter().sum();
    let middle = |axis: usize| {
        let moments = centroids
            .iter()
            .zip(&areas)
            .map(|(at, area)| at[axis] * area);
        moments.sum::<f64>() / area
    };
    let (x, y) = (middle(0), middle(1));
    let radius = (0.1 * area / std::f64::consts::PI).sqrt();
    let mut loaded = geometry.sigma0.clone();
    for (&triangle, at) in mesh.region().iter().zip(&centroids) {
        if (at[0] - x).hypot(at[1] - y) < radius {
            loaded[triangle] *= 0.5;
        }
    }
    let forward = Forward::new(Arc::clone(mesh), &geometry.contact_ohm_m)?;
    let before = forward.readings(&geometry.sigma0, protocol)?;
    let after = forward.readings(&loaded, protocol)?;
    Ok(baseline
        .iter()
        .zip(before.iter().zip(after.iter()))
        .map(|(reading, (before, after))| match reading.volts() {
            Some(volts) => Reading::Ok(Volts(volts.0 * after / before)),
            None => *reading,
        })
        .collect())
}
