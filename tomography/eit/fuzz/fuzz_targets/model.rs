//! A model file of arbitrary bytes, a damaged one, and one with the fuzzer's content and a matching checksum: each is
//! read or refused, and never panics. A damaged file that is read must equal what was written.

#![no_main]

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use eit::model::{load, save};
use eit::{
    DiscTank, Model, ModelError, Network, RbfNetwork, Report, TrainingReport, TrainingSettings,
};
use libfuzzer_sys::fuzz_target;
use safetensors::tensor::{Dtype, SafeTensors, View};
use sha2::{Digest, Sha256};
use survey::{Protocol, Reading, Volts};

struct Made {
    path: PathBuf,
    model: Model,
    bytes: Vec<u8>,
    text: String,
    tensors: Vec<(String, Tensor)>,
}

#[derive(Clone)]
struct Tensor {
    kind: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

static MADE: OnceLock<Made> = OnceLock::new();

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, bytes)) = bytes.split_first() else {
        return;
    };
    let made = MADE.get_or_init(make);
    match kind % 4 {
        0 => {
            let _ = read(&made.path, bytes);
        }
        1 => {
            let damaged = damaged(&made.bytes, bytes);
            if let Ok(model) = read(&made.path, &damaged) {
                // Spaces or an additional entry in the header's JSON change the file but not the model.
                assert_eq!(model.network(), made.model.network());
                assert_eq!(model.protocol(), made.model.protocol());
                assert_eq!(model.mesh().hash(), made.model.mesh().hash());
            }
        }
        _ => {
            let (text, tensors) = altered(made, bytes);
            let Some(sealed) = seal(&text, tensors) else {
                return;
            };
            let Ok(model) = read(&made.path, &sealed) else {
                return;
            };
            let readings = model.protocol().len();
            let flat = vec![Reading::Ok(Volts(1e-3)); readings];
            let still = model.clone().into_reconstructor().reconstruct(&flat, &flat);
            if let Ok(map) = still {
                assert_eq!(map.values.len(), model.mesh().region().len());
            }
        }
    }
});

fn read(path: &Path, bytes: &[u8]) -> Result<Model, ModelError> {
    std::fs::write(path, bytes).expect("a temporary file");
    load(path)
}

/// Each order: position in the header or the tensors, and how many bytes to overwrite.
fn damaged(bytes: &[u8], mut orders: &[u8]) -> Vec<u8> {
    let mut damaged = bytes.to_vec();
    while let Some((&[low, high, length], rest)) = orders.split_first_chunk() {
        let at = usize::from(u16::from_le_bytes([low, high])) * bytes.len() / 65_536;
        if length == 255 {
            damaged.truncate(at);
            break;
        }
        let length = usize::from(length % 16)
            .min(bytes.len() - at)
            .min(rest.len());
        let (new, rest) = rest.split_at(length);
        damaged[at..at + length].copy_from_slice(new);
        orders = rest;
    }
    damaged
}

/// Metadata and tensors with the fuzzer's changes.
fn altered(made: &Made, mut orders: &[u8]) -> (String, Vec<(String, Tensor)>) {
    let mut text = made.text.clone().into_bytes();
    let mut tensors = made.tensors.clone();
    while let Some((&[order, low, high, length], rest)) = orders.split_first_chunk() {
        let (new, rest) = rest.split_at(usize::from(length % 16).min(rest.len()));
        orders = rest;
        let place = u16::from_le_bytes([low, high]);
        let which = usize::from(order >> 3) % tensors.len().max(1);
        match order % 8 {
            0..3 => {
                // Overwrite a digit of the metadata: other changes soon break the JSON.
                let digits: Vec<usize> = (1..text.len())
                    .filter(|&at| text[at].is_ascii_digit() && text[at - 1] == b':')
                    .collect();
                let Some(&at) = digits.get(usize::from(place) % digits.len().max(1)) else {
                    continue;
                };
                let end = at + text[at..].iter().take_while(|b| b.is_ascii_digit()).count();
                let number = new.iter().map(|byte| b'0' + byte % 10);
                text.splice(at..end, number);
            }
            3 => {
                let at = usize::from(place) * text.len() / 65_536;
                let end = (at + new.len()).min(text.len());
                text.splice(at..end, new.iter().copied());
            }
            _ if tensors.is_empty() => {}
            4 | 5 => {
                let bytes = &mut tensors[which].1.bytes;
                let at = usize::from(place) * bytes.len() / 65_536;
                let end = (at + new.len()).min(bytes.len());
                bytes[at..end].copy_from_slice(&new[..end - at]);
            }
            6 => {
                let tensor = &mut tensors[which].1;
                tensor.shape = new
                    .iter()
                    .map(|extent| usize::from(*extent))
                    .take(4)
                    .collect();
                let length = tensor.shape.iter().product::<usize>().min(1 << 20);
                tensor.bytes.resize(length * size(tensor.kind), low);
            }
            _ if length >= 128 => drop(tensors.remove(which)),
            _ => {
                let tensor = &mut tensors[which].1;
                tensor.kind = [Dtype::F64, Dtype::F32, Dtype::F16, Dtype::U32, Dtype::I8]
                    [usize::from(low) % 5];
                let length = tensor.shape.iter().product::<usize>().min(1 << 20);
                tensor.bytes.resize(length * size(tensor.kind), high);
            }
        }
    }
    (String::from_utf8_lossy(&text).into_owned(), tensors)
}

