//! Parses a model from the content of its file.

use std::path::Path;
use std::sync::Arc;

use half::f16;
use safetensors::tensor::{Dtype, Metadata as TensorInfo, SafeTensors, TensorView};
use survey::{Dipole, Electrode, Measurement, Protocol};

use super::{KEY, checksum, layer_name, stated_checksum};
use crate::inverse::learned::network::{DeepNetwork, Layer, TrainingDistribution, Weights};
use crate::model::{
    Kind, Metadata, Model, ModelError, Network, Report, VERSION, fingerprint, fits,
};
use crate::{Depth, Mesh, RbfNetwork};

/// Parses the content of a model file; `path` is used in messages.
pub(in crate::model) fn parse(path: &Path, bytes: &[u8]) -> Result<Model, ModelError> {
    let info = tensor_info(path, bytes)?;
    let (metadata, text) = metadata(path, &info)?;
    let damaged = |why: String| damaged(path, why);
    let tensors = SafeTensors::deserialize(bytes).map_err(|fault| damaged(fault.to_string()))?;
    // the hash of the file and its internal checksum each read every byte: computed in parallel
    let (hash, summed) = rayon::join(
        || fingerprint(bytes),
        || content_checksum(&metadata, text, &tensors),
    );
    if summed != metadata.checksum {
        return Err(damaged(format!(
            "its checksum is {}, its content's is {summed}; copy it again",
            metadata.checksum
        )));
    }
    training_numbers(&metadata).map_err(damaged)?;
    let tensors = Tensors { path, tensors };
    let mesh = tensors.mesh(metadata.electrodes)?;
    let protocol = tensors.protocol(metadata.electrodes)?;
    for (what, stated, found) in [
        ("geometry", &metadata.geometry, mesh.hash().to_owned()),
        ("survey", &metadata.survey, protocol.hash()),
    ] {
        if *stated != found {
            return Err(damaged(format!(
                "it states {what} {stated} and has {found}"
            )));
        }
    }
    let network = match metadata.kind {
        Kind::Rbf => tensors.rbf(protocol.len(), mesh.region().len())?,
        Kind::Deep => tensors.deep(protocol.len())?,
    };
    fits(&network, &mesh, &protocol).map_err(damaged)?;
    Ok(Model {
        metadata,
        mesh: Arc::new(mesh),
        protocol,
        network,
        hash,
    })
}

fn damaged(path: &Path, why: String) -> ModelError {
    ModelError::Damaged {
        path: path.to_owned(),
        why,
    }
}

fn foreign(path: &Path, why: &str) -> ModelError {
    ModelError::Foreign {
        path: path.to_owned(),
        why: why.to_owned(),
    }
}

/// The header of the file: names, shapes and places of its tensors, and entries of text.
fn tensor_info(path: &Path, bytes: &[u8]) -> Result<TensorInfo, ModelError> {
    let truncated = || ModelError::Truncated {
        path: path.to_owned(),
    };
    let header = bytes.first_chunk::<8>().ok_or_else(truncated)?;
    let header = u64::from_le_bytes(*header);
    if bytes.len() > 8 && bytes[8] != b'{' || header > 100_000_000 {
        return Err(foreign(path, "it has no safetensors header"));
    }
    if header + 8 > bytes.len() as u64 {
        return Err(truncated());
    }
    match SafeTensors::read_metadata(bytes) {
        Ok((_, info)) => Ok(info),
        Err(fault) => Err(match promised(&bytes[8..8 + header as usize]) {
            Some(length) if length.saturating_add(8 + header) > bytes.len() as u64 => truncated(),
            _ => foreign(path, &fault.to_string()),
        }),
    }
}

/// Number of bytes of tensors that a safetensors header declares.
fn promised(header: &[u8]) -> Option<u64> {
    let header: serde_json::Value = serde_json::from_slice(header).ok()?;
    header
        .as_object()?
        .values()
        .filter_map(|tensor| tensor["data_offsets"][1].as_u64())
        .max()
}

