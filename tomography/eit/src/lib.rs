//! The mathematics: mesh, forward model, sensitivity, reconstructors, model files.

mod bounded;
mod case;
mod data_space;
mod dense;
mod forward;
mod jacobian;
mod kmeans;
mod mesh;
mod mesher;
pub mod model;
mod one_step;
pub mod preset;
mod prior;
mod rbf;
mod reconstructor;
mod sparse;
mod training;

pub use case::{
    Case, CaseError, NamedFrame, Table, digits, frames_text, matrix_text, protocol_text,
    read_frames, read_named_frames, read_protocol,
};
pub use forward::{Admitted, FLOOR, Fields, Forward, ForwardError};
pub use mesh::{ENOUGH_EDGES, Mesh, MeshError, MeshQuality};
pub use model::{Model, ModelError, load_reconstructor};
pub use one_step::{
    EXPECTED_CHANGE, Hyper, OneStep, OneStepError, OneStepOptions, Scale, UNEXPLAINED,
};
pub use preset::{DiscTank, PaperSheet, Preset};
pub use prior::Prior;
pub use rbf::{NOVELTY_LIMIT, RbfNetwork, RbfReconstructor};
pub use reconstructor::{MOST_MISSING, ReconstructError, Reconstructor};
pub use training::{
    Jitter, Stage, TrainError, TrainingReport, TrainingSet, TrainingSettings, train_rbf,
};
