//! Trains the RBF network of a case (the paper's section 4.3): k-means, the spread, least squares. `eit` evaluates the
//! network.

mod kmeans;
mod least_squares;

use std::sync::Arc;

use eit::{Case, Model, Network, Report, TrainingReport, TrainingSettings};

use crate::model_cache::{Cached, kept};
use crate::noise_figure::with_noise_figure;
use crate::samples::{Noise, Progress, Samples, Simulation, TrainError};
use crate::symmetry::Symmetric;
pub use least_squares::train_rbf_on;

/// Ratio of spread to median distance above which a few samples dominate the spread of Eq. 13.
pub const SPREAD_RULED: f64 = 10.0;

/// A warning if the ratio of spread to median distance is more than [`SPREAD_RULED`]; otherwise `None`.
pub fn spread_note(report: &TrainingReport) -> Option<String> {
    let times = report.spread_over_median;
    (times > SPREAD_RULED).then(|| match times < least_squares::MEDIAN_OF_ZERO {
        true => format!(
            "the spread is {times:.0} median distances: a few cases near electrodes determine it (Eq. 13)"
        ),
        false => "most cases are alike: the others alone determine the spread (Eq. 13)".to_owned(),
    })
}

/// Trains on `samples`, or on cases simulated with `settings`; with `symmetric`, the set is extended by every symmetry
/// of the sheet.
///
/// # Errors
/// A set that cannot be simulated or read, invalid settings, or a least-squares problem that cannot be solved.
pub fn fit(
    case: &Case,
    settings: TrainingSettings,
    samples: Option<&dyn Samples>,
    symmetric: bool,
    name: &str,
    progress: Progress<'_>,
) -> Result<Model, TrainError> {
    let sigma0 = case.unloaded_conductance();
    let simulation = Simulation::of_case(case, &settings)?;
    let once = samples.unwrap_or(&simulation);
    let mirrored = Symmetric::new(once, case, &sigma0);
    let samples: &dyn Samples = if symmetric { &mirrored } else { once };
    let (network, report) = train_rbf_on(samples, &settings, progress)?;
    let noise = Noise::new(
        &settings.jitter,
        settings.open.spread,
        samples.baseline(),
        settings.seed,
    )?;
    let model = Model::new(
        name,
        Arc::clone(&case.mesh),
        &case.protocol,
        Network::Rbf(network),
        settings,
        Report::Rbf(report),
        None,
    )?;
    Ok(with_noise_figure(model, case, &sigma0, &noise))
}

/// The RBF network of a case: from the cache if it was trained before with the same settings, otherwise trained and
/// cached.
///
/// # Errors
/// See [`fit`].
pub fn cached(
    case: &Case,
    settings: &TrainingSettings,
    progress: Progress<'_>,
) -> Result<Cached, TrainError> {
    let mut cached = kept(case, settings, "rbf", || {
        fit(case, settings.clone(), None, false, "rbf", progress)
    })?;
    if cached.is_new
        && let Report::Rbf(report) = &cached.model.metadata().report
    {
        cached.notes.extend(spread_note(report));
    }
    Ok(cached)
}
