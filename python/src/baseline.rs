//! A baseline and the model fitted to it, from which maps and a tracked baseline start.

use std::sync::Arc;

use imaging::recorded::{Fitted, Unloaded};
use imaging::{BuildError, Conditions, Geometry};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use survey::{Protocol, Reading};

use crate::arguments::Expected;
use crate::forward::Forward;
use crate::maps::{readings, rows_of_readings};
use crate::mesh::conductances;
use crate::outcome::{interruptible, refused};

/// A baseline with the model fitted to it.
pub(crate) struct Recorded {
    pub(crate) fitted: Fitted,
    pub(crate) unloaded: Unloaded,
    /// Standard deviation of one reading, V; None if it is not stated.
    noise_v: Option<f64>,
    protocol: Protocol,
}

impl Recorded {
    /// sigma0: S per square, None to fit it to the baseline. current: A. noise: V, None to estimate it from the frames
    /// of the baseline. baseline: V, shape (frames, readings), NaN for a missing reading.
    pub(crate) fn new(
        py: Python<'_>,
        forward: &Forward,
        sigma0: Option<&Bound<'_, PyAny>>,
        current: &Bound<'_, PyAny>,
        noise: Option<&Bound<'_, PyAny>>,
        baseline: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let amperes = Expected {
            name: "current",
            about: "the injected current in A, above 0",
        };
        let current = amperes.positive(current)?;
        let volts = Expected {
            name: "noise",
            about: "the standard deviation of one reading in V, above 0, e.g. 2e-6; leave it out if it is unknown",
        };
        let noise_v = noise.map(|noise| volts.positive(noise)).transpose()?;
        let triangles = forward.triangles();
        let sigma0 = sigma0
            .map(|sigma0| conductances(sigma0, "sigma0", triangles, &[0, 1]))
            .transpose()?;
        let protocol = &forward.protocol.get().0;
        let geometry = Geometry {
            name: "mesh from Python".to_owned(),
            mesh: Arc::clone(forward.forward.mesh()),
            contact_ohm_m: forward.forward.contact_ohm_m().to_vec(),
            sigma0_known: sigma0.is_some(),
            sigma0: sigma0.map_or_else(|| vec![1.0; triangles], |(sigma0, _)| sigma0.values),
            // the currents are stated, as in a case folder
            from_case: true,
        };
        let baseline = rows_of_readings(baseline, "baseline", protocol.len())?;
        let each: Vec<Vec<Reading>> = baseline
            .values
            .chunks_exact(protocol.len())
            .map(readings)
            .collect();
        let protocol = protocol.clone();
        interruptible(py, None, move |_| {
            let each: Vec<&[Reading]> = each.iter().map(Vec::as_slice).collect();
            let unloaded = Unloaded::mean(&each);
            let currents = vec![current; protocol.len()];
            let fitted = Fitted::new(geometry, &protocol, &currents, &unloaded)?;
            Ok(Self {
                fitted,
                unloaded,
                noise_v,
                protocol,
            })
        })?
        .map_err(|fault| unlike(&fault))
    }

    /// Number of triangles of a map.
    pub(crate) fn region(&self) -> usize {
        self.fitted.geometry.mesh.region().len()
    }

    /// The conditions under which a method is prepared.
    pub(crate) fn conditions(&self) -> Conditions<'_> {
        let mut conditions = self.fitted.conditions(&self.protocol);
        if self.noise_v.is_some() {
            (conditions.noise_v, conditions.noise_assumed) = (self.noise_v, false);
        }
        conditions
    }
}

/// The Python error for a baseline that cannot be used.
pub(crate) fn unlike(fault: &BuildError) -> PyErr {
    match fault {
        BuildError::Unlike => PyValueError::new_err(
            "argument 'baseline': it does not look like this geometry: it is zero, its readings have the opposite sign of \
             the model's, or none is valid; if they are magnitudes, pass -baseline and -frames",
        ),
        other => refused(other),
    }
}