fn size(kind: Dtype) -> usize {
    match kind {
        Dtype::F64 => 8,
        Dtype::F32 | Dtype::U32 => 4,
        Dtype::F16 => 2,
        _ => 1,
    }
}

/// The file with this content and a matching checksum; `text` has an empty one.
fn seal(text: &str, mut tensors: Vec<(String, Tensor)>) -> Option<Vec<u8>> {
    tensors.sort_by(|a, b| a.0.cmp(&b.0));
    let mut hasher = Sha256::new();
    hasher.update(text.as_bytes());
    for (name, Tensor { kind, shape, bytes }) in &tensors {
        hasher.update(format!("{name} {kind:?} {shape:?}").as_bytes());
        hasher.update(bytes);
    }
    let digits: String = hasher
        .finalize()
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    let text = text.replacen(
        "\"checksum\":\"\"",
        &format!("\"checksum\":\"{digits}\""),
        1,
    );
    safetensors::serialize(tensors, Some(HashMap::from([("tactus".to_owned(), text)]))).ok()
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

fn make() -> Made {
    let memory = Path::new("/dev/shm");
    let base = if memory.is_dir() {
        memory.to_owned()
    } else {
        std::env::temp_dir()
    };
    let folder = tempfile::Builder::new()
        .prefix("fuzz")
        .tempdir_in(base)
        .expect("a temporary folder")
        .keep();
    let tank = DiscTank {
        radius_mm: 100.0,
        electrodes: 8,
        fineness: 0.5,
        ..DiscTank::default()
    };
    let mesh = Arc::new(tank.mesh().expect("a small tank"));
    let protocol = Protocol::sheffield(8).expect("8 electrodes");
    let (network, report) = small_network(protocol.len(), mesh.region().len());
    let model = Model::new(
        "fuzzed",
        mesh,
        &protocol,
        network,
        TrainingSettings::default(),
        report,
        Some(0.5),
    )
    .expect("a small model");
    let path = folder.join("fuzzed.safetensors");
    save(&path, eit::Existing::Replace, &model).expect("a temporary file");
    let bytes = std::fs::read(&path).expect("the model's file");

    let (_, info) = SafeTensors::read_metadata(&bytes).expect("its header");
    let text = &info.metadata().as_ref().expect("metadata")["tactus"];
    let message = format!(
        "\"checksum\":\"{}\"",
        load(&path).expect("the model").metadata().checksum
    );
    let text = text.replacen(&message, "\"checksum\":\"\"", 1);
    let tensors: Vec<(String, Tensor)> = SafeTensors::deserialize(&bytes)
        .expect("its tensors")
        .tensors()
        .into_iter()
        .map(|(name, view)| {
            let tensor = Tensor {
                kind: view.dtype(),
                shape: view.shape().to_vec(),
                bytes: view.data().to_vec(),
            };
            (name, tensor)
        })
        .collect();
    // Sealing must match the crate, otherwise every file below would be refused for its checksum alone.
    assert_eq!(seal(&text, tensors.clone()).as_ref(), Some(&bytes));
    Made {
        path,
        model,
        bytes,
        text,
        tensors,
    }
}

/// An untrained network of nine neurons.
fn small_network(inputs: usize, outputs: usize) -> (Network, Report) {
    const NEURONS: usize = 9;
    let wave = |count: usize| (0..count).map(|k| 0.01 * (k as f64).sin());
    let network = RbfNetwork::new(
        [inputs, outputs],
        0.2,
        wave(NEURONS * inputs).map(|value| value as f32).collect(),
        wave(NEURONS * NEURONS).collect(),
        wave(NEURONS * outputs).map(|value| value as f32).collect(),
    )
    .expect("parts that fit");
    let report = TrainingReport {
        unchanged: 0,
        jitter: 1e-3,
        rounds: 1,
        reseeded: 0,
        spread: 0.2,
        spread_over_median: 1.0,
        familiar: 1.0,
        rank: NEURONS,
        condition: 10.0,
        largest_weight: 0.01,
    };
    (Network::Rbf(network), Report::Rbf(report))
}
