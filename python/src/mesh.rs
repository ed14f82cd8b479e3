//! The class `Mesh`.

use std::sync::Arc;

use eit::{DiscTank, MeshError, PaperSheet, Preset, SheetElectrode};
use imaging::Geometry;
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arguments::{Expected, Values, pairs};
use crate::outcome::{detached, refused, rows};
use crate::sizes::{electrodes, fine, millimetres, seeded};

/// A triangulated sheet with electrodes on its boundary.
///
/// nodes: floats of shape (nodes, 2), positions in m. Every node belongs to a triangle.
/// triangles: integers of shape (triangles, 3), the nodes of each from 0, counter-clockwise.
/// electrodes: a list with an array of shape (edges, 2) for each electrode: the two nodes of every boundary edge that it
///     touches. Electrodes have no node in common.
/// region: integers of shape (n,), the triangles that maps show; by default all.
///
/// >>> import numpy, tactus_eit
/// >>> nodes = numpy.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
/// >>> tactus_eit.Mesh(nodes, [[0, 1, 2], [0, 2, 3]], [[[3, 0]], [[1, 2]]])
/// <Mesh of 2 triangles, 4 nodes, 2 electrodes>
#[pyclass(frozen, module = "tactus_eit")]
#[derive(Debug)]
pub(crate) struct Mesh {
    pub(crate) mesh: Arc<eit::Mesh>,
    /// Contact impedances and unloaded conductance; None if the source of the mesh does not state them.
    pub(crate) known: Option<Known>,
}

/// The properties that a preset or a case folder states in addition to the mesh.
#[derive(Debug, Clone)]
pub(crate) struct Known {
    pub(crate) contact_ohm_m: Vec<f64>,
    pub(crate) sigma0: Option<Vec<f64>>,
}

#[pymethods]
impl Mesh {
    #[new]
    #[pyo3(signature = (nodes, triangles, electrodes, *, region=None))]
    fn new(
        nodes: &Bound<'_, PyAny>,
        triangles: &Bound<'_, PyAny>,
        electrodes: &Bound<'_, PyAny>,
        region: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let points = Expected {
            name: "nodes",
            about: "floats of shape (nodes, 2), positions in m",
        };
        let nodes = pairs(points, &points.floats(nodes, &[2])?)?;
        let corners = Expected {
            name: "triangles",
            about: "integers of shape (triangles, 3), the nodes of each counted from 0, counter-clockwise",
        };
        let given = corners.indices(triangles, &[2])?;
        if given.shape[1] != 3 {
            return Err(corners.shape_error(&given.shape));
        }
        let triangles = given
            .values
            .chunks_exact(3)
            .map(|t| [t[0], t[1], t[2]])
            .collect();
        let edges = electrode_edges(electrodes)?;
        let listed = Expected {
            name: "region",
            about: "integers of shape (n,), triangles counted from 0, each once",
        };
        let region = region
            .map(|region| listed.indices(region, &[1]))
            .transpose()?
            .map(|region| region.values);
        let mesh = detached(electrodes.py(), || {
            eit::Mesh::new(nodes, triangles, edges, region)
        })?;
        let mesh = mesh.map_err(|fault| mend(&fault))?;
        Ok(Self {
            mesh: Arc::new(mesh),
            known: None,
        })
    }

