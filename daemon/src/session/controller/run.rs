//! A session from its first frame to its closed record.

use std::sync::Arc;
use std::time::Duration;

use chrono::{DateTime, Utc};
use dbus::Fault;
use logbook::{InstrumentRecord, LogbookError, SessionHeader, SessionKind, SessionWriter};
use rig::Clock;
use survey::{Baseline, Checks};
use tokio::sync::mpsc;
use tracing::Instrument;

use crate::acquisition::measuring::Measuring;
use crate::acquisition::task::{Course, Ended, FrameSource, Watch};
use crate::events::broadcast::Notice;
use crate::preparation::Setup;
use crate::recording::reconstruction_worker::{Mapper, Means};
use crate::recording::recorder::{Disk, Order, QUEUE, Recorder, Task, free_bytes};
use crate::recording::session_status::{Ending, Facts, Live};
use crate::session::controller::recovery::{MOST_FAILED, may_pass};
use crate::session::controller::rig_events::{Concerned, Happening};
use crate::session::controller::session_options::Assignment;
use crate::session::controller::{Keeper, disk_fault};
use crate::session::state::{Event, Work};
use survey::error_chain as chain;

/// Ended sessions that stay on the bus, so that who started one can still ask how it went.
const REMEMBERED: usize = 16;
/// Between looks whether the file is still in its place.
const BETWEEN_LOOKS: Duration = Duration::from_secs(1);
/// Transcripts of failed frames that a session leaves on disk: each is some 100 kB, and the first ones say most.
const TRANSCRIPTS: u64 = 100;
/// Summaries are at most five a second.
const BETWEEN_SUMMARIES: Duration = Duration::from_millis(200);

