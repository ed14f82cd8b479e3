//! A session of ONNX Runtime in a reconstructor.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use ort::session::Session;
use ort::value::{Outlet, TensorElementType, TensorRef, ValueType};
use survey::Protocol;

use crate::inverse::learned::network::onnx::OnnxError;
use crate::inverse::learned::trained::{Respond, Trained, TrainedReconstructor};
use crate::{Mesh, Novelty};

/// Environment variable with the path of the runtime.
const LIBRARY: &str = "ORT_DYLIB_PATH";
/// Metadata properties that name the geometry and survey of the training: [`Protocol::hash`] and [`Mesh::hash`].
const SURVEY: &str = "tactus.survey";
const GEOMETRY: &str = "tactus.geometry";

/// An ONNX network.
pub(super) struct OnnxNetwork {
    // a run needs exclusive access to the session; frames come one after another
    session: Mutex<Session>,
    /// Dimensions of the input, open ones as 1.
    shape: Vec<i64>,
}

/// Loads a file and checks that it has an input per reading of the protocol and an output per triangle of the
/// region.
///
/// # Errors
/// See [`OnnxError`].
pub(super) fn load(
    path: &Path,
    mesh: Arc<Mesh>,
    protocol: &Protocol,
) -> Result<TrainedReconstructor<OnnxNetwork>, OnnxError> {
    let library = std::env::var(LIBRARY).unwrap_or_else(|_| "libonnxruntime.so".to_owned());
    ort::init_from(&library)
        .map_err(|cause| OnnxError::Runtime {
            place: library.clone(),
            cause: cause.to_string(),
        })?
        .commit();
    let failed = |cause: String| OnnxError::File {
        path: path.to_owned(),
        cause,
    };
    let mut builder = Session::builder().map_err(|fault| failed(fault.to_string()))?;
    let session = builder
        .commit_from_file(path)
        .map_err(|fault| failed(fault.to_string()))?;
    let shape = checked(
        path,
        "input",
        session.inputs(),
        protocol.len(),
        "the readings of this survey",
    )?;
    checked(
        path,
        "output",
        session.outputs(),
        mesh.region().len(),
        "the triangles of this geometry's region",
    )?;
    let (mut notes, mut unreported) = (Vec::new(), Vec::new());
    for (key, what, here) in [
        (SURVEY, "survey", protocol.hash()),
        (GEOMETRY, "geometry", mesh.hash().to_owned()),
    ] {
        let value = session.metadata().ok().and_then(|all| all.custom(key));
        // ort reads a key that the file does not have as an empty text
        match value.filter(|value| !value.is_empty()) {
            Some(value) if value == here => notes.push(what),
            Some(value) => {
                return Err(OnnxError::Other {
                    path: path.to_owned(),
                    what,
                    value,
                    here,
                });
            }
            None => unreported.push(key),
        }
    }
    let mut assumptions = vec!["trained elsewhere: nothing is known about its training".to_owned()];
    if !notes.is_empty() {
        assumptions.push(format!("its file names this {}", notes.join(" and ")));
    }
    if !unreported.is_empty() {
        assumptions.push(format!(
            "its file has no metadata {}: only the numbers of inputs and outputs were checked",
            unreported.join(", ")
        ));
    }
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    Ok(TrainedReconstructor {
        network: OnnxNetwork {
            session: Mutex::new(session),
            shape,
        },
        trained: Trained {
            mesh,
            twins: protocol.reciprocal_twins(),
            protocol: protocol.clone(),
            method: format!("onnx {name}"),
            assumptions,
            noise_figure: None,
        },
    })
}

/// The dimensions of the only input or output, open ones as 1; it must be of f32 and one dimension of the required
/// length.
fn checked(
    path: &Path,
    what: &'static str,
    outlets: &[Outlet],
    wants: usize,
    meaning: &'static str,
) -> Result<Vec<i64>, OnnxError> {
    let signature = |found| OnnxError::Signature {
        path: path.to_owned(),
        what,
        found,
    };
    let [outlet] = outlets else {
        return Err(signature(format!("{} {what}s", outlets.len())));
    };
    let ValueType::Tensor {
        ty: TensorElementType::Float32,
        shape,
        ..
    } = outlet.dtype()
    else {
        return Err(signature(format!(
            "{what} '{}' of another type",
            outlet.name()
        )));
    };
    let shape: Vec<i64> = shape.iter().copied().collect();
    let long: Vec<i64> = shape
        .iter()
        .copied()
        .filter(|n| ![1, -1].contains(n))
        .collect();
    let one = wants == 1 && long.is_empty() && !shape.is_empty();
    if long != [wants as i64] && !one {
        return Err(OnnxError::Shape {
            path: path.to_owned(),
            what,
            name: outlet.name().to_owned(),
            shape,
            wants,
            meaning,
        });
    }
    Ok(shape.iter().map(|n| n.abs()).collect())
}

impl Respond for OnnxNetwork {
    type Input = Vec<f32>;

    fn input(&self, change: Vec<f64>, _: &[usize]) -> Vec<f32> {
        change.iter().map(|value| *value as f32).collect()
    }

    /// Nothing is known about its training.
    fn novelty(&self, _: &Vec<f32>) -> Option<(Novelty, f64)> {
        None
    }

    fn respond(&self, input: Vec<f32>) -> Result<Vec<f64>, String> {
        // a run that panicked leaves no state that affects the next run
        let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        let tensor = TensorRef::from_array_view((self.shape.clone(), &input[..]))
            .map_err(|fault| fault.to_string())?;
        let outputs = session
            .run(ort::inputs![tensor])
            .map_err(|fault| fault.to_string())?;
        let (_, values) = outputs[0]
            .try_extract_tensor::<f32>()
            .map_err(|fault| fault.to_string())?;
        Ok(values.iter().map(|value| f64::from(*value)).collect())
    }
}
