use eit::Jitter;

use super::*;
use crate::samples::Sample;

/// Six readings of four triangles: each triangle affects two readings strongly and the others a little, nonlinearly.
struct Toy {
    baseline: Vec<f64>,
    cases: usize,
    /// A case, and its third reading.
    poisoned: Option<(usize, f32)>,
}

impl Toy {
    fn new(cases: usize) -> Self {
        Self {
            baseline: vec![1.0, 0.5, 0.2, 0.7, 0.9, 0.3],
            cases,
            poisoned: None,
        }
    }
}

impl Samples for Toy {
    fn len(&self) -> usize {
        self.cases
    }

    fn outputs(&self) -> usize {
        4
    }

    fn baseline(&self) -> &[f64] {
        &self.baseline
    }

    fn sample(&self, case: usize) -> Result<Sample, SampleError> {
        let loss = |t: usize| ((case * (t + 3)) as f32 * 0.618).fract();
        let mut sample = Sample {
            input: (0..6)
                .map(|r| {
                    (0..4)
                        .map(|t| {
                            let near = if r / 2 == t || r % 4 == t { 0.2 } else { 0.03 };
                            near * loss(t) / (1.2 - loss(t))
                        })
                        .sum()
                })
                .collect(),
            target: (0..4).map(|t| (t as u32, -loss(t))).collect(),
        };
        if let Some((poisoned, reading)) = self.poisoned
            && poisoned == case
        {
            sample.input[2] = reading;
        }
        sample.check("the toy", case)?;
        Ok(sample)
    }
}

fn noise(toy: &Toy) -> Noise {
    let jitter = Jitter::Matched {
        noise_v: 1e-3,
        current_a: 1.0,
    };
    Noise::new(&jitter, Default::default(), &toy.baseline, 5).unwrap()
}

fn recipe<'a>(toy: &'a Toy, noise: &'a Noise, epochs: usize) -> Recipe<'a> {
    Recipe {
        samples: toy,
        noise,
        repeats: 2,
        settings: DeepSettings {
            hidden_layers: 2,
            width: 24,
            epochs,
            batch: 16,
            drop_every: 12,
            held_out: 40,
            ..DeepSettings::default()
        },
        seed: 3,
        precision: Precision::F32,
        checkpoint: None,
    }
}

#[test]
fn a_toy_is_learnt_and_the_report_is_true() {
    let toy = Toy::new(340);
    let noise = noise(&toy);
    let (network, familiar, report) = train(&recipe(&toy, &noise, 20), &|_| {}).unwrap();
    assert!(
        report.held_out_loss < 0.05 * report.empty_loss,
        "{} {}",
        report.held_out_loss,
        report.empty_loss
    );
    assert_eq!(report.samples, 600);
    assert_eq!(report.epochs, 20);
    // the returned network gives the same outputs as the trained one
    let feed = JitteredSet {
        samples: &toy,
        noise: &noise,
        repeats: 2,
        held_out: 40,
    };
    let exact = rounding(&network, &network, &feed).unwrap();
    assert!((exact.held_out_loss / report.held_out_loss - 1.0).abs() < 1e-4);
    assert_eq!(exact.map_change, 0.0);
    let coarse = rounding(&network, &network.with_precision(Precision::Int8), &feed).unwrap();
    assert!((1e-4..0.1).contains(&coarse.map_change), "{coarse:?}");
    let seen = toy.sample(339).unwrap().input;
    assert!(familiar.novelty(&seen) < 1.0);
}

#[test]
fn a_run_that_was_cut_short_goes_on_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("toy.checkpoint");
    let toy = Toy::new(140);
    let noise = noise(&toy);
    let whole = train(&recipe(&toy, &noise, 5), &|_| {}).unwrap();
    let part = |epochs: usize, name: &str| {
        let recipe = Recipe {
            checkpoint: Some((&path, name.to_owned())),
            ..recipe(&toy, &noise, epochs)
        };
        let resumed = std::cell::Cell::new(None);
        let trained = train(&recipe, &|moment| {
            if let TrainingEvent::Resumed { epochs } = moment {
                resumed.set(Some(epochs));
            }
        });
        (trained, resumed.get())
    };
    let (_, resumed) = part(2, "toy");
    assert_eq!(resumed, None);
    // a process killed while it wrote the next checkpoint leaves an incomplete file, which is never read
    std::fs::write(path.with_extension("part"), b"torn").unwrap();
    let (trained, resumed) = part(5, "toy");
    assert_eq!(resumed, Some(2));
    let (network, _, report) = trained.unwrap();
    assert_eq!(network, whole.0);
    assert_eq!(report.held_out_loss, whole.2.held_out_loss);
    assert_eq!(report.best_epoch, whole.2.best_epoch);
    let (other, _) = part(5, "other");
    assert!(matches!(
        other,
        Err(DeepFault::Checkpoint(CheckpointFault::Other { .. }))
    ));
    std::fs::write(&path, b"nothing of ours").unwrap();
    let (damaged, _) = part(5, "toy");
    assert!(matches!(
        damaged,
        Err(DeepFault::Checkpoint(CheckpointFault::Damaged { .. }))
    ));
}

