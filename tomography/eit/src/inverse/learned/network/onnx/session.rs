//! A session of ONNX Runtime as a reconstructor.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use ort::session::Session;
use ort::value::{Outlet, TensorElementType, TensorRef, ValueType};
use survey::{Map, Protocol, Reading};

use crate::inverse::learned::network::onnx::OnnxError;
use crate::inverse::learned::trained::Trained;
use crate::{Mesh, ReconstructError, Reconstructor};

/// Environment variable with the path of the runtime.
const LIBRARY: &str = "ORT_DYLIB_PATH";
/// Metadata properties that name the geometry and survey of the training: [`Protocol::hash`] and [`Mesh::hash`].
const SURVEY: &str = "tactus.survey";
const GEOMETRY: &str = "tactus.geometry";

/// An ONNX network for one sheet and survey.
pub struct OnnxReconstructor {
    // a run needs exclusive access to the session; frames come one after another
    session: Mutex<Session>,
    trained: Trained,
    /// Dimensions of the input, open ones as 1.
    shape: Vec<i64>,
}

impl OnnxReconstructor {
    /// Loads a file and checks that it has an input per reading of the protocol and an output per triangle of the
    /// region.
    ///
    /// # Errors
    /// See [`OnnxError`].
    pub fn load(path: &Path, mesh: Arc<Mesh>, protocol: &Protocol) -> Result<Self, OnnxError> {
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
        let mut assumptions =
            vec!["trained elsewhere: nothing is known about its training".to_owned()];
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
        Ok(Self {
            session: Mutex::new(session),
            trained: Trained {
                mesh,
                twins: protocol.reciprocal_twins(),
                protocol: protocol.clone(),
                method: format!("onnx {name}"),
                assumptions,
                noise_figure: None,
            },
            shape,
        })
    }
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

impl Reconstructor for OnnxReconstructor {
    fn method(&self) -> &str {
        &self.trained.method
    }

    fn protocol(&self) -> &Protocol {
        &self.trained.protocol
    }

    fn mesh(&self) -> &Arc<Mesh> {
        &self.trained.mesh
    }

    fn assumptions(&self) -> Vec<String> {
        self.trained.assumptions.clone()
    }

    fn reconstruct(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        let (change, _, masked) = self.trained.change(baseline, frame)?;
        let input: Vec<f32> = change.iter().map(|value| *value as f32).collect();
        let failed = |cause: String| ReconstructError::Numerical {
            method: self.trained.method.clone(),
            cause,
        };
        // a run that panicked leaves no state that affects the next run
        let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        let tensor = TensorRef::from_array_view((self.shape.clone(), &input[..]))
            .map_err(|fault| failed(fault.to_string()))?;
        let outputs = session
            .run(ort::inputs![tensor])
            .map_err(|fault| failed(fault.to_string()))?;
        let (_, values) = outputs[0]
            .try_extract_tensor::<f32>()
            .map_err(|fault| failed(fault.to_string()))?;
        if values.len() != self.trained.mesh.region().len() {
            return Err(failed(format!("it gave {} numbers", values.len())));
        }
        if let Some(triangle) = values.iter().position(|value| !value.is_finite()) {
            return Err(failed(format!(
                "its value for triangle {triangle} is {}",
                values[triangle]
            )));
        }
        let values = values.iter().map(|value| f64::from(*value)).collect();
        Ok(self.trained.map(values, masked))
    }
}
