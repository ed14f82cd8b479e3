//! Builds a geometry and a [`Reconstructor`](eit::Reconstructor) from settings. The daemon, the command line programs
//! and all other programs that read frames use this crate, so that recomputed maps are equal bit for bit.
//!
//! Not included: the mathematics (crate `eit`), instruments, D-Bus, drawing, and the programs' own options.
//!
//! ```
//! use imaging::{Conditions, GeometrySettings, PresetName, ReconstructionSettings};
//! use survey::{Amps, Protocol};
//! let geometry = GeometrySettings { preset: Some(PresetName::DiscTank), ..Default::default() }.geometry(None)?;
//! let protocol = Protocol::sheffield(geometry.electrodes())?;
//! let conditions = Conditions::live(&geometry, &protocol, Amps(1e-3));
//! let model = imaging::build(&ReconstructionSettings::default(), &conditions)?;
//! assert!(model.reconstructor.method().starts_with("one-step"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[cfg(feature = "arguments")]
mod arguments;
mod baseline_check;
mod conditions;
mod drift_removal;
mod error;
mod geometry;
mod map_noise;
mod methods;
mod model;
mod model_file;
pub mod noise;
pub mod quantities;
mod reconstruction;
pub mod recorded;
mod settings;
pub mod tracking;

#[cfg(feature = "arguments")]
pub use arguments::{MethodArguments, TrackedArguments};
pub use baseline_check::baseline_remarks;
pub use conditions::{Conditions, trial_frame};
pub use drift::{DriftError, MapDeviation};
pub use drift_removal::months_of_drift;
pub use error::BuildError;
#[cfg(feature = "arguments")]
pub use geometry::DepthArguments;
pub use geometry::{
    DepthRemark, DepthSettings, Geometry, GeometryError, GeometrySettings, PresetName, has_mesh,
};
pub use map_noise::map_noise;
pub use model::Model;
pub use model_file::{find_model, find_model_in, load, short_hash};
pub use reconstruction::{
    build, calibrate, check_live, judging, read_calibration, unjudged, with_drift,
};
pub use settings::{
    DriftRule, HyperChoice, Ignored, Method, PriorName, ReconstructionSettings, Unknowns,
};
pub use tracking::{Tracked, TrackedFrame, Tracking};
