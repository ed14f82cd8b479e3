//! Model files whose metadata contradict the network.

use std::path::Path;
use std::sync::Arc;

use survey::{Protocol, Reading, Volts};

use super::*;
use crate::model::{Model, ModelError, Network, Report};
use crate::{DiscTank, MisfitClass, OwnMisfit, RbfNetwork, TrainingReport, TrainingSettings};

/// A network of one neuron, centred on the input without a change.
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

/// Writes the model to a file, even with invalid metadata, and reads it back.
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
    // JSON cannot represent NaN, so the file could not be read back
    let unknown = wrong(|misfit| misfit.classes[0].limit = f64::NAN);
    assert!(model().with_own_misfit(unknown).is_err());
}

#[test]
fn novelty_needs_a_distance_of_the_training_inputs() {
    let volts = |volts| vec![Reading::Ok(Volts(volts)); model().protocol.len()];
    let (baseline, frame) = (volts(1.0), volts(1.3));
    let network = |familiar| read(&with_familiar(familiar)).unwrap().into_reconstructor();
    let quality = |familiar| {
        let map = network(familiar).reconstruct(&baseline, &frame).unwrap();
        map.quality
    };
    let novelty = |familiar| network(familiar).novelty(&baseline, &frame).unwrap();
    assert!(quality(1.0).is_some_and(|quality| quality.text().contains("1.9 times")));
    assert_eq!(quality(5.0), None);
    // as many neurons as samples
    assert_eq!(quality(0.0), None);
    assert!(novelty(1.0).is_some_and(|novelty| novelty.outside()));
    assert_eq!(novelty(0.0), None);
    let refused = read(&with_familiar(-1.0)).unwrap_err();
    assert!(matches!(refused, ModelError::Damaged { .. }), "{refused}");
}
