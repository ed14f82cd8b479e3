//! The misfit of learned maps: computed at training, stored in the model file, and used to doubt maps with a larger
//! misfit. The frames are simulated on a finer mesh, with another seed than the training's.

use std::sync::{Arc, OnceLock};

use eit::inverse::learned::network::{Layer, Weights};
use eit::model::{load, save};
use eit::{
    Case, DeepNetwork, DiscTank, Existing, Forward, Jitter, Model, ModelCheck, Network, OwnMisfit,
    PaperSheet, Precision, Preset, Reconstructor, Scale, TrainingSettings,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use survey::{MapQuality, Protocol, Reading, Volts};
use training::linear;
use training::own_misfit::of_fresh_cases;
use training::samples::Stage;

const NOISE_V: f64 = 2e-6;
const CURRENT: f64 = 1e-3;

fn silent(_: Stage, _: usize, _: usize) {}

fn settings(cases: usize) -> TrainingSettings {
    TrainingSettings {
        cases,
        repeats: 1,
        jitter: Jitter::Matched {
            noise_v: NOISE_V,
            current_a: CURRENT,
        },
        ..TrainingSettings::default()
    }
}

fn fitted(case: &Case, settings: TrainingSettings) -> Model {
    let drawn = settings.seed;
    let model = linear::fit(case, settings, None, true, Precision::F32, "test", &silent).unwrap();
    of_fresh_cases(model, case, drawn).unwrap()
}

/// A tank of eight electrodes.
fn tank() -> Case {
    let tank = DiscTank {
        radius_mm: 100.0,
        electrodes: 8,
        fineness: 0.5,
        ..DiscTank::default()
    };
    let mesh = Arc::new(tank.mesh().unwrap());
    let protocol = Protocol::sheffield(8).unwrap();
    let sigma0 = vec![tank.conductance(); mesh.triangles().len()];
    Case {
        contact_ohm_m: tank.contact_ohm_m(),
        currents: vec![CURRENT; protocol.len()],
        has_region: false,
        protocol,
        sigma: [("homog".to_owned(), sigma0)].into(),
        mesh,
    }
}

/// The paper's sheet.
fn sheet() -> &'static Case {
    static CASE: OnceLock<Case> = OnceLock::new();
    CASE.get_or_init(|| {
        let sheet = PaperSheet::default();
        let mesh = Arc::new(Preset::default().mesh().unwrap());
        let protocol = Protocol::sheffield(26).unwrap();
        let sigma0 = vec![sheet.conductance(); mesh.triangles().len()];
        Case {
            contact_ohm_m: sheet.contact_ohm_m(),
            currents: vec![CURRENT; protocol.len()],
            has_region: true,
            protocol,
            sigma: [("homog".to_owned(), sigma0)].into(),
            mesh,
        }
    })
}

/// A linear map of the paper's sheet.
fn model() -> &'static Model {
    static MODEL: OnceLock<Model> = OnceLock::new();
    MODEL.get_or_init(|| fitted(sheet(), settings(2000)))
}

/// The sheet on a finer mesh, with noise on baseline and frame.
struct FineSheet {
    forward: Forward,
    sigma0: Vec<f64>,
    check: ModelCheck,
}

impl FineSheet {
    fn new() -> Self {
        let fine = PaperSheet {
            fineness: 1.6,
            ..PaperSheet::default()
        };
        let mesh = Arc::new(fine.mesh().unwrap());
        let case = sheet();
        let check = ModelCheck::new(
            &case.mesh,
            &case.contact_ohm_m,
            &case.unloaded_conductance(),
            &case.protocol,
            Scale::Uniform,
            Some(NOISE_V / CURRENT),
        );
        Self {
            sigma0: vec![fine.conductance(); mesh.triangles().len()],
            forward: Forward::new(mesh, &fine.contact_ohm_m()).unwrap(),
            check: check.unwrap(),
        }
    }

    /// The quality of a learned map of a frame; `loss` is the relative loss of conductance as a function of the
    /// position, m.
    fn quality(
        &self,
        network: &dyn Reconstructor,
        loss: impl Fn([f64; 2]) -> f64,
        random: &mut ChaCha8Rng,
    ) -> MapQuality {
        self.quality_by(network, loss, random, &usual())
    }

    fn quality_by(
        &self,
        network: &dyn Reconstructor,
        loss: impl Fn([f64; 2]) -> f64,
        random: &mut ChaCha8Rng,
        usual: &OwnMisfit,
    ) -> MapQuality {
        self.judged(network, &self.readings(loss, random), usual)
    }

