//! A session from its first frame to its closed record.

mod announcements;
mod frames;
#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::time::Duration;

use chrono::{DateTime, Utc};
use dbus::Fault;
use imaging::noise::{self, Noise};
use imaging::quantities::Deviation;
use logbook::{InstrumentRecord, LogbookError, SessionHeader, SessionKind, SessionWriter};
use rig::Clock;
use survey::{Baseline, Checks};
use tokio::sync::{OwnedMutexGuard, mpsc};

use crate::acquisition::measuring::Measuring;
use crate::acquisition::task::{Acquisition, AcquisitionEnd, AcquisitionProgress};
use crate::alarms::sink::AlarmSink;
use crate::events::event::{BusEvent, Event};
use crate::events::kind::EventKind;
use crate::monitoring::disk::free_bytes;
use crate::recording::logbook_sink::{DiskPolicy, LogbookSink};
use crate::recording::reconstruction_worker::{
    QuantityContext, ReconstructionContext, ReconstructionWorker, TrackingContext,
};
use crate::recording::recorder::{Recorder, Task};
use crate::recording::recorder_message::{QUEUE, RecorderMessage};
use crate::recording::records::disk_fault;
use crate::recording::session_status::{Facts, SessionEnd, SessionStatus};
use crate::session::controller::Controller;
use crate::session::controller::session_options::{Assignment, protocol_of};
use crate::session::state::{Trigger, Work};
use survey::error_chain as chain;

/// Time between two checks that the file is still at its path.
const FILE_CHECK_INTERVAL: Duration = Duration::from_secs(1);

impl Controller {
    /// Begins a session whose settings were checked while `no_reload` was held.
    pub(super) async fn begin(
        self: &Arc<Self>,
        order: Assignment,
        no_reload: OwnedMutexGuard<()>,
    ) -> Result<Arc<SessionStatus>, Fault> {
        self.change_state(Trigger::Start(order.work))
            .map_err(|error| Fault::SessionActive(error.to_string()))?;
        // spawned, so that a caller that drops the future does not leave the state inconsistent
        let controller = Arc::clone(self);
        let begun = tokio::spawn(async move {
            let _no_reload = no_reload;
            let _beginning = controller.beginning.lock().await;
            let begun = controller.begin_now(order).await;
            if let Err(fault) = &begun {
                let _ = match fault {
                    Fault::DiskRefused(text) | Fault::InstrumentFault(text) => {
                        controller.change_state(Trigger::Fault(text.clone()))
                    }
                    _ => controller.change_state(Trigger::Ended),
                };
            }
            begun
        });
        begun
            .await
            .unwrap_or_else(|_| Err(Fault::Failed("the session could not be started".into())))
    }

