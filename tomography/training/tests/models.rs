//! Training, saving, loading and running of RBF networks, and refusal of invalid files.

use std::sync::{Arc, OnceLock};

use eit::model::{load, save};
use eit::{
    DiscTank, DistancesChoice, Forward, Jitter, Mesh, Model, ModelError, Network, OpenChoices,
    ReconstructError, Reconstructor, Report, TrainingSettings, load_reconstructor,
};
use safetensors::SafeTensors;
use sha2::{Digest, Sha256};
use survey::{Protocol, Reading, Volts};
use training::rbf::train_rbf_on;
use training::samples::{Simulation, Stage, TrainError};

const CONTACT: [f64; 8] = [0.3; 8];

fn mesh() -> Arc<Mesh> {
    static MESH: OnceLock<Arc<Mesh>> = OnceLock::new();
    Arc::clone(MESH.get_or_init(|| {
        let tank = DiscTank {
            radius_mm: 100.0,
            electrodes: 8,
            fineness: 0.5,
            ..DiscTank::default()
        };
        Arc::new(tank.mesh().unwrap())
    }))
}

fn settings() -> TrainingSettings {
    TrainingSettings {
        cases: 400,
        repeats: 2,
        neurons: 25,
        radius_m: 0.06,
        jitter: Jitter::matched(),
        ..TrainingSettings::default()
    }
}

fn trained(settings: &TrainingSettings) -> Result<Model, TrainError> {
    let mesh = mesh();
    let protocol = Protocol::sheffield(8).unwrap();
    let sigma = vec![1e-3; mesh.triangles().len()];
    let silent = |_: Stage, _: usize, _: usize| {};
    let simulation = Simulation::new(&mesh, &CONTACT, &sigma, &protocol, settings)?;
    let (network, report) = train_rbf_on(&simulation, settings, &silent)?;
    Ok(Model::new(
        "rbf test",
        mesh,
        &protocol,
        Network::Rbf(network),
        settings.clone(),
        Report::Rbf(report),
        Some(0.5),
    )
    .unwrap())
}

fn model() -> &'static Model {
    static MODEL: OnceLock<Model> = OnceLock::new();
    MODEL.get_or_init(|| trained(&settings()).unwrap())
}

/// Baseline and a frame with a disc of 60 mm at (30, 20) mm pressed to half its conductance.
fn frames() -> [Vec<Reading>; 2] {
    let mesh = mesh();
    let forward = Forward::new(Arc::clone(&mesh), &CONTACT).unwrap();
    let protocol = Protocol::sheffield(8).unwrap();
    let pressed = (0..mesh.triangles().len())
        .map(|triangle| {
            let [x, y] = mesh.centroid(triangle);
            let inside = (x - 0.03).hypot(y - 0.02) < 0.03;
            if inside { 5e-4 } else { 1e-3 }
        })
        .collect::<Vec<_>>();
    [vec![1e-3; mesh.triangles().len()], pressed].map(|sigma| {
        let volts = forward.readings(&sigma, &protocol).unwrap();
        volts.iter().map(|v| Reading::Ok(Volts(1e-3 * v))).collect()
    })
}

#[test]
fn a_small_network_finds_a_large_press() {
    let [baseline, frame] = frames();
    let mesh = mesh();
    let network = model().clone().into_reconstructor();
    let map = network.reconstruct(&baseline, &frame).unwrap();
    let found = map
        .found(&mesh.region_centroids(), &mesh.region_areas())
        .unwrap();
    let error = (found[0] - 0.03).hypot(found[1] - 0.02);
    assert!(error < 0.025, "{found:?}");
    // without a load the map is nearly empty
    let still = network.reconstruct(&baseline, &baseline).unwrap();
    let most = still.largest_loss().map_or(0.0, |(_, loss)| loss);
    assert!(most < 0.5 * map.largest_loss().unwrap().1, "{most}");
}

#[test]
fn a_model_of_cases_mostly_alike_is_read_again() {
    // nine of ten cases change nothing, so that the median distance of two samples is zero
    let settings = TrainingSettings {
        polygons: 1,
        vertices: 3,
        open: OpenChoices {
            distances: DistancesChoice::Clean,
            ..OpenChoices::default()
        },
        ..settings()
    };
    let model = trained(&settings).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    save(&path, eit::Existing::Refuse, &model).unwrap();
    let loaded = load(&path).unwrap();
    let Report::Rbf(report) = &loaded.metadata().report else {
        panic!("a network of another kind");
    };
    assert_eq!(report.spread_over_median, 1e30);
    let note = training::rbf::spread_note(report).unwrap();
    assert!(note.contains("most cases are alike"), "{note}");
}