impl Keeper {
    pub(super) async fn begin(self: &Arc<Self>, order: Assignment) -> Result<Arc<Live>, Fault> {
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

    pub(super) async fn begin_now(
        self: &Arc<Self>,
        mut order: Assignment,
    ) -> Result<Arc<Live>, Fault> {
        let house = self.house();
        if self.rig_fault().is_some() {
            self.find_rig_again()
                .await
                .map_err(Fault::InstrumentFault)?;
        }
        self.know_wear().await;
        let started = house.clock.wall();
        let (kind, letter) = match order.work {
            Work::Baseline => (SessionKind::Baseline, 'b'),
            Work::Measurement | Work::Test => (SessionKind::Measurement, 'm'),
        };
        let resumed = order.resumed.take();
        let header = match &resumed {
            Some((found, _)) => found.resumed.header.clone(),
            None => self.header(kind, started, letter, &order),
        };
        let directory = house.setup.record_directory.clone();
        let copy = order.baseline.clone();
        let id = header.session().to_owned();
        order.before = resumed.as_ref().and_then(|(found, _)| found.last.clone());
        let writer = tokio::task::spawn_blocking(move || match resumed {
            Some((found, text)) => {
                let mut writer = found.writer;
                // without room, or under a lock, it waits in the recorder as everything else does, and hears of a stop
                let waits = match writer.event(started, logbook::RESUMED, &text) {
                    Ok(()) => false,
                    Err(error) if error.is_full() || error.is_locked() => true,
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
                simulated: house.simulated,
                baseline_id,
                method,
                every: order.schedule.every,
            },
            writer.path().to_owned(),
            order.step,
            Arc::clone(&self.observed.tally),
        ));
        live.goes_on_after(writer.acknowledged());
        if let Some((text, waits)) = gone_on {
            order.first_event = waits.then(|| text.clone());
            self.tell_of(started, logbook::RESUMED, &text, Some(&live.facts.id));
        }
        self.inner().active = Some(Arc::clone(&live));
        self.herald.say(&Notice::SessionAdded(Arc::clone(&live)));
        self.herald.say(&Notice::Daemon);
        tokio::spawn(Arc::clone(self).tell_progress(Arc::clone(&live)));
        tokio::spawn(Arc::clone(self).mark_when_asked_to_end(Arc::clone(&live)));
        let task = tokio::spawn(Arc::clone(self).keep(Arc::clone(&live), writer, order));
        let (keeper, kept) = (Arc::clone(self), Arc::clone(&live));
        tokio::spawn(async move {
            // a frame ends with the source off, and acquisition sees to its own panics: here only the session is lost
            if task.await.is_err() {
                let text = "the daemon's own code failed; its log says where, please report it";
                keeper.finish(
                    &kept,
                    &Ended::Done("a fault of the daemon".to_owned()),
                    Err(text.to_owned()),
                );
            }
        });
        Ok(live)
    }

    fn header(
        &self,
        kind: SessionKind,
        started: DateTime<Utc>,
        letter: char,
        order: &Assignment,
    ) -> SessionHeader {
        let (house, known) = (self.house(), self.known());
        let Setup {
            config_toml,
            config_hash,
            protocol,
            geometry,
            ..
        } = &house.setup;
        let id = format!("{letter}{}", started.format("%Y%m%dt%H%M%S_%3f"));
        SessionHeader {
            kind,
            instruments: known
                .instruments
                .iter()
                .map(|found| InstrumentRecord {
                    role: found.role.to_owned(),
                    identity: found.identity.clone(),
                    address: found.address.clone(),
                })
                .collect(),
            modules: known.modules,
            config_toml: config_toml.clone(),
            config_hash: config_hash.clone(),
            model_hash: order.model.as_ref().and_then(|model| model.hash.clone()),
            geometry_hash: Some(geometry.mesh.hash().to_owned()),
            build: house.build.clone(),
            simulated: house.simulated,
            seed: house
                .bench
                .as_ref()
                .map(crate::instruments::simulation::seed),
            note: order.note.clone(),
            about: order.about.clone(),
            asked: order.asked.clone(),
            ..SessionHeader::new(id, started, protocol.clone())
        }
    }

    /// A session from its first frame to its closed record.
    pub(super) async fn keep(
        self: Arc<Self>,
        live: Arc<Live>,
        writer: SessionWriter,
        order: Assignment,
    ) {
        let (orders, queue) = mpsc::channel(QUEUE);
        let house = self.house();
        let mesh = &house.setup.geometry.mesh;
        let checks = Checks::new(&house.setup.protocol);
        let checks = match &order.baseline {
            Some(baseline) => checks.against(&baseline.readings),
            None => checks,
        };
        let asked = order.plan.clone().or_else(|| house.plan.clone());
        let measuring = Measuring::of(asked, order.baseline.as_deref());
        self.inner().session_plan = measuring.now();
        let task = match (order.baseline, order.model) {
            (Some(baseline), Some(model)) => {
                let means = Means {
                    baseline: baseline.as_ref().clone(),
                    model,
                    centroids: mesh.region_centroids(),
                    areas: mesh.region_areas(),
                    build: house.build.clone(),
                };
                match Mapper::start(means, orders.downgrade()) {
                    Ok(mapper) => Task::maps(mapper),
                    Err(cause) => {
                        let recorded = Err(format!("no thread for maps: {cause}"));
                        let why = Ended::Done("the session could not be started".to_owned());
                        return self.finish(&live, &why, recorded);
                    }
                }
            }
            _ => Task::Baseline {
                frames: Vec::new(),
                wanted: order.frames,
            },
        };
        let (speaker, whose) = (Arc::clone(&self), live.facts.id.clone());
        let recorder = Recorder {
            live: Arc::clone(&live),
            writer,
            clock: house.clock,
            checks,
            task,
            pulse: Arc::clone(&self.pulse),
            before: order.before,
            patient: self.is_recording(),
            began: None,
            disk: Disk::new(house.setup.config.record.clone(), Box::new(free_bytes)),
            tell: Box::new(move |at, kind, text| speaker.tell_of(at, kind, text, Some(&whose))),
        };
        if let Some(text) = order.first_event {
            let (at, kind) = (house.clock.wall(), logbook::RESUMED);
            let _ = orders.send(Order::Event { at, kind, text }).await;
        }
        let recording = tokio::task::spawn_blocking(move || recorder.run(queue));
        tokio::spawn(remind_of_place(orders.downgrade()));
        let keeper = Arc::clone(&self);
        let (speaker, whose) = (Arc::clone(&self), live.facts.id.clone());
        let mut watch = Watch {
            live: Arc::clone(&live),
            schedule: order.schedule,
            speed: order.speed,
            clock: house.clock,
            recorder: orders.clone(),
            paused: Arc::new(move |paused| {
                let event = if paused {
                    Event::Suspend
                } else {
                    Event::Resume
                };
                let _ = keeper.happened(event);
            }),
            tape: self.tape.clone(),
            pulse: Arc::clone(&self.pulse),
            course: Course::after(live.acquired()),
            said: Box::new(move |said, plan| {
                speaker.inner().session_plan = plan;
                speaker.herald.say(&Notice::Happened(Happening {
                    session: Some(whose.clone()),
                    ..said
                }));
            }),
            measuring,
        };
        let ended = self.run_and_recover(&mut watch, &orders).await;
        let reason = ended.text();
        if !matches!(ended, Ended::Done(_)) {
            tracing::error!(session = live.facts.id, "{reason}");
            let _ = orders
                .send(Order::Event {
                    at: house.clock.wall(),
                    kind: "fault",
                    text: reason.clone(),
                })
                .await;
        }
        let at = house.clock.wall();
        let last = match live.is_left_open() {
            true => Order::Leave { at, reason },
            false => {
                self.mark_end(&live, &reason).await;
                Order::Close { at, reason }
            }
        };
        let _ = orders.send(last).await;
        drop(orders);
        let recorded = match recording.await {
            Ok(Ok(baseline)) => Ok(baseline),
            Ok(Err(error)) => Err(chain(&error)),
            Err(_) => Err("the recorder failed".to_owned()),
        };
        self.settle_end(&live, &ended.text()).await;
        self.finish(&live, &ended, recorded);
    }

    /// Frame after frame, through losses of the rig.
    async fn run_and_recover(
        self: &Arc<Self>,
        watch: &mut Watch,
        orders: &mpsc::Sender<Order>,
    ) -> Ended {
        let live = Arc::clone(&watch.live);
        let whom = Concerned {
            live: &live,
            record: orders,
        };
        let mut source = self.source.lock().await;
        let (mut failed, mut acquired) = (0, live.acquired());
        loop {
            let ended = watch.run(&mut source).await;
            let Ended::Rig(error) = &ended else {
                return ended;
            };
            if live.acquired() > acquired {
                (failed, acquired) = (0, live.acquired());
            }
            failed += 1;
            self.frame_failed(whom, error).await;
            if live.stop_wish().is_asked() || !may_pass(error) || failed >= MOST_FAILED {
                if let FrameSource::Rig { rig, .. } = &mut *source {
                    // its links may be out of step: it is put together anew
                    *rig = None;
                }
                return ended;
            }
            if !self.recover(whom, &mut source, error).await {
                return match live.has_failed() || self.source_state() == "unknown" {
                    true => ended,
                    false => Ended::Done(live.stop_reason()),
                };
            }
        }
    }

    /// A frame has failed: it is no frame of the record, which tells why, and what was said is kept on disk.
    async fn frame_failed(&self, whom: Concerned<'_>, error: &rig::AcquireError) {
        whom.live.count_failure();
        let number = whom.live.acquired() + 1;
        let failures = whom.live.failures();
        let text = format!(
            "frame {number} failed: {}",
            crate::acquisition::failed_frame::tell(error)
        );
        let instrument = error.cause().and_then(rig::RigError::instrument);
        let journal = tracing::error_span!("frame", frame = number, instrument);
        self.tell(Some(whom), "frame-failed", &text)
            .instrument(journal)
            .await;
        self.take_down(Some(whom), error).await;
        if failures > TRANSCRIPTS {
            if failures == TRANSCRIPTS + 1 {
                let text = format!(
                    "{TRANSCRIPTS} transcripts of failed frames are kept for this session; what was said for later ones \
                     is not"
                );
                self.tell(Some(whom), "transcript", &text).await;
            }
            return;
        }
        let name = format!("{}-failed-{failures}.transcript.jsonl", whom.live.facts.id);
        let path = self.house().setup.record_directory.join(name);
        let tape = self.tape.clone();
        let kept = path.clone();
        let written = tokio::task::spawn_blocking(move || {
            crate::instruments::transcripts::write_last(&tape, &kept)
        })
        .await;
        match written {
            Ok(Ok(())) => {
                let text = format!("what was said for frame {number} is in {}", path.display());
                self.tell(Some(whom), "transcript", &text).await;
            }
            Ok(Err(error)) => tracing::warn!("{}", chain(&error)),
            Err(_) => tracing::warn!("the transcript could not be written"),
        }
    }

    fn finish(
        self: &Arc<Self>,
        live: &Arc<Live>,
        ended: &Ended,
        recorded: Result<Option<Baseline>, String>,
    ) {
        let fault = match (&recorded, ended) {
            (Err(disk), _) => Some(match live.marked.get() {
                Some(marked) if !live.is_closed() => format!(
                    "the record failed, the source is off: {disk}; {}",
                    marked.text(&live.facts.id)
                ),
                _ => format!("the record failed, the source is off: {disk}"),
            }),
            (Ok(_), Ended::Done(why)) => live.has_failed().then(|| why.clone()),
            (Ok(_), ended) => Some(ended.text()),
        };
        {
            let mut inner = self.inner();
            if let Ok(Some(baseline)) = recorded {
                inner.baseline = Some(Arc::new(baseline));
            }
            inner.active = None;
            inner.session_plan = None;
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
        live.readers.publish(&dbus::stream::Record {
            sequence: live.durable(),
            wall_ns: crate::recording::recorder::nanoseconds(self.house().clock.wall()),
            gap: 0,
            simulated: live.facts.simulated,
            body: dbus::stream::Body::End {
                reason: ending.reason.clone(),
            },
        });
        live.end(ending);
        // also where the session was stopped while its rig was being looked for
        if self.rig_fault().is_some() {
            self.herald.say(&Notice::Instruments);
            tokio::spawn(Arc::clone(self).look_for_rig());
        }
        self.take_waiting();
    }

    /// Tells everybody of frames, at most five times a second, and of everything else about a session.
    pub(super) async fn tell_progress(self: Arc<Self>, live: Arc<Live>) {
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
}

/// As long as the session lasts. A recorder that is busy looks by itself.
async fn remind_of_place(orders: mpsc::WeakSender<Order>) {
    loop {
        tokio::time::sleep(BETWEEN_LOOKS).await;
        let Some(orders) = orders.upgrade() else {
            return;
        };
        // not in the place of a frame
        if orders.capacity() > QUEUE / 2 {
            let _ = orders.try_send(Order::LookAtPlace);
        }
    }
}