    pub(super) async fn begin_now(
        self: &Arc<Self>,
        mut order: Assignment,
    ) -> Result<Arc<SessionStatus>, Fault> {
        self.inner().check_not_stopping()?;
        let runtime = self.runtime();
        if self.rig_fault().is_some() {
            self.reassemble_rig()
                .await
                .map_err(Fault::InstrumentFault)?;
        }
        // a baseline has no schedule of its own, and measuring continues with the configured one
        let every = match order.work {
            Work::Baseline => runtime.setup.schedule.every,
            Work::Measurement | Work::Test => order.schedule.every,
        };
        self.read_relay_wear(order.plan.clone(), every).await;
        let started = runtime.clock.wall();
        let (kind, payload) = match order.work {
            Work::Baseline => (SessionKind::Baseline, 'b'),
            Work::Measurement | Work::Test => (SessionKind::Measurement, 'm'),
        };
        let resumed = order.resumed.take();
        let header = match &resumed {
            Some((found, _)) => found.resumed.header.clone(),
            None => self.header(kind, started, payload, &order),
        };
        let directory = runtime.setup.record_directory.clone();
        let copy = order.baseline.clone();
        let id = header.session().to_owned();
        order.before = resumed.as_ref().and_then(|(found, _)| found.last.clone());
        let writer = tokio::task::spawn_blocking(move || match resumed {
            Some((found, text)) => {
                let mut writer = found.writer;
                // without space, or under a lock, the event waits in the recorder, where the wait can be stopped
                let waits = match writer.event(started, logbook::RESUMED, &text) {
                    Ok(()) => false,
                    Err(error) if error.may_pass() => true,
                    Err(error) => return Err(error),
                };
                Ok((writer, Some((text, waits))))
            }
            None => {
                let mut writer = SessionWriter::create(&directory, &header)?;
                if let Some(baseline) = copy {
                    writer.baseline(&baseline)?;
                }
                Ok::<_, LogbookError>((writer, None))
            }
        });
        let (writer, gone_on) = writer
            .await
            .map_err(|_| Fault::Failed("the session file could not be created".into()))?
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
        let status = Arc::new(SessionStatus::new(
            Facts {
                id,
                kind,
                simulated: runtime.simulated,
                baseline_id,
                method,
                every: order.schedule.every,
            },
            writer.path().to_owned(),
            order.step,
            Arc::clone(&self.observed.counters),
        ));
        status.set_frames_on_disk(writer.acknowledged());
        self.hand_over(&status);
        self.inner().active = Some(Arc::clone(&status));
        self.events
            .publish(&BusEvent::SessionAdded(status.facts.id.clone()));
        self.events.publish(&BusEvent::Daemon);
        if let Some((text, waits)) = gone_on {
            order.first_event = waits.then(|| text.clone());
            let id = Some(status.facts.id.as_str());
            self.events
                .report(Event::new(started, EventKind::Restarted, &text, id));
        }
        tokio::spawn(Arc::clone(self).announce_frames(Arc::clone(&status)));
        tokio::spawn(Arc::clone(self).mark_when_requested_to_end(Arc::clone(&status)));
        let task = tokio::spawn(Arc::clone(self).run_session(Arc::clone(&status), writer, order));
        let (controller, kept) = (Arc::clone(self), Arc::clone(&status));
        tokio::spawn(async move {
            // the source is already off, because acquisition handles its own panics: only the session is ended here
            if task.await.is_err() {
                let text = "the daemon's own code failed; its log says where, please report it";
                controller.finish(
                    &kept,
                    &AcquisitionEnd::Done("a fault of the daemon".to_owned()),
                    Err(text.to_owned()),
                );
            }
        });
        Ok(status)
    }

    fn header(
        &self,
        kind: SessionKind,
        started: DateTime<Utc>,
        payload: char,
        order: &Assignment,
    ) -> SessionHeader {
        let (runtime, identities) = (self.runtime(), self.identities());
        let geometry = &runtime.setup.geometry;
        let (config_toml, config_hash) = runtime.setup.stored_config(order.settings.as_ref());
        let protocol = protocol_of(order.plan.as_deref(), &runtime.setup);
        let id = format!("{payload}{}", started.format("%Y%m%dt%H%M%S_%3f"));
        SessionHeader {
            kind,
            instruments: identities
                .instruments
                .iter()
                .map(|found| InstrumentRecord {
                    role: found.role.to_owned(),
                    identity: found.identity.clone(),
                    address: found.address.clone(),
                })
                .collect(),
            modules: identities.modules,
            config_toml,
            config_hash,
            model_hash: order.model.as_ref().and_then(|model| model.hash.clone()),
            geometry_hash: Some(geometry.mesh.hash().to_owned()),
            build: crate::BUILD.to_owned(),
            simulated: runtime.simulated,
            seed: runtime
                .simulated_rig
                .as_ref()
                .map(crate::instruments::simulation::seed),
            note: order.note.clone(),
            about: order.about.clone(),
            asked: order.requested.clone(),
            ..SessionHeader::new(id, started, protocol.clone())
        }
    }