/// The metadata entry of this project, parsed and as text.
fn metadata<'a>(path: &Path, info: &'a TensorInfo) -> Result<(Metadata, &'a str), ModelError> {
    let text = info
        .metadata()
        .as_ref()
        .and_then(|entries| entries.get(KEY))
        .ok_or_else(|| foreign(path, "it is safetensors without a 'tactus' entry"))?;
    let entry: serde_json::Value =
        serde_json::from_str(text).map_err(|_| foreign(path, "its 'tactus' entry is not JSON"))?;
    let (kind, version) = (&entry["kind"], &entry["version"]);
    if !(kind == "rbf" || kind == "deep") || version != VERSION {
        return Err(ModelError::Kind {
            path: path.to_owned(),
            holds: format!("kind {kind} of version {version}"),
        });
    }
    let metadata: Metadata =
        serde_json::from_value(entry).map_err(|fault| damaged(path, fault.to_string()))?;
    // programs print and record these texts
    for (what, text) in [
        ("name", &metadata.name),
        ("normalisation", &metadata.normalisation),
        ("build", &metadata.build),
    ] {
        if survey::printable(text) != text.as_str() {
            return Err(damaged(
                path,
                format!("its {what} has characters that cannot be shown"),
            ));
        }
    }
    Ok((metadata, text))
}

/// The checksum of the tensors and of the metadata, whose text is given.
fn content_checksum(metadata: &Metadata, text: &str, tensors: &SafeTensors<'_>) -> String {
    let mut views = tensors.tensors();
    views.sort_by(|a, b| a.0.cmp(&b.0));
    let blank = text.replacen(
        &stated_checksum(&metadata.checksum),
        &stated_checksum(""),
        1,
    );
    let views = views
        .iter()
        .map(|(name, view)| (name.as_str(), view.dtype(), view.shape(), view.data()));
    checksum(&blank, views)
}

/// Checks the numbers of the training record; the error describes the first impossible one.
fn training_numbers(metadata: &Metadata) -> Result<(), String> {
    let misfit = metadata.own_misfit.as_ref();
    if misfit.is_some_and(|misfit| !misfit.is_sound()) {
        return Err(
            "its own_misfit has no classes, classes out of order, or impossible numbers; train it again"
                .to_owned(),
        );
    }
    match &metadata.report {
        Report::Rbf(report) if !(report.familiar >= 0.0 && report.familiar.is_finite()) => {
            Err(format!(
                "its training inputs lie within {} spreads of a centre, which is not a possible distance; train it again",
                report.familiar
            ))
        }
        _ => Ok(()),
    }
}

/// The tensors of a file.
struct Tensors<'a> {
    path: &'a Path,
    tensors: SafeTensors<'a>,
}

impl<'a> Tensors<'a> {
    fn damaged(&self, why: String) -> ModelError {
        damaged(self.path, why)
    }

    fn has(&self, name: &str) -> bool {
        self.tensors.tensor(name).is_ok()
    }

