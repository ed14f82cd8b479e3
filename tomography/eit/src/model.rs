//! Model files: trained weights, and all that is needed to use them, in one file.
//!
//! A file is `safetensors` with one metadata entry, `tactus`: JSON that says kind, geometry hash, survey hash,
//! normalisation, training and build. Mesh and protocol are tensors beside the weights, so the file alone makes maps.
//! The same model has the same bytes.

use std::borrow::Cow;
use std::collections::HashMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use safetensors::tensor::{Dtype, SafeTensors, TensorView, View};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use survey::{Dipole, Electrode, Measurement, Protocol};

use crate::{Mesh, RbfNetwork, RbfReconstructor, Reconstructor, TrainingReport, TrainingSettings};

const KEY: &str = "tactus";
const VERSION: u32 = 1;

/// What kind of network a file holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Radial basis functions ([`RbfNetwork`]).
    Rbf,
}

/// What a file says about itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metadata {
    /// Version of the layout, 1.
    pub version: u32,
    /// Kind of network.
    pub kind: Kind,
    /// A short name: `rbf paper`.
    pub name: String,
    /// [`Mesh::hash`] of the geometry it was trained on.
    pub geometry: String,
    /// [`Protocol::hash`] of the survey it was trained on.
    pub survey: String,
    /// Number of electrodes.
    pub electrodes: usize,
    /// Number of readings.
    pub readings: usize,
    /// How readings become inputs and outputs become a map, in words.
    pub normalisation: String,
    /// Settings of the training, its seed among them.
    pub training: TrainingSettings,
    /// What the training found.
    pub report: TrainingReport,
    /// The build that trained it.
    pub build: String,
}

const NORMALISATION: &str =
    "input (v - v0) / max|v0| (Eq. 6); output dsigma / sigma0 a triangle of the region (Eq. 7)";

/// A model with its geometry and survey.
#[derive(Debug, Clone)]
pub struct Model {
    metadata: Metadata,
    mesh: Arc<Mesh>,
    protocol: Protocol,
    network: RbfNetwork,
    hash: String,
}

/// Why a model cannot be read, written or used.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The file cannot be read or written.
    #[error("model file {} cannot be accessed", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        #[source]
        cause: std::io::Error,
    },
    /// The file ends before its content does.
    #[error("model file {} is truncated: copy it again", .path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
    },
    /// The file is something else.
    #[error("{} is not a model file of Tactus: {why}", .path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What gives it away.
        why: String,
    },
    /// A model of a kind or version that this build does not know.
    #[error("model file {} holds {holds}, this build knows rbf of version {VERSION}: use a newer build", .path.display())]
    Kind {
        /// The file.
        path: PathBuf,
        /// Kind and version it names.
        holds: String,
    },
    /// A model whose content does not fit together.
    #[error("model file {} is damaged: {why}", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What does not fit.
        why: String,
    },
    /// Made for other questions.
    #[error(
        "the model was made for survey {model} ({model_readings} readings), this is survey {here} ({here_readings} readings)"
    )]
    Survey {
        /// Hash in the model.
        model: String,
        /// Its readings.
        model_readings: usize,
        /// Hash here.
        here: String,
        /// Readings here.
        here_readings: usize,
    },
    /// Made for another sheet.
    #[error("the model was made for geometry {model}, this is geometry {here}")]
    Geometry {
        /// Hash in the model.
        model: String,
        /// Hash here.
        here: String,
    },
    /// The network does not fit the mesh or the protocol, or has numbers that are not finite.
    #[error("the network does not fit its geometry and survey: {0}")]
    Network(String),
}

impl Model {
    /// Joins a trained network with its geometry, survey and history.
    ///
    /// # Errors
    /// A network that does not fit them.
    pub fn rbf(
        name: &str,
        mesh: Arc<Mesh>,
        protocol: &Protocol,
        network: RbfNetwork,
        training: TrainingSettings,
        report: TrainingReport,
    ) -> Result<Self, ModelError> {
        fits(&network, &mesh, protocol).map_err(ModelError::Network)?;
        let metadata = Metadata {
            version: VERSION,
            kind: Kind::Rbf,
            name: name.to_owned(),
            geometry: mesh.hash().to_owned(),
            survey: protocol.hash(),
            electrodes: protocol.electrodes(),
            readings: protocol.len(),
            normalisation: NORMALISATION.to_owned(),
            training,
            report,
            build: concat!("eit ", env!("CARGO_PKG_VERSION")).to_owned(),
        };
        let mut model = Self {
            metadata,
            mesh,
            protocol: protocol.clone(),
            network,
            hash: String::new(),
        };
        model.hash = fingerprint(&model.bytes()?);
        Ok(model)
    }