    /// Baseline and frame; `loss` is the relative loss as a function of the position, m.
    fn readings(
        &self,
        loss: impl Fn([f64; 2]) -> f64,
        random: &mut ChaCha8Rng,
    ) -> [Vec<Reading>; 2] {
        let mesh = self.forward.mesh();
        let loaded: Vec<f64> = (0..self.sigma0.len())
            .map(|t| self.sigma0[t] * (1.0 - loss(mesh.centroid(t))))
            .collect();
        let noise = Normal::new(0.0, NOISE_V).unwrap();
        [&self.sigma0, &loaded].map(|sigma| -> Vec<Reading> {
            let ohms = self.forward.readings(sigma, &sheet().protocol).unwrap();
            let volts = ohms
                .iter()
                .map(|ohms| CURRENT * ohms + noise.sample(random));
            volts.map(|volts| Reading::Ok(Volts(volts))).collect()
        })
    }

    fn judged(
        &self,
        network: &dyn Reconstructor,
        [baseline, frame]: &[Vec<Reading>; 2],
        usual: &OwnMisfit,
    ) -> MapQuality {
        let map = network.reconstruct(baseline, frame).unwrap();
        let judged = self.check.judged(baseline, frame, map, Some(usual));
        judged.quality.unwrap()
    }
}

fn usual() -> OwnMisfit {
    let misfit = model().metadata().own_misfit.clone();
    misfit.unwrap()
}

fn has(quality: &MapQuality, kind: &str) -> bool {
    quality.reasons.iter().any(|reason| reason.kind == kind)
}

/// A disc of 50 mm at a random place in the region, with half the conductance lost.
fn press(random: &mut ChaCha8Rng) -> impl Fn([f64; 2]) -> f64 + use<> {
    let at = [0.107, 0.115];
    let reach = [0.0588, 0.0654];
    let centre = [0, 1].map(|axis| at[axis] + random.random_range(-reach[axis]..reach[axis]));
    move |[x, y]| match (x - centre[0]).hypot(y - centre[1]) < 0.025 {
        true => 0.5,
        false => 0.0,
    }
}

/// The same network with other weights.
fn damaged(change: impl Fn(&mut Vec<f32>)) -> Box<dyn Reconstructor> {
    let Network::Deep(network, familiar) = model().network().clone() else {
        unreachable!("a linear map is a deep network of one layer");
    };
    let Weights::F32(mut weights) = network.layers()[0].weights.clone() else {
        unreachable!("it was fitted in f32");
    };
    change(&mut weights);
    let layer = Layer {
        weights: Weights::F32(weights),
        bias: network.layers()[0].bias.clone(),
    };
    let [mean, gain, shift] = network.normalisation().map(<[f32]>::to_vec);
    let network = DeepNetwork::new(mean, gain, shift, vec![layer]).unwrap();
    let metadata = model().metadata();
    let damaged = Model::new(
        "damaged",
        Arc::clone(model().mesh()),
        model().protocol(),
        Network::Deep(network, familiar),
        metadata.training.clone(),
        metadata.report.clone(),
        None,
    );
    damaged.unwrap().into_reconstructor()
}

#[test]
fn maps_of_presses_leave_no_more_than_held_out_cases() {
    let fine = FineSheet::new();
    let network = model().clone().into_reconstructor();
    let random = &mut ChaCha8Rng::seed_from_u64(71);
    for _ in 0..20 {
        let quality = fine.quality(network.as_ref(), press(random), random);
        assert!(
            !has(&quality, "own_misfit") && !has(&quality, "novelty"),
            "{quality}"
        );
    }
}

#[test]
fn damaged_weights_leave_more_than_held_out_cases() {
    let fine = FineSheet::new();
    let random = &mut ChaCha8Rng::seed_from_u64(72);
    let moved = damaged(|weights| {
        let third = weights.len() / 3;
        weights.rotate_left(third);
    });
    let halved = damaged(|weights| weights.iter_mut().for_each(|weight| *weight *= 0.5));
    for (network, what) in [(moved, "moved"), (halved, "halved")] {
        let mut found = 0;
        for _ in 0..10 {
            let quality = fine.quality(network.as_ref(), press(random), random);
            found += usize::from(has(&quality, "own_misfit"));
            println!("{what}: {quality}");
        }
        assert!(found >= 8, "{what}: {found} of 10");
    }
}

