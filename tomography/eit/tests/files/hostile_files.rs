//! Model files and case folders damaged by chance or on purpose, and files that change during a read.
//! `TACTUS_MUTATIONS` is the number of mutations of each kind; equal numbers give equal mutations.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use eit::inverse::learned::network::{Layer, Rounding, TrainingDistribution, Weights};
use eit::model::{load, save};
use eit::{
    Case, CaseError, DeepNetwork, DeepReport, DeepSettings, DiscTank, Existing, Mesh, Model,
    Network, Precision, RbfNetwork, Report, TrainingReport, TrainingSettings, frames_text,
    load_reconstructor, read_frames,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use safetensors::tensor::{Dtype, SafeTensors, View};
use sha2::{Digest, Sha256};
use survey::{Protocol, Reading, Volts};

fn mutations() -> u64 {
    std::env::var("TACTUS_MUTATIONS").map_or(200, |text| text.parse().unwrap())
}

/// A model of a network made for these numbers of readings and triangles.
fn model(network: fn(usize, usize) -> (Network, Report)) -> Model {
    let tank = DiscTank {
        radius_mm: 100.0,
        electrodes: 8,
        fineness: 0.5,
        ..DiscTank::default()
    };
    let mesh = Arc::new(tank.mesh().unwrap());
    let protocol = Protocol::sheffield(8).unwrap();
    let (network, report) = network(protocol.len(), mesh.region().len());
    let settings = TrainingSettings::default();
    Model::new("small", mesh, &protocol, network, settings, report, None).unwrap()
}

/// An untrained network of nine neurons.
fn rbf(inputs: usize, outputs: usize) -> (Network, Report) {
    const NEURONS: usize = 9;
    let wave = |count: usize| (0..count).map(|k| 0.01 * (k as f64).sin());
    let network = RbfNetwork::new(
        [inputs, outputs],
        0.2,
        wave(NEURONS * inputs).map(|value| value as f32).collect(),
        wave(NEURONS * NEURONS).collect(),
        wave(NEURONS * outputs).map(|value| value as f32).collect(),
    )
    .unwrap();
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

/// An untrained network with a hidden layer of nine, stored as int8.
fn deep(inputs: usize, outputs: usize) -> (Network, Report) {
    const HIDDEN: usize = 9;
    let wave = |count: usize| {
        (0..count)
            .map(|k| 0.01 * (k as f32).sin())
            .collect::<Vec<_>>()
    };
    let layer = |inputs: usize, outputs: usize| Layer {
        weights: Weights::F32(wave(inputs * outputs)),
        bias: wave(outputs),
    };
    let network = DeepNetwork::new(
        wave(inputs),
        vec![1.0; inputs],
        wave(inputs),
        vec![layer(inputs, HIDDEN), layer(HIDDEN, outputs)],
    )
    .unwrap();
    let familiar = TrainingDistribution::learn(&wave(50 * inputs), inputs).unwrap();
    let report = DeepReport {
        settings: DeepSettings::default(),
        parameters: 1,
        samples: 50,
        epochs: 1,
        best_epoch: 1,
        training_loss: 0.5,
        held_out_loss: 0.7,
        empty_loss: 1.4,
        kept: Rounding {
            precision: Precision::Int8,
            map_change: 0.01,
            held_out_loss: 0.71,
        },
    };
    let network = network.with_precision(Precision::Int8);
    (Network::Deep(network, familiar), Report::Deep(report))
}

/// Bytes with one to four changes: overwritten bytes, flipped bits, pieces removed, duplicated or moved.
fn mutated(bytes: &[u8], random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut mutated = bytes.to_vec();
    for _ in 0..random.random_range(1..=4) {
        if mutated.is_empty() {
            break;
        }
        let at = random.random_range(0..mutated.len());
        let length = random.random_range(1..=16).min(mutated.len() - at);
        match random.random_range(0..8) {
            0 => mutated[at] ^= 1 << random.random_range(0..8),
            1 => mutated[at] = random.random(),
            2 => drop(mutated.drain(at..at + length)),
            3 => mutated.truncate(at),
            4 => {
                let piece: Vec<u8> = mutated[at..at + length].to_vec();
                mutated.splice(at..at, piece);
            }
            5 => {
                let piece: Vec<u8> = (0..length).map(|_| random.random()).collect();
                mutated.splice(at..at, piece);
            }
            6 => {
                let from = random.random_range(0..mutated.len());
                mutated.swap(at, from);
            }
            // characters of numbers and of the structure
            _ => {
                let words = [
                    "-1",
                    "1e308",
                    "nan",
                    "inf",
                    "99999999999999999999",
                    "\n",
                    ",",
                    "\"",
                ];
                let word = words[random.random_range(0..words.len())];
                mutated.splice(at..at + length, word.bytes());
            }
        }
    }
    mutated
}

#[test]
fn network_without_readings_or_whole_rows_is_refused() {
    let new = |sizes, centres, mixing, weights| {
        let [centres, weights] = [centres, weights].map(|count| vec![0.1; count]);
        RbfNetwork::new(sizes, 0.2, centres, vec![0.1; mixing], weights)
    };
    // two neurons of four readings, three directions of six triangles
    assert!(new([4, 6], 8, 6, 18).is_ok());
    for (sizes, centres, mixing, weights) in [
        ([0, 6], 8, 6, 18),
        ([4, 0], 8, 6, 18),
        ([4, 6], 0, 6, 18),
        ([4, 6], 9, 6, 18),
        ([4, 6], 8, 7, 18),
        ([4, 6], 8, 6, 20),
        ([4, 6], 8, 0, 0),
    ] {
        let refused = new(sizes, centres, mixing, weights);
        assert!(refused.is_err(), "{sizes:?} {centres} {mixing} {weights}");
    }
}

#[test]
fn a_model_file_may_change_while_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    let model = model(rbf);
    save(&path, Existing::Refuse, &model).unwrap();
    let whole = std::fs::read(&path).unwrap();
    let flat = vec![Reading::Ok(Volts(1e-3)); model.protocol().len()];
    let loaded = load_reconstructor(&path).unwrap();
    let before = loaded.reconstruct(&flat, &flat).unwrap().hash();
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !stop.load(Ordering::Relaxed) {
                let file = std::fs::File::options().write(true).open(&path).unwrap();
                file.set_len(0).unwrap();
                std::fs::write(&path, &whole).unwrap();
            }
        });
        let until = Instant::now() + Duration::from_secs(120);
        let mut refused = 0;
        while refused < 50 && Instant::now() < until {
            match load(&path) {
                Ok(read) => assert_eq!(read.hash(), model.hash()),
                Err(_) => refused += 1,
            }
        }
        stop.store(true, Ordering::Relaxed);
        assert_eq!(refused, 50, "no file was seen half-written");
    });
    std::fs::write(&path, b"").unwrap();
    assert_eq!(loaded.reconstruct(&flat, &flat).unwrap().hash(), before);
}