    /// What the file says about itself.
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// SHA-256 of the file, hex.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// The geometry it was trained on.
    pub fn mesh(&self) -> &Arc<Mesh> {
        &self.mesh
    }

    /// The survey it was trained on.
    pub fn protocol(&self) -> &Protocol {
        &self.protocol
    }

    /// The network.
    pub fn network(&self) -> &RbfNetwork {
        &self.network
    }

    /// Refuses another survey or geometry, naming both.
    ///
    /// # Errors
    /// [`ModelError::Survey`], [`ModelError::Geometry`].
    pub fn check(&self, protocol: &Protocol, mesh: &Mesh) -> Result<(), ModelError> {
        if &self.protocol != protocol {
            return Err(ModelError::Survey {
                model: self.metadata.survey.clone(),
                model_readings: self.protocol.len(),
                here: protocol.hash(),
                here_readings: protocol.len(),
            });
        }
        if self.mesh.hash() != mesh.hash() {
            return Err(ModelError::Geometry {
                model: self.metadata.geometry.clone(),
                here: mesh.hash().to_owned(),
            });
        }
        Ok(())
    }

    /// Ready to make maps.
    pub fn into_reconstructor(self) -> Box<dyn Reconstructor> {
        Box::new(RbfReconstructor::new(
            self.network,
            self.mesh,
            self.protocol,
            self.metadata.name,
        ))
    }

    /// The file's content.
    fn bytes(&self) -> Result<Vec<u8>, ModelError> {
        let unfit = |why: String| ModelError::Network(why);
        let mesh = &self.mesh;
        let network = &self.network;
        let neurons = network.neurons();
        let rank = network.mixing.len() / neurons;
        let edges: Vec<usize> = mesh
            .electrode_edges()
            .iter()
            .enumerate()
            .flat_map(|(electrode, edges)| edges.iter().flat_map(move |[a, b]| [electrode, *a, *b]))
            .collect();
        let questions: Vec<usize> = self
            .protocol
            .measurements()
            .iter()
            .flat_map(|q| [q.drive.plus, q.drive.minus, q.sense.plus, q.sense.minus])
            .map(|electrode| electrode.0)
            .collect();
        let nodes: Vec<f64> = mesh.nodes().iter().flatten().copied().collect();
        let triangles: Vec<usize> = mesh.triangles().iter().flatten().copied().collect();
        let tensors = [
            ("nodes", Tensor::f64(&nodes, &[mesh.nodes().len(), 2])),
            (
                "triangles",
                Tensor::u32(&triangles, &[mesh.triangles().len(), 3]),
            ),
            (
                "electrode_edges",
                Tensor::u32(&edges, &[edges.len() / 3, 3]),
            ),
            ("region", Tensor::u32(mesh.region(), &[mesh.region().len()])),
            (
                "protocol",
                Tensor::u32(&questions, &[self.protocol.len(), 4]),
            ),
            (
                "centres",
                Tensor::f32(&network.centres, &[neurons, network.inputs]),
            ),
            ("spread", Tensor::f64(&[network.spread], &[1])),
            ("mixing", Tensor::f64(&network.mixing, &[rank, neurons])),
            (
                "weights",
                Tensor::f32(&network.weights, &[rank, network.outputs]),
            ),
        ];
        let metadata =
            serde_json::to_string(&self.metadata).map_err(|fault| unfit(fault.to_string()))?;
        // one entry only: a map with more would be written in a random order
        let metadata = HashMap::from([(KEY.to_owned(), metadata)]);
        safetensors::serialize(tensors, Some(metadata)).map_err(|fault| unfit(fault.to_string()))
    }
}

/// Writes a model; a file that is there is replaced whole or not at all.
///
/// # Errors
/// [`ModelError::Io`].
pub fn save(path: &Path, model: &Model) -> Result<(), ModelError> {
    let failed = |cause| ModelError::Io {
        path: path.to_owned(),
        cause,
    };
    let beside = path.with_extension("safetensors.part");
    std::fs::write(&beside, model.bytes()?).map_err(failed)?;
    std::fs::rename(&beside, path).map_err(failed)
}

