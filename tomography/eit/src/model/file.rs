//! The layout of a model file: tensors and one JSON entry, written and read back with every doubt resolved.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use safetensors::tensor::{Dtype, SafeTensors, TensorView, View};
use survey::{Dipole, Electrode, Measurement, Protocol};

use super::{Metadata, Model, ModelError, VERSION, fingerprint, fits};
use crate::{Mesh, RbfNetwork};

/// Name of the one metadata entry.
const KEY: &str = "tactus";

/// The content of a model's file.
pub(super) fn bytes(model: &Model) -> Result<Vec<u8>, ModelError> {
    let unfit = |why: String| ModelError::Network(why);
    let mesh = &model.mesh;
    let network = &model.network;
    let neurons = network.neurons();
    let rank = network.mixing.len() / neurons;
    let edges: Vec<usize> = mesh
        .electrode_edges()
        .iter()
        .enumerate()
        .flat_map(|(electrode, edges)| edges.iter().flat_map(move |[a, b]| [electrode, *a, *b]))
        .collect();
    let questions: Vec<usize> = model
        .protocol
        .measurements()
        .iter()
        .flat_map(|q| [q.drive.plus, q.drive.minus, q.sense.plus, q.sense.minus])
        .map(|electrode| electrode.0)
        .collect();
    let nodes: Vec<f64> = mesh.nodes().iter().flatten().copied().collect();
    let triangles: Vec<usize> = mesh.triangles().iter().flatten().copied().collect();
    let tensors = [
        ("nodes", Tensor::f64(&nodes, &[mesh.nodes().len(), 2])),
        (
            "triangles",
            Tensor::u32(&triangles, &[mesh.triangles().len(), 3]),
        ),
        (
            "electrode_edges",
            Tensor::u32(&edges, &[edges.len() / 3, 3]),
        ),
        ("region", Tensor::u32(mesh.region(), &[mesh.region().len()])),
        (
            "protocol",
            Tensor::u32(&questions, &[model.protocol.len(), 4]),
        ),
        (
            "centres",
            Tensor::f32(&network.centres, &[neurons, network.inputs]),
        ),
        ("spread", Tensor::f64(&[network.spread], &[1])),
        ("mixing", Tensor::f64(&network.mixing, &[rank, neurons])),
        (
            "weights",
            Tensor::f32(&network.weights, &[rank, network.outputs]),
        ),
    ];
    let metadata =
        serde_json::to_string(&model.metadata).map_err(|fault| unfit(fault.to_string()))?;
    // one entry only: a map with more would be written in a random order
    let metadata = HashMap::from([(KEY.to_owned(), metadata)]);
    safetensors::serialize(tensors, Some(metadata)).map_err(|fault| unfit(fault.to_string()))
}