#[test]
fn a_pipe_in_place_of_a_model_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    for path in [Path::new("/dev/zero"), folder.path()] {
        let refused = load(path).unwrap_err().to_string();
        assert!(refused.contains("no regular file"), "{refused}");
    }
}

#[test]
fn a_mutated_model_is_refused_or_is_the_same_model() {
    mutate(&model(rbf));
    mutate(&model(deep));
}

fn mutate(model: &Model) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    save(&path, Existing::Refuse, model).unwrap();
    // its metadata reads back to within the last digit of the numbers
    let model = load(&path).unwrap();
    let whole = std::fs::read(&path).unwrap();
    let header = 8 + u64::from_le_bytes(*whole.first_chunk().unwrap()) as usize;
    for seed in 0..mutations() {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        // half of them in the header, a small part of the file
        let bytes = match seed % 2 {
            0 => mutated(&whole, &mut random),
            _ => [
                mutated(&whole[..header], &mut random),
                whole[header..].to_vec(),
            ]
            .concat(),
        };
        std::fs::write(&path, &bytes).unwrap();
        match load(&path) {
            Ok(read) => {
                assert_eq!(read.network(), model.network(), "{seed}");
                assert_eq!(read.protocol(), model.protocol(), "{seed}");
                assert_eq!(read.mesh().hash(), model.mesh().hash(), "{seed}");
                assert_eq!(read.metadata(), model.metadata(), "{seed}");
                // a file with other bytes has another hash
                assert_eq!(bytes == whole, read.hash() == model.hash(), "{seed}");
            }
            Err(refused) => {
                let reported = refused.to_string();
                assert!(reported.contains("model.safetensors"), "{seed}: {reported}");
            }
        }
    }
}