#[test]
fn a_checkpoint_that_cannot_be_written_leaves_the_last_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("toy.checkpoint");
    let toy = Toy::new(140);
    let noise = noise(&toy);
    let part = |path: &std::path::Path, epochs: usize| {
        let recipe = Recipe {
            checkpoint: Some((path, "toy".to_owned())),
            ..recipe(&toy, &noise, epochs)
        };
        train(&recipe, &|_| {})
    };
    part(&path, 1).unwrap();
    let good = std::fs::read(&path).unwrap();
    // an unwritable path in place of a full disk
    let unwritable = folder.path().join("toy.tactus");
    std::fs::copy(&path, &unwritable).unwrap();
    let fault = part(&unwritable, 2).unwrap_err();
    assert!(
        matches!(&fault, DeepFault::Checkpoint(CheckpointFault::Unwritten { path, .. })
            if path.ends_with("toy.tactus")),
        "{fault}"
    );
    assert_eq!(std::fs::read(&unwritable).unwrap(), good);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    let resumed = part(&path, 3).unwrap();
    assert_eq!(
        resumed.0,
        train(&recipe(&toy, &noise, 3), &|_| {}).unwrap().0
    );
}

#[test]
fn a_sample_that_is_no_number_is_refused_by_name() {
    let toy = Toy {
        poisoned: Some((77, f32::NAN)),
        ..Toy::new(140)
    };
    let noise = noise(&toy);
    let fault = train(&recipe(&toy, &noise, 1), &|_| {}).unwrap_err();
    let message = std::error::Error::source(&fault).unwrap().to_string();
    assert!(message.contains("reading 2 of case 77"), "{message}");
}

#[test]
fn an_infinite_loss_of_held_out_cases_ends_the_training() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("toy.checkpoint");
    let toy = Toy {
        poisoned: Some((139, f32::MAX)),
        ..Toy::new(140)
    };
    let noise = noise(&toy);
    let mut recipe = recipe(&toy, &noise, 2);
    recipe.checkpoint = Some((&path, "toy".to_owned()));
    let fault = train(&recipe, &|_| {}).unwrap_err();
    assert!(
        matches!(fault, DeepFault::RanAway { epoch: 1, .. }),
        "{fault}"
    );
    // the checkpoint would be unreadable, because JSON has no such number
    assert!(!path.exists());
}

#[test]
fn what_cannot_be_trained_is_refused() {
    let toy = Toy::new(41);
    let noise = noise(&toy);
    let few = train(&recipe(&toy, &noise, 1), &|_| {});
    assert!(matches!(few, Err(DeepFault::Few { cases: 1, .. })));
    let mut wrong = recipe(&toy, &noise, 1);
    wrong.settings.beta2 = 1.0;
    assert!(matches!(
        train(&wrong, &|_| {}),
        Err(DeepFault::Setting {
            setting: "beta2",
            ..
        })
    ));
    let toy = Toy::new(140);
    let mut wild = recipe(&toy, &noise, 30);
    wild.settings.learning_rate = 1e30;
    assert!(matches!(
        train(&wild, &|_| {}),
        Err(DeepFault::RanAway { .. } | DeepFault::Network(_))
    ));
}

#[test]
fn training_ends_when_it_no_longer_helps() {
    let toy = Toy::new(140);
    let noise = noise(&toy);
    let mut recipe = recipe(&toy, &noise, 200);
    recipe.settings.drop_every = 2;
    recipe.settings.patience = 3;
    let (_, _, report) = train(&recipe, &|_| {}).unwrap();
    assert!(report.epochs < 200 && report.epochs - report.best_epoch == 3);
}
