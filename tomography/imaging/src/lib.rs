//! From settings to a geometry and a [`Reconstructor`](eit::Reconstructor): the one place where it is decided how
//! voltages become a map. The daemon, the command line programs and every other reader of frames use it, so that a map
//! that is made again has the same bits.
//!
//! Left to others: the mathematics (crate `eit`), instruments, the bus, drawing, and the programs' own options.
//!
//! ```
//! use imaging::{Conditions, GeometrySettings, PresetName, ReconstructionSettings};
//! use survey::{Amps, Protocol};
//! let geometry = GeometrySettings { preset: Some(PresetName::DiscTank), ..Default::default() }.geometry(None)?;
//! let protocol = Protocol::sheffield(geometry.electrodes())?;
//! let conditions = Conditions { geometry: &geometry, protocol: &protocol, current: Amps(1e-3), noise_v: None };
//! let model = imaging::build(&ReconstructionSettings::default(), &conditions)?;
//! assert!(model.reconstructor.method().starts_with("one-step"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod baseline_check;
mod geometry;
mod map_noise;
pub mod noise;
mod reconstruction;
pub mod recorded;
mod settings;
mod stored_models;

pub use baseline_check::baseline_remarks;
pub use geometry::{Geometry, GeometryError, GeometrySettings, PresetName, has_mesh};
pub use map_noise::map_noise;
pub use reconstruction::{BuildError, Conditions, Model, build, check_live, load};
pub use settings::{Method, PriorName, ReconstructionSettings};
pub use stored_models::{find_model, find_model_in, short_hash};