#[test]
fn a_forged_model_is_refused_or_makes_maps() {
    forge(&model(rbf));
    forge(&model(deep));
}

fn forge(model: &Model) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    save(&path, Existing::Refuse, model).unwrap();
    let whole = std::fs::read(&path).unwrap();
    let (text, tensors) = opened(&whole);
    // sealing must match the crate, otherwise every file below would be refused for its checksum alone
    assert_eq!(sealed(&text, tensors.clone()).unwrap(), whole);
    for seed in 0..mutations() {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let (mut text, mut tensors) = (text.clone(), tensors.clone());
        match seed % 3 {
            0 => text = String::from_utf8_lossy(&mutated(text.as_bytes(), &mut random)).into(),
            1 => {
                let which = random.random_range(0..tensors.len());
                let tensor = &mut tensors[which].1;
                let at = random.random_range(0..tensor.bytes.len());
                tensor.bytes[at] = random.random();
            }
            _ => {
                let which = random.random_range(0..tensors.len());
                let tensor = &mut tensors[which].1;
                let width = tensor.bytes.len() / tensor.shape.iter().product::<usize>().max(1);
                tensor.shape = (0..random.random_range(0..3))
                    .map(|_| random.random_range(0..40))
                    .collect();
                tensor
                    .bytes
                    .resize(tensor.shape.iter().product::<usize>() * width, 1);
            }
        }
        let Some(forged) = sealed(&text, tensors) else {
            continue;
        };
        std::fs::write(&path, forged).unwrap();
        match load(&path) {
            Ok(read) => {
                let triangles = read.mesh().region().len();
                let flat = vec![Reading::Ok(Volts(1e-3)); read.protocol().len()];
                if let Ok(map) = read.into_reconstructor().reconstruct(&flat, &flat) {
                    assert_eq!(map.values.len(), triangles, "{seed}");
                }
            }
            Err(refused) => {
                let reported = refused.to_string();
                assert!(reported.contains("model.safetensors"), "{seed}: {reported}");
            }
        }
    }
}

#[test]
fn a_name_that_acts_on_a_terminal_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    save(&path, Existing::Refuse, &model(rbf)).unwrap();
    let (text, tensors) = opened(&std::fs::read(&path).unwrap());
    for name in ["\\u001b[2J", "a\\n[notify]", "\\u202e", "\\u0000"] {
        let named = text.replacen("\"small\"", &format!("\"{name}\""), 1);
        assert_ne!(named, text);
        std::fs::write(&path, sealed(&named, tensors.clone()).unwrap()).unwrap();
        let refused = load(&path).unwrap_err().to_string();
        assert!(refused.contains("its name has characters"), "{refused}");
    }
}

