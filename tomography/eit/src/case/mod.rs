//! Case folders: geometry, protocol and data as plain CSV, for users' own meshes and recordings.
//!
//! A first line with a field that is not a number is a header; a leading column of text is a label; a missing
//! `current_A` is 1 A. SI units, indices from 0. Numbers are written with 17 significant digits.

mod error;
mod foreign;
mod frames;
mod protocol;
mod table;
mod text;
mod write;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use survey::{Electrode, Protocol};

use crate::mesh::bounding_box;
use crate::{Depth, Mesh, MeshError};
pub use error::CaseError;
pub use frames::{NamedFrame, frames_text, read_frames, read_named_frames};
pub use protocol::{protocol_text, read_protocol};
pub use table::Table;
pub use text::{digits, matrix_text};

/// File of a tank's depth.
const DEPTH: &str = "depth.csv";

/// Conductance assumed where a case folder gives none, S per square.
const ASSUMED_CONDUCTANCE: f64 = 1e-3;

/// Largest extent of a sheet or tank, m. Meshes in mm are larger.
const LARGEST_M: f64 = 20.0;

/// A geometry with its contacts, its protocol and its named conductances.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// The mesh; its region is `roi.csv`, else every triangle.
    pub mesh: Arc<Mesh>,
    /// Contact impedance of each electrode, ohm m.
    pub contact_ohm_m: Vec<f64>,
    /// The measurements in the order of the readings.
    pub protocol: Protocol,
    /// Current of each reading, A.
    pub currents: Vec<f64>,
    /// Conductances by name (`sigma_<name>.csv`), S per square, one per triangle.
    pub sigma: BTreeMap<String, Vec<f64>>,
    /// Whether the folder has a `roi.csv`.
    pub has_region: bool,
}

impl Case {
    /// Reads a folder: `nodes`, `elems`, `electrode_edges`, `electrodes`, `protocol` and, where present, `roi`, `depth`
    /// and every `sigma_<name>`, all `.csv`.
    ///
    /// # Errors
    /// The first fault found, naming file and line.
    pub fn read(folder: &Path) -> Result<Self, CaseError> {
        let file = |name: &str| folder.join(name);
        let node_table = Table::read(&file("nodes.csv"))?;
        let nodes = node_table
            .in_units(&["x_m", "y_m"])?
            .numbers(2, 2)?
            .into_iter()
            .map(|(_, row)| [row[0], row[1]])
            .collect::<Vec<_>>();
        check_size(&file("nodes.csv"), &nodes)?;
        let element_table = Table::read(&file("elems.csv"))?;
        let triangles = element_table
            .numbers(3, 3)?
            .into_iter()
            .map(|(line, row)| {
                let node = |k: usize| element_table.below(line, "node", row[k], nodes.len());
                Ok([node(0)?, node(1)?, node(2)?])
            })
            .collect::<Result<Vec<_>, CaseError>>()?;
        let (electrode_table, contact_ohm_m) = read_electrodes(&file("electrodes.csv"))?;
        let edge_table = Table::read(&file("electrode_edges.csv"))?;
        let electrode_edges = read_edges(&edge_table, contact_ohm_m.len(), nodes.len())?;
        let region_path = file("roi.csv");
        let has_region = region_path.exists();
        let region = has_region
            .then(|| {
                let table = Table::read(&region_path)?;
                table
                    .numbers(1, 1)?
                    .into_iter()
                    .map(|(line, row)| table.below(line, "element", row[0], triangles.len()))
                    .collect::<Result<Vec<_>, CaseError>>()
            })
            .transpose()?;
        let mesh = Mesh::new(nodes, triangles, electrode_edges, region).map_err(|cause| {
            let (name, line) = match &cause {
                MeshError::NotFinite { node } | MeshError::UnusedNode { node } => {
                    ("nodes.csv", node_table.lines.get(*node))
                }
                MeshError::NoSuchNode { element, .. }
                | MeshError::Inverted { element, .. }
                | MeshError::NoArea { element, .. }
                | MeshError::Overlap { element, .. }
                | MeshError::Disconnected { element } => {
                    ("elems.csv", element_table.lines.get(*element))
                }
                MeshError::NoEdge { electrode } => {
                    ("electrodes.csv", electrode_table.lines.get(electrode.0))
                }
                MeshError::NotBoundary {
                    electrode,
                    from,
                    to,
                }
                | MeshError::EdgeTwice {
                    electrode,
                    from,
                    to,
                } => (
                    "electrode_edges.csv",
                    edge_line(&edge_table, *electrode, &[*from, *to]),
                ),
                MeshError::ElectrodesMeet { second, node, .. } => (
                    "electrode_edges.csv",
                    edge_line(&edge_table, *second, &[*node]),
                ),
                MeshError::Region { .. } => ("roi.csv", None),
                MeshError::Empty | MeshError::Preset { .. } | MeshError::Depth { .. } => {
                    ("elems.csv", None)
                }
            };
            CaseError::Mesh {
                path: file(name),
                line: line.copied(),
                cause,
            }
        })?;
        let mesh = mesh.with_depth(read_depth(&file(DEPTH))?);
        let (protocol, currents) =
            read_protocol(&folder.join("protocol.csv"), Some(contact_ohm_m.len()))?;
        let mut case = Self {
            mesh: Arc::new(mesh),
            contact_ohm_m,
            protocol,
            currents,
            sigma: BTreeMap::new(),
            has_region,
        };
        for (name, path) in sigma_files(folder)? {
            let sigma = case.read_sigma(&path)?;
            case.sigma.insert(name, sigma);
        }
        Ok(case)
    }

