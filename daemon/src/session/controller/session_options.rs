//! Checks the options of a request before anything is started.

use std::path::Path;
use std::sync::Arc;

use dbus::{ABOUT_OPTIONS, Fault, MEASURING_OPTIONS, Options, SESSION_OPTIONS, SessionOptions};
use logbook::{About, FrameRecord, LogbookError};
use survey::{Baseline, Protocol, Settings, duration};

use crate::acquisition::measuring::Measuring;
use crate::acquisition::schedule::Schedule;
use crate::instruments::rig_plan::RigPlan;
use crate::panics::containment;
use crate::preparation;
use crate::preparation::Setup;
use crate::recording::session_status::SessionStatus;
use crate::session::controller::Controller;
use crate::session::controller::resume::{Interrupted, to_json};
use crate::session::option_values;
use crate::session::state::Work;
use config::{AboutSection, SurveySection};
use imaging::{BuildError, Conditions, Method, Model, ReconstructionSettings, noise};
use survey::error_chain as chain;

/// Default number of frames of a baseline.
const BASELINE_FRAMES: u64 = 10;

/// The error if a baseline is needed and there is none.
pub(crate) fn no_baseline() -> Fault {
    Fault::NoBaseline(
        "no baseline has been recorded; take all loads off the sheet and run `tactus baseline record`"
            .into(),
    )
}

/// The error if the plan of a recording is requested.
pub(crate) fn no_plan() -> Fault {
    Fault::Unsupported("a recording has no plan: nothing is measured".into())
}

/// The settings of a new session.
pub(super) struct Assignment {
    pub work: Work,
    pub schedule: Schedule,
    pub speed: Option<f64>,
    pub step: bool,
    pub note: String,
    pub frames: u64,
    pub baseline: Option<Arc<Baseline>>,
    pub model: Option<Model>,
    /// The complete settings of the model, including the noise of the baseline if the method uses it.
    pub settings: Option<ReconstructionSettings>,
    /// The plan, if it differs from the configured one.
    pub plan: Option<Arc<RigPlan>>,
    pub about: About,
    /// The options that the session was started with, as JSON, stored in its file.
    pub requested: String,
    /// The interrupted session, and the event of its resumption.
    pub resumed: Option<(Box<Interrupted>, String)>,
    /// The event of the resumption, if it could not be written before the session was resumed.
    pub first_event: Option<String>,
    /// The last frame before the interruption.
    pub before: Option<FrameRecord>,
}

/// Notes about the experiment: from the options, otherwise from the configuration.
fn about(options: &SessionOptions, given: &AboutSection) -> About {
    let word = |message: &Option<String>, given: &String| message.as_ref().unwrap_or(given).clone();
    About {
        sheet: word(&options.sheet, &given.sheet),
        foam: word(&options.foam, &given.foam),
        ink: word(&options.ink, &given.ink),
        operator: word(&options.operator, &given.operator),
        wiring: given.wiring.clone(),
        calibration: given.calibration.clone(),
    }
}

/// Parses the options of a method that accepts these groups.
fn read(options: &Options, groups: &[&[&str]]) -> Result<SessionOptions, Fault> {
    options.only(&groups.concat())?;
    option_values::read(options, option_values::session_option)
}

/// The configured survey, overridden by the options of the same names.
fn overlaid(
    configured: &SurveySection,
    options: &SessionOptions,
) -> Result<SurveySection, serde_json::Error> {
    let mut survey = serde_json::to_value(configured)?;
    let options = serde_json::to_value(options)?;
    for key in MEASURING_OPTIONS {
        if let Some(variant) = options.get(key) {
            survey[key] = variant["value"].clone();
        }
    }
    serde_json::from_value(survey)
}

/// The protocol of a session: that of its plan, otherwise the configured one.
pub(super) fn protocol_of<'a>(plan: Option<&'a RigPlan>, setup: &'a Setup) -> &'a Protocol {
    plan.map_or(&setup.protocol, |own| &own.plan.protocol)
}

