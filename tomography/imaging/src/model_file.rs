//! Trained models from files, checked against protocol and geometry.

use std::path::Path;
use std::sync::Arc;

use eit::inverse::learned::network::{is_onnx, load_onnx};
use eit::{LossOnly, Reconstructor};
use survey::{Protocol, Reading};

use crate::geometry::Geometry;
use crate::reconstruction::{BuildError, Model};
use crate::stored_models::short_hash;

/// Loads a model file and checks that it was made for this protocol, and for this geometry where one is given; an ONNX
/// file says nothing of geometry and protocol, takes both from here, and cannot do without. `loss_only` cuts its maps.
///
/// # Errors
/// A file that cannot be read, or that was made for something else.
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
    let loaded = eit::model::load(path).map_err(|cause| BuildError::File {
        path: path.to_owned(),
        cause,
    })?;
    let hash = Some(loaded.hash().to_owned());
    let reconstructor = cut(loaded.into_reconstructor(), loss_only);
    check(path, reconstructor.as_ref(), geometry, protocol)?;
    Ok(Model {
        hash,
        ..Model::new(reconstructor)
    })
}

fn cut(trained: Box<dyn Reconstructor>, loss_only: bool) -> Arc<dyn Reconstructor> {
    match loss_only {
        true => Arc::new(LossOnly::new(trained)),
        false => Arc::from(trained),
    }
}

/// A network trained elsewhere; its file says nothing of sheet and survey, so both are this rig's.
fn onnx(
    path: &Path,
    loss_only: bool,
    geometry: &Geometry,
    protocol: &Protocol,
) -> Result<Model, BuildError> {
    let network = load_onnx(path, Arc::clone(&geometry.mesh), protocol)?;
    let bytes = std::fs::read(path).map_err(|cause| BuildError::File {
        path: path.to_owned(),
        cause: eit::ModelError::Io {
            path: path.to_owned(),
            cause,
        },
    })?;
    Ok(Model {
        hash: Some(eit::model::fingerprint(&bytes)),
        notes: network.assumptions(),
        ..Model::new(cut(network, loss_only))
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
