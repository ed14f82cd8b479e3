//! Case folders: geometry, protocol and data as plain CSV, the way users bring their own mesh and recordings.
//!
//! A first line with a field that is not a number is a header; a leading column of text is a label; a missing
//! `current_A` is 1 A. SI units, indices from 0. Numbers are written with 17 significant digits.

mod frames;
mod table;
mod text;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use survey::{Dipole, Electrode, Measurement, Protocol, ProtocolError};

use crate::{Mesh, MeshError};
pub use frames::{NamedFrame, frames_text, read_frames, read_named_frames};
pub use table::Table;
use text::line;
pub use text::{digits, matrix_text};

/// A geometry with its contacts, its questions and its named conductances.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// The mesh; its region is `roi.csv`, else every triangle.
    pub mesh: Arc<Mesh>,
    /// Contact impedance of each electrode, ohm m.
    pub contact_ohm_m: Vec<f64>,
    /// The questions in the order of the readings.
    pub protocol: Protocol,
    /// Current of each reading, A.
    pub currents: Vec<f64>,
    /// Conductances by name (`sigma_<name>.csv`), S per square, one a triangle.
    pub sigma: BTreeMap<String, Vec<f64>>,
    /// Whether the folder has a `roi.csv`.
    pub has_region: bool,
}

/// Why a folder is not a case, or a file not what it should be. Lines are counted from 1.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// The file cannot be read or written.
    #[error("{}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        #[source]
        cause: std::io::Error,
    },
    /// A field that should be a number is not.
    #[error("{}:{line}: column {column} is '{text}', which is not a number", .path.display())]
    NotANumber {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// The column, from 1.
        column: usize,
        /// What stands there.
        text: String,
    },
    /// A number that should be an index is not one.
    #[error("{}:{line}: {what} is {value}, which is not an index (0, 1, 2, ...)", .path.display())]
    NotAnIndex {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// Name of the column.
        what: &'static str,
        /// What stands there.
        value: f64,
    },
    /// A line with too few or too many fields.
    #[error("{}:{line}: {has} columns, {wants} are needed", .path.display())]
    Columns {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// What it has.
        has: usize,
        /// What is needed, in words.
        wants: String,
    },
    /// A file with too few or too many lines.
    #[error("{}: {has} rows, {wants} are needed", .path.display())]
    Rows {
        /// The file.
        path: PathBuf,
        /// What it has.
        has: usize,
        /// What is needed, in words.
        wants: String,
    },
    /// An electrode number out of turn.
    #[error("{}:{line}: electrode {has} where electrode {wants} is expected (numbered from 0, in order)", .path.display())]
    ElectrodeOrder {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// What stands there.
        has: usize,
        /// What was expected.
        wants: usize,
    },
    /// An electrode or element that does not exist.
    #[error("{}:{line}: {what} {value} does not exist; there are {count}", .path.display())]
    NoSuch {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// `electrode`, `node` or `element`.
        what: &'static str,
        /// What was named.
        value: usize,
        /// How many there are.
        count: usize,
    },
    /// A conductance that does not exist.
    #[error("no conductance '{name}': it is neither a file nor one of {}", .known.join(", "))]
    NoSigma {
        /// What was asked.
        name: String,
        /// What the case has.
        known: Vec<String>,
    },
    /// The mesh is faulty.
    #[error("{}: the mesh is refused", .path.display())]
    Mesh {
        /// The folder.
        path: PathBuf,
        /// Why.
        #[source]
        cause: MeshError,
    },
    /// The protocol is faulty.
    #[error("{}: the protocol is refused", .path.display())]
    Protocol {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        cause: ProtocolError,
    },
}

