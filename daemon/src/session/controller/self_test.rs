//! Self-test and relay wear, never during a session.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use chrono::SecondsFormat;
use dbus::{DiscoverOptions, Discovery, Fault, Options};
use rig::{Clock, Stop, safe_off};
use survey::Relay;

use crate::acquisition::task::FrameSource;
use crate::events::event::BusEvent;
use crate::instruments::address::InstrumentAddress;
use crate::instruments::assembly::SourceState;
use crate::instruments::discovery::{Search, discover};
use crate::instruments::kinds;
use crate::instruments::relay_wear::{Wear, wear};
use crate::instruments::rig_plan::RigPlan;
use crate::session::controller::Controller;
use crate::session::option_values;
use crate::session::state::{State, Trigger, Work};
use imaging::noise::{self, DEFAULT_NOISE_UV};
use self_test::{ExpectedSheet, ProbeError, Report, Request, assess, with_neighbours};
use survey::error_chain as chain;

/// Name of the file in the record's directory with a line of JSON for every self-test.
const REPORTS: &str = "tests.jsonl";

impl Controller {
    /// Tests the rig: every relay against the sheet's own resistances, contacts, reciprocity, noise. The source is off
    /// and verified afterwards; the report is stored in the record's directory.
    ///
    /// # Errors
    /// A session is running, the daemon plays a recording, or an instrument or the disk fails.
    pub(crate) async fn test_instruments(self: &Arc<Self>) -> Result<Report, Fault> {
        self.alone(
            true,
            |controller| async move { controller.test_now().await },
        )
        .await
    }

    /// The closures of each relay, and its remaining life.
    ///
    /// # Errors
    /// As [`Controller::test_instruments`]; the rig has a multiplexer board, whose chips do not wear.
    pub(crate) async fn relay_wear(self: &Arc<Self>) -> Result<Vec<Wear>, Fault> {
        self.alone(false, |controller| async move {
            let plan = controller.plan_of_rig()?;
            let every = controller.runtime().setup.schedule.every;
            let wear = controller.read_wear(&plan, every).await;
            if let Err(Fault::InstrumentFault(_)) = wear
                && let FrameSource::Rig { rig, .. } = &mut *controller.source.lock().await
            {
                // its links may be unsynchronised: the rig is reassembled
                *rig = None;
            }
            wear
        })
        .await
    }

    /// Reads the relays' counters for a session with this plan of its own, or the configured one, and time between
    /// frames, unless they were last projected with the same closures and period. An error does not prevent measuring.
    pub(super) async fn read_relay_wear(&self, own: Option<Arc<RigPlan>>, every: Duration) {
        let Some(plan) = own.or_else(|| self.runtime().plan.clone()) else {
            return;
        };
        if self
            .observed
            .is_projected(&plan.closures(), period(&plan, every))
        {
            return;
        }
        if let Err(fault) = self.read_wear(&plan, every).await {
            tracing::debug!("the relays' counters were not read: {fault}");
            if let Fault::InstrumentFault(_) = fault {
                self.resynchronise(&plan).await;
            }
        }
    }

    /// Resynchronises links after a lost or late reply, by making the rig safe, so that the next frame does not fail.
    /// If that fails, so does the frame, and the rig is recovered in the session.
    async fn resynchronise(&self, plan: &RigPlan) {
        if let FrameSource::Rig { rig: Some(rig), .. } = &*self.source.lock().await
            && let Err(error) = safe_off(rig, &plan.plan.wiring).await
        {
            tracing::debug!("before the first frame: {error}");
        }
    }

    /// Discovers instruments; uses none.
    ///
    /// # Errors
    /// An invalid option or address.
    pub(crate) async fn discover(
        &self,
        addresses: &[String],
        options: &Options,
    ) -> Result<Discovery, Fault> {
        let options: DiscoverOptions = option_values::read(options, |key| {
            (key == "within_s").then_some(option_values::WITHIN_S)
        })?;
        let addresses: Result<Vec<InstrumentAddress>, _> =
            addresses.iter().map(|text| text.parse()).collect();
        let in_use = self.identities().instruments.into_iter();
        let search = Search {
            within: survey::duration(options.within_s.unwrap_or(3.0)),
            mdns: options.mdns.unwrap_or(true),
            broadcast: options.broadcast.unwrap_or(true),
            addresses: addresses.map_err(|error| Fault::InvalidOption(error.to_string()))?,
            in_use: in_use
                .map(|found| (found.address, found.identity))
                .collect(),
            ..Search::default()
        };
        Ok(discover(&search).await)
    }

