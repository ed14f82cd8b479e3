//! Replaces `simulation` if the program is built without feature `simulator`: a configuration with a simulated rig is
//! an error that names the feature.

use std::convert::Infallible;

use keysight_34980a::Module;
use rig::BoxStream;

/// The error of a program that is built without simulated instruments.
#[derive(Debug, Clone, Copy, thiserror::Error)]
#[error(
    "this tactusd is built without simulated instruments; build it with `--features simulator` (a default feature), or use \
     kind = \"instruments\" or \"recording\""
)]
pub(crate) struct NotBuilt;

/// A simulated rig; cannot be constructed.
#[derive(Debug, Clone)]
pub(crate) struct SimulatedRig(Infallible);

/// A scene; cannot be constructed.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Scene(Infallible);

/// A profile; cannot be constructed.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Profile {
    none: Infallible,
    pub(crate) board: Option<()>,
    pub(crate) slots: [Option<Module>; 8],
}

impl Profile {
    /// Refuses to load a profile.
    ///
    /// # Errors
    /// Always [`NotBuilt`].
    pub(crate) fn load(_name_or_path: &str) -> Result<Self, NotBuilt> {
        Err(NotBuilt)
    }
}

impl SimulatedRig {
    pub(crate) fn new(profile: &Profile, _scene: Scene) -> Result<Self, NotBuilt> {
        match profile.none {}
    }
}

pub(crate) fn connect(rig: &SimulatedRig, _name: &str) -> BoxStream {
    match rig.0 {}
}

/// Whether this program can simulate instruments; the error names the missing feature.
pub(crate) fn check_built() -> Result<(), String> {
    Err(NotBuilt.to_string())
}

/// Refuses to load a scene.
pub(crate) fn load_scene(_name_or_path: Option<&str>) -> Result<Scene, String> {
    Err(NotBuilt.to_string())
}

pub(crate) fn seed(rig: &SimulatedRig) -> u64 {
    match rig.0 {}
}

pub(crate) fn press(
    rig: &SimulatedRig,
    _shape: &str,
    _centre_m: [f64; 2],
    _size_m: f64,
    _loss: f64,
) -> Result<(), String> {
    match rig.0 {}
}

pub(crate) fn release(rig: &SimulatedRig) {
    match rig.0 {}
}