    fn any(&self, name: &str) -> Result<TensorView<'a>, ModelError> {
        self.tensors
            .tensor(name)
            .map_err(|fault| self.damaged(format!("tensor '{name}': {fault}")))
    }

    /// The tensor of this name and type with `width` columns; 0: any number of columns.
    fn tensor(&self, name: &str, kind: Dtype, width: usize) -> Result<TensorView<'a>, ModelError> {
        let found = self.any(name)?;
        let wide = found.shape().get(1).copied().unwrap_or(1);
        if found.dtype() != kind || width != 0 && wide != width {
            return Err(self.damaged(format!(
                "tensor '{name}' is {:?} of shape {:?}",
                found.dtype(),
                found.shape()
            )));
        }
        Ok(found)
    }

    fn indices(&self, name: &str, width: usize) -> Result<Vec<usize>, ModelError> {
        let found = self.tensor(name, Dtype::U32, width)?;
        Ok(numbers(&found, |bytes| u32::from_le_bytes(bytes) as usize))
    }

    fn doubles(&self, name: &str, width: usize) -> Result<Vec<f64>, ModelError> {
        let found = self.tensor(name, Dtype::F64, width)?;
        Ok(numbers(&found, f64::from_le_bytes))
    }

    fn floats(&self, name: &str, width: usize) -> Result<Vec<f32>, ModelError> {
        let found = self.tensor(name, Dtype::F32, width)?;
        Ok(numbers(&found, f32::from_le_bytes))
    }

    /// The first number of the tensor with this name.
    fn first<T: Copy>(&self, name: &str, numbers: &[T]) -> Result<T, ModelError> {
        let first = numbers.first().copied();
        first.ok_or_else(|| self.damaged(format!("tensor '{name}' is empty")))
    }

    fn mesh(&self, electrodes: usize) -> Result<Mesh, ModelError> {
        let ends = self.indices("electrode_edges", 3)?;
        // Every electrode has an edge: a larger number would only allocate memory.
        if electrodes > ends.len() / 3 {
            return Err(self.damaged(format!(
                "it states {electrodes} electrodes and has {} edges of them",
                ends.len() / 3
            )));
        }
        let mut edges = vec![Vec::new(); electrodes];
        for edge in ends.chunks(3) {
            edges
                .get_mut(edge[0])
                .ok_or_else(|| self.damaged(format!("an edge of electrode {}", edge[0])))?
                .push([edge[1], edge[2]]);
        }
        let nodes = self.doubles("nodes", 2)?;
        let mesh = Mesh::new(
            nodes.chunks(2).map(|p| [p[0], p[1]]).collect(),
            self.indices("triangles", 3)?
                .chunks(3)
                .map(|t| [t[0], t[1], t[2]])
                .collect(),
            edges,
            Some(self.indices("region", 1)?),
        )
        .map_err(|fault| self.damaged(fault.to_string()))?;
        Ok(mesh.with_depth(self.depth()?))
    }

    fn depth(&self) -> Result<Option<Depth>, ModelError> {
        if !self.has("depth") {
            return Ok(None);
        }
        let numbers = <[f64; 5]>::try_from(self.doubles("depth", 0)?)
            .map_err(|_| self.damaged("tensor 'depth' has not 5 numbers".to_owned()))?;
        let depth = Depth::of_numbers(numbers).map_err(|fault| self.damaged(fault.to_string()))?;
        Ok(Some(depth))
    }

    fn protocol(&self, electrodes: usize) -> Result<Protocol, ModelError> {
        let dipole = |plus, minus| Dipole {
            plus: Electrode(plus),
            minus: Electrode(minus),
        };
        let measurements = self.indices("protocol", 4)?;
        let measurements = measurements.chunks(4).map(|q| Measurement {
            drive: dipole(q[0], q[1]),
            sense: dipole(q[2], q[3]),
        });
        Protocol::new(electrodes, measurements.collect())
            .map_err(|fault| self.damaged(fault.to_string()))
    }

    fn rbf(&self, inputs: usize, outputs: usize) -> Result<Network, ModelError> {
        let centres = self.tensor("centres", Dtype::F32, inputs)?;
        // A scalar has no shape and counts as a column of width 1.
        let neurons = centres.shape().first().copied().unwrap_or(1);
        let network = RbfNetwork::new(
            [inputs, outputs],
            self.first("spread", &self.doubles("spread", 1)?)?,
            numbers(&centres, f32::from_le_bytes),
            self.doubles("mixing", neurons)?,
            self.floats("weights", outputs)?,
        );
        Ok(Network::Rbf(network.map_err(|why| self.damaged(why))?))
    }

    fn deep(&self, inputs: usize) -> Result<Network, ModelError> {
        let mut layers = Vec::new();
        let mut width = inputs;
        while self.has(&layer_name(layers.len(), "bias")) {
            let layer = self.layer(layers.len(), width)?;
            width = layer.bias.len();
            layers.push(layer);
        }
        let network = DeepNetwork::new(
            self.floats("input.mean", 1)?,
            self.floats("input.gain", 1)?,
            self.floats("input.shift", 1)?,
            layers,
        )
        .map_err(|why| self.damaged(why))?;
        let limit = self.floats("familiar.limit", 1)?;
        let familiar = TrainingDistribution {
            mean: self.floats("familiar.mean", 1)?,
            directions: self.floats("familiar.directions", inputs)?,
            deviations: self.floats("familiar.deviations", 1)?,
            limit: self.first("familiar.limit", &limit)?,
        };
        Ok(Network::Deep(network, familiar))
    }

    /// A layer with this number of inputs.
    fn layer(&self, index: usize, inputs: usize) -> Result<Layer, ModelError> {
        let name = |what| layer_name(index, what);
        let bias = self.floats(&name("bias"), 1)?;
        let weights = name("weights");
        let weights = match self.any(&weights)?.dtype() {
            Dtype::F16 => Weights::F16(numbers(
                &self.tensor(&weights, Dtype::F16, inputs)?,
                f16::from_le_bytes,
            )),
            Dtype::I8 => Weights::Int8 {
                values: numbers(
                    &self.tensor(&weights, Dtype::I8, inputs)?,
                    i8::from_le_bytes,
                ),
                scales: self.floats(&name("scales"), 1)?,
            },
            _ => Weights::F32(self.floats(&weights, inputs)?),
        };
        Ok(Layer { weights, bias })
    }
}

/// The numbers of a tensor, of `N` bytes each.
fn numbers<T, const N: usize>(tensor: &TensorView<'_>, number: impl Fn([u8; N]) -> T) -> Vec<T> {
    let (values, _) = tensor.data().as_chunks::<N>();
    values.iter().map(|bytes| number(*bytes)).collect()
}
