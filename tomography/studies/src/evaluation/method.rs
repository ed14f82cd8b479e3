//! A method given as command-line options, prepared for a case and its frames. `linear` and `rbf` are trained here for
//! the case, unlike in other programs; `imaging` prepares all other methods.

use clap::{Args, Parser};
use eit::{Case, Jitter, TrainingSettings};
use imaging::recorded::{Fitted, FrameTable};
use imaging::{
    BuildError, DriftRule, Geometry, Method, MethodArguments, Model, TrackedArguments, Tracking,
};
use survey::Bounds;
use training::{Cached, linear, rbf, single_current};

use crate::failure::{Attempt, Failure};
use crate::progress;

/// Default number of simulated cases of a training.
const CASES: usize = 15_000;
/// Allowed number of simulated cases.
const TRAINING_CASES: Bounds = Bounds::Within(1.0, 1e7);

/// A method and its options.
#[derive(Debug, Clone, Args)]
pub struct MethodOptions {
    #[command(flatten)]
    method: MethodArguments,
    /// Unloaded conductance: a name in the case or a file [default: homog if there is one, else fitted to the baseline]
    #[arg(long, value_name = "NAME|FILE")]
    sigma0: Option<String>,
    /// Number of simulated cases, if a network is trained for the case [default: 15000]
    #[arg(long, value_name = "N", value_parser = TRAINING_CASES.counter())]
    cases: Option<usize>,
}

/// The options without a program's name.
#[derive(Debug, Parser)]
#[command(no_binary_name = true, name = "reconstruct")]
struct Words {
    #[command(flatten)]
    options: MethodOptions,
}

impl MethodOptions {
    /// Parses arguments such as `--method tv --loss-only`; `name` is the method's name in errors.
    ///
    /// # Errors
    /// Arguments that are not options of a method.
    pub fn parse(name: &str, words: &[String]) -> Result<Self, Failure> {
        Words::try_parse_from(words)
            .map(|words| words.options)
            .map_err(|fault| Failure::usage(format!("method '{name}': {fault}")))
    }

    /// Whether the drift of each frame is removed.
    pub fn removes_drift(&self) -> bool {
        self.method.drift == Some(DriftRule::Frame)
    }

    /// Prepares the method.
    ///
    /// # Errors
    /// Options that contradict each other, a model that does not fit the case, or a method that cannot be prepared.
    pub fn prepare(&self, case: &Case, recording: &FrameTable) -> Result<Model, Failure> {
        let requested = self.method.settings().map_err(Failure::usage)?;
        let geometry = self.geometry(case)?;
        if let Some(file) = &requested.file {
            self.no_sigma0("--model")?;
            self.no_cases("--model")?;
            let loss_only = requested.loss_only.unwrap_or(false);
            let model = imaging::load(file, loss_only, &case.protocol, Some(&geometry));
            return self.on_sheet(model.map_err(not_built)?, geometry, case, recording);
        }
        let settings = requested.clone().for_recording();
        let method = settings.method.unwrap_or_default();
        MethodArguments::check(&requested, method).map_err(Failure::usage)?;
        if matches!(method, Method::Linear | Method::Rbf) {
            self.no_sigma0(&format!("--method {}", method.name()))?;
            let loss_only = self.method.loss_only;
            let model = trained(self.train(method, case)?, loss_only);
            return self.on_sheet(model, geometry, case, recording);
        }
        self.no_cases(&format!("--method {}", method.name()))?;
        let fitted = Fitted::new(
            geometry,
            &case.protocol,
            &case.currents,
            &recording.unloaded,
        )
        .map_err(not_built)?;
        let mut model =
            imaging::build(&settings, &fitted.conditions(&case.protocol)).map_err(not_built)?;
        model.notes.splice(0..0, fitted.notes.iter().cloned());
        Ok(model)
    }

    /// Adds to a trained model the quality check of its maps, and removal of the drift of each frame if requested. If
    /// the baseline does not match the sheet, maps have no quality.
    fn on_sheet(
        &self,
        mut model: Model,
        geometry: Geometry,
        case: &Case,
        recording: &FrameTable,
    ) -> Result<Model, Failure> {
        let settings = self.method.settings().map_err(Failure::usage)?;
        let unloaded = &recording.unloaded;
        let fitted = match Fitted::new(geometry, &case.protocol, &case.currents, unloaded) {
            Err(why) if !self.removes_drift() => {
                let why = survey::error_chain(&why);
                model.notes.push(format!("maps are not judged: {why}"));
                return Ok(model);
            }
            fitted => fitted.map_err(not_built)?,
        };
        let conditions = fitted.conditions(&case.protocol);
        let model = imaging::with_drift(model, &settings, &conditions).map_err(not_built)?;
        imaging::judging(model, &settings, &conditions).map_err(not_built)
    }