    /// The rectangular sheet of the paper, electrodes counter-clockwise from the lower left, the origin in that corner.
    ///
    /// width, height: extents, m. electrodes_per_width, electrodes_per_height: along one side each; 2 (6 + 7) = 26.
    /// electrode: "void", the rim of a square hole, or "edge", a part of the sheet's edge. electrode_size: side of a
    /// void or length on the edge, m. inset: distance of a void's centre from the edge, m. fineness: 0.25 to 8, divides
    /// all edge lengths; 1 gives 9,612 triangles. seeding: another number gives another mesh with the same sizes.
    ///
    /// >>> import tactus_eit
    /// >>> tactus_eit.Mesh.sheet()
    /// <Mesh of 9612 triangles, 5161 nodes, 26 electrodes>
    #[staticmethod]
    #[pyo3(signature = (
        *, width=None, height=None, electrodes_per_width=None, electrodes_per_height=None, electrode="void",
        electrode_size=None, inset=None, fineness=None, seeding=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn sheet(
        py: Python<'_>,
        width: Option<&Bound<'_, PyAny>>,
        height: Option<&Bound<'_, PyAny>>,
        electrodes_per_width: Option<&Bound<'_, PyAny>>,
        electrodes_per_height: Option<&Bound<'_, PyAny>>,
        electrode: &str,
        electrode_size: Option<&Bound<'_, PyAny>>,
        inset: Option<&Bound<'_, PyAny>>,
        fineness: Option<&Bound<'_, PyAny>>,
        seeding: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let form = Expected {
            name: "electrode",
            about: "\"void\" or \"edge\"",
        };
        let usual = PaperSheet::default();
        let (width_mm, height_mm) = (millimetres("width", width)?, millimetres("height", height)?);
        // the region keeps its share of the sheet's width and height
        let share = |mm: Option<f64>, usual: f64| mm.map_or(1.0, |mm| mm / usual);
        let sheet = PaperSheet {
            electrode: match electrode {
                "void" => SheetElectrode::Void,
                "edge" => SheetElectrode::Edge,
                other => return Err(form.value_error(&format!("it is {other:?}"))),
            },
            region_half_width_mm: usual.region_half_width_mm * share(width_mm, usual.width_mm),
            region_half_height_mm: usual.region_half_height_mm * share(height_mm, usual.height_mm),
            width_mm: width_mm.unwrap_or(usual.width_mm),
            height_mm: height_mm.unwrap_or(usual.height_mm),
            electrodes_per_width: electrodes("electrodes_per_width", electrodes_per_width)?
                .unwrap_or(usual.electrodes_per_width),
            electrodes_per_height: electrodes("electrodes_per_height", electrodes_per_height)?
                .unwrap_or(usual.electrodes_per_height),
            void_mm: millimetres("electrode_size", electrode_size)?.unwrap_or(usual.void_mm),
            inset_mm: millimetres("inset", inset)?.unwrap_or(usual.inset_mm),
            fineness: fine(fineness)?,
            seeding: seeded(seeding)?,
            ..usual
        };
        Self::of_preset(py, Preset::PaperSheet(sheet))
    }