/// The plan of a rig with this survey.
fn adjusted(setup: &Setup, survey: SurveySection) -> Result<RigPlan, Fault> {
    preparation::adjusted(setup, survey)
        .map_err(|problems| Fault::InvalidOption(problems.join("; ")))
}

impl Controller {
    /// Starts a measurement.
    ///
    /// # Errors
    /// An invalid option, a missing or unsuitable baseline, a model that does not fit, a running session, or an error
    /// of an instrument or the disk.
    pub(crate) async fn start_session(
        self: &Arc<Self>,
        options: &Options,
    ) -> Result<Arc<SessionStatus>, Fault> {
        self.may_start().await;
        let no_reload = self.without_reload().await;
        let order = self.measurement(options, None).await?;
        self.begin(order, no_reload).await
    }

    /// Resolves the options of a measurement. `own` is the baseline of a resumed session.
    ///
    /// # Errors
    /// As [`Controller::start_session`], but nothing is started.
    pub(super) async fn measurement(
        self: &Arc<Self>,
        options: &Options,
        own: Option<Arc<Baseline>>,
    ) -> Result<Assignment, Fault> {
        let mut requested = to_json(options);
        let options = read(
            options,
            &[&SESSION_OPTIONS, &ABOUT_OPTIONS, &MEASURING_OPTIONS],
        )?;
        let given = self.runtime().setup.schedule;
        let schedule = Schedule {
            every: options.every_s.map_or(given.every, duration),
            count: options.count.or(given.count),
            lasts: options.for_s.map(duration).or(given.lasts),
        };
        let speed = options.speed;
        if speed.is_some() && !self.is_recording() {
            return Err(Fault::InvalidOption(
                "option 'speed' is for recordings; a rig has its own rate".into(),
            ));
        }
        let goes_on = own.is_some();
        let baseline = match own {
            Some(own) => own,
            None => self.chosen_baseline(options.baseline.as_deref())?,
        };
        let plan = self.own_plan(&options).await?;
        let measuring = match &plan {
            Some(plan) => Some(plan.settings()),
            None => self.runtime().settings.clone(),
        };
        self.check_baseline(&baseline, measuring.as_ref(), plan.as_deref())?;
        let (model, settings) = self
            .chosen_model(options.model.as_deref(), plan.as_deref(), &baseline)
            .await?;
        // not checked for a resumed session, which is recorded even if the machine is busy now
        if !goes_on {
            self.check_map_time(&model, &baseline, plan.as_ref(), &schedule)
                .await?;
        }
        // stored, because the configuration may differ when the session is resumed
        let every = schedule.every.as_secs_f64();
        requested.insert("every_s".to_owned(), every.into());
        if let Some(count) = schedule.count {
            requested.insert("count".to_owned(), count.into());
        }
        if let Some(lasts) = schedule.lasts {
            requested.insert("for_s".to_owned(), lasts.as_secs_f64().into());
        }
        Ok(Assignment {
            work: Work::Measurement,
            schedule,
            speed,
            step: options.step.unwrap_or(false),
            about: about(&options, &self.runtime().setup.config.about),
            note: options.note.unwrap_or_default(),
            frames: 0,
            baseline: Some(baseline),
            model: Some(model),
            settings: Some(settings),
            plan,
            requested: serde_json::Value::Object(requested).to_string(),
            resumed: None,
            first_event: None,
            before: None,
        })
    }

    /// Starts the recording of a baseline.
    ///
    /// # Errors
    /// As [`Controller::start_session`].
    pub(crate) async fn record_baseline(
        self: &Arc<Self>,
        options: &Options,
    ) -> Result<Arc<SessionStatus>, Fault> {
        let requested = to_json(options);
        let options = read(
            options,
            &[&["frames", "note"], &ABOUT_OPTIONS, &MEASURING_OPTIONS],
        )?;
        let frames = options.frames.unwrap_or(BASELINE_FRAMES);
        let schedule = Schedule {
            count: Some(frames),
            ..Schedule::default()
        };
        self.may_start().await;
        let no_reload = self.without_reload().await;
        let order = Assignment {
            work: Work::Baseline,
            schedule,
            speed: self.is_recording().then_some(0.0),
            step: false,
            plan: self.own_plan(&options).await?,
            about: about(&options, &self.runtime().setup.config.about),
            note: options.note.unwrap_or_default(),
            frames,
            baseline: None,
            model: None,
            settings: None,
            requested: serde_json::Value::Object(requested).to_string(),
            resumed: None,
            first_event: None,
            before: None,
        };
        self.begin(order, no_reload).await
    }

