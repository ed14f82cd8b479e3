//! Checkpoints of a training: written atomically after each epoch, and read by a later run with the same settings.

use std::collections::HashMap;
use std::io;
use std::path::Path;

use outfile::{Existing, OutFile};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};

use super::descent::Descent;

const KEY: &str = "tactus-training";

/// State of a training after an epoch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct TrainingState {
    /// Hash of everything that determines the bits of the result.
    pub(super) fingerprint: String,
    /// Completed epochs.
    pub(super) epochs: usize,
    /// Completed steps.
    pub(super) steps: u64,
    /// The best epoch, from 1, its training loss and held-out loss.
    pub(super) best: Option<(usize, f64, f64)>,
}

/// Errors of checkpoints.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointFault {
    /// The checkpoint cannot be written.
    #[error(
        "checkpoint {path} cannot be written: free space or give another --checkpoint; the same command then continues from the last checkpoint"
    )]
    Unwritten {
        /// The file.
        path: String,
        /// The cause.
        #[source]
        cause: io::Error,
    },
    /// The checkpoint cannot be read.
    #[error("checkpoint {path} cannot be read")]
    Unread {
        /// The file.
        path: String,
        /// The cause.
        #[source]
        cause: io::Error,
    },
    /// The checkpoint is damaged.
    #[error("checkpoint {path} is damaged ({why}): remove it to start again")]
    Damaged {
        /// The file.
        path: String,
        /// How it was detected.
        why: String,
    },
    /// The checkpoint was written by a training with other settings.
    #[error(
        "checkpoint {path} belongs to a training with other settings: remove it, or give another --checkpoint"
    )]
    Other {
        /// The file.
        path: String,
    },
}

/// Writes weights, moments, best weights and state.
pub(super) fn write(
    path: &Path,
    descent: &Descent,
    best: &[Vec<f32>],
    course: &TrainingState,
) -> Result<(), CheckpointFault> {
    let failed = |cause| CheckpointFault::Unwritten {
        path: path.display().to_string(),
        cause,
    };
    let text = text(course).map_err(|fault| failed(io::Error::other(fault)))?;
    let mut parts: Vec<(String, Vec<u8>)> = Vec::new();
    for (index, part) in descent.trained().enumerate() {
        for (name, values) in [
            ("values", &part.values),
            ("first", &part.first),
            ("second", &part.second),
        ] {
            parts.push((format!("{name}{index}"), bytes(values)));
        }
    }
    for (index, values) in best.iter().enumerate() {
        parts.push((format!("best{index}"), bytes(values)));
    }
    let views = parts.iter().map(|(name, bytes)| {
        let view = TensorView::new(Dtype::F32, vec![bytes.len() / 4], bytes)
            .expect("the length is that of the bytes");
        (name, view)
    });
    // an existing file was read as a checkpoint of this training and may be replaced; a failed write removes its
    // temporary file
    let file =
        OutFile::create(path, Existing::Replace).map_err(|refused| failed(refused.into_io()))?;
    let Some(temporary) = file.temporary_path() else {
        let text = "a checkpoint is read again, which is not possible for a device or a pipe";
        return Err(failed(io::Error::other(text)));
    };
    safetensors::serialize_to_file(
        views,
        Some(HashMap::from([(KEY.to_owned(), text)])),
        temporary,
    )
    .map_err(|fault| match fault {
        safetensors::SafeTensorError::IoError(cause) => failed(cause),
        other => failed(io::Error::other(other)),
    })?;
    file.finish()
        .map(drop)
        .map_err(|refused| failed(refused.into_io()))
}

/// Reads a checkpoint into a network of the same shape; `None` if the file does not exist.
pub(super) fn read(
    path: &Path,
    descent: &mut Descent,
    best: &mut Vec<Vec<f32>>,
    fingerprint: &str,
) -> Result<Option<TrainingState>, CheckpointFault> {
    let place = || path.display().to_string();
    let content = match std::fs::read(path) {
        Ok(content) => content,
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(cause) => {
            return Err(CheckpointFault::Unread {
                path: place(),
                cause,
            });
        }
    };
    let damaged = |why: String| CheckpointFault::Damaged { path: place(), why };
    let (_, info) =
        SafeTensors::read_metadata(&content).map_err(|fault| damaged(fault.to_string()))?;
    let text = info
        .metadata()
        .as_ref()
        .and_then(|entries| entries.get(KEY))
        .ok_or_else(|| damaged("it is not a checkpoint".to_owned()))?;
    let course = state(text).map_err(|fault| damaged(fault.to_string()))?;
    if course.fingerprint != fingerprint {
        return Err(CheckpointFault::Other { path: place() });
    }
    let tensors = SafeTensors::deserialize(&content).map_err(|fault| damaged(fault.to_string()))?;
    let floats = |name: String, length: usize| {
        let tensor = tensors
            .tensor(&name)
            .map_err(|fault| damaged(fault.to_string()))?;
        let (values, _) = tensor.data().as_chunks::<4>();
        if values.len() != length {
            return Err(damaged(format!("tensor '{name}' has {}", values.len())));
        }
        Ok(values
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect::<Vec<_>>())
    };
    best.clear();
    for (index, part) in descent.trained_mut().enumerate() {
        let length = part.values.len();
        part.values = floats(format!("values{index}"), length)?;
        part.first = floats(format!("first{index}"), length)?;
        part.second = floats(format!("second{index}"), length)?;
        best.push(floats(format!("best{index}"), length)?);
    }
    descent.steps = course.steps;
    Ok(Some(course))
}

/// The losses are read back bit for bit: they decide which epoch is the best, and are in the report of the model file.
fn text(course: &TrainingState) -> serde_json::Result<String> {
    Ok(shards::encode(serde_json::to_value(course)?).to_string())
}

fn state(text: &str) -> serde_json::Result<TrainingState> {
    serde_json::from_value(shards::decode(serde_json::from_str(text)?))
}

fn bytes(values: &[f32]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn losses_are_read_back_to_the_bit() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for epoch in 1..=10_000 {
            let course = TrainingState {
                fingerprint: "of the settings".to_owned(),
                epochs: epoch,
                steps: 7,
                best: Some((epoch, random.random(), random.random())),
            };
            assert_eq!(state(&text(&course).unwrap()).unwrap(), course);
        }
    }
}