/// A model from the content of its file; `path` is for messages.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Model, ModelError> {
    let foreign = |why: &str| ModelError::Foreign {
        path: path.to_owned(),
        why: why.to_owned(),
    };
    let truncated = || ModelError::Truncated {
        path: path.to_owned(),
    };
    let header = bytes.first_chunk::<8>().ok_or_else(truncated)?;
    let header = u64::from_le_bytes(*header);
    if bytes.len() > 8 && bytes[8] != b'{' || header > 100_000_000 {
        return Err(foreign("it has no safetensors header"));
    }
    if header + 8 > bytes.len() as u64 {
        return Err(truncated());
    }
    let (_, info) = SafeTensors::read_metadata(bytes).map_err(|fault| {
        match promised(&bytes[8..8 + header as usize]) {
            Some(length) if 8 + header + length > bytes.len() as u64 => truncated(),
            _ => foreign(&fault.to_string()),
        }
    })?;
    let text = info
        .metadata()
        .as_ref()
        .and_then(|entries| entries.get(KEY))
        .ok_or_else(|| foreign("it is safetensors without a 'tactus' entry"))?;
    let said: serde_json::Value =
        serde_json::from_str(text).map_err(|_| foreign("its 'tactus' entry is not JSON"))?;
    let (kind, version) = (&said["kind"], &said["version"]);
    if kind != "rbf" || version != VERSION {
        return Err(ModelError::Kind {
            path: path.to_owned(),
            holds: format!("kind {kind} of version {version}"),
        });
    }
    let damaged = |why: String| ModelError::Damaged {
        path: path.to_owned(),
        why,
    };
    let metadata: Metadata =
        serde_json::from_value(said).map_err(|fault| damaged(fault.to_string()))?;
    let tensors = SafeTensors::deserialize(bytes).map_err(|fault| damaged(fault.to_string()))?;
    let tensor = |name: &str, kind, width| {
        let found = tensors
            .tensor(name)
            .map_err(|fault| damaged(format!("tensor '{name}': {fault}")))?;
        let wide = found.shape().get(1).copied().unwrap_or(1);
        if found.dtype() != kind || width != 0 && wide != width {
            return Err(damaged(format!(
                "tensor '{name}' is {:?} of shape {:?}",
                found.dtype(),
                found.shape()
            )));
        }
        Ok(found)
    };
    let index = |name, width| Ok::<_, ModelError>(indices(&tensor(name, Dtype::U32, width)?));
    let mut edges = vec![Vec::new(); metadata.electrodes];
    for edge in index("electrode_edges", 3)?.chunks(3) {
        edges
            .get_mut(edge[0])
            .ok_or_else(|| damaged(format!("an edge of electrode {}", edge[0])))?
            .push([edge[1], edge[2]]);
    }
    let nodes = f64s(&tensor("nodes", Dtype::F64, 2)?);
    let mesh = Mesh::new(
        nodes.chunks(2).map(|p| [p[0], p[1]]).collect(),
        index("triangles", 3)?
            .chunks(3)
            .map(|t| [t[0], t[1], t[2]])
            .collect(),
        edges,
        Some(index("region", 1)?),
    )
    .map_err(|fault| damaged(fault.to_string()))?;
    let questions = index("protocol", 4)?
        .chunks(4)
        .map(|q| {
            let dipole = |plus, minus| Dipole {
                plus: Electrode(plus),
                minus: Electrode(minus),
            };
            Measurement {
                drive: dipole(q[0], q[1]),
                sense: dipole(q[2], q[3]),
            }
        })
        .collect();
    let protocol = Protocol::new(metadata.electrodes, questions)
        .map_err(|fault| damaged(fault.to_string()))?;
    for (what, said, found) in [
        ("geometry", &metadata.geometry, mesh.hash().to_owned()),
        ("survey", &metadata.survey, protocol.hash()),
    ] {
        if *said != found {
            return Err(damaged(format!("it says {what} {said} and holds {found}")));
        }
    }
    let centres = tensor("centres", Dtype::F32, protocol.len())?;
    let neurons = centres.shape()[0];
    let network = RbfNetwork {
        inputs: protocol.len(),
        outputs: mesh.region().len(),
        spread: f64s(&tensor("spread", Dtype::F64, 1)?)
            .first()
            .copied()
            .ok_or_else(|| damaged("tensor 'spread' is empty".to_owned()))?,
        centres: f32s(&centres),
        mixing: f64s(&tensor("mixing", Dtype::F64, neurons)?),
        weights: f32s(&tensor("weights", Dtype::F32, mesh.region().len())?),
    };
    fits(&network, &mesh, &protocol).map_err(damaged)?;
    Ok(Model {
        metadata,
        mesh: Arc::new(mesh),
        protocol,
        network,
        hash: fingerprint(bytes),
    })
}

/// How many bytes of tensors a safetensors header promises.
fn promised(header: &[u8]) -> Option<u64> {
    let header: serde_json::Value = serde_json::from_slice(header).ok()?;
    header
        .as_object()?
        .values()
        .filter_map(|tensor| tensor["data_offsets"][1].as_u64())
        .max()
}

/// A tensor about to be written.
struct Tensor {
    kind: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Tensor {
    fn new(kind: Dtype, shape: &[usize], bytes: Vec<u8>) -> Self {
        Self {
            kind,
            shape: shape.to_vec(),
            bytes,
        }
    }

    fn f64(values: &[f64], shape: &[usize]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        Self::new(Dtype::F64, shape, bytes.collect())
    }

    fn f32(values: &[f32], shape: &[usize]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        Self::new(Dtype::F32, shape, bytes.collect())
    }

    /// Indices of nodes, triangles and electrodes, which are far below 2^32.
    fn u32(values: &[usize], shape: &[usize]) -> Self {
        let bytes = values
            .iter()
            .flat_map(|value| (*value as u32).to_le_bytes());
        Self::new(Dtype::U32, shape, bytes.collect())
    }
}

impl View for Tensor {
    fn dtype(&self) -> Dtype {
        self.kind
    }
    fn shape(&self) -> &[usize] {
        &self.shape
    }
    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.bytes)
    }
    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}

fn f64s(tensor: &TensorView<'_>) -> Vec<f64> {
    let (values, _) = tensor.data().as_chunks::<8>();
    values
        .iter()
        .map(|bytes| f64::from_le_bytes(*bytes))
        .collect()
}

fn f32s(tensor: &TensorView<'_>) -> Vec<f32> {
    let (values, _) = tensor.data().as_chunks::<4>();
    values
        .iter()
        .map(|bytes| f32::from_le_bytes(*bytes))
        .collect()
}

fn indices(tensor: &TensorView<'_>) -> Vec<usize> {
    let (values, _) = tensor.data().as_chunks::<4>();
    values
        .iter()
        .map(|bytes| u32::from_le_bytes(*bytes) as usize)
        .collect()
}
