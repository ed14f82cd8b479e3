//! Who looks after the daemon while it works: catches up with what the journal was not told, notices troubles and tells
//! people, sums up the day, serves the metrics. It waits for nothing that a frame waits for, and no
//! frame waits for it.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use rig::Clock;
use tokio::sync::mpsc;
use tokio::time::Instant;

use crate::monitoring::alarm::{Alarm, Message, Phase};
use crate::monitoring::daily_summary::{Daily, Evening};
use crate::monitoring::health::{Counts, Health};
use crate::monitoring::metrics;
use crate::monitoring::metrics_listener::Door;
use crate::monitoring::notification::{Delivered, deliver, letter};
use crate::session::controller::Keeper;

/// Between two looks.
const EVERY: Duration = Duration::from_secs(5);
/// Messages that may wait for the command.
const MESSAGES: usize = 16;
/// Bytes at the end of the file of self-tests that are read for the last one.
const LAST_TEST: u64 = 1 << 20;

/// Looks after the daemon until it ends.
pub(crate) async fn observe(keeper: Arc<Keeper>) {
    let (messages, letters) = mpsc::channel(MESSAGES);
    tokio::spawn(post(Arc::downgrade(&keeper), letters));
    let house = keeper.house();
    let mut daily = Daily::new(house.clock.wall(), Counts::of(&keeper.observed.tally));
    let mut alarm = Alarm::default();
    let mut door = Listening::default();
    let text = format!(
        "tactusd {} on {}",
        env!("CARGO_PKG_VERSION"),
        house.config.display()
    );
    drop(house);
    keeper.tell(None, "started", &text).await;
    let mut ticks = tokio::time::interval(EVERY);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        keeper.observed.aloud.catch_up();
        crate::service::containment::catch_up();
        door.keep_open(&keeper).await;
        let health = keeper.health().await;
        judge(&keeper, &mut alarm, &health, &messages).await;
        if daily.is_over(health.at) {
            let text = daily.summary(health.at, &evening(&keeper).await);
            keeper.tell(None, "daily", &text).await;
        }
    }
}

/// Notices what has begun and what has ended, and puts it on its way to people.
async fn judge(
    keeper: &Arc<Keeper>,
    alarm: &mut Alarm,
    health: &Health,
    messages: &mpsc::Sender<(Message, Health)>,
) {
    let house = keeper.house();
    let limits = &house.setup.config.notify;
    let troubles = health.troubles(limits);
    let lingering = health.troubles(&limits.wider());
    let mut unsure = Vec::new();
    if health.session.is_some() && health.room.per_day.is_none() {
        unsure.push("disk-days");
    }
    if health.relays.is_none() {
        unsure.push("relay-life");
    }
    let again = survey::duration(limits.again_s);
    for message in alarm.judge(Instant::now(), &troubles, &lingering, &unsure, again) {
        let kind = match message.phase {
            Phase::Ended => "trouble-over",
            _ => "trouble",
        };
        let text = format!("{}: {}", message.kind, message.text);
        keeper.tell(None, kind, &text).await;
        if !limits.command.is_empty() && messages.try_send((message, health.clone())).is_err() {
            let text = "too many notifications wait for their command; one is lost";
            keeper.tell(None, "notify-failed", text).await;
        }
    }
}

/// Runs the command for one message after the other.
async fn post(keeper: std::sync::Weak<Keeper>, mut letters: mpsc::Receiver<(Message, Health)>) {
    while let Some((message, health)) = letters.recv().await {
        let Some(keeper) = keeper.upgrade() else {
            return;
        };
        let done = run_command(&keeper, &message, &health).await;
        if !done.is_done() {
            let text = format!("{} could not be told: {}", message.kind, done.text());
            keeper.tell(None, "notify-failed", &text).await;
        }
    }
}

async fn run_command(keeper: &Arc<Keeper>, message: &Message, health: &Health) -> Delivered {
    let house = keeper.house();
    let limits = &house.setup.config.notify;
    let letter = letter(message, health, limits);
    let deadline = survey::duration(limits.deadline_s);
    deliver(&limits.command, &letter, deadline).await
}

impl Keeper {
    /// Runs the command of `[notify]` once and says how it fared.
    pub(crate) async fn notify_test(self: &Arc<Self>) -> Delivered {
        let message = Message {
            kind: "test",
            phase: Phase::Test,
            text: "tactus notify test: this is no trouble".to_owned(),
        };
        let health = self.health().await;
        run_command(self, &message, &health).await
    }
}

/// What is known at the end of a day.
async fn evening(keeper: &Arc<Keeper>) -> Evening {
    let directory = keeper.house().setup.record_directory.clone();
    let contact = tokio::task::spawn_blocking(move || worst_contact(&directory));
    Evening {
        counts: Counts::of(&keeper.observed.tally),
        frame: keeper.active().and_then(|live| live.latest_frame()),
        baseline: keeper.baseline(),
        worst_contact: contact.await.ok().flatten(),
    }
}

/// Of the last self-test beside the record; `None` where there was none.
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

/// The door for whoever scrapes, as configured.
#[derive(Debug, Default)]
struct Listening {
    wanted: Option<SocketAddr>,
    names: Vec<String>,
    door: Option<Door>,
}

impl Listening {
    /// Opens, moves or closes it. An address that cannot be had is tried again, and said.
    async fn keep_open(&mut self, keeper: &Arc<Keeper>) {
        let section = keeper.house().setup.config.metrics.clone();
        let wanted = section.address();
        if wanted != self.wanted || section.names != self.names {
            (self.wanted, self.door) = (wanted, None);
            self.names = section.names;
        }
        let (Some(address), None) = (wanted, &self.door) else {
            keeper
                .observed
                .set_metrics(self.door.as_ref().map(|door| door.address));
            return;
        };
        let asked = Arc::downgrade(keeper);
        let page = move || {
            let asked = asked.clone();
            async move {
                let Some(keeper) = asked.upgrade() else {
                    return String::new();
                };
                let health = keeper.health().await;
                let maps = keeper.observed.tally.reconstruction();
                metrics::page(&health, maps, &keeper.house().setup.config.notify)
            }
        };
        match Door::open(address, self.names.clone(), metrics::CONTENT_TYPE, page).await {
            Ok(door) => {
                tracing::info!("metrics at http://{}/metrics", door.address);
                keeper.observed.set_metrics(Some(door.address));
                self.door = Some(door);
            }
            Err(cause) => {
                let text = format!("nobody can scrape {address}: {cause}");
                keeper.observed.aloud.say("metrics", None, &text);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::monitoring::observer::*;

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