#[test]
fn more_noise_and_smaller_changes_are_not_judged() {
    let fine = FineSheet::new();
    let empty = damaged(|weights| weights.fill(0.0));
    let found = |usual: &OwnMisfit, loss: f64| {
        let random = &mut ChaCha8Rng::seed_from_u64(74);
        let press = press(random);
        let quality = fine.quality_by(empty.as_ref(), |at| loss * press(at), random, usual);
        has(&quality, "own_misfit")
    };
    let usual = usual();
    assert!(found(&usual, 1.0));
    // the frame's noise is ten times that of the training: not judged
    let quieter = OwnMisfit {
        noise: 0.1 * usual.noise,
        ..usual.clone()
    };
    assert!(!found(&quieter, 1.0));
    // no training case had such a small change: not judged
    let larger = OwnMisfit {
        classes: usual.classes[3..].to_vec(),
        ..usual.clone()
    };
    assert!(!found(&larger, 0.1));
    // a change below three times the noise is not judged
    let mut lowest = usual;
    for class in &mut lowest.classes {
        class.above = 0.0;
        class.limit = 0.0;
    }
    assert!(found(&lowest, 1.0) && !found(&lowest, 0.003));
}

#[test]
fn readings_missing_with_their_twins_are_not_judged() {
    let fine = FineSheet::new();
    let empty = damaged(|weights| weights.fill(0.0));
    let random = &mut ChaCha8Rng::seed_from_u64(75);
    let mut readings = fine.readings(press(random), random);
    let twin = sheet().protocol.reciprocal_twins()[40].unwrap();
    let found = |readings: &_| {
        has(
            &fine.judged(empty.as_ref(), readings, &usual()),
            "own_misfit",
        )
    };
    assert!(found(&readings));
    // the network replaces the missing reading by the reciprocal one
    readings[1][40] = Reading::Overload;
    assert!(found(&readings));
    readings[1][twin] = Reading::Overload;
    assert!(!found(&readings));
}

#[test]
fn a_map_of_another_region_has_no_misfit() {
    let fine = FineSheet::new();
    let random = &mut ChaCha8Rng::seed_from_u64(76);
    let [baseline, frame] = fine.readings(press(random), random);
    let mut map = vec![0.0; sheet().mesh.region().len()];
    assert!(fine.check.own_misfit(&baseline, &frame, &map).is_some());
    map.pop();
    assert_eq!(fine.check.own_misfit(&baseline, &frame, &map), None);
}

#[test]
fn wide_loads_over_all_electrodes_are_novel() {
    let fine = FineSheet::new();
    let network = model().clone().into_reconstructor();
    let random = &mut ChaCha8Rng::seed_from_u64(73);
    // from 0 at one side to 40 % at the other
    let quality = fine.quality(network.as_ref(), |[x, _]| 0.4 * x / 0.214, random);
    println!("{quality}");
    assert!(has(&quality, "novelty"), "{quality}");
    let press = press(random);
    let quality = fine.quality(network.as_ref(), |at| 0.2 * press(at), random);
    assert!(!has(&quality, "novelty"), "{quality}");
}

#[test]
fn model_file_keeps_it_and_files_without_it_load() {
    let case = tank();
    let folder = tempfile::tempdir().unwrap();
    let plain = linear::fit(
        &case,
        settings(400),
        None,
        true,
        Precision::F32,
        "test",
        &silent,
    );
    let plain = plain.unwrap();
    let judged = of_fresh_cases(plain.clone(), &case, plain.metadata().training.seed).unwrap();
    let misfit = judged.metadata().own_misfit.clone().unwrap();
    println!("{misfit:?}");
    assert!(
        misfit
            .classes
            .iter()
            .all(|class| class.median < class.limit)
    );
    for (name, model) in [("plain", &plain), ("judged", &judged)] {
        let path = folder.path().join(name);
        save(&path, Existing::Refuse, model).unwrap();
        let loaded = load(&path).unwrap();
        assert_eq!(loaded.metadata().own_misfit, model.metadata().own_misfit);
        assert_eq!(loaded.hash(), model.hash());
        // an unjudged model has no such entry, like files of earlier versions
        let text = std::fs::read(&path).unwrap();
        let entry = b"own_misfit";
        let has_entry = text.windows(entry.len()).any(|window| window == entry);
        assert_eq!(has_entry, name == "judged");
    }
}

#[test]
fn one_seed_gives_the_same_misfit_on_any_number_of_threads() {
    let case = tank();
    let hash = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let model = fitted(&case, settings(400));
            assert!(model.metadata().own_misfit.is_some());
            model.hash().to_owned()
        })
    };
    let one = hash(1);
    assert_eq!(one, hash(2));
    assert_eq!(one, hash(8));
}
