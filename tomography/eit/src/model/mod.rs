//! Model files: a trained network with everything needed to use it, in one file.
//!
//! A file is `safetensors` with one metadata entry, `tactus`: JSON with kind, geometry hash, survey hash,
//! normalisation, training and build. It includes mesh and protocol as tensors, so no other file is needed to make
//! maps. Equal models have equal bytes, and a checksum over metadata and tensors detects flipped bits.

mod file;
mod history;

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use outfile::{Existing, OutFileError};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use survey::Protocol;

use crate::inverse::learned::network::{
    DeepNetwork, DeepReport, FamiliarDeep, TrainingDistribution,
};
use crate::inverse::learned::rbf::FamiliarRbf;
use crate::inverse::learned::trained::{Trained, TrainedReconstructor};
use crate::{Mesh, OwnMisfit, RbfNetwork, Reconstructor};
pub use history::{
    CentresChoice, ChangeChoice, DistancesChoice, Jitter, LossChoice, OpenChoices, PointsChoice,
    SizeChoice, SpreadChoice, TrainingReport, TrainingSettings,
};

const VERSION: u32 = 2;
/// Maximum size of a model file, bytes; the deep network of the paper has 50 MB.
const LARGEST: u64 = 1 << 30;

/// Kind of network in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Radial basis functions ([`RbfNetwork`]).
    Rbf,
    /// Fully connected layers ([`DeepNetwork`]).
    Deep,
}

/// A trained network.
#[derive(Debug, Clone, PartialEq)]
pub enum Network {
    /// Radial basis functions.
    Rbf(RbfNetwork),
    /// Fully connected layers, and the distribution of their training inputs.
    Deep(DeepNetwork, TrainingDistribution),
}

impl Network {
    fn kind(&self) -> Kind {
        match self {
            Self::Rbf(_) => Kind::Rbf,
            Self::Deep(..) => Kind::Deep,
        }
    }

    /// Readings of the input.
    pub fn inputs(&self) -> usize {
        match self {
            Self::Rbf(network) => network.inputs(),
            Self::Deep(network, _) => network.inputs(),
        }
    }

    /// Triangles of the output.
    pub fn outputs(&self) -> usize {
        match self {
            Self::Rbf(network) => network.outputs(),
            Self::Deep(network, _) => network.outputs(),
        }
    }
}

/// Results of a training, by kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Report {
    /// Results of an RBF network's training.
    Rbf(TrainingReport),
    /// Results of a deep network's training.
    Deep(DeepReport),
}

/// Metadata of a model file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metadata {
    /// Version of the layout, 2.
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
    /// Conversion of readings to inputs and of outputs to a map, in words.
    pub normalisation: String,
    /// Settings of the training, including its seed.
    pub training: TrainingSettings,
    /// Results of the training.
    pub report: Report,
    /// Signal-to-noise ratio of the readings over that of the map ([`Reconstructor::noise_figure`]), computed at
    /// training.
    pub noise_figure: Option<f64>,
    /// Misfits of the maps of held-out cases, computed at training; `None` in files made without them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub own_misfit: Option<OwnMisfit>,
    /// The build that trained it.
    pub build: String,
    /// SHA-256, hex, of this JSON with an empty checksum, then name, kind, shape and bytes of every tensor by name.
    pub checksum: String,
}

const NORMALISATION: &str =
    "input (v - v0) / max|v0| (Eq. 6); output dsigma / sigma0 a triangle of the region (Eq. 7)";

/// A model with its geometry and survey.
#[derive(Debug, Clone)]
pub struct Model {
    metadata: Metadata,
    mesh: Arc<Mesh>,
    protocol: Protocol,
    network: Network,
    hash: String,
}

/// Errors in reading, writing and using a model.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The file cannot be read.
    #[error("model file {} cannot be accessed", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        #[source]
        cause: std::io::Error,
    },
    /// The file cannot be written, or exists and must not be replaced.
    #[error(transparent)]
    Unwritten(#[from] OutFileError),
    /// The file is shorter than its content.
    #[error("model file {} is truncated: copy it again", .path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
    },
    /// The file is not a model.
    #[error("{} is not a model file of Tactus: {why}", .path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// How that was detected.
        why: String,
    },
    /// A kind or version that this build does not support.
    #[error("model file {} has {holds}, this build reads rbf and deep of version {VERSION}: train it again, or use another build", .path.display())]
    Kind {
        /// The file.
        path: PathBuf,
        /// Kind and version it names.
        holds: String,
    },
    /// The content is inconsistent.
    #[error("model file {} is damaged: {why}", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Description of the inconsistency.
        why: String,
    },
    /// The network does not fit the mesh or the protocol, or has numbers that are not finite.
    #[error("the network does not fit its geometry and survey: {0}")]
    Network(String),
}

impl Model {
    /// Combines a trained network with its geometry, survey and training record.
    ///
    /// # Errors
    /// A network that does not fit the geometry or the survey.
    pub fn new(
        name: &str,
        mesh: Arc<Mesh>,
        protocol: &Protocol,
        network: Network,
        training: TrainingSettings,
        report: Report,
        noise_figure: Option<f64>,
    ) -> Result<Self, ModelError> {
        fits(&network, &mesh, protocol).map_err(ModelError::Network)?;
        let model = Self {
            metadata: Metadata {
                version: VERSION,
                kind: network.kind(),
                name: name.to_owned(),
                geometry: mesh.hash().to_owned(),
                survey: protocol.hash(),
                electrodes: protocol.electrodes(),
                readings: protocol.len(),
                normalisation: NORMALISATION.to_owned(),
                training,
                report,
                noise_figure: noise_figure.filter(|figure| figure.is_finite()),
                own_misfit: None,
                build: concat!("eit ", env!("CARGO_PKG_VERSION")).to_owned(),
                checksum: String::new(),
            },
            mesh,
            protocol: protocol.clone(),
            network,
            hash: String::new(),
        };
        model.summed()
    }

