//! Trained models from files, checked against protocol and geometry, or located by the hash stored in a session.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eit::Reconstructor;
use eit::inverse::learned::network::{is_onnx, load_onnx};
use survey::{Protocol, Reading};

use crate::error::BuildError;
use crate::geometry::Geometry;
use crate::model::Model;

/// Loads a model file and checks that it was made for this protocol, and for this geometry if one is given. An ONNX
/// file names neither, so it needs both from the caller. `loss_only` clips its maps to losses.
///
/// # Errors
/// A file that cannot be read, or was made for another protocol or geometry.
pub fn load(
    path: &Path,
    loss_only: bool,
    protocol: &Protocol,
    geometry: Option<&Geometry>,
) -> Result<Model, BuildError> {
    if is_onnx(path) {
        let geometry = geometry.ok_or_else(|| {
            BuildError::Setting(format!(
                "model {} is an ONNX file, which holds no mesh; name a preset or a case folder",
                path.display()
            ))
        })?;
        return onnx(path, loss_only, geometry, protocol);
    }
    let loaded = eit::model::load(path)?;
    let hash = Some(loaded.hash().to_owned());
    let own_misfit = loaded.metadata().own_misfit.clone();
    let model = Model::trained(loaded.into_reconstructor(), loss_only);
    check(path, model.reconstructor.as_ref(), geometry, protocol)?;
    Ok(Model {
        hash,
        own_misfit,
        ..model
    })
}

/// Loads an ONNX network for the geometry and protocol of this rig, because the file names neither.
fn onnx(
    path: &Path,
    loss_only: bool,
    geometry: &Geometry,
    protocol: &Protocol,
) -> Result<Model, BuildError> {
    let network = load_onnx(path, Arc::clone(&geometry.mesh), protocol)?;
    let bytes = std::fs::read(path).map_err(|cause| eit::ModelError::Io {
        path: path.to_owned(),
        cause,
    })?;
    Ok(Model {
        hash: Some(eit::model::fingerprint(&bytes)),
        notes: network.assumptions(),
        ..Model::trained(network, loss_only)
    })
}

fn check(
    path: &Path,
    model: &dyn Reconstructor,
    geometry: Option<&Geometry>,
    protocol: &Protocol,
) -> Result<(), BuildError> {
    let name = path.display().to_string();
    if model.protocol() != protocol {
        return Err(BuildError::Survey {
            model: name,
            asks: model.protocol().len(),
            model_electrodes: model.protocol().electrodes(),
            model_hash: short_hash(&model.protocol().hash()).to_owned(),
            rig: protocol.len(),
            rig_electrodes: protocol.electrodes(),
            rig_hash: short_hash(&protocol.hash()).to_owned(),
            half: model
                .protocol()
                .answered_by(protocol, &vec![Reading::NotMeasured; protocol.len()])
                .is_some(),
        });
    }
    if let Some(geometry) = geometry.filter(|geometry| model.mesh().hash() != geometry.mesh.hash())
    {
        return Err(BuildError::Geometry {
            model: name,
            model_hash: short_hash(model.mesh().hash()).to_owned(),
            rig_hash: short_hash(geometry.mesh.hash()).to_owned(),
            geometry: geometry.name.clone(),
        });
    }
    Ok(())
}

/// The model file with this hash: the configured one, or any in its folder, in `models` or in the current directory;
/// `None` if there is none.
pub fn find_model(configured: Option<&Path>, hash: &str) -> Option<PathBuf> {
    let folder = configured.and_then(Path::parent);
    configured
        .filter(|file| has_hash(file, hash))
        .map(Path::to_owned)
        .or_else(|| {
            folder
                .into_iter()
                .chain([Path::new("models"), Path::new(".")])
                .find_map(|folder| find_model_in(folder, hash))
        })
}

/// The model file with this hash in a folder; `None` if there is none.
pub fn find_model_in(folder: &Path, hash: &str) -> Option<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .ok()?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| is_onnx(path) || path.extension().is_some_and(|name| name == "safetensors"))
        .collect();
    files.sort();
    files.into_iter().find(|file| has_hash(file, hash))
}

fn has_hash(file: &Path, hash: &str) -> bool {
    std::fs::read(file).is_ok_and(|bytes| eit::model::fingerprint(&bytes) == hash)
}

/// The first twelve characters of a hash, for display.
pub fn short_hash(hash: &str) -> &str {
    hash.get(..12).unwrap_or(hash)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_models_bring_their_own_misfit() {
        let protocol = Protocol::sheffield(26).unwrap();
        for name in ["rbf-matched", "rbf-paper"] {
            let file = Path::new(env!("CARGO_MANIFEST_DIR"))
                .join("../../models")
                .join(format!("{name}.safetensors"));
            let model = load(&file, false, &protocol, None).unwrap();
            assert!(
                model
                    .own_misfit
                    .is_some_and(|misfit| misfit.classes.len() == 4)
            );
        }
    }

    #[test]
    fn the_error_of_a_model_file_names_it_once() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("short.safetensors");
        std::fs::write(&file, "").unwrap();
        let refused = load(&file, false, &Protocol::sheffield(8).unwrap(), None);
        let wanted = format!("model file {} is truncated: copy it again", file.display());
        assert_eq!(survey::error_chain(&refused.err().unwrap()), wanted);
    }

    #[test]
    fn without_a_check_a_novel_frame_has_no_quality() {
        let protocol = Protocol::sheffield(26).unwrap();
        let file =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/rbf-matched.safetensors");
        let model = load(&file, false, &protocol, None).unwrap();
        assert!(model.check.is_none());
        let volts = |volts| vec![Reading::Ok(survey::Volts(volts)); protocol.len()];
        let (baseline, frame) = (volts(1.0), volts(1.06));
        let own = model.reconstructor.reconstruct(&baseline, &frame).unwrap();
        assert!(
            own.quality
                .is_some_and(|own| own.text().contains("distance from the training inputs"))
        );
        assert_eq!(model.reconstruct(&baseline, &frame).unwrap().quality, None);
    }

    #[test]
    fn a_model_is_found_by_its_hash_not_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let [configured, other] =
            ["a.safetensors", "b.safetensors"].map(|name| folder.path().join(name));
        std::fs::write(&configured, "one").unwrap();
        std::fs::write(&other, "two").unwrap();
        let of = |text: &str| eit::model::fingerprint(text.as_bytes());
        let found = |text: &str| find_model(Some(&configured), &of(text));
        assert_eq!(found("one"), Some(configured.clone()));
        assert_eq!(found("two"), Some(other));
        assert_eq!(found("three"), None);
    }
}
