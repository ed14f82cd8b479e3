//! The daemon's numbers for Prometheus and its like: OpenMetrics, a few dozen series whatever the daemon does.

use std::fmt;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric, MetricEncoder};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use prometheus_client::registry::{Registry, Unit};

use crate::monitoring::alarm::REPORTED;
use crate::monitoring::counters::{RECONSTRUCTION_S, Reconstruction};
use crate::monitoring::health::Health;
use config::NotifySection;

/// Of the text that [`page`] makes.
pub(crate) const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// States, as `tactus status` names them.
const STATES: [&str; 6] = [
    "idle",
    "baseline",
    "acquiring",
    "testing",
    "suspended",
    "faulted",
];

/// The page of one moment.
pub(crate) fn page(health: &Health, maps: Reconstruction, limits: &NotifySection) -> String {
    let alarms = health.alarms(limits);
    let snapshot = Snapshot {
        health: health.clone(),
        well: alarms.is_empty(),
        alarms: alarms.into_iter().map(|alarm| alarm.kind).collect(),
        maps,
        resident: resident(),
    };
    let mut registry = Registry::default();
    registry.register_collector(Box::new(snapshot));
    let mut text = String::new();
    // writing to a text cannot fail
    let _ = prometheus_client::encoding::text::encode(&mut text, &registry);
    text
}

/// Bytes of the daemon's memory; `None` where the system does not say.
fn resident() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes: u64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
    Some(kilobytes * 1024)
}

#[derive(Debug)]
struct Snapshot {
    health: Health,
    well: bool,
    alarms: Vec<&'static str>,
    maps: Reconstruction,
    resident: Option<u64>,
}

type Label = [(&'static str, &'static str); 1];

impl Snapshot {
    fn counters(&self, encoder: &mut DescriptorEncoder) -> fmt::Result {
        let counts = self.health.counts;
        for (name, help, count) in [
            (
                "tactus_frames",
                "Frames that the rig or recording gave",
                counts.acquired,
            ),
            ("tactus_durable_frames", "Frames on disk", counts.durable),
            (
                "tactus_failed_frames",
                "Frames that failed and are not in the record",
                counts.failed,
            ),
            (
                "tactus_dropped_frames",
                "Frames that missed their time, or that the disk refused",
                counts.dropped,
            ),
            ("tactus_overloads", "Readings over range", counts.overloads),
        ] {
            let counter = ConstCounter::new(count);
            let kind = counter.metric_type();
            counter.encode(encoder.encode_descriptor(name, help, None, kind)?)?;
        }
        Ok(())
    }

    /// What is not known is left out: a number that looks like any other would be believed.
    fn gauges(&self, encoder: &mut DescriptorEncoder) -> fmt::Result {
        let health = &self.health;
        let flag = |flag: bool| Some(f64::from(u8::from(flag)));
        let session = health.session.as_ref();
        let life = health.relays.as_ref();
        let (s, bytes, ratio) = (Unit::Seconds, Unit::Bytes, Unit::Ratios);
        let days = Unit::Other("days".to_owned());
        let gauges: [(&str, &str, Option<&Unit>, Option<f64>); 12] = [
            (
                "tactus_well",
                "Whether nothing is in trouble",
                None,
                flag(self.well),
            ),
            (
                "tactus_simulated",
                "Whether voltages are simulated",
                None,
                flag(health.simulated),
            ),
            (
                "tactus_source_unverified",
                "Whether the state of the source is unknown",
                None,
                flag(health.source == "unknown"),
            ),
            (
                "tactus_backlog_frames",
                "Frames of the running session that are not on disk yet",
                None,
                session.map(|session| session.backlog() as f64),
            ),
            (
                "tactus_last_frame_age",
                "Time since the last reading of the last frame on disk",
                Some(&s),
                health.age.map(|age| age.as_secs_f64()),
            ),
            (
                "tactus_period",
                "From start to start of frames of the running session",
                Some(&s),
                session.map(|session| session.period.as_secs_f64()),
            ),
            (
                "tactus_baseline_age",
                "Age of the baseline",
                Some(&s),
                health.baseline.as_ref().map(|(_, age)| age.as_secs_f64()),
            ),
            (
                "tactus_disk_free",
                "Bytes that may still be written to the record",
                Some(&bytes),
                health.room.free.map(|free| free as f64),
            ),
            (
                "tactus_disk_left",
                "Time until the disk is full at the rate of the running session",
                Some(&days),
                health.room.days(),
            ),
            (
                "tactus_relay_life_used",
                "Part of the life of the relay that will be worn out first",
                Some(&ratio),
                life.map(|life| life.used),
            ),
            (
                "tactus_relay_life_left",
                "Time of measuring until its rating is reached",
                Some(&s),
                life.and_then(|life| life.left())
                    .map(|left| left.as_secs_f64()),
            ),
            (
                "process_resident_memory",
                "Memory of the daemon",
                Some(&bytes),
                self.resident.map(|resident| resident as f64),
            ),
        ];
        for (name, help, unit, value) in gauges {
            let Some(value) = value else { continue };
            let gauge = ConstGauge::new(value);
            let kind = gauge.metric_type();
            gauge.encode(encoder.encode_descriptor(name, help, unit, kind)?)?;
        }
        Ok(())
    }

    fn families(&self, encoder: &mut DescriptorEncoder) -> fmt::Result {
        let gauge = MetricType::Gauge;
        let up = self.health.rig_fault.is_none();
        let help = "Whether the instrument answers";
        let mut family = encoder.encode_descriptor("tactus_instrument_up", help, None, gauge)?;
        for (role, _) in &self.health.instruments {
            one(&mut family, [("role", *role)], up)?;
        }
        let help = "What the daemon is doing";
        let mut family = encoder.encode_descriptor("tactus_state", help, None, gauge)?;
        for state in STATES {
            one(&mut family, [("state", state)], self.health.state == state)?;
        }
        let help = "What people are notified of";
        let mut family = encoder.encode_descriptor("tactus_trouble", help, None, gauge)?;
        for kind in REPORTED {
            one(&mut family, [("kind", kind)], self.alarms.contains(&kind))?;
        }
        let help = "Version of the daemon";
        let mut build = encoder.encode_descriptor("tactus_build", help, None, MetricType::Info)?;
        build.encode_info(&[("version", env!("CARGO_PKG_VERSION"))])
    }

    fn histogram(&self, encoder: &mut DescriptorEncoder) -> fmt::Result {
        let mut buckets: Vec<(f64, u64)> =
            RECONSTRUCTION_S.into_iter().zip(self.maps.within).collect();
        let below: u64 = self.maps.within.iter().sum();
        buckets.push((f64::INFINITY, self.maps.count.saturating_sub(below)));
        let help = "Time that maps took";
        let kind = MetricType::Histogram;
        encoder
            .encode_descriptor("tactus_reconstruction", help, Some(&Unit::Seconds), kind)?
            .encode_histogram::<[(&str, &str); 0]>(self.maps.sum_s, self.maps.count, &buckets, None)
    }
}

fn one(family: &mut MetricEncoder<'_>, label: Label, value: bool) -> fmt::Result {
    let gauge = ConstGauge::new(f64::from(u8::from(value)));
    gauge.encode(family.encode_family(&label)?)
}

impl Collector for Snapshot {
    fn encode(&self, mut encoder: DescriptorEncoder) -> fmt::Result {
        self.counters(&mut encoder)?;
        self.gauges(&mut encoder)?;
        self.families(&mut encoder)?;
        self.histogram(&mut encoder)
    }
}
