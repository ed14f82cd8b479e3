//! Who keeps watch: one per daemon, holds the rig, starts and ends sessions, remembers the baseline.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bus::{Fault, Options};
use chrono::{DateTime, Utc};
use logbook::{InstrumentRecord, LogbookError, SessionHeader, SessionKind, SessionWriter};
use rig::{Clock, SystemClock};
use survey::{Baseline, Settings};
use tokio::sync::mpsc;

use crate::herald::{Herald, Notice};
use crate::live::{Ending, Facts, Live};
use crate::model::{self, Model, ModelFault, chain};
use crate::prepare::{FramesFrom, Prepared, RigPlan, Setup, seconds};
use crate::recorder::{Order, QUEUE, Recorder, Task};
use crate::rig_assembly::{Assembled, Bench, Found, assemble};
use crate::schedule::Schedule;
use crate::session::{Event, State, Work};
use crate::watch::{Ended, FrameSource, Watch};

/// Ended sessions that stay on the bus, so that who started one can still ask how it went.
const REMEMBERED: usize = 16;
/// Frames of a baseline where nobody says.
const BASELINE_FRAMES: u64 = 10;
/// Summaries are at most five a second.
const BETWEEN_SUMMARIES: Duration = Duration::from_millis(200);
/// A lost rig is looked for again after so long, and then ever less often up to the second value.
const LOOK_AGAIN: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(10));

/// What never changes while the daemon runs.
pub(crate) struct House {
    pub setup: Setup,
    /// `None` for a recording.
    pub plan: Option<Arc<RigPlan>>,
    pub settings: Option<Settings>,
    pub bench: Bench,
    pub simulated: bool,
    pub instruments: Vec<Found>,
    pub modules: Vec<String>,
    pub clock: SystemClock,
    pub build: String,
}

/// The daemon's one head.
pub(crate) struct Keeper {
    pub house: House,
    pub herald: Herald,
    source: tokio::sync::Mutex<FrameSource>,
    inner: Mutex<Inner>,
}

struct Inner {
    state: State,
    baseline: Option<Arc<Baseline>>,
    active: Option<Arc<Live>>,
    recent: VecDeque<Arc<Live>>,
    /// Why the rig cannot be used, until it is found again.
    rig_fault: Option<String>,
}

/// What a session is to be.
struct Assignment {
    work: Work,
    schedule: Schedule,
    speed: Option<f64>,
    step: bool,
    note: String,
    frames: u64,
    baseline: Option<Arc<Baseline>>,
    model: Option<Model>,
}

