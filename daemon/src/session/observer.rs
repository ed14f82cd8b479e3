//! The monitoring task: writes journal summaries, raises alarms and sends notifications, writes the daily summary,
//! serves the metrics. It cannot delay a frame.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::{Arc, Weak};
use std::time::Duration;

use crate::events::kind::EventKind;
use dbus::NotifyResult;
use http_listener::{Hosts, HttpListener, NoPage, Page};
use imaging::tracking::seconds;
use rig::Clock;
use tokio::sync::mpsc;

use crate::alarms::sink::JudgedFrame;
use crate::monitoring::daily_summary::{DailySummary, DayEnd};
use crate::monitoring::health::{Counts, Health};
use crate::monitoring::metrics;
use crate::monitoring::notices::{Message, Phase};
use crate::monitoring::notification::{self, payload, run_hook};
use crate::panics::containment::{PanicScope, answer};
use crate::session::controller::Controller;

/// Time between two checks.
const EVERY: Duration = Duration::from_secs(5);
/// Time between two searches for journals of closed sessions.
const MERGE_INTERVAL: Duration = Duration::from_secs(60);
/// Maximum number of notifications waiting for the command.
const MESSAGES: usize = 16;
/// Bytes read from the end of the self-test file to find the last one.
const LAST_TEST: u64 = 1 << 20;

/// Monitors the daemon until it ends.
pub(crate) async fn observe(controller: Arc<Controller>) {
    let (messages, payloads) = mpsc::channel(MESSAGES);
    tokio::spawn(post(Arc::downgrade(&controller), payloads));
    let runtime = controller.runtime();
    let mut daily = DailySummary::new(
        runtime.clock.wall(),
        Counts::of(&controller.observed.counters),
    );
    let mut frames = controller.alarms.take_frames();
    let mut listener = Listening::default();
    let text = format!(
        "tactusd {} on {}",
        env!("CARGO_PKG_VERSION"),
        runtime.config.display()
    );
    drop(runtime);
    controller.report(None, EventKind::Started, &text).await;
    let mut ticks = tokio::time::interval(EVERY);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut merge_at = tokio::time::Instant::now() + MERGE_INTERVAL;
    loop {
        let frame = tokio::select! {
            _ = ticks.tick() => None,
            Some(frame) = next(&mut frames) => Some(frame),
        };
        if let Some(frame) = frame {
            judge(&controller, &frame).await;
            continue;
        }
        controller.events.catch_up();
        crate::panics::containment::catch_up();
        listener.keep_open(&controller).await;
        if tokio::time::Instant::now() >= merge_at {
            merge_journals(&controller).await;
            merge_at = tokio::time::Instant::now() + MERGE_INTERVAL;
        }
        let health = controller.health().await;
        check_alarms(&controller, &health, &messages).await;
        if daily.is_over(health.at) {
            let text = daily.summary(health.at, &day_end(&controller).await);
            controller.report(None, EventKind::Daily, &text).await;
        }
    }
}

/// Merges the journals of closed sessions into their files. A journal remains if a program was reading the session when
/// it was closed; the file is complete, and can be archived, only without it.
async fn merge_journals(controller: &Arc<Controller>) {
    let directory = controller.runtime().setup.record_directory.clone();
    let merged = tokio::task::spawn_blocking(move || logbook::merge_closed(directory)).await;
    match merged {
        Ok(Ok(merged)) => {
            for path in merged {
                tracing::info!(
                    "{} is complete: no program reads it any more",
                    path.display()
                );
            }
        }
        Ok(Err(error)) => tracing::debug!("{}", survey::error_chain(&error)),
        Err(failure) => tracing::warn!("the record could not be read: {failure}"),
    }
}

/// The next frame with quantities; never returns if another task judges the frames.
async fn next(frames: &mut Option<mpsc::Receiver<JudgedFrame>>) -> Option<JudgedFrame> {
    match frames {
        Some(frames) => frames.recv().await,
        None => std::future::pending().await,
    }
}

/// Judges the rules on quantities by a frame.
async fn judge(controller: &Arc<Controller>, frame: &JudgedFrame) {
    let at_s = seconds(controller.runtime().clock.wall());
    let changes = controller.alarms.judge_frame(at_s, frame).await;
    controller.report_changes(changes);
}

/// Judges all alarms by the health of the daemon, and queues notifications of those that began or ended.
async fn check_alarms(
    controller: &Arc<Controller>,
    health: &Health,
    messages: &mpsc::Sender<(Message, Health)>,
) {
    let runtime = controller.runtime();
    let limits = &runtime.setup.config.notify;
    let map_every = runtime.setup.config.model.map_every.unwrap_or(1);
    let at_s = seconds(health.at);
    let judged = controller
        .alarms
        .judge_health(at_s, health, limits, map_every);
    let (changes, due) = judged.await;
    controller.report_changes(changes);
    for message in due {
        if !limits.command.is_empty() && messages.try_send((message, health.clone())).is_err() {
            let text = "too many notifications wait for their command; one is lost";
            controller.report(None, EventKind::NotifyFailed, text).await;
        }
    }
}

/// Runs the command for each notification in turn.
async fn post(
    controller: std::sync::Weak<Controller>,
    mut payloads: mpsc::Receiver<(Message, Health)>,
) {
    while let Some((message, health)) = payloads.recv().await {
        let Some(controller) = controller.upgrade() else {
            return;
        };
        let done = run_command(&controller, &message, &health).await;
        if done.done != Some(true) {
            let text = format!(
                "the notification of {} failed: {}",
                message.kind,
                notification::text(&done)
            );
            controller
                .report(None, EventKind::NotifyFailed, &text)
                .await;
        }
    }
}

