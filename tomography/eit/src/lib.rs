//! The mathematics: mesh, forward model, sensitivity, reconstructors, model files.
//!
//! From conductances to voltages (complete electrode model) and back to a map. Refused at this door: clocks, tokio, the
//! bus, instruments, and the phantom: a reconstructor that could see the truth would be an inverse crime.
//!
//! - **mesh**: triangles with electrodes on boundary edges and a region of interest; **preset**: a ready-made one
//! - **case**: a mesh, contacts, a protocol and conductances as a folder of CSV files
//! - **forward**: voltages of all drives from one factorisation; **Jacobian**: how readings follow conductances
//! - **reconstructor**: a map from a baseline and a frame; **model**: a reconstructor as one file
//!
//! ```
//! use std::sync::Arc;
//! use eit::{DiscTank, Forward};
//! use survey::Protocol;
//! let tank = DiscTank { fineness: 0.5, ..DiscTank::default() };
//! let mesh = Arc::new(tank.mesh()?);
//! let forward = Forward::new(mesh.clone(), &tank.contact_ohm_m())?;
//! let sigma = vec![tank.conductance(); mesh.triangles().len()];
//! let protocol = Protocol::sheffield(16)?;
//! let volts = forward.readings(&sigma, &protocol)?;
//! let jacobian = forward.jacobian(&sigma, &protocol)?;
//! assert_eq!((volts.len(), jacobian.shape()), (208, (208, mesh.triangles().len())));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bounded;
mod calibration;
mod case;
mod data_space;
mod dense;
mod fold;
mod forward;
mod hyper;
mod interior;
mod jacobian;
mod kmeans;
mod linear;
mod loss_only;
pub mod merit;
mod mesh;
mod mesher;
pub mod model;
pub mod network;
mod novelty;
mod one_step;
pub mod preset;
mod prior;
mod processor;
mod quick;
mod rbf;
mod reconstructor;
mod sparse;
mod training;
mod tv;
mod wide;

pub use calibration::{
    CALIBRATION_KIND, CONTRADICTION, Calibration, CalibrationError, FEWEST_PRESSES,
    FEWEST_PRESSURES, KnownPress, Pressure,
};
pub use case::{
    Case, CaseError, NamedFrame, Table, digits, frames_text, matrix_text, protocol_text,
    read_frames, read_named_frames, read_protocol,
};
pub use forward::{Admitted, FLOOR, Fields, Forward, ForwardError, Workspace};
pub use hyper::{l_curve_lambda, probable_lambda};
pub use jacobian::Parameters;
pub use loss_only::LossOnly;
pub use mesh::{ENOUGH_EDGES, Mesh, MeshError, MeshQuality};
pub use model::{Model, ModelError, Network, Report, load_reconstructor};
pub use network::{DeepNetwork, DeepReport, DeepSettings, Precision};
pub use one_step::{
    CLIPPED, EXPECTED_CHANGE, Hyper, MODEL_SHARE, OneStep, OneStepError, OneStepOptions, Scale,
    UNEXPLAINED,
};
/// What becomes of a file that has the name of a model or case already.
pub use outfile::Existing;
pub use preset::{DiscTank, PaperSheet, Preset, SheetElectrode};
pub use prior::{Prior, SMOOTH_LENGTH_M};
pub use processor::cpu_features;
pub use rbf::{NOVELTY_LIMIT, RbfNetwork, RbfReconstructor};
pub use reconstructor::{MOST_MISSING, Novelty, ReconstructError, Reconstructor};
pub use training::{
    CentresReading, ChangeReading, DistancesReading, Jitter, LossReading, Noise, OpenReadings,
    PointsReading, Sample, SampleError, Samples, Simulation, SizeReading, SpreadReading, Stage,
    TrainError, TrainingReport, TrainingSet, TrainingSettings, dense_target, train_rbf,
    train_rbf_on,
};
pub use tv::{Strength, TV_STRENGTH, Tv, TvError, TvOptions, TvSolution};