    /// Runs an operation on the rig while no session can use it. The operation continues if its caller has
    /// disconnected. A fault of the rig remains while the rig cannot be used; any other fault remains unless the
    /// operation `tests` the rig.
    async fn alone<T, F>(
        self: &Arc<Self>,
        tests: bool,
        act: impl FnOnce(Arc<Self>) -> F + Send + 'static,
    ) -> Result<T, Fault>
    where
        T: Send + 'static,
        F: Future<Output = Result<T, Fault>> + Send + 'static,
    {
        if self.is_recording() {
            return Err(Fault::Unsupported(
                "a recording has no instruments; nothing can be tested".into(),
            ));
        }
        let lost = self.rig_fault().is_some();
        let before = self
            .change_state(Trigger::Start(Work::Test))
            .map_err(|error| Fault::SessionActive(error.to_string()))?;
        let controller = Arc::clone(self);
        let supervised = tokio::spawn(async move {
            let task = tokio::spawn(act(Arc::clone(&controller)));
            let outcome = match task.await {
                Ok(outcome) => outcome,
                // the operation has panicked
                Err(_) => match controller.make_safe_again().await {
                    Ok(()) => Err(Fault::Failed(
                        "the daemon's own code failed; its log says where, please report it".into(),
                    )),
                    Err(text) => Err(Fault::InstrumentFault(text)),
                },
            };
            controller.inner().test = None;
            if let Err(Fault::InstrumentFault(text)) = &outcome {
                tracing::error!("{text}");
                controller.rig_lost(text);
            } else {
                // if the rig was reconnected meanwhile, its fault has ended
                let stays = controller.rig_fault().is_some() || !(tests || lost);
                let _ = controller.change_state(match before {
                    State::Faulted(why) if stays && controller.state() == State::Testing => {
                        Trigger::Fault(why)
                    }
                    _ => Trigger::Ended,
                });
            }
            outcome
        });
        supervised
            .await
            .unwrap_or_else(|_| Err(Fault::Failed("the daemon's own code failed".into())))
    }

    /// Stops a running self-test, which then switches the source off.
    pub(super) fn stop_test(&self) {
        if let Some(button) = &self.inner().test {
            button.press();
        }
    }

    async fn make_safe_again(&self) -> Result<(), String> {
        let mut source = self.source.lock().await;
        let FrameSource::Rig { rig, plan } = &mut *source else {
            return Ok(());
        };
        let Some(held) = rig.as_ref() else {
            return Ok(());
        };
        let made = safe_off(held, &plan.plan.wiring).await;
        made.map_err(|error| {
            // its links may be unsynchronised: the rig is reassembled
            *rig = None;
            error.to_string()
        })
        .map(drop)
    }