    /// Sets the checksum and the hash of the content.
    fn summed(mut self) -> Result<Self, ModelError> {
        let (bytes, checksum) = file::bytes(&self)?;
        self.metadata.checksum = checksum;
        self.hash = fingerprint(&bytes);
        Ok(self)
    }

    /// The same model with a noise figure in its metadata; a figure that is not finite is omitted.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_noise_figure(mut self, figure: f64) -> Result<Self, ModelError> {
        self.metadata.noise_figure = Some(figure).filter(|figure| figure.is_finite());
        self.summed()
    }

    /// The same model with the misfits of the maps of held-out cases.
    ///
    /// # Errors
    /// As [`Self::new`]; numbers that are not finite or out of order.
    pub fn with_own_misfit(mut self, misfit: OwnMisfit) -> Result<Self, ModelError> {
        if !misfit.is_sound() {
            let why = format!("its own misfit has numbers not finite or out of order: {misfit:?}");
            return Err(ModelError::Network(why));
        }
        self.metadata.own_misfit = Some(misfit);
        self.summed()
    }

    /// The file's metadata.
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
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Whether it was trained on this survey and geometry.
    pub fn is_for(&self, protocol: &Protocol, mesh: &Mesh) -> bool {
        &self.protocol == protocol && self.mesh.hash() == mesh.hash()
    }

    /// The model as a reconstructor.
    pub fn into_reconstructor(self) -> Box<dyn Reconstructor> {
        let assumptions = self.assumptions();
        let Metadata {
            name,
            report,
            noise_figure,
            ..
        } = self.metadata;
        let trained = Trained {
            mesh: self.mesh,
            twins: self.protocol.reciprocal_twins(),
            protocol: self.protocol,
            method: name,
            assumptions,
            noise_figure,
        };
        match self.network {
            Network::Rbf(network) => {
                let familiar = match report {
                    Report::Rbf(report) => report.familiar,
                    Report::Deep(_) => f64::NAN,
                };
                let network = FamiliarRbf { network, familiar };
                Box::new(TrainedReconstructor { network, trained })
            }
            Network::Deep(network, familiar) => {
                let network = FamiliarDeep { network, familiar };
                Box::new(TrainedReconstructor { network, trained })
            }
        }
    }

    /// Training and accuracy, a sentence each.
    fn assumptions(&self) -> Vec<String> {
        let training = &self.metadata.training;
        let mut sentences = vec![format!(
            "trained on {} simulated cases, {} copies of each with jitter ({}): losses of conductance only",
            training.cases, training.repeats, training.jitter
        )];
        match &self.metadata.report {
            Report::Rbf(report) => sentences.push(format!(
                "condition {:.1e} of the least-squares problem, rank {}",
                report.condition, report.rank
            )),
            Report::Deep(report) => sentences.extend(report.sentences()),
        }
        sentences
    }
}

/// Writes a model, completely or not at all.
///
/// # Errors
/// [`ModelError::Unwritten`].
pub fn save(path: &Path, existing: Existing, model: &Model) -> Result<(), ModelError> {
    Ok(outfile::write(path, existing, &file::bytes(model)?.0)?)
}

/// Reads a model and checks that its content is consistent.
///
/// # Errors
/// See [`ModelError`].
pub fn load(path: &Path) -> Result<Model, ModelError> {
    let failed = |cause| ModelError::Io {
        path: path.to_owned(),
        cause,
    };
    let foreign = |why: &str| ModelError::Foreign {
        path: path.to_owned(),
        why: why.to_owned(),
    };
    // opening a pipe would block until somebody writes to it
    let kind = std::fs::metadata(path).map_err(failed)?;
    if !kind.is_file() {
        return Err(foreign("it is no regular file"));
    }
    let file = File::open(path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    if length > LARGEST {
        return Err(foreign("it is larger than 1 GiB"));
    }
    // Read, not mapped: truncating a mapped file would end this process (SIGBUS).
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0));
    file.take(LARGEST).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.is_empty() {
        return Err(ModelError::Truncated {
            path: path.to_owned(),
        });
    }
    file::parse(path, &bytes)
}

/// Loads a model file as a reconstructor.
///
/// # Errors
/// As [`load`].
pub fn load_reconstructor(path: &Path) -> Result<Box<dyn Reconstructor>, ModelError> {
    Ok(load(path)?.into_reconstructor())
}

/// Checks that the network has an input per reading and an output per triangle of the region, and is finite.
fn fits(network: &Network, mesh: &Mesh, protocol: &Protocol) -> Result<(), String> {
    let (inputs, outputs) = (network.inputs(), network.outputs());
    if inputs != protocol.len() || outputs != mesh.region().len() {
        return Err(format!(
            "it takes {inputs} readings and gives {outputs} triangles, there are {} and {}",
            protocol.len(),
            mesh.region().len()
        ));
    }
    match network {
        // checked when it was constructed
        Network::Rbf(_) => Ok(()),
        Network::Deep(_, familiar) if familiar.is_sound(inputs) => Ok(()),
        Network::Deep(..) => {
            Err("its training inputs are not described in finite numbers".to_owned())
        }
    }
}

/// SHA-256 of some bytes, hex: the identity of models and their training data.
pub fn fingerprint(bytes: &[u8]) -> String {
    survey::hex(&Sha256::digest(bytes))
}
