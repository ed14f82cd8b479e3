//! Format of model files: tensors and one JSON entry. Reading validates shapes, checksum and version.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use half::f16;
use safetensors::tensor::{Dtype, SafeTensors, TensorView, View};
use sha2::{Digest, Sha256};
use survey::{Dipole, Electrode, Measurement, Protocol};

use super::{Kind, Metadata, Model, ModelError, Network, Report, VERSION, fingerprint, fits};
use crate::inverse::learned::network::{DeepNetwork, Layer, TrainingDistribution, Weights};
use crate::{Depth, Mesh, RbfNetwork};

/// Name of the one metadata entry.
const KEY: &str = "tactus";

/// The bytes of a model's file, and its checksum.
pub(super) fn bytes(model: &Model) -> Result<(Vec<u8>, String), ModelError> {
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
    let mut tensors = vec![
        (
            "nodes".to_owned(),
            Tensor::f64(&nodes, &[mesh.nodes().len(), 2]),
        ),
        (
            "triangles".to_owned(),
            Tensor::u32(&triangles, &[mesh.triangles().len(), 3]),
        ),
        (
            "electrode_edges".to_owned(),
            Tensor::u32(&edges, &[edges.len() / 3, 3]),
        ),
        (
            "region".to_owned(),
            Tensor::u32(mesh.region(), &[mesh.region().len()]),
        ),
        (
            "protocol".to_owned(),
            Tensor::u32(&questions, &[model.protocol.len(), 4]),
        ),
    ];
    if let Some(depth) = mesh.depth() {
        tensors.push(("depth".to_owned(), Tensor::f64(&depth.numbers(), &[5])));
    }
    match &model.network {
        Network::Rbf(network) => tensors.extend(of_rbf(network)),
        Network::Deep(network, familiar) => tensors.extend(of_deep(network, familiar)),
    }
    tensors.sort_by(|a, b| a.0.cmp(&b.0));
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
    // a single entry: the order of several would be random
    let metadata = HashMap::from([(KEY.to_owned(), text)]);
    let bytes = safetensors::serialize(tensors, Some(metadata))
        .map_err(|fault| unfit(fault.to_string()))?;
    Ok((bytes, checksum))
}

fn of_rbf(network: &RbfNetwork) -> Vec<(String, Tensor)> {
    let neurons = network.neurons();
    let rank = network.mixing.len() / neurons;
    vec![
        (
            "centres".to_owned(),
            Tensor::f32(&network.centres, &[neurons, network.inputs]),
        ),
        ("spread".to_owned(), Tensor::f64(&[network.spread], &[1])),
        (
            "mixing".to_owned(),
            Tensor::f64(&network.mixing, &[rank, neurons]),
        ),
        (
            "weights".to_owned(),
            Tensor::f32(&network.weights, &[rank, network.outputs]),
        ),
    ]
}

fn of_deep(network: &DeepNetwork, familiar: &TrainingDistribution) -> Vec<(String, Tensor)> {
    let inputs = network.inputs();
    let mut tensors = Vec::new();
    for (name, values) in ["mean", "gain", "shift"]
        .iter()
        .zip(network.normalisation())
    {
        tensors.push((format!("input.{name}"), Tensor::f32(values, &[inputs])));
    }
    for (index, layer) in network.layers().iter().enumerate() {
        let shape = [layer.outputs(), layer.inputs()];
        let mut push = |what: &str, tensor| tensors.push((layer_name(index, what), tensor));
        push("bias", Tensor::f32(&layer.bias, &shape[..1]));
        match &layer.weights {
            Weights::F32(values) => push("weights", Tensor::f32(values, &shape)),
            Weights::F16(values) => push("weights", Tensor::f16(values, &shape)),
            Weights::Int8 { values, scales } => {
                push("weights", Tensor::i8(values, &shape));
                push("scales", Tensor::f32(scales, &shape[..1]));
            }
        }
    }
    let kept = familiar.deviations.len();
    tensors.extend([
        (
            "familiar.mean".to_owned(),
            Tensor::f32(&familiar.mean, &[inputs]),
        ),
        (
            "familiar.directions".to_owned(),
            Tensor::f32(&familiar.directions, &[kept - 1, inputs]),
        ),
        (
            "familiar.deviations".to_owned(),
            Tensor::f32(&familiar.deviations, &[kept]),
        ),
        (
            "familiar.limit".to_owned(),
            Tensor::f32(&[familiar.limit], &[1]),
        ),
    ]);
    tensors
}

