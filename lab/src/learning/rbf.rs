//! `tactus-lab train rbf`.

use eit::{Case, Model, Network, Report, TrainingReport, TrainingSettings};
use studies::{Failure, progress};
use training::TrainError;
use training::rbf;
use training::samples::{Sample, SampleError, Samples, Simulation, dense_target};

use super::data::Data;
use super::limits;
use super::model_file;
use crate::args::TrainOptions;
use crate::output::print_line;

/// Number of cases on which a network is compared with empty maps.
const JUDGED: usize = 100;

/// Trains and writes the model file.
pub(super) fn train(options: &TrainOptions) -> Result<(), Failure> {
    let data = Data::read(&options.data)?;
    let drawn = match &data.set {
        Some(set) => set.settings().clone(),
        None => TrainingSettings {
            cases: options.cases,
            ..TrainingSettings::default()
        },
    };
    let drawn_seed = match &data.set {
        Some(set) => set.settings().seed,
        None => options.seed,
    };
    // recorded cases cannot be simulated: the last tenth of them is held out to test the training
    let recorded = data.set.as_ref().filter(|set| set.is_recorded());
    let first = recorded.map(|set| FirstCases {
        of: set,
        count: set.len() - set.len() / 10,
    });
    let settings = TrainingSettings {
        repeats: options.repeats,
        neurons: options.neurons,
        spread_times: options.spread_times,
        seed: options.seed,
        jitter: data.jitter.clone(),
        cases: first.as_ref().map_or(drawn.cases, Samples::len),
        ..drawn
    };
    if settings.cases < options.neurons {
        eprintln!(
            "tactus-lab: {} cases for {} neurons: with fewer cases than neurons the network repeats the cases rather \
             than learns from them; the paper has 15000 cases for 100 neurons",
            settings.cases, options.neurons
        );
    }
    limits::check_memory(settings.cases, data.case.protocol.len(), settings.repeats)?;
    let bars = progress::Training::default();
    let show = |stage, done, of| bars.show(stage, done, of);
    let model = rbf::fit(
        &data.case,
        settings.clone(),
        first
            .as_ref()
            .map(|first| first as &dyn Samples)
            .or(data.samples()),
        options.data.symmetric,
        &format!("rbf {}", options.data.profile.name()),
        &show,
    )?;
    drop(bars);
    let unseen = TrainingSettings {
        cases: JUDGED,
        neurons: 1,
        seed: drawn_seed.wrapping_add(1),
        ..settings
    };
    let [loss, empty] = losses(&data.case, &model, first.as_ref(), &unseen)?;
    limits::check_learnt(loss, empty, options.data.yes)?;
    let held_out = first
        .as_ref()
        .map_or(0, |first| first.of.len() - first.count);
    let model = data.judged(model, held_out)?;
    model_file::save(&options.out, &options.replacing, &model)?;
    let report = found(&model);
    if let Some(note) = rbf::spread_note(report) {
        eprintln!("tactus-lab: {note}");
    }
    if options.json {
        let line = model_file::json(&options.out, &model, report);
        print_line!("{}", survey::printable_json(line.to_string()));
    } else {
        print_line!(
            "{}: {} of {} simulated cases, {} of them without a load\n\
             jitter on the inputs: {:.2e} of the largest baseline reading (standard deviation)\n\
             width b of the neurons (Eq. 13): {:.3e} of the largest baseline reading, {:.1} times the median distance \
             between samples\n\
             least squares: rank {} of {}, condition {:.1e}, largest weight {:.1e} (relative change of conductance)\n\
             {}\n\
             sha256 {}",
            options.out.display(),
            model.metadata().name,
            model.metadata().training.cases,
            report.unchanged,
            report.jitter,
            report.spread,
            report.spread_over_median,
            report.rank,
            options.neurons,
            report.condition,
            report.largest_weight,
            model_file::misfit(&model),
            model.hash()
        );
    }
    Ok(())
}

/// The results of an RBF network's training.
fn found(model: &Model) -> &TrainingReport {
    match &model.metadata().report {
        Report::Rbf(report) => report,
        Report::Deep(_) => unreachable!("an RBF network was trained"),
    }
}

/// The first cases of a set.
struct FirstCases<'a> {
    of: &'a dyn Samples,
    count: usize,
}

impl Samples for FirstCases<'_> {
    fn len(&self) -> usize {
        self.count
    }

    fn outputs(&self) -> usize {
        self.of.outputs()
    }

    fn baseline(&self) -> &[f64] {
        self.of.baseline()
    }

    fn sample(&self, case: usize) -> Result<Sample, SampleError> {
        self.of.sample(case)
    }
}

/// Losses of a network and of empty maps, without noise, on unseen cases: on those of a recorded set that are not in
/// `trained_on`, otherwise on simulated ones.
fn losses(
    case: &Case,
    model: &Model,
    trained_on: Option<&FirstCases<'_>>,
    unseen: &TrainingSettings,
) -> Result<[f64; 2], Failure> {
    let Network::Rbf(network) = model.network() else {
        unreachable!("an RBF network was trained");
    };
    let simulated;
    let (samples, first): (&dyn Samples, usize) = match trained_on {
        Some(trained_on) => (trained_on.of, trained_on.count),
        None => {
            simulated = Simulation::of_case(case, unseen)?;
            (&simulated, 0)
        }
    };
    let mut losses = [0.0; 2];
    let judged = (samples.len() - first).max(1);
    for number in first..samples.len() {
        let sample = samples.sample(number).map_err(TrainError::from)?;
        let input: Vec<f64> = sample.input.iter().map(|x| f64::from(*x)).collect();
        let truth = dense_target(&sample.target, samples.outputs());
        for (map, truth) in network.predict(&input).iter().zip(&truth) {
            let truth = f64::from(*truth);
            losses[0] += 0.5 * (map - truth).powi(2) / judged as f64;
            losses[1] += 0.5 * truth.powi(2) / judged as f64;
        }
    }
    Ok(losses)
}