/// Reads a model and checks that its content fits together.
///
/// # Errors
/// See [`ModelError`].
pub fn load(path: &Path) -> Result<Model, ModelError> {
    let failed = |cause| ModelError::Io {
        path: path.to_owned(),
        cause,
    };
    let file = File::open(path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    if length == 0 {
        return Err(ModelError::Truncated {
            path: path.to_owned(),
        });
    }
    // SAFETY: the mapping is private to this function and read once into owned values; `save` replaces files by a
    // rename, so a file that is mapped is not written to by this house.
    #[allow(unsafe_code)]
    let bytes = unsafe { memmap2::Mmap::map(&file) }.map_err(failed)?;
    parse(path, &bytes)
}

/// A reconstructor from a model file.
///
/// # Errors
/// As [`load`].
pub fn load_reconstructor(path: &Path) -> Result<Box<dyn Reconstructor>, ModelError> {
    Ok(load(path)?.into_reconstructor())
}

fn parse(path: &Path, bytes: &[u8]) -> Result<Model, ModelError> {
    let foreign = |why: &str| ModelError::Foreign {
        path: path.to_owned(),
        why: why.to_owned(),
    };
    let truncated = || ModelError::Truncated {
        path: path.to_owned(),
    };
    let header = bytes.first_chunk::<8>().ok_or_else(truncated)?;
    let header = u64::from_le_bytes(*header);
    if bytes.len() > 8 && bytes[8] != b'{' || header > 100_000_000 {
        return Err(foreign("it has no safetensors header"));
    }
    if header + 8 > bytes.len() as u64 {
        return Err(truncated());
    }
    let (_, info) = SafeTensors::read_metadata(bytes).map_err(|fault| {
        match promised(&bytes[8..8 + header as usize]) {
            Some(length) if 8 + header + length > bytes.len() as u64 => truncated(),
            _ => foreign(&fault.to_string()),
        }
    })?;
    let text = info
        .metadata()
        .as_ref()
        .and_then(|entries| entries.get(KEY))
        .ok_or_else(|| foreign("it is safetensors without a 'tactus' entry"))?;
    let said: serde_json::Value =
        serde_json::from_str(text).map_err(|_| foreign("its 'tactus' entry is not JSON"))?;
    let (kind, version) = (&said["kind"], &said["version"]);
    if kind != "rbf" || version != VERSION {
        return Err(ModelError::Kind {
            path: path.to_owned(),
            holds: format!("kind {kind} of version {version}"),
        });
    }
    let damaged = |why: String| ModelError::Damaged {
        path: path.to_owned(),
        why,
    };
    let metadata: Metadata =
        serde_json::from_value(said).map_err(|fault| damaged(fault.to_string()))?;
    let tensors = SafeTensors::deserialize(bytes).map_err(|fault| damaged(fault.to_string()))?;
    let tensor = |name: &str, kind, width| {
        let found = tensors
            .tensor(name)
            .map_err(|fault| damaged(format!("tensor '{name}': {fault}")))?;
        let wide = found.shape().get(1).copied().unwrap_or(1);
        if found.dtype() != kind || width != 0 && wide != width {
            return Err(damaged(format!(
                "tensor '{name}' is {:?} of shape {:?}",
                found.dtype(),
                found.shape()
            )));
        }
        Ok(found)
    };
    let index = |name, width| Ok::<_, ModelError>(indices(&tensor(name, Dtype::U32, width)?));
    let mut edges = vec![Vec::new(); metadata.electrodes];
    for edge in index("electrode_edges", 3)?.chunks(3) {
        edges
            .get_mut(edge[0])
            .ok_or_else(|| damaged(format!("an edge of electrode {}", edge[0])))?
            .push([edge[1], edge[2]]);
    }
    let nodes = f64s(&tensor("nodes", Dtype::F64, 2)?);
    let mesh = Mesh::new(
        nodes.chunks(2).map(|p| [p[0], p[1]]).collect(),
        index("triangles", 3)?
            .chunks(3)
            .map(|t| [t[0], t[1], t[2]])
            .collect(),
        edges,
        Some(index("region", 1)?),
    )
    .map_err(|fault| damaged(fault.to_string()))?;
    let questions = index("protocol", 4)?
        .chunks(4)
        .map(|q| {
            let dipole = |plus, minus| Dipole {
                plus: Electrode(plus),
                minus: Electrode(minus),
            };
            Measurement {
                drive: dipole(q[0], q[1]),
                sense: dipole(q[2], q[3]),
            }
        })
        .collect();
    let protocol = Protocol::new(metadata.electrodes, questions)
        .map_err(|fault| damaged(fault.to_string()))?;
    for (what, said, found) in [
        ("geometry", &metadata.geometry, mesh.hash().to_owned()),
        ("survey", &metadata.survey, protocol.hash()),
    ] {
        if *said != found {
            return Err(damaged(format!("it says {what} {said} and holds {found}")));
        }
    }
    let centres = tensor("centres", Dtype::F32, protocol.len())?;
    let neurons = centres.shape()[0];
    let network = RbfNetwork {
        inputs: protocol.len(),
        outputs: mesh.region().len(),
        spread: f64s(&tensor("spread", Dtype::F64, 1)?)
            .first()
            .copied()
            .ok_or_else(|| damaged("tensor 'spread' is empty".to_owned()))?,
        centres: f32s(&centres),
        mixing: f64s(&tensor("mixing", Dtype::F64, neurons)?),
        weights: f32s(&tensor("weights", Dtype::F32, mesh.region().len())?),
    };
    fits(&network, &mesh, &protocol).map_err(damaged)?;
    Ok(Model {
        metadata,
        mesh: Arc::new(mesh),
        protocol,
        network,
        hash: fingerprint(bytes),
    })
}

/// How many bytes of tensors a safetensors header promises.
fn promised(header: &[u8]) -> Option<u64> {
    let header: serde_json::Value = serde_json::from_slice(header).ok()?;
    header
        .as_object()?
        .values()
        .filter_map(|tensor| tensor["data_offsets"][1].as_u64())
        .max()
}

/// Whether the network takes the protocol's readings, gives the region's triangles, and is finite.
fn fits(network: &RbfNetwork, mesh: &Mesh, protocol: &Protocol) -> Result<(), String> {
    let (inputs, outputs) = (network.inputs(), network.outputs());
    if inputs != protocol.len() || outputs != mesh.region().len() {
        return Err(format!(
            "it takes {inputs} readings and gives {outputs} triangles, there are {} and {}",
            protocol.len(),
            mesh.region().len()
        ));
    }
    let neurons = network.neurons();
    if neurons == 0
        || network.mixing.is_empty()
        || network.mixing.len() / neurons != network.weights.len() / outputs
    {
        return Err("its mixing and weights have different ranks".to_owned());
    }
    if network.is_finite() {
        Ok(())
    } else {
        Err("it has numbers that are not finite".to_owned())
    }
}

/// A tensor about to be written.
struct Tensor {
    kind: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Tensor {
    fn new(kind: Dtype, shape: &[usize], bytes: Vec<u8>) -> Self {
        Self {
            kind,
            shape: shape.to_vec(),
            bytes,
        }
    }

    fn f64(values: &[f64], shape: &[usize]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        Self::new(Dtype::F64, shape, bytes.collect())
    }

    fn f32(values: &[f32], shape: &[usize]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        Self::new(Dtype::F32, shape, bytes.collect())
    }

    /// Indices of nodes, triangles and electrodes, which are far below 2^32.
    fn u32(values: &[usize], shape: &[usize]) -> Self {
        let bytes = values
            .iter()
            .flat_map(|value| (*value as u32).to_le_bytes());
        Self::new(Dtype::U32, shape, bytes.collect())
    }
}

impl View for Tensor {
    fn dtype(&self) -> Dtype {
        self.kind
    }
    fn shape(&self) -> &[usize] {
        &self.shape
    }
    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.bytes)
    }
    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}

fn f64s(tensor: &TensorView<'_>) -> Vec<f64> {
    let (values, _) = tensor.data().as_chunks::<8>();
    values
        .iter()
        .map(|bytes| f64::from_le_bytes(*bytes))
        .collect()
}

fn f32s(tensor: &TensorView<'_>) -> Vec<f32> {
    let (values, _) = tensor.data().as_chunks::<4>();
    values
        .iter()
        .map(|bytes| f32::from_le_bytes(*bytes))
        .collect()
}

fn indices(tensor: &TensorView<'_>) -> Vec<usize> {
    let (values, _) = tensor.data().as_chunks::<4>();
    values
        .iter()
        .map(|bytes| u32::from_le_bytes(*bytes) as usize)
        .collect()
}

/// SHA-256 of some bytes, hex: how models, and what they are trained from, are told apart.
pub fn fingerprint(bytes: &[u8]) -> String {
    let digest = Sha256::digest(bytes);
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}