    /// The tracked baseline of a recording, starting at a time, s.
    ///
    /// # Errors
    /// A noise that is neither stated nor measurable from the baseline, or a sheet that does not match the baseline.
    pub fn tracking(
        &self,
        case: &Case,
        recording: &FrameTable,
        at_s: f64,
    ) -> Result<Tracking, Failure> {
        let unloaded = &recording.unloaded;
        let noise_v = TrackedArguments::noise_v(unloaded.known_noise(self.method.noise_v));
        let noise_v = noise_v.map_err(Failure::usage)?;
        let geometry = self.geometry(case)?;
        let fitted =
            Fitted::new(geometry, &case.protocol, &case.currents, unloaded).map_err(not_built)?;
        let conditions = fitted.conditions(&case.protocol);
        Tracking::new(&conditions, &unloaded.readings, noise_v, at_s)
            .attempt("the baseline cannot be tracked")
    }

    /// The largest loss by noise alone in maps of a prepared model; `None` if the noise of a reading is unknown.
    pub fn map_noise(&self, model: &Model, recording: &FrameTable) -> Option<f64> {
        let unloaded = &recording.unloaded;
        let noise = unloaded.known_noise(self.method.noise_v)?;
        imaging::map_noise(model, &unloaded.readings, noise)
    }

    /// The case's geometry with the conductance given by `--sigma0`.
    fn geometry(&self, case: &Case) -> Result<Geometry, Failure> {
        let mut geometry = Geometry::of_case(case, "the case".to_owned());
        if let Some(name) = &self.sigma0 {
            geometry.sigma0 = case.sigma(name).attempt("cannot read --sigma0")?;
            geometry.sigma0_known = true;
        }
        Ok(geometry)
    }

    /// Trains the model for the case, or loads it from the cache.
    fn train(&self, method: Method, case: &Case) -> Result<Cached, Failure> {
        let bars = progress::Training::default();
        let show = |stage, done, of| bars.show(stage, done, of);
        let noise_v = self.method.noise_v;
        let cases = self.cases.unwrap_or(CASES);
        let jitter = match noise_v {
            Some(noise_v) => linear::matched(&[noise_v], single_current(case)?),
            None => Jitter::paper(),
        };
        let settings = TrainingSettings {
            cases,
            // a linear map has no neurons, but settings with more neurons than samples are refused
            neurons: TrainingSettings::default().neurons.min(cases),
            jitter,
            ..TrainingSettings::default()
        };
        if method == Method::Linear {
            let once = TrainingSettings {
                repeats: 1,
                ..settings
            };
            return Ok(linear::cached(case, &once, &show)?);
        }
        Ok(rbf::cached(case, &settings, &show)?)
    }

    /// Refuses `--sigma0` for a trained model.
    fn no_sigma0(&self, with: &str) -> Result<(), Failure> {
        match &self.sigma0 {
            None => Ok(()),
            Some(_) => Err(Failure::usage(format!(
                "--sigma0 belongs to the model-based methods and does not apply to {with}"
            ))),
        }
    }

    /// Refuses `--cases` for a method that is not trained for the case.
    fn no_cases(&self, with: &str) -> Result<(), Failure> {
        match self.cases {
            None => Ok(()),
            Some(cases) => Err(Failure::usage(format!(
                "--cases {cases} belongs to the methods that are trained for the case, linear and rbf, and does not apply to {with}"
            ))),
        }
    }
}

/// A model trained for the case; its maps are clipped to losses if requested.
fn trained(cached: Cached, loss_only: bool) -> Model {
    let mut model = Model::trained(cached.model.into_reconstructor(), loss_only);
    model.notes = cached.notes;
    model
}

/// Converts an error: [`BuildError::Setting`] is a usage error, all others are not.
fn not_built(error: BuildError) -> Failure {
    match error {
        BuildError::Setting(text) => Failure::usage(text),
        error => Failure::of("cannot prepare the method", &error),
    }
}