fn layer_name(index: usize, what: &str) -> String {
    format!("layer{}.{what}", index + 1)
}

/// The checksum as written in the metadata.
fn stated_checksum(checksum: &str) -> String {
    format!("\"checksum\":\"{checksum}\"")
}

/// SHA-256 over metadata with an empty checksum and all tensors in the order of their names.
fn checksum<'a>(
    metadata: &str,
    tensors: impl Iterator<Item = (&'a str, Dtype, &'a [usize], &'a [u8])>,
) -> String {
    let mut hasher = Sha256::new();
    hasher.update(metadata.as_bytes());
    for (name, kind, shape, bytes) in tensors {
        hasher.update(format!("{name} {kind:?} {shape:?}").as_bytes());
        hasher.update(bytes);
    }
    survey::hex(&hasher.finalize())
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
            Some(length) if length.saturating_add(8 + header) > bytes.len() as u64 => truncated(),
            _ => foreign(&fault.to_string()),
        }
    })?;
    let text = info
        .metadata()
        .as_ref()
        .and_then(|entries| entries.get(KEY))
        .ok_or_else(|| foreign("it is safetensors without a 'tactus' entry"))?;
    let entry: serde_json::Value =
        serde_json::from_str(text).map_err(|_| foreign("its 'tactus' entry is not JSON"))?;
    let (kind, version) = (&entry["kind"], &entry["version"]);
    if !(kind == "rbf" || kind == "deep") || version != VERSION {
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
        serde_json::from_value(entry).map_err(|fault| damaged(fault.to_string()))?;
    // programs print and record these
    for (what, text) in [
        ("name", &metadata.name),
        ("normalisation", &metadata.normalisation),
        ("build", &metadata.build),
    ] {
        if survey::printable(text) != text.as_str() {
            return Err(damaged(format!(
                "its {what} has characters that cannot be shown"
            )));
        }
    }
    let tensors = SafeTensors::deserialize(bytes).map_err(|fault| damaged(fault.to_string()))?;
    // the hash of the file and its internal checksum each read every byte: computed in parallel
    let (hash, summed) = rayon::join(
        || fingerprint(bytes),
        || {
            let mut views = tensors.tensors();
            views.sort_by(|a, b| a.0.cmp(&b.0));
            let blank = text.replacen(
                &stated_checksum(&metadata.checksum),
                &stated_checksum(""),
                1,
            );
            checksum(
                &blank,
                views
                    .iter()
                    .map(|(name, view)| (name.as_str(), view.dtype(), view.shape(), view.data())),
            )
        },
    );
    if summed != metadata.checksum {
        return Err(damaged(format!(
            "its checksum is {}, its content's is {summed}; copy it again",
            metadata.checksum
        )));
    }
    let misfit = metadata.own_misfit.as_ref();
    if misfit.is_some_and(|misfit| !misfit.is_sound()) {
        return Err(damaged(
            "its own_misfit has no classes, classes out of order, or numbers that cannot be; train it again"
                .to_owned(),
        ));
    }
    if let Report::Rbf(report) = &metadata.report
        && !(report.familiar >= 0.0 && report.familiar.is_finite())
    {
        return Err(damaged(format!(
            "its training inputs lie within {} spreads of a centre, which is no distance; train it again",
            report.familiar
        )));
    }
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
    let index = |name, width| {
        Ok::<_, ModelError>(numbers(&tensor(name, Dtype::U32, width)?, |bytes| {
            u32::from_le_bytes(bytes) as usize
        }))
    };
    let ends = index("electrode_edges", 3)?;
    // Every electrode has an edge: a larger number would only allocate memory.
    if metadata.electrodes > ends.len() / 3 {
        return Err(damaged(format!(
            "it says {} electrodes and holds {} edges of them",
            metadata.electrodes,
            ends.len() / 3
        )));
    }
    let mut edges = vec![Vec::new(); metadata.electrodes];
    for edge in ends.chunks(3) {
        edges
            .get_mut(edge[0])
            .ok_or_else(|| damaged(format!("an edge of electrode {}", edge[0])))?
            .push([edge[1], edge[2]]);
    }
    let nodes = numbers(&tensor("nodes", Dtype::F64, 2)?, f64::from_le_bytes);
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
    let depth = match tensors.tensor("depth") {
        Ok(_) => {
            let numbers = numbers(&tensor("depth", Dtype::F64, 0)?, f64::from_le_bytes);
            let numbers = <[f64; 5]>::try_from(numbers)
                .map_err(|_| damaged("tensor 'depth' has not 5 numbers".to_owned()))?;
            Some(Depth::of_numbers(numbers).map_err(|fault| damaged(fault.to_string()))?)
        }
        Err(_) => None,
    };
    let mesh = mesh.with_depth(depth);
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
    for (what, stated, found) in [
        ("geometry", &metadata.geometry, mesh.hash().to_owned()),
        ("survey", &metadata.survey, protocol.hash()),
    ] {
        if *stated != found {
            return Err(damaged(format!(
                "it says {what} {stated} and holds {found}"
            )));
        }
    }
    let first = |name: &str, values: Vec<f64>| {
        values
            .first()
            .copied()
            .ok_or_else(|| damaged(format!("tensor '{name}' is empty")))
    };
    let network = match metadata.kind {
        Kind::Rbf => {
            let centres = tensor("centres", Dtype::F32, protocol.len())?;
            // A scalar has no shape and counts as a column of width 1.
            let neurons = centres.shape().first().copied().unwrap_or(1);
            let network = RbfNetwork::new(
                [protocol.len(), mesh.region().len()],
                first(
                    "spread",
                    numbers(&tensor("spread", Dtype::F64, 1)?, f64::from_le_bytes),
                )?,
                numbers(&centres, f32::from_le_bytes),
                numbers(&tensor("mixing", Dtype::F64, neurons)?, f64::from_le_bytes),
                numbers(
                    &tensor("weights", Dtype::F32, mesh.region().len())?,
                    f32::from_le_bytes,
                ),
            );
            Network::Rbf(network.map_err(damaged)?)
        }
        Kind::Deep => {
            let floats = |name: &str, width| {
                Ok::<_, ModelError>(numbers(
                    &tensor(name, Dtype::F32, width)?,
                    f32::from_le_bytes,
                ))
            };
            let mut layers = Vec::new();
            let mut width = protocol.len();
            while tensors.tensor(&layer_name(layers.len(), "bias")).is_ok() {
                let name = |what| layer_name(layers.len(), what);
                let bias = floats(&name("bias"), 1)?;
                let kept = tensors
                    .tensor(&name("weights"))
                    .map_err(|fault| damaged(format!("tensor '{}': {fault}", name("weights"))))?;
                let weights = match kept.dtype() {
                    Dtype::F16 => Weights::F16(numbers(
                        &tensor(&name("weights"), Dtype::F16, width)?,
                        f16::from_le_bytes,
                    )),
                    Dtype::I8 => Weights::Int8 {
                        values: numbers(
                            &tensor(&name("weights"), Dtype::I8, width)?,
                            i8::from_le_bytes,
                        ),
                        scales: floats(&name("scales"), 1)?,
                    },
                    _ => Weights::F32(floats(&name("weights"), width)?),
                };
                width = bias.len();
                layers.push(Layer { weights, bias });
            }
            let network = DeepNetwork::new(
                floats("input.mean", 1)?,
                floats("input.gain", 1)?,
                floats("input.shift", 1)?,
                layers,
            )
            .map_err(damaged)?;
            let limit = floats("familiar.limit", 1)?;
            let familiar = TrainingDistribution {
                mean: floats("familiar.mean", 1)?,
                directions: floats("familiar.directions", protocol.len())?,
                deviations: floats("familiar.deviations", 1)?,
                limit: first("familiar.limit", limit.into_iter().map(f64::from).collect())? as f32,
            };
            Network::Deep(network, familiar)
        }
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

/// Number of bytes of tensors according to a safetensors header.
fn promised(header: &[u8]) -> Option<u64> {
    let header: serde_json::Value = serde_json::from_slice(header).ok()?;
    header
        .as_object()?
        .values()
        .filter_map(|tensor| tensor["data_offsets"][1].as_u64())
        .max()
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

/// The numbers of a tensor, of `N` bytes each.
fn numbers<T, const N: usize>(tensor: &TensorView<'_>, number: impl Fn([u8; N]) -> T) -> Vec<T> {
    let (values, _) = tensor.data().as_chunks::<N>();
    values.iter().map(|bytes| number(*bytes)).collect()
}

#[cfg(test)]
mod tests {
    use survey::{Reading, Volts};

    use super::*;
    use crate::{DiscTank, MisfitClass, OwnMisfit, TrainingReport, TrainingSettings};

    /// A network of one neuron, at the input without a change.
    fn model() -> Model {
        let tank = DiscTank {
            electrodes: 8,
            fineness: 0.5,
            ..DiscTank::default()
        };
        let mesh = Arc::new(tank.mesh().unwrap());
        let protocol = Protocol::sheffield(8).unwrap();
        let [inputs, outputs] = [protocol.len(), mesh.region().len()];
        let network = RbfNetwork::new(
            [inputs, outputs],
            1.0,
            vec![0.0; inputs],
            vec![1.0],
            vec![0.0; outputs],
        );
        let report = TrainingReport {
            unchanged: 0,
            jitter: 1.0,
            rounds: 1,
            reseeded: 0,
            spread: 1.0,
            spread_over_median: 1.0,
            familiar: 1.0,
            rank: 1,
            condition: 1.0,
            largest_weight: 0.0,
        };
        Model::new(
            "test",
            mesh,
            &protocol,
            Network::Rbf(network.unwrap()),
            TrainingSettings::default(),
            Report::Rbf(report),
            None,
        )
        .unwrap()
    }

    /// From the file of the model, whatever its metadata.
    fn read(model: &Model) -> Result<Model, ModelError> {
        parse(Path::new("a.safetensors"), &bytes(model).unwrap().0)
    }

    fn with_familiar(familiar: f64) -> Model {
        let mut model = model();
        let Report::Rbf(report) = &mut model.metadata.report else {
            unreachable!("it is an RBF network");
        };
        report.familiar = familiar;
        model
    }

    #[test]
    fn a_wrong_own_misfit_is_refused() {
        let class = |above| MisfitClass {
            above,
            cases: 100,
            median: 0.2,
            limit: 0.6,
        };
        let sound = OwnMisfit {
            noise: 1e-5,
            classes: vec![class(1e-4), class(1e-3)],
        };
        let with = |misfit: &OwnMisfit| {
            let mut model = model();
            model.metadata.own_misfit = Some(misfit.clone());
            model
        };
        let loaded = read(&with(&sound)).unwrap();
        assert_eq!(loaded.metadata.own_misfit.as_ref(), Some(&sound));
        let wrong = |change: fn(&mut OwnMisfit)| {
            let mut misfit = sound.clone();
            change(&mut misfit);
            misfit
        };
        for misfit in [
            wrong(|misfit| misfit.classes.reverse()),
            wrong(|misfit| misfit.classes.clear()),
            wrong(|misfit| misfit.classes[1].limit = 0.1),
            wrong(|misfit| misfit.classes[0].median = -0.1),
            wrong(|misfit| misfit.classes[0].cases = 0),
            wrong(|misfit| misfit.noise = 0.0),
        ] {
            let refused = read(&with(&misfit)).unwrap_err();
            let damaged =
                matches!(&refused, ModelError::Damaged { why, .. } if why.contains("own_misfit"));
            assert!(damaged, "{misfit:?}: {refused}");
            assert!(model().with_own_misfit(misfit).is_err());
        }
        // JSON has no such number: the file could never be read
        let unknown = wrong(|misfit| misfit.classes[0].limit = f64::NAN);
        assert!(model().with_own_misfit(unknown).is_err());
    }

    #[test]
    fn novelty_needs_a_distance_of_the_training_inputs() {
        let volts = |volts| vec![Reading::Ok(Volts(volts)); model().protocol.len()];
        let (baseline, frame) = (volts(1.0), volts(1.3));
        let quality = |familiar| {
            let network = read(&with_familiar(familiar)).unwrap().into_reconstructor();
            network.reconstruct(&baseline, &frame).unwrap().quality
        };
        assert!(quality(1.0).is_some_and(|quality| quality.text().contains("1.9 times")));
        assert_eq!(quality(5.0), None);
        // as many neurons as samples
        assert_eq!(quality(0.0), None);
        let refused = read(&with_familiar(-1.0)).unwrap_err();
        assert!(matches!(refused, ModelError::Damaged { .. }), "{refused}");
    }
}