    /// A session from its first frame to its closed record.
    pub(super) async fn run_session(
        self: Arc<Self>,
        status: Arc<SessionStatus>,
        writer: SessionWriter,
        order: Assignment,
    ) {
        let (orders, queue) = mpsc::channel(QUEUE);
        status.set_record(orders.downgrade());
        let runtime = self.runtime();
        let mesh = &runtime.setup.geometry.mesh;
        let checks = Checks::new(protocol_of(order.plan.as_deref(), &runtime.setup));
        let checks = match &order.baseline {
            Some(baseline) => checks.against(&baseline.readings),
            None => checks,
        };
        let requested = order.plan.clone().or_else(|| runtime.plan.clone());
        let measuring = Measuring::of(requested, order.baseline.as_deref());
        let has_zero = measuring
            .now()
            .is_some_and(|plan| plan.zero_every.is_some());
        self.session_plan.send_replace(measuring.now());
        let mut injections = None;
        let task = match (order.baseline, order.model, order.settings) {
            (Some(baseline), Some(model), Some(settings)) => {
                let measured = Noise::of(&baseline).and_then(Noise::measured);
                let stated = settings.noise_uv.filter(|_| !self.is_recording());
                let reading_noise = measured.or(stated.map(|noise_uv| 1e-6 * noise_uv));
                let tracks = settings.tracking == Some(true) && !self.is_recording();
                let tracking = tracks.then(|| TrackingContext {
                    geometry: runtime.setup.geometry.clone(),
                    protocol: protocol_of(order.plan.as_deref(), &runtime.setup).clone(),
                    current: baseline.settings.current,
                    noise_v: reading_noise.unwrap_or_else(|| noise::against(&baseline)),
                    folder: runtime.setup.record_directory.clone(),
                    session: writer.header().session().to_owned(),
                    after: writer.acknowledged(),
                });
                let quantities = QuantityContext {
                    settings: runtime.setup.config.quantities.clone(),
                    regions: runtime.setup.config.region.clone(),
                    folder: runtime.setup.record_directory.clone(),
                    session: writer.header().session().to_owned(),
                    after: writer.acknowledged(),
                    deviation: reading_noise
                        .filter(|_| settings.is_quick())
                        .map(|noise_v| Deviation::new(&model, noise_v)),
                };
                let context = ReconstructionContext {
                    tracking,
                    quantities: Some(quantities),
                    reading_noise,
                    baseline: baseline.as_ref().clone(),
                    model,
                    centroids: mesh.region_centroids(),
                    areas: mesh.region_areas(),
                    status: Arc::clone(&status),
                };
                let recorder = orders.downgrade();
                let started = tokio::task::spawn_blocking(move || {
                    ReconstructionWorker::start(context, recorder)
                });
                let started = started
                    .await
                    .unwrap_or_else(|failed| Err(std::io::Error::other(failed)));
                match started {
                    Ok(mut worker) => {
                        injections = worker.take_injections();
                        Task::maps(worker, settings)
                    }
                    Err(cause) => {
                        let recorded = Err(format!("no thread for maps: {cause}"));
                        let why =
                            AcquisitionEnd::Done("the session could not be started".to_owned());
                        return self.finish(&status, &why, recorded);
                    }
                }
            }
            _ => Task::Baseline {
                frames: Vec::new(),
                wanted: order.frames,
            },
        };
        let injections = match (injections, self.is_recording(), has_zero) {
            (_, true, _) => Err("a recording has whole frames only"),
            (_, _, true) => Err(
                "zero-current frames are subtracted from whole frames only: see `zero_every` in [survey]",
            ),
            (None, ..) => Err(
                "the session does not track its baseline: see `tracking` in [model], and `tactus events`",
            ),
            (Some(to), ..) => Ok(to),
        };
        let _ = status
            .injections
            .set(injections.as_ref().map(|_| ()).map_err(|why| *why));
        let logbook = LogbookSink {
            status: Arc::clone(&status),
            writer,
            clock: runtime.clock,
            events: self.events.clone(),
            heartbeats: Arc::clone(&self.heartbeats),
            disk: DiskPolicy::new(runtime.setup.config.record.clone(), Box::new(free_bytes)),
            before: order.before,
            began: None,
            is_recording: self.is_recording(),
        };
        let judged = AlarmSink {
            session: status.facts.id.clone(),
            frames: self.alarms.frames(),
        };
        let recorder =
            Recorder::new(logbook, checks, task, self.is_recording()).and_to(Box::new(judged));
        if let Some(text) = order.first_event {
            let (at, kind) = (runtime.clock.wall(), EventKind::Restarted);
            let event = Event::new(at, kind, &text, Some(&status.facts.id));
            let _ = orders.send(RecorderMessage::Event(event)).await;
        }
        let recording = tokio::task::spawn_blocking(move || recorder.run(queue));
        tokio::spawn(request_file_checks(orders.downgrade()));
        let (pauses, requested_pauses) = mpsc::channel(1);
        tokio::spawn(Arc::clone(&self).follow_pauses(requested_pauses));
        let mut acquisition = Acquisition {
            status: Arc::clone(&status),
            schedule: order.schedule,
            speed: order.speed,
            clock: runtime.clock,
            recorder: orders.clone(),
            pauses,
            transcript: self.transcript.clone(),
            heartbeats: Arc::clone(&self.heartbeats),
            progress: AcquisitionProgress::after(status.acquired()),
            events: self.events.clone(),
            plan: self.session_plan.clone(),
            measuring,
            injections: injections.ok(),
        };
        let ended = self.run_and_recover(&mut acquisition, &orders).await;
        let reason = ended.text();
        if !matches!(ended, AcquisitionEnd::Done(_)) {
            tracing::error!(session = status.facts.id, "{reason}");
            let _ = orders
                .send(RecorderMessage::Event(Event::new(
                    runtime.clock.wall(),
                    EventKind::Fault,
                    &reason,
                    Some(&status.facts.id),
                )))
                .await;
        }
        let at = runtime.clock.wall();
        let last = match status.is_left_open() {
            true => RecorderMessage::Leave { at, reason },
            false => {
                self.mark_end(&status, &reason).await;
                RecorderMessage::Close { at, reason }
            }
        };
        let _ = orders.send(last).await;
        drop(orders);
        let recorded = match recording.await {
            Ok(Ok(baseline)) => Ok(baseline),
            Ok(Err(error)) => Err(chain(&error)),
            Err(_) => Err("the recorder failed".to_owned()),
        };
        self.settle_end(&status, &ended.text()).await;
        self.finish(&status, &ended, recorded);
    }

