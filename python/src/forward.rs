//! The class `Forward`.

use std::sync::Arc;

use eit::Parameters;
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arguments::Expected;
use crate::mesh::{Mesh, conductances};
use crate::outcome::{detached, matrix, refused, rows};
use crate::protocol::Protocol;

/// The forward model: voltages of a sheet with electrodes of finite length and contact impedance (complete electrode
/// model), from its conductance.
///
/// mesh: a Mesh. protocol: a Protocol for the same number of electrodes.
/// contact: contact impedance in ohm m (contact resistance times length of the electrode), 0 or more: a number, or shape
///     (electrodes,). By default that of the mesh, if it is a preset or from a case folder.
///
/// >>> import tactus_eit
/// >>> mesh = tactus_eit.Mesh.disc(electrodes=16, fineness=0.5)
/// >>> forward = tactus_eit.Forward(mesh, tactus_eit.Protocol.sheffield(16))
/// >>> forward.solve(1e-3).shape
/// (208,)
#[pyclass(frozen, module = "tactus_eit")]
#[derive(Debug)]
pub(crate) struct Forward {
    pub(crate) mesh: Py<Mesh>,
    pub(crate) protocol: Py<Protocol>,
    pub(crate) forward: Arc<eit::Forward>,
}

#[pymethods]
impl Forward {
    #[new]
    #[pyo3(signature = (mesh, protocol, contact=None))]
    fn new(
        py: Python<'_>,
        mesh: &Bound<'_, PyAny>,
        protocol: &Bound<'_, PyAny>,
        contact: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let on = Expected {
            name: "mesh",
            about: "a Mesh",
        };
        let mesh: Py<Mesh> = on.instance(mesh)?;
        let given = mesh.get();
        let electrodes = given.mesh.electrodes();
        let asks = Expected {
            name: "protocol",
            about: "a Protocol for the electrodes of the mesh",
        };
        let protocol: Py<Protocol> = asks.instance(protocol)?;
        if protocol.get().0.electrodes() != electrodes {
            return Err(asks.value_error(&format!(
                "it is for {} electrodes and the mesh has {electrodes}",
                protocol.get().0.electrodes()
            )));
        }
        let about =
            format!("contact impedance in ohm m, 0 or more: a number, or shape ({electrodes},)");
        let expected = Expected {
            name: "contact",
            about: &about,
        };
        let contact = match (contact, &given.known) {
            (None, Some(known)) => known.contact_ohm_m.clone(),
            (None, None) => {
                return Err(expected.value_error(
                    "it is missing, and this mesh states none: for 100 ohm a contact, 100.0 * mesh.electrode_lengths",
                ));
            }
            (Some(contact), _) => {
                let values = expected.floats(contact, &[0, 1])?;
                match values.shape[..] {
                    [] => vec![values.values[0]; electrodes],
                    [count] if count == electrodes => values.values,
                    _ => return Err(expected.shape_error(&values.shape)),
                }
            }
        };
        if let Some(negative) = contact.iter().find(|contact| **contact < 0.0) {
            return Err(expected.value_error(&format!("a value is {negative}")));
        }
        let on = Arc::clone(&given.mesh);
        let forward = detached(py, || eit::Forward::new(on, &contact))?;
        Ok(Self {
            forward: Arc::new(forward.map_err(|fault| refused(&fault))?),
            mesh,
            protocol,
        })
    }

    /// Readings at 1 A, V.
    ///
    /// sigma: conductance in S per square: a number, shape (triangles,), or (rows, triangles). Returns shape
    /// (readings,), or (rows, readings). Triangles with conductance 0 get 1e-8 of the largest.
    fn solve<'py>(
        &self,
        py: Python<'py>,
        sigma: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let triangles = self.triangles();
        let (sigma, count) = conductances(sigma, "sigma", triangles, &[0, 1, 2])?;
        let protocol = &self.protocol.get().0;
        if sigma.shape.len() < 2 {
            let readings = detached(py, || self.forward.readings(&sigma.values, protocol))?;
            let readings: Vec<f64> = readings.map_err(|fault| refused(&fault))?.data.into();
            return Ok(PyArray1::from_vec(py, readings).into_any());
        }
        let mut readings = Vec::with_capacity(count * protocol.len());
        let mut workspace = self
            .forward
            .workspace(protocol)
            .map_err(|fault| refused(&fault))?;
        for row in sigma.values.chunks_exact(triangles) {
            let solved = detached(py, || workspace.readings(row))?;
            readings.extend_from_slice(solved.map_err(|fault| refused(&fault))?.as_slice());
            py.check_signals()?;
        }
        Ok(rows(py, readings, [count, protocol.len()])?.into_any())
    }

    /// Derivative of each reading at 1 A with respect to the conductance of each triangle, V per S: shape (readings,
    /// triangles), in Fortran order.
    ///
    /// sigma: conductance in S per square: a number, or shape (triangles,).
    /// region: columns for the triangles of mesh.region only. log: derivative with respect to the logarithm of the
    /// conductance, V.
    #[pyo3(signature = (sigma, *, region=false, log=false))]
    fn jacobian<'py>(
        &self,
        py: Python<'py>,
        sigma: &Bound<'py, PyAny>,
        region: bool,
        log: bool,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (sigma, _) = conductances(sigma, "sigma", self.triangles(), &[0, 1])?;
        let parameters = match region {
            false => Parameters::elements(),
            true => Parameters::region(),
        };
        let parameters = if log {
            parameters.logarithmic()
        } else {
            parameters
        };
        let protocol = &self.protocol.get().0;
        let jacobian = detached(py, || {
            self.forward
                .sensitivity(&sigma.values, protocol, &parameters)
        })?;
        matrix(py, jacobian.map_err(|fault| refused(&fault))?)
    }

    /// Transfer impedance between the electrodes, ohm: shape (electrodes, electrodes). The voltages of the electrodes are
    /// Z @ currents for all currents (A) that sum to zero.
    ///
    /// sigma: conductance in S per square: a number, or shape (triangles,).
    fn transfer<'py>(
        &self,
        py: Python<'py>,
        sigma: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (sigma, _) = conductances(sigma, "sigma", self.triangles(), &[0, 1])?;
        let transfer = detached(py, || self.forward.transfer_impedance(&sigma.values))?;
        matrix(py, transfer.map_err(|fault| refused(&fault))?)
    }

    /// The mesh.
    #[getter]
    fn mesh(&self, py: Python<'_>) -> Py<Mesh> {
        self.mesh.clone_ref(py)
    }

    /// The protocol.
    #[getter]
    fn protocol(&self, py: Python<'_>) -> Py<Protocol> {
        self.protocol.clone_ref(py)
    }

    /// Contact impedance of each electrode, ohm m: shape (electrodes,).
    #[getter]
    fn contact<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, self.forward.contact_ohm_m())
    }

    fn __repr__(&self) -> String {
        format!(
            "<Forward model of {} triangles, {} readings>",
            self.triangles(),
            self.protocol.get().0.len()
        )
    }
}

impl Forward {
    pub(crate) fn triangles(&self) -> usize {
        self.forward.mesh().triangles().len()
    }
}