impl Keeper {
    /// Takes over a rig or a recording that has been prepared; nothing runs yet.
    pub(crate) fn new(
        prepared: Prepared,
        bench: Bench,
        assembled: Option<Assembled>,
        clock: SystemClock,
    ) -> Arc<Self> {
        let simulated = prepared.is_simulated();
        let (rig, instruments, modules) = match assembled {
            Some(assembled) => (
                Some(assembled.rig),
                assembled.instruments,
                assembled.modules,
            ),
            None => (None, Vec::new(), Vec::new()),
        };
        let Prepared { setup, frames } = prepared;
        let (source, settings, plan, baseline) = match frames {
            FramesFrom::Rig(plan) => {
                let settings = rig::settings(&plan.plan, plan.meter);
                let source = FrameSource::Rig {
                    rig,
                    plan: Arc::clone(&plan),
                };
                let latest =
                    logbook::latest_baseline(&setup.record_directory).unwrap_or_else(|error| {
                        tracing::warn!("the last baseline cannot be read: {}", chain(&error));
                        None
                    });
                let baseline = latest.map(|(_, baseline)| baseline);
                (source, Some(settings), Some(plan), baseline)
            }
            FramesFrom::Recording {
                recording,
                baseline,
            } => {
                let settings = recording.settings();
                (
                    FrameSource::Recording(recording),
                    settings,
                    None,
                    Some(*baseline),
                )
            }
        };
        Arc::new(Self {
            house: House {
                build: format!("tactusd {}", env!("CARGO_PKG_VERSION")),
                setup,
                plan,
                settings,
                bench,
                simulated,
                instruments,
                modules,
                clock,
            },
            herald: Herald::default(),
            source: tokio::sync::Mutex::new(source),
            inner: Mutex::new(Inner {
                state: State::Idle,
                baseline: baseline.map(Arc::new),
                active: None,
                recent: VecDeque::new(),
                rig_fault: None,
            }),
        })
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn state(&self) -> State {
        self.inner().state.clone()
    }

    pub(crate) fn baseline(&self) -> Option<Arc<Baseline>> {
        self.inner().baseline.clone()
    }

    pub(crate) fn active(&self) -> Option<Arc<Live>> {
        self.inner().active.clone()
    }

    /// The running session and those that ended a short while ago.
    pub(crate) fn sessions(&self) -> Vec<Arc<Live>> {
        let inner = self.inner();
        inner.recent.iter().chain(&inner.active).cloned().collect()
    }

    /// Why an instrument cannot be used; `None` when all can.
    pub(crate) fn rig_fault(&self) -> Option<String> {
        self.inner().rig_fault.clone()
    }

    /// Changes the state; a refusal leaves it.
    fn happened(&self, event: Event) -> Result<(), crate::session::Refusal> {
        let outcome = {
            let mut inner = self.inner();
            let state = std::mem::replace(&mut inner.state, State::Idle);
            match state.after(event) {
                Ok(next) => {
                    inner.state = next;
                    Ok(())
                }
                Err((kept, refusal)) => {
                    inner.state = kept;
                    Err(refusal)
                }
            }
        };
        if outcome.is_ok() {
            let status = format!("STATUS={}\n", self.state());
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Custom(&status)]);
            self.herald.say(&Notice::Daemon);
        }
        outcome
    }

    /// Starts a measurement.
    ///
    /// # Errors
    /// An option that cannot be, no or another baseline, a model that does not fit, a session running, an instrument or
    /// a disk that fails.
    pub(crate) async fn start_session(
        self: &Arc<Self>,
        options: &Options,
    ) -> Result<Arc<Live>, Fault> {
        options.only(&bus::SESSION_OPTIONS)?;
        let not_negative = |key: &str| match options.number(key)? {
            Some(value) if value < 0.0 => Err(Fault::InvalidOption(format!(
                "option '{key}' is {value}; it must be 0 or more"
            ))),
            value => Ok(value),
        };
        let given = &self.house.setup.schedule;
        let step = options.flag("step")?.unwrap_or(false);
        let schedule = Schedule {
            every: not_negative("every_s")?.map_or(given.every, seconds),
            count: options.whole("count")?.or(given.count),
            lasts: not_negative("for_s")?.map(seconds).or(given.lasts),
        };
        if schedule.count == Some(0) {
            return Err(Fault::InvalidOption(
                "option 'count' is 0; it must be 1 or more".into(),
            ));
        }
        let speed = not_negative("speed")?;
        if speed.is_some() && !self.is_recording() {
            return Err(Fault::InvalidOption(
                "option 'speed' is for recordings; a rig has its own rate".into(),
            ));
        }
        let note = options.text("note")?.unwrap_or_default().to_owned();
        let baseline = self.chosen_baseline(options.text("baseline")?)?;
        self.check_baseline(&baseline)?;
        let model = self.chosen_model(options.text("model")?).await?;
        self.begin(Assignment {
            work: Work::Measurement,
            schedule,
            speed,
            step,
            note,
            frames: 0,
            baseline: Some(baseline),
            model: Some(model),
        })
        .await
    }

    /// Starts the recording of a baseline.
    ///
    /// # Errors
    /// As [`Keeper::start_session`].
    pub(crate) async fn record_baseline(
        self: &Arc<Self>,
        options: &Options,
    ) -> Result<Arc<Live>, Fault> {
        options.only(&["frames", "note"])?;
        let frames = options.whole("frames")?.unwrap_or(BASELINE_FRAMES);
        if frames == 0 {
            return Err(Fault::InvalidOption(
                "option 'frames' is 0; it must be 1 or more".into(),
            ));
        }
        let schedule = Schedule {
            count: Some(frames),
            ..Schedule::default()
        };
        self.begin(Assignment {
            work: Work::Baseline,
            schedule,
            speed: self.is_recording().then_some(0.0),
            step: false,
            note: options.text("note")?.unwrap_or_default().to_owned(),
            frames,
            baseline: None,
            model: None,
        })
        .await
    }

    pub(crate) fn is_recording(&self) -> bool {
        self.house.plan.is_none()
    }

    fn chosen_baseline(&self, id: Option<&str>) -> Result<Arc<Baseline>, Fault> {
        let current = self.baseline();
        let Some(id) = id else {
            return current.ok_or_else(|| {
                Fault::NoBaseline(
                    "no baseline has been recorded; record one of the unloaded sheet first".into(),
                )
            });
        };
        if let Some(current) = current.filter(|current| current.id == id) {
            return Ok(current);
        }
        let found = logbook::find(&self.house.setup.record_directory, id)
            .and_then(logbook::SessionReader::open)
            .and_then(|session| session.baseline());
        match found {
            Ok(Some(baseline)) => Ok(Arc::new(baseline)),
            Ok(None) => Err(Fault::NoBaseline(format!(
                "session '{id}' has no baseline in it"
            ))),
            Err(error) => Err(Fault::NoBaseline(chain(&error))),
        }
    }

    fn check_baseline(&self, baseline: &Baseline) -> Result<(), Fault> {
        let Some(settings) = &self.house.settings else {
            return Ok(());
        };
        baseline
            .check(
                settings,
                self.house.setup.protocol.len(),
                self.house.simulated,
            )
            .map_err(|error| Fault::BaselineMismatch(error.to_string()))
    }

    async fn chosen_model(self: &Arc<Self>, asked: Option<&str>) -> Result<Model, Fault> {
        let Some(asked) = asked.map(str::to_owned) else {
            return Ok(self.house.setup.model.clone());
        };
        if asked != "one-step" && !Path::new(&asked).is_absolute() {
            return Err(Fault::InvalidOption(format!(
                "option 'model' is '{asked}'; write an absolute path, or one-step"
            )));
        }
        let keeper = Arc::clone(self);
        let loaded = tokio::task::spawn_blocking(move || {
            let Setup {
                config,
                geometry,
                protocol,
                ..
            } = &keeper.house.setup;
            if asked == "one-step" {
                let section = crate::config::ModelSection {
                    file: None,
                    ..config.model.clone()
                };
                model::one_step(&section, &config.survey, geometry, protocol)
            } else {
                model::from_file(Path::new(&asked), geometry, protocol)
            }
        });
        match loaded.await {
            Ok(Ok(model)) => Ok(model),
            Ok(Err(fault)) if fault.is_mismatch() => Err(Fault::ModelMismatch(chain(&fault))),
            Ok(Err(fault @ ModelFault::File { .. })) => Err(Fault::ModelFile(chain(&fault))),
            Ok(Err(fault)) => Err(Fault::Failed(chain(&fault))),
            Err(_) => Err(Fault::Failed("the model could not be prepared".into())),
        }
    }

    async fn begin(self: &Arc<Self>, order: Assignment) -> Result<Arc<Live>, Fault> {
        self.happened(Event::Start(order.work))
            .map_err(|refusal| Fault::SessionActive(refusal.to_string()))?;
        // whoever loses interest in the answer does not leave the state behind
        let keeper = Arc::clone(self);
        let begun = tokio::spawn(async move {
            let begun = keeper.begin_now(order).await;
            if let Err(fault) = &begun {
                let _ = match fault {
                    Fault::DiskRefused(text) | Fault::InstrumentFault(text) => {
                        keeper.happened(Event::Fault(text.clone()))
                    }
                    _ => keeper.happened(Event::Ended),
                };
            }
            begun
        });
        begun
            .await
            .unwrap_or_else(|_| Err(Fault::Failed("the session could not be started".into())))
    }

    async fn begin_now(self: &Arc<Self>, order: Assignment) -> Result<Arc<Live>, Fault> {
        if self.rig_fault().is_some() {
            self.find_rig_again()
                .await
                .map_err(Fault::InstrumentFault)?;
        }
        let started = self.house.clock.wall();
        let (kind, letter) = match order.work {
            Work::Baseline => (SessionKind::Baseline, 'b'),
            Work::Measurement => (SessionKind::Measurement, 'm'),
        };
        let header = self.header(kind, started, letter, &order);
        let directory = self.house.setup.record_directory.clone();
        let copy = order.baseline.clone();
        let id = header.id.clone();
        let writer = tokio::task::spawn_blocking(move || {
            let mut writer = SessionWriter::create(&directory, &header)?;
            if let Some(baseline) = copy {
                writer.baseline(&baseline)?;
            }
            Ok::<_, LogbookError>(writer)
        })
        .await
        .map_err(|_| Fault::Failed("the session file could not be made".into()))?
        .map_err(|error| disk_fault(&error))?;
        let baseline_id = order
            .baseline
            .as_ref()
            .map(|b| b.id.clone())
            .unwrap_or_default();
        let method = order
            .model
            .as_ref()
            .map(|m| m.reconstructor.method().to_owned())
            .unwrap_or_default();
        let live = Arc::new(Live::new(
            Facts {
                id,
                kind,
                simulated: self.house.simulated,
                baseline_id,
                method,
                path: writer.path().to_owned(),
            },
            order.step,
        ));
        self.inner().active = Some(Arc::clone(&live));
        self.herald.say(&Notice::SessionAdded(Arc::clone(&live)));
        self.herald.say(&Notice::Daemon);
        tokio::spawn(Arc::clone(self).tell_progress(Arc::clone(&live)));
        tokio::spawn(Arc::clone(self).keep(Arc::clone(&live), writer, order));
        Ok(live)
    }

    fn header(
        &self,
        kind: SessionKind,
        started: DateTime<Utc>,
        letter: char,
        order: &Assignment,
    ) -> SessionHeader {
        let Setup {
            config_toml,
            config_hash,
            protocol,
            geometry,
            ..
        } = &self.house.setup;
        let id = format!("{letter}{}", started.format("%Y%m%dt%H%M%S_%3f"));
        SessionHeader {
            kind,
            instruments: self
                .house
                .instruments
                .iter()
                .map(|found| InstrumentRecord {
                    role: found.role.to_owned(),
                    identity: found.identity.clone(),
                    address: found.address.clone(),
                })
                .collect(),
            modules: self.house.modules.clone(),
            config_toml: config_toml.clone(),
            config_hash: config_hash.clone(),
            model_hash: order.model.as_ref().and_then(|model| model.hash.clone()),
            geometry_hash: Some(geometry.mesh.hash().to_owned()),
            build: self.house.build.clone(),
            simulated: self.house.simulated,
            seed: self.house.bench.as_ref().map(crate::simulation::seed),
            note: order.note.clone(),
            ..SessionHeader::new(id, started, protocol.clone())
        }
    }

    /// A session from its first frame to its closed record.
    async fn keep(self: Arc<Self>, live: Arc<Live>, writer: SessionWriter, order: Assignment) {
        let (orders, queue) = mpsc::channel(QUEUE);
        let mesh = &self.house.setup.geometry.mesh;
        let recorder = Recorder {
            live: Arc::clone(&live),
            writer,
            clock: self.house.clock,
            twins: self.house.setup.protocol.reciprocal_twins(),
            build: self.house.build.clone(),
            task: match (order.baseline, order.model) {
                (Some(baseline), Some(model)) => Task::Maps {
                    baseline: Box::new(baseline.as_ref().clone()),
                    model,
                    centroids: mesh.region_centroids(),
                    areas: mesh.region_areas(),
                },
                _ => Task::Baseline {
                    frames: Vec::new(),
                    wanted: order.frames,
                },
            },
        };
        let recording = tokio::task::spawn_blocking(move || recorder.run(queue));
        let keeper = Arc::clone(&self);
        let watch = Watch {
            live: Arc::clone(&live),
            schedule: order.schedule,
            speed: order.speed,
            clock: self.house.clock,
            recorder: orders.clone(),
            paused: Arc::new(move |paused| {
                let event = if paused {
                    Event::Suspend
                } else {
                    Event::Resume
                };
                let _ = keeper.happened(event);
            }),
        };
        let ended = {
            let mut source = self.source.lock().await;
            let ended = watch.run(&mut source).await;
            if matches!(ended, Ended::Rig(_))
                && let FrameSource::Rig { rig, .. } = &mut *source
            {
                // its links may be out of step: it is put together anew
                *rig = None;
            }
            ended
        };
        let reason = ended.text();
        if !matches!(ended, Ended::Done(_)) {
            tracing::error!(session = live.facts.id, "{reason}");
            let _ = orders
                .send(Order::Event {
                    at: self.house.clock.wall(),
                    kind: "fault",
                    text: reason.clone(),
                })
                .await;
        }
        let _ = orders
            .send(Order::Close {
                at: self.house.clock.wall(),
                reason: reason.clone(),
            })
            .await;
        drop(orders);
        let recorded = match recording.await {
            Ok(Ok(baseline)) => Ok(baseline),
            Ok(Err(error)) => Err(chain(&error)),
            Err(_) => Err("the recorder failed".to_owned()),
        };
        self.finish(&live, &ended, recorded);
    }

    fn finish(
        self: &Arc<Self>,
        live: &Arc<Live>,
        ended: &Ended,
        recorded: Result<Option<Baseline>, String>,
    ) {
        let fault = match (&recorded, ended) {
            (Err(disk), _) => Some(format!("the record failed, the source is off: {disk}")),
            (Ok(_), Ended::Done(_)) => None,
            (Ok(_), ended) => Some(ended.text()),
        };
        {
            let mut inner = self.inner();
            if let Ok(Some(baseline)) = recorded {
                inner.baseline = Some(Arc::new(baseline));
            }
            inner.active = None;
            inner.recent.push_back(Arc::clone(live));
            while inner.recent.len() > REMEMBERED {
                if let Some(old) = inner.recent.pop_front() {
                    self.herald
                        .say(&Notice::SessionRemoved(old.facts.id.clone()));
                }
            }
            if matches!(ended, Ended::Rig(_)) {
                inner.rig_fault = Some(ended.text());
            }
        }
        let ending = Ending {
            reason: fault.clone().unwrap_or_else(|| ended.text()),
            faulted: fault.is_some(),
        };
        let _ = self.happened(match fault {
            Some(text) => Event::Fault(text),
            None => Event::Ended,
        });
        live.readers.publish(&bus::stream::Record {
            sequence: live.durable(),
            wall_ns: crate::recorder::nanoseconds(self.house.clock.wall()),
            gap: 0,
            simulated: live.facts.simulated,
            body: bus::stream::Body::End {
                reason: ending.reason.clone(),
            },
        });
        live.end(ending);
        if matches!(ended, Ended::Rig(_)) {
            self.herald.say(&Notice::Instruments);
            tokio::spawn(Arc::clone(self).look_for_rig());
        }
    }

    /// Tells everybody of frames, at most five times a second, and of everything else about a session.
    async fn tell_progress(self: Arc<Self>, live: Arc<Live>) {
        let mut durable = live.follow_durable();
        let mut progress = live.follow();
        let mut told = 0;
        loop {
            let over = tokio::select! {
                changed = durable.changed() => changed.is_err(),
                changed = progress.changed() => {
                    let over = progress.borrow_and_update().ended.is_some();
                    if !over {
                        self.herald.say(&Notice::SessionChanged(Arc::clone(&live)));
                    }
                    over || changed.is_err()
                }
            };
            if let Some(latest) = live.latest_frame()
                && latest.frame.sequence > told
            {
                told = latest.frame.sequence;
                self.herald
                    .say(&Notice::FrameDone(Arc::clone(&live), latest));
                if !over {
                    tokio::time::sleep(BETWEEN_SUMMARIES).await;
                }
            }
            if over {
                self.herald.say(&Notice::SessionChanged(live));
                return;
            }
        }
    }

    /// After a fault of the rig: until every instrument is back and verified off, or a session has found it first.
    async fn look_for_rig(self: Arc<Self>) {
        let mut pause = LOOK_AGAIN.0;
        loop {
            tokio::time::sleep(pause).await;
            if self.rig_fault().is_none() {
                return;
            }
            if self.state().is_busy() {
                continue;
            }
            match self.find_rig_again().await {
                Ok(()) => {
                    let _ = self.happened(Event::Recovered);
                    return;
                }
                Err(text) => tracing::warn!("{text}"),
            }
            pause = (pause * 2).min(LOOK_AGAIN.1);
        }
    }

    /// Puts the rig together anew; it is verified off afterwards.
    async fn find_rig_again(&self) -> Result<(), String> {
        let mut source = self.source.lock().await;
        let FrameSource::Rig { rig, plan } = &mut *source else {
            return Ok(());
        };
        if rig.is_none() {
            let assembled = assemble(plan, &self.house.bench)
                .await
                .map_err(|error| chain(&error))?;
            tracing::info!("the rig is back; its source is off and verified");
            *rig = Some(assembled.rig);
        }
        self.inner().rig_fault = None;
        self.herald.say(&Notice::Instruments);
        Ok(())
    }

    /// Ends whatever runs and leaves the source off and verified.
    ///
    /// # Errors
    /// What could not be made safe.
    pub(crate) async fn shut_down(&self, why: &str) -> Result<(), String> {
        if let Some(live) = self.active() {
            live.stop(why);
            live.ended().await;
        }
        if self.rig_fault().is_some() {
            self.find_rig_again().await?;
        }
        let source = self.source.lock().await;
        match &*source {
            FrameSource::Rig {
                rig: Some(rig),
                plan,
            } => rig
                .safe_off(&plan.plan.wiring)
                .await
                .map_err(|error| error.to_string()),
            FrameSource::Rig { rig: None, .. } => {
                Err("the rig was lost and has not come back; its state is unknown".to_owned())
            }
            FrameSource::Recording(_) => Ok(()),
        }
    }
}

/// A logbook's refusal as a fault on the bus.
pub(crate) fn disk_fault(error: &LogbookError) -> Fault {
    if error.is_disk() {
        Fault::DiskRefused(chain(error))
    } else {
        Fault::Failed(chain(error))
    }
}
