//! Health of the daemon, collected at one moment. Status, metrics and notifications use the same data.

use std::time::Duration;

use chrono::{DateTime, Utc};
use survey::duration;

use crate::monitoring::counters::{Gap, LastFrame, read};
use crate::monitoring::disk::FreeSpace;
use crate::monitoring::{Counters, RelayLife};
use config::NotifySection;
use survey::nanoseconds;

/// State of the daemon.
#[derive(Debug, Clone)]
pub(crate) struct Health {
    pub at: DateTime<Utc>,
    /// `idle`, `baseline`, `acquiring`, `testing`, `suspended`, `faulted`.
    pub state: &'static str,
    /// Why it is faulted; `None` if it is not.
    pub fault: Option<String>,
    /// `off` (verified), `in use`, `unknown`.
    pub source: &'static str,
    pub simulated: bool,
    pub session: Option<Running>,
    pub last_frame: Option<LastFrame>,
    /// Time since the last reading of `last_frame`.
    pub age: Option<Duration>,
    pub last_gap: Option<Gap>,
    pub counts: Counts,
    /// Roles of the instruments.
    pub instruments: Vec<&'static str>,
    /// Why the instruments cannot be used; `None` if they can.
    pub rig_fault: Option<String>,
    pub baseline: Option<(String, Duration)>,
    /// Name and text of the rules of `[[alarm]]` whose alarm is active or that cannot be judged.
    pub rules: Vec<(String, String)>,
    /// How the configured noise contradicts the current baseline.
    pub noise: Option<String>,
    pub space: FreeSpace,
    /// Free bytes below which an alarm is raised, at any growth rate.
    pub warn_below: u64,
    pub relays: Option<RelayLife>,
    /// Address of the metrics endpoint.
    pub metrics: Option<std::net::SocketAddr>,
}

/// Counts over all sessions since the daemon started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Counts {
    pub acquired: u64,
    pub durable: u64,
    pub failed: u64,
    pub dropped: u64,
    pub overloads: u64,
}

impl Counts {
    pub(crate) fn of(counters: &Counters) -> Self {
        Self {
            acquired: read(&counters.acquired),
            durable: read(&counters.durable),
            failed: read(&counters.failed),
            dropped: read(&counters.dropped),
            overloads: read(&counters.overloads),
        }
    }
}

/// The running session.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Running {
    pub id: String,
    pub kind: &'static str,
    pub acquired: u64,
    pub durable: u64,
    pub failed: u64,
    pub dropped: u64,
    /// Frames that may wait for the disk.
    pub queue: u64,
    /// Frame period: the longest of the scheduled, planned and observed period.
    pub period: Duration,
    /// Time since its last frame, its start, or its resumption; `None` if no frame is expected.
    pub quiet: Option<Duration>,
    /// The last error of the session, such as the reason why the last frame has no map; empty without one.
    pub last_error: String,
}

impl Running {
    /// Frames that are not on disk yet.
    pub(crate) fn backlog(&self) -> u64 {
        self.acquired.saturating_sub(self.durable)
    }
}

/// An active alarm.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ActiveAlarm {
    /// Machine-readable kind.
    pub kind: &'static str,
    /// Text for people.
    pub text: String,
}

impl Health {
    /// The active alarms, most severe first; empty if all is well.
    pub(crate) fn alarms(&self, limits: &NotifySection) -> Vec<ActiveAlarm> {
        let mut alarms = Vec::new();
        let mut add = |kind, text| alarms.push(ActiveAlarm { kind, text });
        if self.source == "unknown" {
            let text = "the state of the source is unknown: treat the sheet as live";
            add("source-unverified", text.to_owned());
        }
        if let Some(why) = &self.fault {
            add("faulted", why.clone());
        } else if let Some(why) = &self.rig_fault {
            add("instrument", why.clone());
        }
        if let Some(session) = &self.session {
            self.of_the_session(session, limits, &mut add);
        }
        let days = self.space.days();
        if let Some(days) = days.filter(|days| *days < limits.disk_days) {
            let text = format!("the disk is full in {days:.1} days at the present rate");
            add("disk-days", text);
        } else if let Some(free) = self.space.free.filter(|free| *free < self.warn_below) {
            let text = format!("the disk has {:.0} MB left", free as f64 / 1e6);
            add("disk-days", text);
        }
        if let Some(life) = self
            .relays
            .as_ref()
            .filter(|life| life.used >= limits.relay_life)
        {
            let part = 100.0 * life.used;
            let text = format!("relay {} has used {part:.1} % of its life", life.relay);
            add("relay-life", text);
        }
        if let Some((id, age)) = &self.baseline {
            let days = age.as_secs_f64() / 86_400.0;
            if days > limits.baseline_days {
                let text = format!(
                    "baseline {id} is {days:.1} days old; unload the sheet and `tactus baseline record`"
                );
                add("baseline-stale", text);
            }
        }
        if let Some(text) = &self.noise {
            add("noise", text.clone());
        }
        alarms
    }