    async fn test_now(self: Arc<Self>) -> Result<Report, Fault> {
        if self.rig_fault().is_some() {
            self.reassemble_rig()
                .await
                .map_err(Fault::InstrumentFault)?;
        }
        let (button, stop) = Stop::button();
        {
            let mut inner = self.inner();
            inner.check_not_stopping()?;
            inner.test = Some(button);
        }
        let plan = self.plan_of_rig()?;
        let tested = with_neighbours(&plan.plan).ok_or_else(|| {
            Fault::Unsupported(
                "the self-test drives and measures every pair of neighbouring electrodes, and this survey has no relays \
                 for some of them; set survey.half = false for it"
                    .into(),
            )
        })?;
        let events = self.events.clone();
        let progress = move |done: u64, total: u64, what: &str| {
            events.publish(&BusEvent::TestProgress {
                done,
                total,
                what: what.to_owned(),
            });
        };
        let probed = {
            let mut source = self.source.lock().await;
            let FrameSource::Rig { rig, .. } = &mut *source else {
                return Err(Fault::Unsupported("a recording has no instruments".into()));
            };
            let held = rig
                .as_ref()
                .ok_or_else(|| lost("the rig has not come back"))?;
            let request = Request {
                plan: &tested,
                meter: plan.meter,
                wide: kinds::range_for(plan.plan.compliance),
                meter_relays: Vec::new(),
                settle: rig::settings(&plan.plan, plan.meter).settle,
                stop,
                progress: &progress,
            };
            let probed = kinds::probe(held, request).await;
            let safe = safe_off(held, &plan.plan.wiring).await;
            if safe.is_err() || matches!(probed, Err(ProbeError::Rig(_))) {
                *rig = None;
            }
            match (probed, safe) {
                (Ok(raw), Ok(_)) => Ok(raw),
                (Err(ProbeError::Stopped), Ok(_)) => Err(Fault::Failed(
                    "the self-test was stopped; the source is off".into(),
                )),
                (Err(error), Ok(_)) => Err(lost(&format!(
                    "the self-test failed: {}; the source is off, verified",
                    chain(&error)
                ))),
                (_, Err(unsafe_still)) => {
                    {
                        let mut inner = self.inner();
                        if unsafe_still.source_state_unknown() {
                            inner.source_state = SourceState::Unknown;
                        }
                        inner.relays_unknown |= unsafe_still.relays.is_some();
                    }
                    Err(lost(&format!(
                        "after the self-test the rig could not be made safe: {unsafe_still}"
                    )))
                }
            }
        }?;
        let controller = Arc::clone(&self);
        let at = self
            .runtime()
            .clock
            .wall()
            .to_rfc3339_opts(SecondsFormat::Millis, true);
        let judged = tokio::task::spawn_blocking(move || {
            let setup = &controller.runtime().setup;
            let noise_uv = setup.config.model.noise_uv;
            let noise_v = noise_uv.map_or_else(
                || match controller.baseline() {
                    Some(baseline) => noise::against(&baseline),
                    None => DEFAULT_NOISE_UV * 1e-6,
                },
                |noise_uv| noise_uv * 1e-6,
            );
            let geometry = &setup.geometry;
            let expected = ExpectedSheet {
                mesh: Arc::clone(&geometry.mesh),
                contact_ohm_m: geometry.contact_ohm_m.clone(),
                sigma: geometry.sigma0.clone(),
            };
            let report = assess(
                &probed,
                &tested.wiring,
                tested.current.0,
                &expected,
                noise_v,
                at,
            );
            let report = Report {
                simulated: controller.runtime().simulated,
                ..report.map_err(|error| Fault::Failed(chain(&error)))?
            };
            save(&setup.record_directory, &report).map_err(|cause| {
                Fault::DiskRefused(format!(
                    "the report of the self-test cannot be written: {cause}"
                ))
            })?;
            Ok(report)
        });
        judged
            .await
            .unwrap_or_else(|_| Err(Fault::Failed("the readings could not be judged".into())))
    }

    fn plan_of_rig(&self) -> Result<Arc<RigPlan>, Fault> {
        let plan = self.runtime().plan.as_ref().map(Arc::clone);
        plan.ok_or_else(|| Fault::Unsupported("a recording has no instruments".into()))
    }

    async fn read_wear(&self, plan: &RigPlan, every: Duration) -> Result<Vec<Wear>, Fault> {
        let closures = plan.closures();
        let relays: Vec<Relay> = closures.iter().map(|(relay, _)| *relay).collect();
        let counts = {
            let source = self.source.lock().await;
            let FrameSource::Rig { rig: Some(rig), .. } = &*source else {
                return Err(Fault::Failed(
                    "the rig cannot be reached; `tactus instruments` shows why".into(),
                ));
            };
            kinds::relay_cycles(rig, &relays).await
        };
        let Some(counts) = counts else {
            return Err(Fault::Unsupported(
                "a multiplexer board has no relays: its chips do not wear and have no counters"
                    .into(),
            ));
        };
        let counts = counts.map_err(|error| lost(&chain(&error)))?;
        let life = self.runtime().setup.config.relay_wear.relay_life_cycles;
        let period = period(plan, every);
        let each = closures.iter().copied().zip(counts);
        let wear: Vec<Wear> = each
            .map(|((relay, closures), cycles)| {
                let slot = keysight_34980a::split(relay).map_or(0, |(slot, _)| slot);
                let module = plan.modules.get(&slot).copied();
                let purpose = plan.plan.wiring.purpose(relay);
                wear(relay, purpose, cycles, module, life, closures, period)
            })
            .collect();
        self.observed.set_relays(&wear, closures, period);
        Ok(wear)
    }
}

/// Mean time between the frames of a plan that are started at least this time apart.
fn period(plan: &RigPlan, every: Duration) -> Duration {
    plan.mean_duration()
        .max(every)
        .max(Duration::from_micros(1))
}

fn lost(text: &str) -> Fault {
    Fault::InstrumentFault(text.to_owned())
}

/// Appends a report, durable when this returns.
fn save(directory: &Path, report: &Report) -> std::io::Result<()> {
    std::fs::create_dir_all(directory)?;
    let mut file = std::fs::OpenOptions::new()
        .create(true)
        .append(true)
        .open(directory.join(REPORTS))?;
    let mut line = serde_json::to_string(report)?;
    line.push('\n');
    file.write_all(line.as_bytes())?;
    file.sync_all()
}
