//! Serializes a model.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};

use half::f16;
use safetensors::tensor::{Dtype, View};

use super::{KEY, checksum, layer_name, stated_checksum};
use crate::inverse::learned::network::Weights;
use crate::model::{Metadata, Model, ModelError, Network};

/// The bytes of a model's file, and its checksum.
pub(in crate::model) fn bytes(model: &Model) -> Result<(Vec<u8>, String), ModelError> {
    let unfit = |why: String| ModelError::Network(why);
    let mesh = &model.mesh;
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
        .flat_map(|q| q.electrodes())
        .map(|electrode| electrode.0)
        .collect();
    let nodes: Vec<f64> = mesh.nodes().iter().flatten().copied().collect();
    let triangles: Vec<usize> = mesh.triangles().iter().flatten().copied().collect();
    // in the order of their names
    let mut tensors = BTreeMap::new();
    let mut put = |name: &str, tensor| {
        tensors.insert(name.to_owned(), tensor);
    };
    put("nodes", Tensor::f64(&nodes, &[mesh.nodes().len(), 2]));
    put(
        "triangles",
        Tensor::u32(&triangles, &[mesh.triangles().len(), 3]),
    );
    put(
        "electrode_edges",
        Tensor::u32(&edges, &[edges.len() / 3, 3]),
    );
    put("region", Tensor::u32(mesh.region(), &[mesh.region().len()]));
    put(
        "protocol",
        Tensor::u32(&questions, &[model.protocol.len(), 4]),
    );
    if let Some(depth) = mesh.depth() {
        put("depth", Tensor::f64(&depth.numbers(), &[5]));
    }
    match &model.network {
        Network::Rbf(network) => {
            let [neurons, inputs] = [network.neurons(), network.inputs];
            let rank = network.mixing.len() / neurons;
            put("centres", Tensor::f32(&network.centres, &[neurons, inputs]));
            put("spread", Tensor::f64(&[network.spread], &[1]));
            put("mixing", Tensor::f64(&network.mixing, &[rank, neurons]));
            put(
                "weights",
                Tensor::f32(&network.weights, &[rank, network.outputs]),
            );
        }
        Network::Deep(network, familiar) => {
            let inputs = network.inputs();
            for (name, values) in ["mean", "gain", "shift"]
                .iter()
                .zip(network.normalisation())
            {
                put(&format!("input.{name}"), Tensor::f32(values, &[inputs]));
            }
            for (index, layer) in network.layers().iter().enumerate() {
                let shape = [layer.outputs(), layer.inputs()];
                let mut put = |what: &str, tensor| put(&layer_name(index, what), tensor);
                put("bias", Tensor::f32(&layer.bias, &shape[..1]));
                match &layer.weights {
                    Weights::F32(values) => put("weights", Tensor::f32(values, &shape)),
                    Weights::F16(values) => put("weights", Tensor::f16(values, &shape)),
                    Weights::Int8 { values, scales } => {
                        put("scales", Tensor::f32(scales, &shape[..1]));
                        put("weights", Tensor::i8(values, &shape));
                    }
                }
            }
            let kept = familiar.deviations.len();
            put("familiar.mean", Tensor::f32(&familiar.mean, &[inputs]));
            put(
                "familiar.directions",
                Tensor::f32(&familiar.directions, &[kept - 1, inputs]),
            );
            put(
                "familiar.deviations",
                Tensor::f32(&familiar.deviations, &[kept]),
            );
            put("familiar.limit", Tensor::f32(&[familiar.limit], &[1]));
        }
    }
    let blank = Metadata {
        checksum: String::new(),
        ..model.metadata.clone()
    };
    let text = serde_json::to_string(&blank).map_err(|fault| unfit(fault.to_string()))?;
    let checksum = checksum(
        &text,
        tensors.iter().map(|(name, tensor)| {
            (
                name.as_str(),
                tensor.kind,
                &tensor.shape[..],
                &tensor.bytes[..],
            )
        }),
    );
    let text = text.replacen(&stated_checksum(""), &stated_checksum(&checksum), 1);
    // a single entry, because the order of several entries would be random
    let metadata = HashMap::from([(KEY.to_owned(), text)]);
    let bytes = safetensors::serialize(tensors, Some(metadata))
        .map_err(|fault| unfit(fault.to_string()))?;
    Ok((bytes, checksum))
}

/// A tensor to write.
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

    fn f16(values: &[f16], shape: &[usize]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        Self::new(Dtype::F16, shape, bytes.collect())
    }

    fn i8(values: &[i8], shape: &[usize]) -> Self {
        let bytes = values.iter().map(|value| value.cast_unsigned());
        Self::new(Dtype::I8, shape, bytes.collect())
    }

    /// Indices of nodes, triangles and electrodes, all far below 2^32.
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