    /// The plan of a session with these options, with ranges from the current baseline. Takes long to compute: must not
    /// be called on the threads that sessions need.
    ///
    /// # Errors
    /// An option is invalid, or the daemon plays a recording.
    pub(crate) fn plan_with(&self, options: &Options) -> Result<Arc<RigPlan>, Fault> {
        let options = read(options, &[&MEASURING_OPTIONS])?;
        let own = self.own_survey(&options)?;
        let (runtime, baseline) = (self.runtime(), self.baseline());
        let plan = match own {
            Some(survey) => Arc::new(adjusted(&runtime.setup, survey)?),
            None => runtime.plan.clone().ok_or_else(no_plan)?,
        };
        let hash = plan.settings().protocol_hash;
        // a baseline of another pattern cannot determine the ranges
        let baseline = baseline.filter(|baseline| baseline.settings.protocol_hash == hash);
        let measuring = Measuring::of(Some(Arc::clone(&plan)), baseline.as_deref());
        Ok(measuring.now().unwrap_or(plan))
    }

    /// The baseline with this id, read from the record if needed; without an id, the current one.
    ///
    /// # Errors
    /// There is no such baseline.
    pub(crate) fn chosen_baseline(&self, id: Option<&str>) -> Result<Arc<Baseline>, Fault> {
        let current = self.baseline();
        let Some(id) = id else {
            return current.ok_or_else(no_baseline);
        };
        if let Some(current) = current.filter(|current| current.id == id) {
            return Ok(current);
        }
        let found = logbook::find(&self.runtime().setup.record_directory, id)
            .and_then(logbook::SessionReader::open)
            .and_then(|session| session.baseline());
        match found {
            Ok(Some(baseline)) => Ok(Arc::new(baseline)),
            Ok(None) => Err(Fault::NoBaseline(format!(
                "session '{id}' has no baseline in it"
            ))),
            Err(LogbookError::NoSuchSession { .. } | LogbookError::BadId { .. }) => {
                Err(Fault::NoSession(format!(
                    "there is no baseline '{}'; `tactus baseline list` lists the recorded ones",
                    survey::printable(id)
                )))
            }
            // the ids that match may be those of measurements, so they are not listed
            Err(LogbookError::Ambiguous { .. }) => Err(Fault::InvalidOption(format!(
                "'{}' is the beginning of several session ids, not the id of a baseline; `tactus baseline list` lists the recorded ones",
                survey::printable(id)
            ))),
            Err(error) => Err(Fault::NoBaseline(chain(&error))),
        }
    }

    /// The protocol of a session with these options.
    ///
    /// # Errors
    /// An invalid option.
    pub(super) async fn protocol_for(&self, options: &Options) -> Result<Protocol, Fault> {
        let options = option_values::read(options, option_values::session_option)?;
        let plan = self.own_plan(&options).await?;
        Ok(protocol_of(plan.as_deref(), &self.runtime().setup).clone())
    }

    /// The plan of a session with survey options; `None` if they do not change the configured survey.
    async fn own_plan(&self, options: &SessionOptions) -> Result<Option<Arc<RigPlan>>, Fault> {
        let Some(survey) = self.own_survey(options)? else {
            return Ok(None);
        };
        let runtime = self.runtime();
        match tokio::task::spawn_blocking(move || adjusted(&runtime.setup, survey)).await {
            Ok(plan) => plan.map(|plan| Some(Arc::new(plan))),
            Err(_) => Err(Fault::Failed("the plan could not be made".into())),
        }
    }