    /// A disc with its centre at the origin, electrodes on arcs of its rim, counter-clockwise.
    ///
    /// radius: m. electrodes: 2 to 256. arc_deg: width of an electrode seen from the centre, degrees. first_deg:
    /// direction of electrode 0, degrees counter-clockwise from +x. fineness: 0.25 to 8, divides all edge lengths.
    /// seeding: another number gives another mesh with the same sizes.
    ///
    /// >>> import tactus_eit
    /// >>> mesh = tactus_eit.Mesh.disc(radius=0.15, electrodes=16, fineness=0.5)
    /// >>> mesh.electrode_centres.shape
    /// (16, 2)
    #[staticmethod]
    #[pyo3(signature = (
        *, radius=None, electrodes=None, arc_deg=None, first_deg=None, fineness=None, seeding=None
    ))]
    fn disc(
        py: Python<'_>,
        radius: Option<&Bound<'_, PyAny>>,
        electrodes: Option<&Bound<'_, PyAny>>,
        arc_deg: Option<&Bound<'_, PyAny>>,
        first_deg: Option<&Bound<'_, PyAny>>,
        fineness: Option<&Bound<'_, PyAny>>,
        seeding: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let usual = DiscTank::default();
        let arc = Expected {
            name: "arc_deg",
            about: "the width of an electrode seen from the centre, degrees",
        };
        let first = Expected {
            name: "first_deg",
            about: "the direction of electrode 0, degrees",
        };
        let tank = DiscTank {
            radius_mm: millimetres("radius", radius)?.unwrap_or(usual.radius_mm),
            electrodes: crate::sizes::electrodes("electrodes", electrodes)?
                .unwrap_or(usual.electrodes),
            arc_deg: arc_deg.map_or(Ok(usual.arc_deg), |given| arc.positive(given))?,
            first_deg: first_deg.map_or(Ok(usual.first_deg), |given| first.number(given))?,
            fineness: fine(fineness)?,
            seeding: seeded(seeding)?,
            ..usual
        };
        Self::of_preset(py, Preset::DiscTank(tank))
    }

    /// The mesh of a case folder, with its contact impedances, unloaded conductance, region and depth.
    #[staticmethod]
    fn from_case(py: Python<'_>, folder: &Bound<'_, PyAny>) -> PyResult<Self> {
        let folder = Expected {
            name: "folder",
            about: "the path of a case folder",
        }
        .path(folder)?;
        let geometry = detached(py, || Geometry::from_case(&folder))?;
        Ok(Self::of(geometry.map_err(|fault| refused(&fault))?))
    }

    /// The mesh of an EIDORS fwd_model of triangles, as ``scipy.io.loadmat(...)["fmdl"]`` returns it; see
    /// ``tactus_eit.eidors``.
    #[staticmethod]
    fn from_eidors<'py>(py: Python<'py>, model: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        py.import("tactus_eit.eidors")?
            .call_method1("mesh", (model,))
    }

    /// Positions of the nodes, m: shape (nodes, 2).
    #[getter]
    fn nodes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        points(py, self.mesh.nodes())
    }

    /// Nodes of each triangle, counter-clockwise: shape (triangles, 3).
    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        let corners = self.mesh.triangles().iter().flatten();
        let values = corners.map(|node| *node as i64).collect();
        rows(py, values, [self.mesh.triangles().len(), 3])
    }

    /// Boundary edges of each electrode: a list of arrays of shape (edges, 2).
    #[getter]
    fn electrodes<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyArray2<i64>>>> {
        let each = self.mesh.electrode_edges().iter();
        each.map(|edges| {
            let values = edges.iter().flatten().map(|node| *node as i64).collect();
            rows(py, values, [edges.len(), 2])
        })
        .collect()
    }

    /// Triangles that maps show, in the order of a map's values: shape (region,).
    #[getter]
    fn region<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        PyArray1::from_vec(py, self.mesh.region().iter().map(|t| *t as i64).collect())
    }

    /// Centroid of each triangle, m: shape (triangles, 2).
    #[getter]
    fn centroids<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let each = 0..self.mesh.triangles().len();
        points(py, &each.map(|t| self.mesh.centroid(t)).collect::<Vec<_>>())
    }

    /// Area of each triangle, m2: shape (triangles,).
    #[getter]
    fn areas<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let each = 0..self.mesh.triangles().len();
        PyArray1::from_vec(py, each.map(|t| self.mesh.area(t)).collect())
    }

    /// Centre of each electrode, m: shape (electrodes, 2).
    #[getter]
    fn electrode_centres<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        points(py, &self.mesh.electrode_centres())
    }

    /// Length of the contact of each electrode, m: shape (electrodes,).
    #[getter]
    fn electrode_lengths<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let each = 0..self.mesh.electrodes();
        PyArray1::from_vec(py, each.map(|e| self.mesh.electrode_length(e)).collect())
    }

    /// Contact impedance of each electrode, ohm m: shape (electrodes,); None for a mesh from arrays.
    #[getter]
    fn contact<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        let known = self.known.as_ref()?;
        Some(PyArray1::from_slice(py, &known.contact_ohm_m))
    }

    /// Conductance of each triangle without a load, S per square: shape (triangles,); None if it is not stated.
    #[getter]
    fn sigma0<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        let known = self.known.as_ref()?;
        Some(PyArray1::from_slice(py, known.sigma0.as_ref()?))
    }

    /// SHA-256 of the geometry, hexadecimal: the same as in session files and models.
    #[getter]
    fn hash(&self) -> String {
        self.mesh.hash().to_owned()
    }

    fn __repr__(&self) -> String {
        format!(
            "<Mesh of {} triangles, {} nodes, {} electrodes>",
            self.mesh.triangles().len(),
            self.mesh.nodes().len(),
            self.mesh.electrodes()
        )
    }
}