    fn finish(
        self: &Arc<Self>,
        status: &Arc<SessionStatus>,
        ended: &AcquisitionEnd,
        recorded: Result<Option<Baseline>, String>,
    ) {
        let fault = match (&recorded, ended) {
            (Err(disk), _) => Some(match status.marked.get() {
                Some(marked) if !status.is_closed() => format!(
                    "the record failed, the source is off: {disk}; {}",
                    marked.text(&status.facts.id)
                ),
                _ => format!("the record failed, the source is off: {disk}"),
            }),
            (Ok(_), AcquisitionEnd::Done(why)) => status.has_failed().then(|| why.clone()),
            // the fault of the rig is the cause, if it is known
            (Ok(_), AcquisitionEnd::NoRig) => self.rig_fault().or_else(|| Some(ended.text())),
            (Ok(_), ended) => Some(ended.text()),
        };
        {
            let mut inner = self.inner();
            if let Ok(Some(baseline)) = recorded {
                inner.baseline = Some(Arc::new(baseline));
            }
            inner.active = None;
            self.remember(&mut inner, status);
            match ended {
                AcquisitionEnd::Rig(_) => inner.rig_fault = Some(ended.text()),
                AcquisitionEnd::NoRig => {
                    inner.rig_fault.get_or_insert_with(|| ended.text());
                }
                AcquisitionEnd::Done(_) | AcquisitionEnd::Recording(_) => {}
            }
        }
        self.session_plan.send_replace(None);
        let end = SessionEnd {
            reason: fault.clone().unwrap_or_else(|| ended.text()),
            faulted: fault.is_some(),
        };
        let _ = self.change_state(match fault {
            Some(text) => Trigger::Fault(text),
            None => Trigger::Ended,
        });
        status.readers.publish(&dbus::stream::Record {
            sequence: status.durable(),
            wall_ns: survey::nanoseconds(self.runtime().clock.wall()),
            gap: 0,
            simulated: status.facts.simulated,
            body: dbus::stream::Body::End {
                reason: end.reason.clone(),
            },
        });
        status.end(end);
        // also if the session was stopped while its rig was being reconnected
        if self.rig_fault().is_some() {
            self.events.publish(&BusEvent::Instruments);
            self.look_for_rig();
        }
        self.take_waiting();
    }
}

/// Requests checks that the file is still at its path, while the session runs. While frames are written, the recorder
/// checks without a request.
async fn request_file_checks(orders: mpsc::WeakSender<RecorderMessage>) {
    loop {
        tokio::time::sleep(FILE_CHECK_INTERVAL).await;
        let Some(orders) = orders.upgrade() else {
            return;
        };
        // must not fill the queue, in which frames wait
        if orders.capacity() > QUEUE / 2 {
            let _ = orders.try_send(RecorderMessage::CheckFile);
        }
    }
}