#[test]
fn a_model_comes_back_from_its_file_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    save(&path, eit::Existing::Refuse, model()).unwrap();
    let loaded = load(&path).unwrap();
    assert_eq!(loaded.hash(), model().hash());
    assert_eq!(loaded.network(), model().network());
    assert_eq!(loaded.protocol(), model().protocol());
    assert_eq!(loaded.mesh().hash(), mesh().hash());
    assert_eq!(loaded.metadata().training, settings());
    let [baseline, frame] = frames();
    let map = |network: &dyn Reconstructor| network.reconstruct(&baseline, &frame).unwrap().hash();
    assert_eq!(
        map(load_reconstructor(&path).unwrap().as_ref()),
        map(model().clone().into_reconstructor().as_ref())
    );
}

#[test]
fn same_settings_give_same_bytes_on_any_number_of_threads() {
    let few = TrainingSettings {
        cases: 60,
        neurons: 10,
        ..settings()
    };
    let hash = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| trained(&few).unwrap().hash().to_owned())
    };
    let one = hash(1);
    assert_eq!(one, hash(3));
    let other = TrainingSettings { seed: 2, ..few };
    assert_ne!(one, trained(&other).unwrap().hash());
}

#[test]
fn a_masked_reading_moves_the_map_little() {
    let [baseline, frame] = frames();
    let network = model().clone().into_reconstructor();
    let whole = network.reconstruct(&baseline, &frame).unwrap();
    let mut masked = frame.clone();
    masked[3] = Reading::Overload;
    let map = network.reconstruct(&baseline, &masked).unwrap();
    assert_eq!(map.masked, 1);
    let most = whole.largest_loss().unwrap().1;
    for (a, b) in whole.values.iter().zip(&map.values) {
        // the missing reading is replaced by the reciprocal one, equal except for rounding of the forward solution
        assert!((a - b).abs() < 1e-6 * most, "{a} {b}");
    }
    masked[..11].fill(Reading::NotMeasured);
    assert!(matches!(
        network.reconstruct(&baseline, &masked),
        Err(ReconstructError::TooManyMissing { missing: 11, .. })
    ));
}

#[test]
fn frames_far_from_the_training_are_refused() {
    let [baseline, _] = frames();
    let far: Vec<Reading> = baseline
        .iter()
        .map(|reading| Reading::Ok(Volts(-30.0 * reading.volts().unwrap().0)))
        .collect();
    let network = model().clone().into_reconstructor();
    assert!(matches!(
        network.reconstruct(&baseline, &far),
        Err(ReconstructError::OutsideModel { novelty, .. }) if novelty > 6.0
    ));
    let dead = vec![Reading::Ok(Volts(0.0)); baseline.len()];
    assert_eq!(
        network.reconstruct(&dead, &baseline),
        Err(ReconstructError::DeadBaseline)
    );
}

#[test]
fn files_that_are_no_models_are_refused_by_what_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.safetensors");
    save(&path, eit::Existing::Refuse, model()).unwrap();
    let good = std::fs::read(&path).unwrap();
    let refusal = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        let refusal = load(&path).unwrap_err();
        assert!(refusal.to_string().contains("m.safetensors"), "{refusal}");
        refusal
    };
    for cut in [0, 5, 100, good.len() / 2, good.len() - 1] {
        let refusal = refusal(&good[..cut]);
        assert!(matches!(refusal, ModelError::Truncated { .. }), "{refusal}");
    }
    let text = refusal(b"x_m,y_m\n0.1,0.2\n0.3,0.4\n");
    assert!(matches!(text, ModelError::Foreign { .. }), "{text}");
    let stranger = b"\x08\0\0\0\0\0\0\0{}      ";
    assert!(matches!(refusal(stranger), ModelError::Foreign { .. }));
    let replaced = |from: &str, to: &str| {
        let at = good
            .windows(from.len())
            .position(|window| window == from.as_bytes())
            .unwrap();
        let mut bytes = good.clone();
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        bytes
    };
    let kind = refusal(&replaced(r#"\"kind\":\"rbf\""#, r#"\"kind\":\"dnn\""#));
    assert!(
        matches!(&kind, ModelError::Kind { holds, .. } if holds.contains("dnn")),
        "{kind}"
    );
    let geometry = model().metadata().geometry.clone();
    let other = refusal(&replaced(&geometry, &"0".repeat(64)));
    assert!(
        matches!(&other, ModelError::Damaged { why, .. } if why.contains("checksum")),
        "{other}"
    );
    assert!(matches!(
        load(&folder.path().join("none")),
        Err(ModelError::Io { .. })
    ));
}

#[test]
fn a_bit_that_has_turned_anywhere_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.safetensors");
    save(&path, eit::Existing::Refuse, model()).unwrap();
    let good = std::fs::read(&path).unwrap();
    let header = 8 + u64::from_le_bytes(good[..8].try_into().unwrap()) as usize;
    for place in (8..header)
        .step_by(41)
        .chain((header..good.len()).step_by(997))
    {
        let mut bytes = good.clone();
        bytes[place] ^= 1 << (place % 8);
        std::fs::write(&path, &bytes).unwrap();
        assert!(load(&path).is_err(), "byte {place} of {}", good.len());
    }
}