async fn run_command(
    controller: &Arc<Controller>,
    message: &Message,
    health: &Health,
) -> NotifyResult {
    let runtime = controller.runtime();
    let limits = &runtime.setup.config.notify;
    let payload = payload(message, health, limits);
    let deadline = survey::duration(limits.deadline_s);
    run_hook(&limits.command, &payload, deadline).await
}

impl Controller {
    /// Runs the command of `[notify]` once and returns its result.
    pub(crate) async fn notify_test(self: &Arc<Self>) -> NotifyResult {
        let message = Message {
            kind: "test".to_owned(),
            phase: Phase::Test,
            text: "tactus notify test: this is not an alarm".to_owned(),
        };
        let health = self.health().await;
        run_command(self, &message, &health).await
    }
}

/// Values at the end of a day.
async fn day_end(controller: &Arc<Controller>) -> DayEnd {
    let directory = controller.runtime().setup.record_directory.clone();
    let contact = tokio::task::spawn_blocking(move || worst_contact(&directory));
    DayEnd {
        counts: Counts::of(&controller.observed.counters),
        readings: controller
            .active()
            .and_then(|status| status.latest_frame())
            .map(|latest| latest.frame.readings.clone()),
        baseline: controller.baseline(),
        worst_contact: contact.await.ok().flatten(),
    }
}

/// The worst contact of the last self-test in the record's directory, as text for people; `None` without a self-test.
fn worst_contact(directory: &Path) -> Option<String> {
    use std::io::{Read, Seek, SeekFrom};
    let mut file = std::fs::File::open(directory.join("tests.jsonl")).ok()?;
    let length = file.metadata().ok()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(LAST_TEST)))
        .ok()?;
    let mut text = Vec::new();
    file.read_to_end(&mut text).ok()?;
    let text = String::from_utf8_lossy(&text);
    let report: serde_json::Value = serde_json::from_str(text.lines().last()?).ok()?;
    let contacts = report["lines"]
        .as_array()?
        .iter()
        .filter(|line| line["check"] == "contact" && line["subject"].as_str().is_some());
    let worst = contacts
        .filter_map(|line| Some((line["measured"].as_f64()?, line)))
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(format!(
        "{} {:.0} {} (self-test of {})",
        worst.1["subject"].as_str()?,
        worst.0,
        worst.1["unit"].as_str()?,
        report["at"].as_str()?
    ))
}

async fn metrics_page(controller: Weak<Controller>) -> Result<Page, NoPage> {
    let controller = controller.upgrade().ok_or(NoPage::Failed)?;
    let health = controller.health().await;
    let maps = controller.observed.counters.reconstruction();
    let alarms = &controller.alarms.shown().alarms;
    let limits = &controller.runtime().setup.config.notify;
    Ok(Page {
        content: metrics::CONTENT_TYPE,
        body: metrics::page(&health, alarms, maps, limits),
    })
}

/// The listener for metrics, as configured.
#[derive(Debug, Default)]
struct Listening {
    wanted: Option<SocketAddr>,
    names: Vec<String>,
    listener: Option<HttpListener>,
}

impl Listening {
    /// Opens, moves or closes the listener. An unavailable address is reported, and retried.
    async fn keep_open(&mut self, controller: &Arc<Controller>) {
        let section = controller.runtime().setup.config.metrics.clone();
        let wanted = section.address();
        if wanted != self.wanted || section.names != self.names {
            (self.wanted, self.listener) = (wanted, None);
            self.names = section.names;
        }
        let (Some(address), None) = (wanted, &self.listener) else {
            controller
                .observed
                .set_metrics(self.listener.as_ref().map(HttpListener::address));
            return;
        };
        let requested = Arc::downgrade(controller);
        let pages = move |path: String, _| {
            let requested = requested.clone();
            async move {
                match path.as_str() {
                    "/metrics" => answer(PanicScope::Reply, metrics_page(requested))
                        .await
                        .unwrap_or(Err(NoPage::Failed)),
                    _ => Err(NoPage::NotFound),
                }
            }
        };
        match HttpListener::open(address, Hosts::Own(self.names.clone()), pages).await {
            Ok(listener) => {
                tracing::info!("metrics at http://{}/metrics", listener.address());
                controller.observed.set_metrics(Some(listener.address()));
                self.listener = Some(listener);
            }
            Err(cause) => {
                controller.observed.set_metrics(None);
                let text = format!("metrics cannot be served on {address}: {cause}");
                controller.events.journal(EventKind::Metrics, &text);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::session::observer::*;

    #[test]
    fn the_worst_contact_is_that_of_the_last_self_test() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(worst_contact(folder.path()), None);
        let line = |at: &str, ohm: [f64; 2]| {
            let one = |number: usize, ohm: f64| serde_json::json!({"subject": format!("electrode {number}"), "check": "contact", "unit": "ohm", "measured": ohm});
            let other = serde_json::json!({"subject": "sheet", "check": "resistance", "unit": "ohm", "measured": 1e6});
            let lines = [one(1, ohm[0]), one(2, ohm[1]), other];
            format!("{}\n", serde_json::json!({"at": at, "lines": lines}))
        };
        let text = line("monday", [900.0, 100.0]) + &line("tuesday", [120.0, 130.0]);
        std::fs::write(folder.path().join("tests.jsonl"), text).unwrap();
        assert_eq!(
            worst_contact(folder.path()).unwrap(),
            "electrode 2 130 ohm (self-test of tuesday)"
        );
    }
}