impl Mesh {
    fn of_preset(py: Python<'_>, preset: Preset) -> PyResult<Self> {
        let geometry = detached(py, || Geometry::from_preset(&preset))?;
        Ok(Self::of(geometry.map_err(|fault| refused(&fault))?))
    }

    fn of(geometry: Geometry) -> Self {
        let known = Known {
            contact_ohm_m: geometry.contact_ohm_m,
            sigma0: geometry.sigma0_known.then_some(geometry.sigma0),
        };
        Self {
            mesh: geometry.mesh,
            known: Some(known),
        }
    }
}

/// The edges of each electrode, from a sequence of arrays.
fn electrode_edges(given: &Bound<'_, PyAny>) -> PyResult<Vec<Vec<[usize; 2]>>> {
    let expected = Expected {
        name: "electrodes",
        about: "a list with integers of shape (edges, 2) for each electrode, the two nodes of every boundary edge it touches",
    };
    let each = given
        .try_iter()
        .map_err(|_| expected.type_error("it is no list"))?;
    each.map(|edges| {
        let edges = expected.indices(&edges?, &[1, 2])?;
        match edges.shape[..] {
            [0] => Ok(Vec::new()),
            _ => pairs(expected, &edges),
        }
    })
    .collect()
}

fn points<'py>(py: Python<'py>, points: &[[f64; 2]]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    rows(
        py,
        points.iter().flatten().copied().collect(),
        [points.len(), 2],
    )
}

/// The Python error for a fault of a mesh, with advice how to correct it.
fn mend(fault: &MeshError) -> PyErr {
    let hint = match fault {
        MeshError::Inverted { .. } => {
            "; turn those triangles round: triangles[turned] = triangles[turned][:, ::-1]"
        }
        MeshError::NoSuchNode { .. } => {
            "; nodes are counted from 0: subtract 1 from indices of MATLAB"
        }
        MeshError::UnusedNode { .. } => {
            ": used, triangles = numpy.unique(triangles, return_inverse=True)"
        }
        MeshError::NoEdge { .. } | MeshError::NotBoundary { .. } => {
            "; give the two nodes of each edge of the outline that the electrode touches"
        }
        _ => "",
    };
    pyo3::exceptions::PyValueError::new_err(format!("{fault}{hint}"))
}

/// Conductances as rows, and the number of rows; a number is the conductance of a uniform sheet.
pub(crate) fn conductances(
    given: &Bound<'_, PyAny>,
    name: &str,
    triangles: usize,
    dimensions: &[usize],
) -> PyResult<(Values<f64>, usize)> {
    let several = if dimensions.contains(&2) {
        format!(", or (rows, {triangles})")
    } else {
        String::new()
    };
    let about = format!(
        "conductances in S per square, 0 or more: a number, or shape ({triangles},), one a triangle{several}"
    );
    let expected = Expected {
        name,
        about: &about,
    };
    let mut values = expected.floats(given, dimensions)?;
    let count = match values.shape[..] {
        [] => {
            values.values = vec![values.values[0]; triangles];
            1
        }
        [length] if length == triangles => 1,
        [count, length] if length == triangles => count,
        _ => return Err(expected.shape_error(&values.shape)),
    };
    match values.values.iter().find(|value| **value < 0.0) {
        Some(negative) => Err(expected.value_error(&format!("a value is {negative}"))),
        None => Ok((values, count)),
    }
}