/// A model file with changed metadata and a matching checksum.
fn forged(good: &[u8], from: &str, to: &str) -> Vec<u8> {
    let (_, info) = SafeTensors::read_metadata(good).unwrap();
    let text = &info.metadata().as_ref().unwrap()["tactus"];
    let message = |checksum: &str| format!("\"checksum\":\"{checksum}\"");
    let blank = text.replacen(&message(&model().metadata().checksum), &message(""), 1);
    let changed = blank.replacen(from, to, 1);
    assert_ne!(changed, blank, "{from} is not there");
    let tensors = SafeTensors::deserialize(good).unwrap();
    let mut views = tensors.tensors();
    views.sort_by(|a, b| a.0.cmp(&b.0));
    let mut hasher = Sha256::new();
    hasher.update(changed.as_bytes());
    for (name, view) in &views {
        hasher.update(format!("{name} {:?} {:?}", view.dtype(), view.shape()).as_bytes());
        hasher.update(view.data());
    }
    let digest = hasher.finalize();
    let checksum: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
    let changed = changed.replacen(&message(""), &message(&checksum), 1);
    safetensors::serialize(views, Some([("tactus".to_owned(), changed)].into())).unwrap()
}

#[test]
fn huge_count_is_refused_before_memory_is_allocated() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.safetensors");
    save(&path, eit::Existing::Refuse, model()).unwrap();
    let good = std::fs::read(&path).unwrap();
    for electrodes in [9, u64::MAX >> 1] {
        let message = format!("\"electrodes\":{electrodes}");
        std::fs::write(&path, forged(&good, "\"electrodes\":8", &message)).unwrap();
        let refusal = load(&path).unwrap_err();
        assert!(
            matches!(&refusal, ModelError::Damaged { why, .. } if !why.contains("checksum")),
            "{refusal}"
        );
    }
    // a header with a tensor whose size in bytes overflows an integer
    let header = r#"{"a":{"dtype":"U8","shape":[1],"data_offsets":[0,18446744073709551615]}}"#;
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header.as_bytes());
    std::fs::write(&path, &bytes).unwrap();
    let refusal = load(&path).unwrap_err();
    assert!(matches!(refusal, ModelError::Truncated { .. }), "{refusal}");
}

#[test]
fn a_model_is_for_its_own_survey_and_geometry_only() {
    let model = model();
    assert!(model.is_for(model.protocol(), &mesh()));
    assert!(!model.is_for(&Protocol::sheffield(9).unwrap(), &mesh()));
    let finer = DiscTank::default().mesh().unwrap();
    assert!(!model.is_for(model.protocol(), &finer));
}

#[test]
fn settings_without_meaning_are_refused() {
    for (broken, name) in [
        (
            TrainingSettings {
                cases: 0,
                ..settings()
            },
            "cases",
        ),
        (
            TrainingSettings {
                neurons: 801,
                ..settings()
            },
            "neurons",
        ),
        (
            TrainingSettings {
                jitter: Jitter::Paper { gamma: f64::NAN },
                ..settings()
            },
            "gamma",
        ),
    ] {
        let refusal = trained(&broken).unwrap_err();
        assert!(
            matches!(refusal, TrainError::Setting { setting, .. } if setting == name),
            "{refusal}"
        );
    }
}