    /// The conductance with this name in the folder, otherwise read from a file with one value per triangle.
    ///
    /// # Errors
    /// Neither a name nor a readable file, or the wrong number of values.
    pub fn sigma(&self, name_or_file: &str) -> Result<Vec<f64>, CaseError> {
        if let Some(sigma) = self.sigma.get(name_or_file) {
            return Ok(sigma.clone());
        }
        let path = Path::new(name_or_file);
        if path.is_file() {
            return self.read_sigma(path);
        }
        Err(CaseError::NoSigma {
            name: name_or_file.to_owned(),
            known: self.sigma.keys().cloned().collect(),
        })
    }

    /// The unloaded conductance of each triangle, S per square: `homog` if the case has it, otherwise 1 mS throughout.
    pub fn unloaded_conductance(&self) -> Vec<f64> {
        self.sigma
            .get("homog")
            .cloned()
            .unwrap_or_else(|| vec![ASSUMED_CONDUCTANCE; self.mesh.triangles().len()])
    }

    /// Conductances from a file with a row each and a column per triangle, with the line number of each.
    ///
    /// # Errors
    /// A file that cannot be read, the wrong number of columns, or an invalid conductance; the line is named.
    pub fn sigma_rows(&self, path: &Path) -> Result<Vec<(usize, Vec<f64>)>, CaseError> {
        let wants = self.mesh.triangles().len();
        let rows = Table::read(path)?.numbers(wants, wants)?;
        for (line, row) in &rows {
            if let Some(&value) = row.iter().find(|value| **value < 0.0) {
                return Err(negative(path, *line, value));
            }
        }
        Ok(rows)
    }

    /// Electrodes with so few edges that their resistance depends on the mesh: callers warn of them.
    pub fn coarse_electrodes(&self) -> Vec<Electrode> {
        self.mesh.quality().coarse_electrodes
    }

    fn read_sigma(&self, path: &Path) -> Result<Vec<f64>, CaseError> {
        let rows = Table::read(path)?.numbers(1, 1)?;
        if let Some((line, row)) = rows.iter().find(|(_, row)| row[0] < 0.0) {
            return Err(negative(path, *line, row[0]));
        }
        let values: Vec<f64> = rows.into_iter().map(|(_, row)| row[0]).collect();
        let wants = self.mesh.triangles().len();
        if values.len() != wants {
            let has = values.len();
            let fault = format!("{has} rows, {wants} (one an element) are needed");
            return Err(CaseError::refused(path, None, fault));
        }
        Ok(values)
    }
}