impl Case {
    /// Reads a folder: `nodes`, `elems`, `electrode_edges`, `electrodes`, `protocol` and, where present, `roi` and
    /// every `sigma_<name>`, all `.csv`.
    ///
    /// # Errors
    /// The first fault found, naming file and line.
    pub fn read(folder: &Path) -> Result<Self, CaseError> {
        let nodes = Table::read(&folder.join("nodes.csv"))?
            .numbers(2, 2)?
            .into_iter()
            .map(|(_, row)| [row[0], row[1]])
            .collect::<Vec<_>>();
        let table = Table::read(&folder.join("elems.csv"))?;
        let triangles = table
            .numbers(3, 3)?
            .into_iter()
            .map(|(line, row)| {
                Ok([
                    table.below(line, "node", row[0], nodes.len())?,
                    table.below(line, "node", row[1], nodes.len())?,
                    table.below(line, "node", row[2], nodes.len())?,
                ])
            })
            .collect::<Result<Vec<_>, CaseError>>()?;
        let contact_ohm_m = read_electrodes(&folder.join("electrodes.csv"))?;
        let electrode_edges = read_edges(
            &folder.join("electrode_edges.csv"),
            contact_ohm_m.len(),
            nodes.len(),
        )?;
        let region_path = folder.join("roi.csv");
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
            CaseError::Mesh {
                path: folder.to_owned(),
                cause,
            }
        })?;
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

    /// Writes the folder, which is made if need be.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), CaseError> {
        std::fs::create_dir_all(folder).map_err(|cause| CaseError::Io {
            path: folder.to_owned(),
            cause,
        })?;
        let put = |name: &str, text: String| {
            let path = folder.join(name);
            std::fs::write(&path, text).map_err(|cause| CaseError::Io { path, cause })
        };
        let mut text = String::from("x_m,y_m\n");
        for [x, y] in self.mesh.nodes() {
            line(&mut text, &[digits(*x), digits(*y)]);
        }
        put("nodes.csv", text)?;
        let mut text = String::from("n0,n1,n2\n");
        for triangle in self.mesh.triangles() {
            line(&mut text, &triangle.map(|node| node.to_string()));
        }
        put("elems.csv", text)?;
        let mut text = String::from("electrode,node_a,node_b\n");
        for (electrode, edges) in self.mesh.electrode_edges().iter().enumerate() {
            for [a, b] in edges {
                line(
                    &mut text,
                    &[electrode, *a, *b].map(|value| value.to_string()),
                );
            }
        }
        put("electrode_edges.csv", text)?;
        let mut text = String::from("electrode,z_contact_ohm_m,length_m,centre_x_m,centre_y_m\n");
        for (electrode, (z, [x, y])) in self
            .contact_ohm_m
            .iter()
            .zip(self.mesh.electrode_centres())
            .enumerate()
        {
            let length = self.mesh.electrode_length(electrode);
            line(
                &mut text,
                &[
                    electrode.to_string(),
                    digits(*z),
                    digits(length),
                    digits(x),
                    digits(y),
                ],
            );
        }
        put("electrodes.csv", text)?;
        put(
            "protocol.csv",
            protocol_text(&self.protocol, &self.currents),
        )?;
        if self.has_region {
            let mut text = String::from("element\n");
            for element in self.mesh.region() {
                line(&mut text, &[element.to_string()]);
            }
            put("roi.csv", text)?;
        }
        for (name, sigma) in &self.sigma {
            let mut text = String::from("sigma_S_per_sq\n");
            for value in sigma {
                line(&mut text, &[digits(*value)]);
            }
            put(&format!("sigma_{name}.csv"), text)?;
        }
        Ok(())
    }

    /// A conductance by its name in the folder, else from a file of one value a triangle.
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

    /// Electrodes with so few edges that their resistance is the mesh's rather than theirs: worth a warning.
    pub fn coarse_electrodes(&self) -> Vec<Electrode> {
        self.mesh.quality().coarse_electrodes
    }

    fn read_sigma(&self, path: &Path) -> Result<Vec<f64>, CaseError> {
        let values: Vec<f64> = Table::read(path)?
            .numbers(1, 1)?
            .into_iter()
            .map(|(_, row)| row[0])
            .collect();
        let wants = self.mesh.triangles().len();
        if values.len() != wants {
            return Err(CaseError::Rows {
                path: path.to_owned(),
                has: values.len(),
                wants: format!("{wants} (one an element)"),
            });
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

fn read_electrodes(path: &Path) -> Result<Vec<f64>, CaseError> {
    let table = Table::read(path)?;
    table
        .numbers(2, 5)?
        .into_iter()
        .enumerate()
        .map(|(wants, (line, row))| {
            let has = table.index(line, "electrode", row[0])?;
            if has == wants {
                Ok(row[1])
            } else {
                Err(CaseError::ElectrodeOrder {
                    path: path.to_owned(),
                    line,
                    has,
                    wants,
                })
            }
        })
        .collect()
}

fn read_edges(
    path: &Path,
    electrodes: usize,
    nodes: usize,
) -> Result<Vec<Vec<[usize; 2]>>, CaseError> {
    let table = Table::read(path)?;
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

/// Reads a protocol file and the current of each reading (A; 1 where the column is missing). Without `electrodes` the
/// ring is as large as the largest number named.
///
/// # Errors
/// A fault in the file, naming its line, or a protocol that is refused.
pub fn read_protocol(
    path: &Path,
    electrodes: Option<usize>,
) -> Result<(Protocol, Vec<f64>), CaseError> {
    let table = Table::read(path)?;
    let mut measurements = Vec::new();
    let mut currents = Vec::new();
    let mut largest = 0;
    for (line, row) in table.numbers(5, 6)? {
        let electrode = |column: usize, what| {
            match electrodes {
                Some(count) => table.below(line, "electrode", row[column], count),
                None => table.index(line, what, row[column]),
            }
            .map(Electrode)
        };
        let question = Measurement {
            drive: Dipole {
                plus: electrode(1, "source")?,
                minus: electrode(2, "sink")?,
            },
            sense: Dipole {
                plus: electrode(3, "v_plus")?,
                minus: electrode(4, "v_minus")?,
            },
        };
        for dipole in [question.drive, question.sense] {
            largest = largest.max(dipole.plus.0).max(dipole.minus.0);
        }
        measurements.push(question);
        currents.push(row.get(5).copied().unwrap_or(1.0));
    }
    Protocol::new(electrodes.unwrap_or(largest + 1), measurements)
        .map(|protocol| (protocol, currents))
        .map_err(|cause| CaseError::Protocol {
            path: path.to_owned(),
            cause,
        })
}

/// A protocol as the text of its file.
pub fn protocol_text(protocol: &Protocol, currents: &[f64]) -> String {
    let mut text = String::from("meas,source,sink,v_plus,v_minus,current_A\n");
    for (meas, (question, current)) in protocol.measurements().iter().zip(currents).enumerate() {
        let Measurement { drive, sense } = question;
        let _ = writeln!(
            text,
            "{meas},{},{},{},{},{}",
            drive.plus.0,
            drive.minus.0,
            sense.plus.0,
            sense.minus.0,
            digits(*current)
        );
    }
    text
}
