//! Collects the daemon's health.

use std::sync::Arc;
use std::time::Duration;

use imaging::noise;
use rig::Clock;
use survey::Baseline;

use crate::monitoring::health::{Counts, Health, Running};
use crate::recording::recorder_message::QUEUE;
use crate::recording::session_status::SessionStatus;
use crate::session::controller::Controller;
use crate::session::state::State;

impl Controller {
    /// How the configured noise contradicts a baseline.
    pub(crate) fn noise_contradiction(&self, baseline: &Baseline) -> Option<String> {
        noise::contradiction(self.runtime().setup.config.model.noise_uv?, baseline)
    }

    /// Collects the health of the daemon. Queries the disk, for two seconds at most; queries no instrument.
    pub(crate) async fn health(self: &Arc<Self>) -> Health {
        let (runtime, counters) = (self.runtime(), &self.observed.counters);
        let now = counters.now();
        let status = self.active();
        let plan = self.plan();
        let plan = plan.map(|rig| rig.plan.duration(&rig.timing));
        let file = status.as_ref().map(|status| status.path());
        let directory = &runtime.setup.record_directory;
        let space = self.observed.disk.space(directory, file, now).await;
        let last_frame = counters.last_frame();
        let counts = Counts::of(counters);
        let wall = runtime.clock.wall();
        let relays = self.observed.relays();
        let state = self.state();
        Health {
            at: wall,
            state: state.word(),
            fault: match &state {
                State::Faulted(why) => Some(why.clone()),
                _ => None,
            },
            source: self.source_state(),
            simulated: runtime.simulated,
            session: status.map(|status| running(&status, plan, now)),
            age: last_frame
                .as_ref()
                .map(|frame| now.saturating_sub(frame.taken)),
            last_frame,
            last_gap: counters.last_gap(),
            relays: relays.map(|life| life.after(counts.acquired)),
            counts,
            instruments: self
                .identities()
                .instruments
                .into_iter()
                .map(|found| found.role)
                .collect(),
            rig_fault: self.rig_fault(),
            baseline: self.baseline().map(|baseline| {
                let age = wall.signed_duration_since(baseline.wall);
                (baseline.id.clone(), age.to_std().unwrap_or_default())
            }),
            rules: self.alarms.shown().of_rules(),
            noise: self
                .baseline()
                .filter(|_| !self.is_recording())
                .and_then(|baseline| self.noise_contradiction(&baseline)),
            space,
            warn_below: runtime.setup.config.record.warn_below_mb * 1_000_000,
            metrics: self.observed.metrics(),
        }
    }
}

fn running(status: &SessionStatus, plan: Option<Duration>, now: Duration) -> Running {
    let frame = status.latest_frame();
    let taken = frame.map(|frame| (frame.frame.monotonic, frame.frame.duration));
    let length = taken.map(|(_, duration)| duration);
    let (from, first, last) = status.pace();
    let durable = status.durable();
    let between = match (first, last) {
        (Some(first), Some(last)) if durable > 1 => {
            let steps = u32::try_from(durable - 1).unwrap_or(u32::MAX);
            Some(last.saturating_sub(first) / steps)
        }
        _ => None,
    };
    let period = [length, plan, between].into_iter().flatten();
    let period = period.fold(status.facts.every, Duration::max);
    let since = taken.map_or(from, |(at, duration)| from.max(at + duration));
    Running {
        id: status.facts.id.clone(),
        kind: status.facts.kind.as_str(),
        acquired: status.acquired(),
        durable,
        failed: status.failures(),
        dropped: status.dropped(),
        queue: QUEUE as u64,
        period: period.max(Duration::from_millis(1)),
        quiet: status.awaits_frames().then(|| now.saturating_sub(since)),
        last_error: status.progress().last_error,
    }
}
