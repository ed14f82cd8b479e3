//! Networks trained elsewhere (PyTorch, MATLAB), as ONNX files, run by ONNX Runtime.
//!
//! Requires the feature `onnx`; a build without it returns an error. The library is loaded with the first such network,
//! from `ORT_DYLIB_PATH`, or as the system finds `libonnxruntime`. An ONNX file does not describe sheet and survey, so
//! both are given. The numbers of inputs and outputs are checked, and so are the metadata properties `tactus.survey`
//! and `tactus.geometry` (the hashes in a training set's manifest) if the file has them. Its input is the normalised
//! difference of Eq. 6 (f32, one per reading in the protocol's order), its output the relative change (Eq. 7) of each
//! triangle of the region in the mesh's order.

#[cfg(feature = "onnx")]
mod session;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use survey::Protocol;

use crate::{Mesh, Reconstructor};

/// Why a network trained elsewhere cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum OnnxError {
    /// This build cannot run such networks.
    #[error("ONNX file {}: this build cannot run ONNX networks; build it with --features onnx", .path.display())]
    NotBuilt {
        /// The file.
        path: PathBuf,
    },
    /// The machine has no ONNX Runtime.
    #[error(
        "ONNX Runtime cannot be loaded from {place} ({cause}): install it (e.g. pip install onnxruntime) and set its \
         path in ORT_DYLIB_PATH"
    )]
    Runtime {
        /// The library.
        place: String,
        /// The loader's error.
        cause: String,
    },
    /// The file is missing, damaged, or uses features that this runtime does not support.
    #[error("ONNX file {} cannot be used: {cause}", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The runtime's error.
        cause: String,
    },
    /// Not exactly one input and one output of floats.
    #[error("ONNX file {} has {found}, one f32 {what} is needed", .path.display())]
    Signature {
        /// The file.
        path: PathBuf,
        /// `input` or `output`.
        what: &'static str,
        /// The inputs or outputs found.
        found: String,
    },
    /// Made for another survey or region.
    #[error(
        "ONNX file {}: its {what} '{name}' has the shape {shape:?} (-1: any), [1, {wants}] is needed: {meaning}", .path.display()
    )]
    Shape {
        /// The file.
        path: PathBuf,
        /// `input` or `output`.
        what: &'static str,
        /// Its name.
        name: String,
        /// Its dimensions; -1 matches any.
        shape: Vec<i64>,
        /// Numbers needed.
        wants: usize,
        /// What they are: readings or triangles.
        meaning: &'static str,
    },
    /// Its metadata names another survey or geometry.
    #[error("ONNX file {} was trained for {what} {value}, this is {what} {here}", .path.display())]
    Other {
        /// The file.
        path: PathBuf,
        /// `survey` or `geometry`.
        what: &'static str,
        /// The hash in the file.
        value: String,
        /// The hash of the survey or geometry in use.
        here: String,
    },
}

/// Whether a path names an ONNX file, by its extension.
pub fn is_onnx(path: &Path) -> bool {
    path.extension()
        .is_some_and(|kind| kind.eq_ignore_ascii_case("onnx"))
}

/// Loads a network and checks that it has an input per reading of the protocol and an output per triangle of the
/// region. All other dimensions are 1 or left open in the file: `[1, 598]`, `[batch, 598]`, MATLAB's `[1, 598, 1, 1]`.
///
/// # Errors
/// See [`OnnxError`].
pub fn load_onnx(
    path: &Path,
    mesh: Arc<Mesh>,
    protocol: &Protocol,
) -> Result<Box<dyn Reconstructor>, OnnxError> {
    #[cfg(feature = "onnx")]
    return Ok(Box::new(session::load(path, mesh, protocol)?));
    #[cfg(not(feature = "onnx"))]
    {
        let _ = (mesh, protocol);
        Err(OnnxError::NotBuilt {
            path: path.to_owned(),
        })
    }
}
