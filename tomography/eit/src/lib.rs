//! Mathematics of impedance tomography: mesh, forward model, sensitivity, reconstructors, model files.
//!
//! From conductances to voltages (complete electrode model) and back to a map. The crate uses no clock, no tokio, no
//! D-Bus, no instruments, and not the phantom: a reconstructor with access to the truth would be an inverse crime.
//!
//! - **mesh**: triangles with electrodes on boundary edges and a region of interest; **preset**: ready-made meshes
//! - **case**: a mesh, contacts, a protocol and conductances as a folder of CSV files
//! - **forward**: voltages of all drives from one factorisation; **Jacobian**: their derivatives with respect to
//!   conductance
//! - **reconstructor**: a map from a baseline and a frame; **model**: a reconstructor in one file
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

mod calibration;
mod case;
mod forward;
pub mod inverse;
mod jacobian;
pub mod linear_algebra;
mod mesh;
pub mod metrics;
pub mod model;
pub mod preset;

pub use crate::inverse::error::OneStepError;
pub use crate::inverse::learned::network::{DeepNetwork, DeepReport, DeepSettings, Precision};
pub use crate::inverse::learned::rbf::{NOVELTY_LIMIT, RbfNetwork};
pub use crate::inverse::model_check::{Leftover, MisfitClass, ModelCheck, OwnMisfit};
pub use crate::inverse::nonlinear::{NOISE_ONLY, NonlinearTv, NonlinearTvOptions};
pub use crate::inverse::one_step::{CLIPPED, EXPECTED_CHANGE, MODEL_SHARE, OneStep};
pub use crate::inverse::options::{DEFAULT_NOISE_V, Hyper, HyperRule, OneStepOptions, Scale};
pub use crate::inverse::prior::{OUTSIDE_WEIGHT, Prior, SMOOTH_LENGTH_M};
pub use crate::inverse::reconstructor::{
    LARGEST_SCALE_RATIO, MOST_MISSING, MOST_MISSING_TRAINED, Novelty, ReconstructError,
    Reconstructor,
};
pub use crate::inverse::tv::{Strength, TV_STRENGTH, Tv, TvError, TvOptions, TvSolution};
pub use crate::inverse::wrappers::loss_only::LossOnly;
pub use crate::inverse::wrappers::whole_sheet::WholeSheet;
pub use crate::linear_algebra::processor::cpu_features;
pub use calibration::{
    CALIBRATION_KIND, CONTRADICTION, Calibration, CalibrationError, FEWEST_PRESSES,
    FEWEST_PRESSURES, KnownPress, Pressure,
};
pub use case::{
    Case, CaseError, NamedFrame, Table, digits, frames_text, matrix_text, protocol_text,
    read_frames, read_named_frames, read_protocol,
};
pub use forward::{Admitted, FLOOR, Fields, Forward, ForwardError, Workspace};
pub use jacobian::Parameters;
pub use mesh::polygon::{clip_by, left_of, polygon_area, polygon_contains};
pub use mesh::{Depth, ENOUGH_EDGES, Mesh, MeshError, MeshQuality, bounding_box};
pub use model::{
    CentresChoice, ChangeChoice, DistancesChoice, Jitter, LossChoice, Model, ModelError, Network,
    OpenChoices, PointsChoice, Report, SizeChoice, SpreadChoice, TrainingReport, TrainingSettings,
    load_reconstructor,
};
/// Whether writing a model or case may replace an existing file.
pub use outfile::Existing;
pub use preset::{DiscTank, PaperSheet, Preset, SheetElectrode};