fn sigma_files(folder: &Path) -> Result<BTreeMap<String, PathBuf>, CaseError> {
    let fault = |cause| CaseError::Io {
        path: folder.to_owned(),
        cause,
    };
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(fault)? {
        let path = entry.map_err(fault)?.path();
        let name = path
            .file_name()
            .and_then(|name| name.to_str())
            .and_then(|name| name.strip_prefix("sigma_")?.strip_suffix(".csv"))
            .map(str::to_owned);
        if let Some(name) = name {
            files.insert(name, path);
        }
    }
    Ok(files)
}

/// The depth of the tank; `None` without the file.
fn read_depth(path: &Path) -> Result<Option<Depth>, CaseError> {
    if !path.exists() {
        return Ok(None);
    }
    let columns = [
        "depth_m",
        "electrode_height_m",
        "electrode_centre_m",
        "modes",
        "target_height_m",
    ];
    let rows = Table::read(path)?.in_units(&columns)?.numbers(4, 5)?;
    let [(line, row)] = &rows[..] else {
        let fault = format!("{} rows, 1 are needed", rows.len());
        return Err(CaseError::refused(path, None, fault));
    };
    // without the fifth, a change reaches from the bottom to the surface
    let target = row.get(4).copied().unwrap_or(row[0]);
    Depth::of_numbers([row[0], row[1], row[2], row[3], target])
        .map(Some)
        .map_err(|cause| CaseError::Mesh {
            path: path.to_owned(),
            line: Some(*line),
            cause,
        })
}

fn read_electrodes(path: &Path) -> Result<(Table, Vec<f64>), CaseError> {
    let table = Table::read(path)?;
    let contacts = table
        .numbers(2, 5)?
        .into_iter()
        .enumerate()
        .map(|(wants, (line, row))| {
            let has = table.index(line, "electrode", row[0])?;
            let fault = if has != wants {
                format!("electrode {has} where electrode {wants} is expected (numbered from 0, in order)")
            } else if row[1] < 0.0 {
                format!("contact impedance {} ohm m is negative", row[1])
            } else {
                return Ok(row[1]);
            };
            Err(table.refused(line, fault))
        })
        .collect::<Result<_, _>>()?;
    Ok((table, contacts))
}

fn read_edges(
    table: &Table,
    electrodes: usize,
    nodes: usize,
) -> Result<Vec<Vec<[usize; 2]>>, CaseError> {
    let mut edges = vec![Vec::new(); electrodes];
    for (line, row) in table.numbers(3, 3)? {
        let electrode = table.below(line, "electrode", row[0], electrodes)?;
        edges[electrode].push([
            table.below(line, "node", row[1], nodes)?,
            table.below(line, "node", row[2], nodes)?,
        ]);
    }
    Ok(edges)
}

/// Refuses a sheet that only values in another unit can describe.
fn check_size(path: &Path, nodes: &[[f64; 2]]) -> Result<(), CaseError> {
    let [low, high] = bounding_box(nodes.iter().copied());
    let [width, height] = [high[0] - low[0], high[1] - low[1]];
    if width.max(height) <= LARGEST_M {
        return Ok(());
    }
    let fault = format!(
        "the sheet is {width:.0} m x {height:.0} m, and at most {LARGEST_M} m are possible. If the values are in mm, it is \
         {width:.0} mm x {height:.0} mm: divide them by 1000, x_m and y_m are in m"
    );
    Err(CaseError::refused(path, None, fault))
}

/// The error of a conductance below zero.
fn negative(path: &Path, line: usize, value: f64) -> CaseError {
    CaseError::refused(path, line, format!("conductance {value} S is negative"))
}

/// The last line with an edge of this electrode that has all these nodes.
fn edge_line<'t>(table: &'t Table, electrode: Electrode, nodes: &[usize]) -> Option<&'t usize> {
    let is = |field: Option<f64>, index: usize| field == Some(index as f64);
    let found = table.rows.iter().rposition(|row| {
        is(row[0], electrode.0)
            && nodes
                .iter()
                .all(|&node| is(row[1], node) || is(row[2], node))
    });
    found.and_then(|row| table.lines.get(row))
}
