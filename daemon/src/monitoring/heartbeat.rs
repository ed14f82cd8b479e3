//! Heartbeats. Acquisition, recorder and each bus register the time of their next heartbeat; once one is overdue,
//! systemd's watchdog is no longer fed. (A timer alone would also feed it in a daemon that hangs.)

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use rig::{Clock, SystemClock};

use crate::events::event::{BusEvent, Event};
use crate::events::event_log::EventLog;
use crate::events::kind::EventKind;
use crate::monitoring::service_manager;
use config::BusSection;

/// A monitored part of the daemon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    /// Waits for schedules and instruments, each with its own timeout.
    Acquisition,
    /// Writes to the disk.
    Record,
    SessionBus,
    SystemBus,
}

impl Part {
    const ALL: [Self; 4] = [
        Self::Acquisition,
        Self::Record,
        Self::SessionBus,
        Self::SystemBus,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Acquisition => "acquisition",
            Self::Record => "the record",
            Self::SessionBus => "the session bus",
            Self::SystemBus => "the system bus",
        }
    }
}

/// No heartbeat is due: the part is idle.
const IDLE: u64 = u64::MAX;

/// The time of each next heartbeat, in milliseconds of the daemon's monotonic clock.
#[derive(Debug)]
pub(crate) struct Heartbeats([AtomicU64; 4]);

impl Default for Heartbeats {
    fn default() -> Self {
        Self(std::array::from_fn(|_| AtomicU64::new(IDLE)))
    }
}

impl Heartbeats {
    /// Registers that the next heartbeat is due within this time.
    pub(crate) fn set_deadline(&self, part: Part, now: Duration, within: Duration) {
        let due = now.saturating_add(within).as_millis();
        let due = u64::try_from(due).unwrap_or(IDLE - 1);
        self.0[part as usize].store(due, Ordering::Relaxed);
    }

    /// Like [`Heartbeats::set_deadline`], for a part that has to reply: a deadline that is already set is kept.
    pub(crate) fn set_deadline_if_idle(&self, part: Part, now: Duration, within: Duration) {
        if self.0[part as usize].load(Ordering::Relaxed) == IDLE {
            self.set_deadline(part, now, within);
        }
    }

    /// Marks the part as idle: it waits for the operator, or for another part.
    pub(crate) fn set_idle(&self, part: Part) {
        self.0[part as usize].store(IDLE, Ordering::Relaxed);
    }

    /// The first overdue part, and by how much.
    pub(crate) fn overdue(&self, now: Duration) -> Option<(Part, Duration)> {
        let now = u64::try_from(now.as_millis()).unwrap_or(IDLE);
        Part::ALL.into_iter().find_map(|part| {
            let due = self.0[part as usize].load(Ordering::Relaxed);
            let late = now.checked_sub(due).filter(|late| *late > 0)?;
            Some((part, Duration::from_millis(late)))
        })
    }
}

/// Marks the part as idle when dropped.
pub(crate) struct IdleOnDrop(pub Arc<Heartbeats>, pub Part);

impl Drop for IdleOnDrop {
    fn drop(&mut self) {
        self.0.set_idle(self.1);
    }
}

/// Feeds systemd's watchdog, at a third of its timeout, as long as no part is overdue. Returns at once if systemd did
/// not request it.
pub(crate) async fn report_to_systemd(
    heartbeats: Arc<Heartbeats>,
    clock: SystemClock,
    bus: BusSection,
    events: EventLog,
) {
    let Some(patience) = sd_notify::watchdog_enabled() else {
        return;
    };
    let mut ticks = tokio::time::interval(patience / 3);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut silent = false;
    loop {
        ticks.tick().await;
        let now = clock.monotonic();
        match heartbeats.overdue(now) {
            None => {
                silent = false;
                service_manager::notify_alive();
            }
            Some((part, late)) if !silent => {
                silent = true;
                let text = format!(
                    "the heartbeat of {} is {:.0} s overdue; systemd's watchdog is no longer fed, so that systemd will \
                     restart the daemon",
                    part.name(),
                    late.as_secs_f64()
                );
                events.report(Event::new(clock.wall(), EventKind::Alarm, &text, None));
            }
            Some(_) => {}
        }
        // each bus has to reply, or be found dead, before systemd's timeout
        for (wanted, part) in [
            (bus.session, Part::SessionBus),
            (bus.system, Part::SystemBus),
        ] {
            if wanted {
                heartbeats.set_deadline_if_idle(part, now, patience);
            }
        }
        events.publish(&BusEvent::Heartbeats);
    }
}

#[cfg(test)]
mod tests {
    use crate::monitoring::heartbeat::*;

    const S: fn(u64) -> Duration = Duration::from_secs;

    #[test]
    fn overdue_heartbeat_is_found_and_a_punctual_one_is_not() {
        let heartbeats = Heartbeats::default();
        assert_eq!(
            heartbeats.overdue(S(1_000_000)),
            None,
            "nothing is under way"
        );
        heartbeats.set_deadline(Part::Acquisition, S(10), S(5));
        heartbeats.set_deadline(Part::Record, S(10), S(60));
        assert_eq!(heartbeats.overdue(S(15)), None);
        assert_eq!(heartbeats.overdue(S(17)), Some((Part::Acquisition, S(2))));
        heartbeats.set_deadline(Part::Acquisition, S(17), S(5));
        assert_eq!(heartbeats.overdue(S(17)), None);
        heartbeats.set_idle(Part::Acquisition);
        assert_eq!(heartbeats.overdue(S(69)), None);
        assert_eq!(heartbeats.overdue(S(71)), Some((Part::Record, S(1))));
    }

    #[test]
    fn second_heartbeat_request_keeps_the_deadline() {
        let heartbeats = Heartbeats::default();
        heartbeats.set_deadline_if_idle(Part::SystemBus, S(0), S(30));
        heartbeats.set_deadline_if_idle(Part::SystemBus, S(20), S(30));
        assert_eq!(heartbeats.overdue(S(31)), Some((Part::SystemBus, S(1))));
        heartbeats.set_idle(Part::SystemBus);
        heartbeats.set_deadline_if_idle(Part::SystemBus, S(31), S(30));
        assert_eq!(heartbeats.overdue(S(31)), None);
    }

    #[test]
    fn largest_deadline_does_not_overflow() {
        let heartbeats = Heartbeats::default();
        heartbeats.set_deadline(Part::Record, Duration::MAX, Duration::MAX);
        assert_eq!(heartbeats.overdue(S(u64::MAX / 1000)), None);
    }
}
