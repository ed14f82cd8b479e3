//! `tactus-lab train linear`.

use eit::{Report, TrainingSettings};
use studies::{Failure, progress};
use training::linear;

use super::data::Data;
use super::{limits, model_file};
use crate::args::LinearOptions;
use crate::output::print_line;

/// Trains and writes the model file.
pub(super) fn train(options: &LinearOptions) -> Result<(), Failure> {
    let data = Data::read(&options.data)?;
    let usual = TrainingSettings::default();
    let settings = TrainingSettings {
        jitter: data.jitter.clone(),
        repeats: 1,
        ..match &data.set {
            Some(set) => set.settings().clone(),
            None => TrainingSettings {
                cases: options.cases,
                // a linear map has no neurons, but its file stores these settings
                neurons: usual.neurons.min(options.cases),
                seed: options.seed,
                ..usual
            },
        }
    };
    let bars = progress::Training::default();
    let show = |stage, done, of| bars.show(stage, done, of);
    let model = linear::fit(
        &data.case,
        settings,
        data.samples(),
        options.data.symmetric,
        options.precision.into(),
        &format!("linear {}", options.data.profile.name()),
        &show,
    )?;
    drop(bars);
    let Report::Deep(report) = model.metadata().report.clone() else {
        unreachable!("a network of one layer was trained");
    };
    limits::check_learnt(report.held_out_loss, report.empty_loss, options.data.yes)?;
    let model = data.judged(model, report.settings.held_out)?;
    model_file::save(&options.out, &options.replacing, &model)?;
    if options.json {
        let line = model_file::json(&options.out, &model, &report);
        print_line!("{}", survey::printable_json(line.to_string()));
    } else {
        print_line!(
            "{}: {} of {} samples; loss on held-out cases {:.3}, {:.0} % of an empty map's\n{}\nsha256 {}",
            options.out.display(),
            model.metadata().name,
            report.samples,
            report.held_out_loss,
            100.0 * report.held_out_loss / report.empty_loss,
            model_file::misfit(&model),
            model.hash()
        );
    }
    Ok(())
}
