//! Conductance, current and scale of a recording, derived from geometry and baseline.

use std::sync::Arc;

use eit::{Forward, Scale};
use survey::{Amps, Protocol};

use super::Unloaded;
use crate::conditions::Conditions;
use crate::error::BuildError;
use crate::geometry::Geometry;
use crate::noise::{Noise, at_currents, factor, fitted_conductance};

/// Largest ratio, in either direction, between the baseline and the readings of a known conductance for which that
/// conductance is used without scaling.
const BELIEVED: f64 = 1.25;

/// Conductance, current and scale of a recording without a configuration.
#[derive(Debug, Clone)]
pub struct Fitted {
    /// The geometry with the given conductance, or with a uniform one fitted to the baseline.
    pub geometry: Geometry,
    /// Assumptions and derived values, one sentence each.
    pub notes: Vec<String>,
    current: Amps,
    scale: Scale,
    noise: Option<Noise>,
}

impl Fitted {
    /// Compares the baseline with the geometry at these currents (A, one per reading).
    ///
    /// # Errors
    /// A geometry that cannot be solved, or a baseline that does not match it.
    pub fn new(
        mut geometry: Geometry,
        protocol: &Protocol,
        currents: &[f64],
        unloaded: &Unloaded,
    ) -> Result<Self, BuildError> {
        let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m)?;
        let baseline = unloaded.readings.as_slice();
        let mut notes = Vec::new();
        let mut scale = Scale::ByDistance;
        if !geometry.sigma0_known {
            let triangles = geometry.mesh.triangles().len();
            let conductance =
                fitted_conductance(&forward, triangles, currents, protocol, baseline)?
                    .ok_or(BuildError::Unlike)?;
            notes.push(format!(
                "uniform conductance fitted to the baseline: {conductance:.4e} S per square"
            ));
            geometry.sigma0 = vec![conductance; triangles];
        }
        let ohms = forward.readings(&geometry.sigma0, protocol)?;
        if geometry.sigma0_known && geometry.from_case {
            let excess = factor(at_currents(ohms.as_slice(), currents), baseline)
                .ok_or(BuildError::Unlike)?;
            if (BELIEVED.recip()..=BELIEVED).contains(&excess) {
                scale = Scale::Currents(currents.to_vec());
            } else {
                notes.push(format!(
                    "the baseline is {excess:.3} times that of the given conductance and currents: the model is scaled to it"
                ));
            }
        }
        let remark = geometry.depth_remark(protocol, baseline);
        notes.extend(remark.map(|remark| remark.text));
        notes.extend(geometry.ring_remark(protocol, baseline));
        // the model is scaled to the baseline; noise is in the same scale, so the unit does not matter
        let current = factor(ohms.iter().copied(), baseline);
        Ok(Self {
            geometry,
            notes,
            current: Amps(current.ok_or(BuildError::Unlike)?),
            scale,
            noise: Noise::of_baseline(unloaded.noise, baseline),
        })
    }

    /// The conditions for a method.
    pub fn conditions<'a>(&'a self, protocol: &'a Protocol) -> Conditions<'a> {
        Conditions {
            noise_v: self.noise.map(Noise::deviation),
            noise_assumed: matches!(self.noise, Some(Noise::Assumed(_))),
            scale: self.scale.clone(),
            ..Conditions::live(&self.geometry, protocol, self.current)
        }
    }
}
