//! Collects the daemon's health.

use std::sync::Arc;
use std::time::Duration;

use imaging::noise;
use rig::Clock;
use survey::Baseline;

use crate::instruments::rig_plan::RigPlan;
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
            session: status.map(|status| running(&status, plan.as_deref(), now)),
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

fn running(status: &SessionStatus, plan: Option<&RigPlan>, now: Duration) -> Running {
    let frame = status.latest_frame();
    let taken = frame.map(|frame| (frame.frame.monotonic, frame.frame.duration));
    let length = taken.map(|(_, duration)| duration);
    let (from, observed) = status.pace();
    let planned = plan.map(RigPlan::mean_duration);
    let period = [length, planned, observed].into_iter().flatten();
    let period = period.fold(status.facts.every, Duration::max);
    let since = taken.map_or(from, |(at, duration)| from.max(at + duration));
    Running {
        id: status.facts.id.clone(),
        kind: status.facts.kind.as_str(),
        acquired: status.acquired(),
        durable: status.durable(),
        failed: status.failures(),
        dropped: status.dropped(),
        queue: QUEUE as u64,
        period: period.max(Duration::from_millis(1)),
        quiet: status.awaits_frames().then(|| now.saturating_sub(since)),
        last_error: status.progress().last_error,
    }
}

#[cfg(test)]
mod tests {
    use chrono::DateTime;
    use logbook::SessionKind;
    use rig::SystemClock;
    use survey::{Checks, Frame};

    use super::*;
    use crate::monitoring::Counters;
    use crate::preparation::{FramesFrom, prepare};
    use crate::recording::frame_sink::FrameSink;
    use crate::recording::published::Published;
    use crate::recording::session_status::Facts;

    const CONFIG: &str = "[rig]\nkind = \"simulated\"\n[geometry]\npreset = \"disc-tank\"\n\
                          [geometry.disc-tank]\nelectrodes = 16\n[survey]\nelectrodes = 16\nzero_every = 1\n\
                          [record]\ndirectory = \"state\"\n[bus]\npeer_path = \"peer\"\n";

    #[test]
    fn the_period_has_zero_current_frames_and_no_earlier_daemon() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        std::fs::write(&path, CONFIG).unwrap();
        let prepared = prepare(&path).unwrap_or_else(|problems| panic!("{problems:?}"));
        let FramesFrom::Rig(plan) = &prepared.frames else {
            panic!("it is a rig");
        };
        let facts = Facts {
            id: "m1".to_owned(),
            kind: SessionKind::Measurement,
            simulated: true,
            baseline_id: String::new(),
            method: String::new(),
            every: Duration::ZERO,
        };
        let counters = Arc::new(Counters::new(SystemClock::new()));
        let path = folder.path().join("m1");
        let mut status = Arc::new(SessionStatus::new(facts, path, false, counters));
        let seconds = Duration::from_secs;
        let planned = running(&status, Some(plan), seconds(0)).period;
        // as many zero-current frames as others
        let single = plan.plan.duration(&plan.timing).as_secs_f64();
        assert!((planned.as_secs_f64() - 2.0 * single).abs() < 1e-6);

        status.set_frames_on_disk(1000);
        let protocol = &prepared.setup.protocol;
        for (sequence, began) in [(1001, seconds(1000)), (1002, seconds(2000))] {
            let frame = Frame {
                extra: Vec::new(),
                sequence,
                readings: vec![survey::Reading::NotMeasured; protocol.len()],
                monotonic: began,
                wall: DateTime::UNIX_EPOCH,
                duration: Duration::ZERO,
                settings: plan.settings(),
                compliance: Vec::new(),
                simulated: true,
            };
            let published = Published::new(Checks::new(protocol).of(&frame), frame);
            FrameSink::frames(&mut status, &[Arc::new(published)]).unwrap();
        }
        let observed = running(&status, Some(plan), seconds(2000));
        assert_eq!((observed.durable, observed.period), (1002, seconds(1000)));
    }
}