    /// The survey of a session with survey options; `None` if they do not change the configured survey.
    fn own_survey(&self, options: &SessionOptions) -> Result<Option<SurveySection>, Fault> {
        let runtime = self.runtime();
        let configured = &runtime.setup.config.survey;
        if let Some(other) = options.ranges.as_deref()
            && !["fixed", "planned"].contains(&other)
        {
            return Err(Fault::InvalidOption(format!(
                "option 'ranges' is '{other}'; it must be 'fixed' or 'planned'"
            )));
        }
        let mut survey = overlaid(configured, options)
            .map_err(|error| Fault::InvalidOption(format!("measuring options: {error}")))?;
        // 0 means never; in a file the key is left out instead
        survey.zero_every = survey.zero_every.filter(|every| *every > 0);
        if survey == *configured {
            return Ok(None);
        }
        if self.is_recording() {
            return Err(Fault::InvalidOption(
                "measuring options do not apply to a recording; leave them out".into(),
            ));
        }
        Ok(Some(survey))
    }

    pub(super) fn check_baseline(
        &self,
        baseline: &Baseline,
        settings: Option<&Settings>,
        plan: Option<&RigPlan>,
    ) -> Result<(), Fault> {
        let runtime = self.runtime();
        let Some(settings) = settings else {
            return Ok(());
        };
        baseline
            .check(
                settings,
                protocol_of(plan, &runtime.setup).len(),
                runtime.simulated,
            )
            .map_err(|error| Fault::BaselineMismatch(error.to_string()))
    }

    /// The reconstructor of a session and its settings, including the noise of the baseline if the method uses it.
    async fn chosen_model(
        self: &Arc<Self>,
        requested: Option<&str>,
        plan: Option<&RigPlan>,
        baseline: &Baseline,
    ) -> Result<(Model, ReconstructionSettings), Fault> {
        let runtime = self.runtime();
        let protocol = protocol_of(plan, &runtime.setup).clone();
        // for a recording, the preparation has already set the noise, if it is known
        let by_baseline = !self.is_recording();
        let noise_uv = by_baseline.then(|| 1e6 * noise::against(baseline));
        let configured = &runtime.setup.config.model;
        let requested = match requested {
            None if protocol == runtime.setup.protocol
                && (noise_uv.is_none() || !configured.takes_noise_of_baseline()) =>
            {
                return Ok((runtime.setup.model.clone(), configured.clone()));
            }
            Some(other) if other != "one-step" && !Path::new(other).is_absolute() => {
                return Err(Fault::InvalidOption(format!(
                    "option 'model' is '{other}'; write an absolute path, or one-step"
                )));
            }
            requested => requested.map(str::to_owned),
        };
        let loaded = containment::blocking(move || {
            let Setup {
                config,
                geometry,
                current,
                ..
            } = &runtime.setup;
            let mut settings = match requested.as_deref() {
                // the configured method, for the session's own pattern or with the noise of its baseline
                None => config.model.clone(),
                Some("one-step") => ReconstructionSettings {
                    method: Some(Method::OneStep),
                    ..ReconstructionSettings::default()
                }
                .over(config.model.clone()),
                Some(file) => ReconstructionSettings {
                    file: Some(file.into()),
                    noise_uv: config.model.noise_uv,
                    loss_only: config.model.loss_only,
                    map_every: config.model.map_every,
                    tracking: config.model.tracking,
                    drift: config.model.drift,
                    ..ReconstructionSettings::default()
                },
            };
            if settings.takes_noise_of_baseline() {
                settings.noise_uv = noise_uv;
            }
            imaging::check_live(&settings)?;
            let conditions = Conditions::live(geometry, &protocol, *current);
            Ok::<_, BuildError>((imaging::build(&settings, &conditions)?, settings))
        });
        match loaded.await {
            Ok(Ok(chosen)) => Ok(chosen),
            Ok(Err(fault)) if fault.is_mismatch() => Err(Fault::ModelMismatch(chain(&fault))),
            Ok(Err(fault @ (BuildError::File(_) | BuildError::Onnx(_)))) => {
                Err(Fault::ModelFile(chain(&fault)))
            }
            Ok(Err(fault)) => Err(Fault::Failed(chain(&fault))),
            Err(_) => Err(Fault::Failed("the model could not be prepared".into())),
        }
    }
}