#[derive(Clone)]
struct Tensor {
    kind: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
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

/// The metadata without its checksum, and the tensors.
fn opened(bytes: &[u8]) -> (String, Vec<(String, Tensor)>) {
    let (_, info) = SafeTensors::read_metadata(bytes).unwrap();
    let text = &info.metadata().as_ref().unwrap()["tactus"];
    let metadata: serde_json::Value = serde_json::from_str(text).unwrap();
    let message = format!("\"checksum\":{}", metadata["checksum"]);
    let tensors = SafeTensors::deserialize(bytes).unwrap();
    let tensors = tensors.tensors().into_iter().map(|(name, view)| {
        let tensor = Tensor {
            kind: view.dtype(),
            shape: view.shape().to_vec(),
            bytes: view.data().to_vec(),
        };
        (name, tensor)
    });
    (
        text.replacen(&message, "\"checksum\":\"\"", 1),
        tensors.collect(),
    )
}

/// A file with this content and a matching checksum, as anyone with knowledge of the format can make it.
fn sealed(text: &str, mut tensors: Vec<(String, Tensor)>) -> Option<Vec<u8>> {
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
    let checksum = format!("\"checksum\":\"{digits}\"");
    let text = text.replacen("\"checksum\":\"\"", &checksum, 1);
    safetensors::serialize(tensors, Some(HashMap::from([("tactus".to_owned(), text)]))).ok()
}

/// Eight triangles around a node, four electrodes.
fn small_case() -> Case {
    let ring = (0..8).map(|k| {
        let angle = f64::from(k) * std::f64::consts::FRAC_PI_4;
        [0.1 * angle.cos(), 0.1 * angle.sin()]
    });
    let nodes = std::iter::once([0.0, 0.0]).chain(ring).collect();
    let triangles: Vec<_> = (0..8).map(|k| [0, 1 + k, 1 + (k + 1) % 8]).collect();
    let edges = (0..4).map(|k| vec![[1 + 2 * k, 2 + 2 * k]]).collect();
    let mesh = Mesh::new(nodes, triangles, edges, Some(vec![1, 3, 5])).unwrap();
    let protocol = Protocol::sheffield(4).unwrap();
    Case {
        contact_ohm_m: vec![0.3; 4],
        currents: vec![1e-3; protocol.len()],
        sigma: [("homog".to_owned(), vec![1e-3; 8])].into(),
        mesh: Arc::new(mesh),
        has_region: true,
        protocol,
    }
}

#[test]
fn a_mutated_case_is_refused_by_file_or_is_a_valid_case() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("case");
    let again = folder.path().join("again");
    let case = small_case();
    case.write(&path, Existing::Refuse).unwrap();
    let frames = [vec![Some(1e-3); 4], vec![None; 4]];
    std::fs::write(path.join("frames.csv"), frames_text(&frames)).unwrap();
    let files = [
        "nodes.csv",
        "elems.csv",
        "electrode_edges.csv",
        "electrodes.csv",
        "protocol.csv",
        "roi.csv",
        "sigma_homog.csv",
        "frames.csv",
    ];
    let refused_by_name = |refused: &CaseError, file: &str, seed: u64| {
        let reported = refused.to_string();
        assert!(reported.contains("case"), "{seed} {file}: {reported}");
    };
    for seed in 0..mutations() {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let file = files[random.random_range(0..files.len())];
        let whole = std::fs::read(path.join(file)).unwrap();
        std::fs::write(path.join(file), mutated(&whole, &mut random)).unwrap();
        match Case::read(&path) {
            Ok(read) => {
                read.write(&again, Existing::Replace).unwrap();
                assert_eq!(Case::read(&again).unwrap(), read, "{seed} {file}");
                std::fs::remove_dir_all(&again).unwrap();
            }
            Err(refused) => refused_by_name(&refused, file, seed),
        }
        match read_frames(&path.join("frames.csv"), 4) {
            Ok(frames) => assert!(frames.iter().all(|frame| frame.len() == 4), "{seed}"),
            Err(refused) => refused_by_name(&refused, file, seed),
        }
        std::fs::write(path.join(file), whole).unwrap();
    }
}
