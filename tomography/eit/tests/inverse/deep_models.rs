//! Deep networks in model files are read back unchanged, in every precision, and refuse inputs far from their training.

use std::sync::{Arc, OnceLock};

use eit::inverse::learned::network::{Layer, Rounding, TrainingDistribution, Weights};
use eit::model::{load, save};
use eit::{
    DeepNetwork, DeepReport, DeepSettings, DiscTank, Forward, Mesh, Model, ModelError, Network,
    Precision, ReconstructError, Reconstructor, Report, TrainingSettings,
};
use survey::{Protocol, Reading, Volts};

fn mesh() -> Arc<Mesh> {
    static MESH: OnceLock<Arc<Mesh>> = OnceLock::new();
    Arc::clone(MESH.get_or_init(|| {
        let tank = DiscTank {
            electrodes: 8,
            fineness: 0.4,
            ..DiscTank::default()
        };
        Arc::new(tank.mesh().unwrap())
    }))
}

fn wave(count: usize, step: f32, size: f32) -> Vec<f32> {
    (0..count).map(|i| (i as f32 * step).sin() * size).collect()
}

/// Two untrained hidden layers of 33, for 40 readings; inputs of about 0.01 are familiar.
fn model(precision: Precision) -> Model {
    let mesh = mesh();
    let protocol = Protocol::sheffield(8).unwrap();
    let widths = [protocol.len(), 33, 33, mesh.region().len()];
    let layers = widths
        .windows(2)
        .map(|pair| Layer {
            weights: Weights::F32(wave(
                pair[0] * pair[1],
                0.713,
                (3.0 / pair[0] as f32).sqrt(),
            )),
            bias: wave(pair[1], 0.4, 0.01),
        })
        .collect();
    let inputs = protocol.len();
    let network = DeepNetwork::new(
        wave(inputs, 0.3, 1e-3),
        vec![100.0; inputs],
        vec![0.0; inputs],
        layers,
    )
    .unwrap()
    .with_precision(precision);
    let seen: Vec<f32> = (0..200 * inputs)
        .map(|i| ((i * i % 7919) as f32 * 0.01).sin() * 0.01)
        .collect();
    let familiar = TrainingDistribution::learn(&seen, inputs).unwrap();
    let report = DeepReport {
        settings: DeepSettings::default(),
        parameters: 1,
        samples: 200,
        epochs: 3,
        best_epoch: 2,
        training_loss: 0.5,
        held_out_loss: 0.7,
        empty_loss: 1.4,
        kept: Rounding {
            precision,
            map_change: 0.01,
            held_out_loss: 0.71,
        },
    };
    Model::new(
        "dnn test",
        mesh,
        &protocol,
        Network::Deep(network, familiar),
        TrainingSettings::default(),
        Report::Deep(report),
        Some(2.5),
    )
    .unwrap()
}

/// Baseline and a frame in which every reading has changed by the fraction `share`.
fn frames(share: f64) -> [Vec<Reading>; 2] {
    let mesh = mesh();
    let forward = Forward::new(Arc::clone(&mesh), &[0.3; 8]).unwrap();
    let sigma = vec![1e-3; mesh.triangles().len()];
    let volts = forward
        .readings(&sigma, &Protocol::sheffield(8).unwrap())
        .unwrap();
    [0.0, share].map(|share| {
        volts
            .iter()
            .map(|v| Reading::Ok(Volts(1e-3 * v * (1.0 + share))))
            .collect()
    })
}

#[test]
fn a_deep_model_comes_back_from_its_file_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep.safetensors");
    let [baseline, frame] = frames(0.01);
    for precision in [Precision::F32, Precision::F16, Precision::Int8] {
        let model = model(precision);
        save(&path, eit::Existing::Replace, &model).unwrap();
        let loaded = load(&path).unwrap();
        assert_eq!(loaded.metadata(), model.metadata());
        assert_eq!(loaded.network(), model.network());
        assert_eq!(loaded.hash(), model.hash());
        let [message, loaded] = [model, loaded].map(Model::into_reconstructor);
        let map = |network: &dyn Reconstructor| network.reconstruct(&baseline, &frame).unwrap();
        assert_eq!(map(message.as_ref()).hash(), map(loaded.as_ref()).hash());
        assert_eq!(loaded.noise_figure(), Some(2.5));
        let message = loaded.assumptions().join("; ");
        assert!(message.contains("50 % of an empty map's"), "{message}");
        assert_eq!(
            message.contains(precision.name()),
            precision != Precision::F32,
            "{message}"
        );
    }
}

#[test]
fn a_bit_that_has_turned_in_a_weight_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep.safetensors");
    save(&path, eit::Existing::Refuse, &model(Precision::Int8)).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let last = bytes.len() - 7;
    bytes[last] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let refusal = load(&path).unwrap_err();
    assert!(
        matches!(&refusal, ModelError::Damaged { why, .. } if why.contains("checksum")),
        "{refusal}"
    );
}

#[test]
fn input_unlike_training_is_reported_then_refused() {
    let network = model(Precision::F32).into_reconstructor();
    let novelty = |share| {
        let [baseline, frame] = frames(share);
        network.novelty(&baseline, &frame).unwrap().unwrap()
    };
    assert!(!novelty(0.0).outside(), "{:?}", novelty(0.0));
    assert!(novelty(8.0).outside(), "{:?}", novelty(8.0));
    let [baseline, far] = frames(-30.0);
    assert!(matches!(
        network.reconstruct(&baseline, &far),
        Err(ReconstructError::OutsideModel { .. })
    ));
    let [_, mut gaps] = frames(0.01);
    gaps[3] = Reading::Overload;
    gaps[8] = Reading::Ok(Volts(f64::NAN));
    assert_eq!(network.reconstruct(&baseline, &gaps).unwrap().masked, 2);
    gaps[10..30].fill(Reading::NotMeasured);
    assert!(matches!(
        network.reconstruct(&baseline, &gaps),
        Err(ReconstructError::TooManyMissing { .. })
    ));
}