    /// Whether there is no problem, and no rule whose alarm is active or that cannot be judged.
    pub(crate) fn is_well(&self, limits: &NotifySection) -> bool {
        self.rules.is_empty() && self.alarms(limits).is_empty()
    }

    fn of_the_session(
        &self,
        session: &Running,
        limits: &NotifySection,
        add: &mut impl FnMut(&'static str, String),
    ) {
        let patience = duration(session.period.as_secs_f64() * limits.no_frame_periods)
            .max(duration(limits.no_frame_s));
        if let Some(quiet) = session.quiet.filter(|quiet| *quiet > patience) {
            let text = format!(
                "session {} has had no frame for {:.1} s; one is due every {:.1} s",
                session.id,
                quiet.as_secs_f64(),
                session.period.as_secs_f64()
            );
            add("no-frame", text);
        }
        if session.backlog() > session.queue {
            let text = format!(
                "{} frames wait for the disk, which does not keep up",
                session.backlog()
            );
            add("backlog", text);
        }
        if !session.last_error.is_empty() && self.rig_fault.is_none() {
            add("session", session.last_error.clone());
        }
    }

    /// Converts to the type of D-Bus; unknown values are left out.
    pub(crate) fn report(&self, limits: &NotifySection) -> dbus::Health {
        let alarms = self.alarms(limits);
        let troubles = alarms
            .iter()
            .map(|alarm| format!("{}: {}", alarm.kind, alarm.text));
        let rules = self.rules.iter();
        let troubles = troubles.chain(rules.map(|(name, text)| format!("{name}: {text}")));
        let answers = |role: &str| match &self.rig_fault {
            None => format!("{role}: ready"),
            Some(why) => format!("{role}: fault: {why}"),
        };
        let instruments = self.instruments.iter().map(|role| answers(role));
        let seconds = |time: Duration| time.as_secs_f64();
        let (frame, session) = (self.last_frame.as_ref(), self.session.as_ref());
        let (gap, relays) = (self.last_gap.as_ref(), self.relays.as_ref());
        let (baseline, baseline_age) = self.baseline.clone().unzip();
        dbus::Health {
            at_ns: Some(nanoseconds(self.at)),
            well: Some(self.is_well(limits)),
            troubles: Some(troubles.collect()),
            state: Some(self.state.to_owned()),
            source_state: Some(self.source.to_owned()),
            simulated: Some(self.simulated),
            instruments: Some(instruments.collect()),
            total_frames: Some(self.counts.acquired),
            total_durable: Some(self.counts.durable),
            total_failed: Some(self.counts.failed),
            total_dropped: Some(self.counts.dropped),
            total_overloads: Some(self.counts.overloads),
            session: session.map(|session| session.id.clone()),
            session_kind: session.map(|session| session.kind.to_owned()),
            frames_acquired: session.map(|session| session.acquired),
            frames_durable: session.map(|session| session.durable),
            frames_failed: session.map(|session| session.failed),
            frames_dropped: session.map(|session| session.dropped),
            backlog: session.map(Running::backlog),
            period_s: session.map(|session| seconds(session.period)),
            quiet_s: session.and_then(|session| session.quiet).map(seconds),
            last_frame_ns: frame.map(|frame| nanoseconds(frame.wall)),
            last_frame_age_s: self.age.map(seconds),
            last_frame_sequence: frame.map(|frame| frame.sequence),
            last_frame_session: frame.map(|frame| frame.session.clone()),
            last_gap_ns: gap.map(|gap| nanoseconds(gap.at)),
            last_gap: gap.map(|gap| gap.text.clone()),
            baseline,
            baseline_age_s: baseline_age.map(seconds),
            disk_free_bytes: self.space.free,
            disk_bytes_per_day: self.space.per_day,
            disk_days: self.space.days(),
            relay: relays.map(|life| life.relay),
            relay_used: relays.map(|life| life.used),
            relay_left_s: relays.and_then(RelayLife::left).map(seconds),
            metrics: self.metrics.map(|address| address.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::monitoring::health::*;

    fn well() -> Health {
        Health {
            at: DateTime::UNIX_EPOCH,
            state: "acquiring",
            fault: None,
            source: "in use",
            simulated: true,
            session: Some(Running {
                id: "m1".into(),
                kind: "measurement",
                acquired: 20,
                durable: 19,
                failed: 0,
                dropped: 0,
                queue: 16,
                period: Duration::from_secs(10),
                quiet: Some(Duration::from_secs(3)),
                last_error: String::new(),
            }),
            last_frame: None,
            age: None,
            last_gap: None,
            counts: Counts::default(),
            instruments: vec!["source"],
            rig_fault: None,
            baseline: Some(("b1".into(), Duration::from_secs(86_400))),
            rules: Vec::new(),
            noise: None,
            space: FreeSpace {
                free: Some(100_000_000_000),
                per_day: Some(1e9),
            },
            warn_below: 2_000_000_000,
            relays: Some(RelayLife {
                relay: 1001,
                used: 0.2,
                frames_left: Some(1e6),
                period: Duration::from_secs(10),
                frames: 0,
            }),
            metrics: None,
        }
    }

    fn kinds(health: &Health) -> Vec<&'static str> {
        let alarms = health.alarms(&NotifySection::default());
        alarms.iter().map(|alarm| alarm.kind).collect()
    }

    #[test]
    fn a_disk_that_cannot_be_read_ends_no_alarm() {
        let mut health = well();
        let judgement = |health: &Health| {
            let judged = crate::monitoring::built_in::judgements(health, &NotifySection::default());
            judged.into_iter().find(|(kind, _)| *kind == "disk-days")
        };
        let within = Some(("disk-days", alarms::Judgement::Within));
        assert_eq!(judgement(&health), within);
        health.space.free = None;
        for running in [true, false] {
            let text = format!("{:?}", judgement(&health));
            assert!(text.contains("Suppressed"), "{running}: {text}");
            health.session = None;
        }
    }

    /// Tests both sides of each limit.
    #[test]
    fn every_trouble_is_found_and_no_other() {
        type Change = fn(&mut Health);
        let cases: [(&[&str], Change); 17] = [
            (&[], |_| ()),
            (&["source-unverified"], |health| health.source = "unknown"),
            (&["faulted"], |health| {
                health.fault = Some("lost".into());
                health.rig_fault = Some("lost".into());
            }),
            (&["instrument"], |health| {
                health.rig_fault = Some("the connection was lost".into());
            }),
            (&[], |health| {
                session(health).quiet = Some(Duration::from_secs(49));
            }),
            (&["no-frame"], |health| {
                session(health).quiet = Some(Duration::from_secs(51));
            }),
            (&[], |health| {
                // a session with a period of milliseconds raises no alarm within a second
                session(health).period = Duration::from_millis(5);
            }),
            (&[], |health| session(health).quiet = None),
            (&[], |health| session(health).acquired = 19 + 16),
            (&["backlog"], |health| session(health).acquired = 19 + 17),
            (&["session"], |health| {
                session(health).last_error = "no map".into();
            }),
            (&[], |health| health.space.per_day = Some(7e9)),
            (&["disk-days"], |health| health.space.per_day = Some(8e9)),
            (&["disk-days"], |health| {
                (health.space.free, health.space.per_day) = (Some(1_999_999_999), None);
            }),
            (&["relay-life"], |health| {
                health.relays.as_mut().unwrap().used = 0.9;
            }),
            (&["baseline-stale"], |health| {
                health.baseline = Some(("b".into(), Duration::from_secs(31 * 86_400)));
            }),
            (&["noise"], |health| {
                health.noise = Some("another than the baseline's".into());
            }),
        ];
        for (number, (wanted, change)) in cases.into_iter().enumerate() {
            let mut health = well();
            change(&mut health);
            assert_eq!(kinds(&health), wanted, "case {number}");
        }
    }

    fn session(health: &mut Health) -> &mut Running {
        health.session.as_mut().unwrap()
    }

    #[test]
    fn what_is_not_known_is_left_out() {
        let limits = NotifySection::default();
        let mut health = well();
        let reported = health.report(&limits);
        assert_eq!(
            (reported.disk_days, reported.well),
            (Some(100.0), Some(true))
        );
        assert_eq!(reported.instruments.unwrap(), ["source: ready"]);
        assert_eq!(reported.backlog, Some(1));
        health.space.per_day = None;
        health.relays = None;
        health.session = None;
        health.baseline = None;
        let reported = health.report(&limits);
        assert_eq!((reported.disk_days, reported.relay_used), (None, None));
        assert_eq!((reported.backlog, reported.baseline), (None, None));
        assert_eq!(reported.last_gap, None);
    }
}
