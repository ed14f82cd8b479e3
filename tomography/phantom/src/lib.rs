//! The simulated sheet: computes the voltages at its electrodes under the loads of a scene.
//!
//! A phantom solves the complete electrode model on its own mesh, which is finer than that of any reconstruction and
//! not a refinement of it. Sheet and contacts are ideal unless a scene names an effect; an effect that is not named
//! takes no computing time. The crate uses no clock (time is an argument), no randomness without a seed, no instruments
//! and no reconstruction.
//!
//! - **load**: a shape at a position with a loss of conductance; **scene**: sheet, loads on a time line, effects, seed
//! - **fault**: a failure of an instrument in a scene, as text that the simulated instruments interpret
//! - **loss**: the share of the sheet's conductance that is lost under a load, 0 to 1
//! - **effect**: one imperfection of sheet, contacts, network or readings, with its own random stream
//!
//! ```
//! use std::time::Duration;
//! use phantom::{Load, Phantom, Scene};
//! let mut phantom = Phantom::new(Scene::parse("quiet.toml", "[mesh]\nfineness = 0.5")?)?;
//! let untouched = phantom.transfer_impedance(Duration::ZERO)?.clone();
//! phantom.press(Load::disc([107.0, 115.0], 10.0, 0.5))?;
//! assert!(phantom.transfer_impedance(Duration::ZERO)? != &untouched);
//! phantom.release();
//! assert!(phantom.transfer_impedance(Duration::ZERO)? == &untouched);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod effects;
mod history;
mod law;
mod load;
pub mod paper;
mod press;
mod preview;
mod repeat;
mod scan;
mod scene;
mod sheet;
mod shipped;

pub use effects::settings::*;
pub use effects::{EffectSettings, Needs, ParameterFault, PronyStep, RelayContact};
pub use law::Pressure;
pub use load::{GRAVITY, Load, LoadError, Shape, loss_of_pressure, pressure_kpa};
pub use press::{Amount, Contact, TimedLoad, Waypoint};
pub use preview::{Prediction, Preview};
pub use repeat::{Repeat, RepeatError};
pub use scan::{ReadingContext, Scan, across};
pub use scene::{FINER, Scene, SceneError, SceneFault};
pub use sheet::{Phantom, PhantomError};
pub use shipped::OpenError;
