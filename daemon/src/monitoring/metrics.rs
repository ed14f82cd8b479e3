//! Metrics in the OpenMetrics format (Prometheus): a fixed set of a few dozen series, and three for each rule of
//! `[[alarm]]`.

use std::fmt;

use alarms::{Alarm, Alarms};
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use prometheus_client::registry::{Registry, Unit};

use crate::monitoring::built_in;
use crate::monitoring::counters::{RECONSTRUCTION_S, Reconstruction};
use crate::monitoring::health::Health;
use config::NotifySection;

/// Content type of [`page`].
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

/// The page for a snapshot.
pub(crate) fn page(
    health: &Health,
    alarms: &Alarms,
    maps: Reconstruction,
    limits: &NotifySection,
) -> String {
    let troubles = health.alarms(limits);
    let of_rules = alarms
        .iter()
        .filter(|alarm| !built_in::has(&alarm.rule.name));
    let snapshot = Snapshot {
        health: health.clone(),
        well: health.is_well(limits),
        troubles: troubles.into_iter().map(|trouble| trouble.kind).collect(),
        alarms: of_rules.cloned().collect(),
        maps,
        resident: resident(),
    };
    let mut registry = Registry::default();
    registry.register_collector(Box::new(snapshot));
    let mut text = String::new();
    // writing to a string cannot fail
    let _ = prometheus_client::encoding::text::encode(&mut text, &registry);
    text
}

/// Resident memory of the daemon, bytes; `None` if unknown.
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
    /// Kinds of the current problems.
    troubles: Vec<&'static str>,
    /// The alarms of the rules of `[[alarm]]`.
    alarms: Vec<Alarm>,
    maps: Reconstruction,
    resident: Option<u64>,
}

/// A metric: its description and the source of its value. Unknown values are left out, because any number in their
/// place would be misleading.
struct Metric {
    name: &'static str,
    kind: MetricType,
    /// Unit appended to its name; empty for a plain number.
    unit: &'static str,
    meaning: &'static str,
    values: Values,
}

enum Values {
    Count(fn(&Snapshot) -> u64),
    Number(fn(&Snapshot) -> Option<f64>),
    Flag(fn(&Snapshot) -> bool),
    /// The name of a label, and a flag for each of its values.
    Flags(&'static str, fn(&Snapshot) -> Vec<(&'static str, bool)>),
    /// A flag for each alarm of a rule.
    OfAlarms(fn(&Alarm) -> bool),
    /// The name of a label and its value.
    Label(&'static str, &'static str),
    Reconstruction,
}

impl Metric {
    const fn new(name: &'static str, meaning: &'static str, values: Values) -> Self {
        let kind = match values {
            Values::Count(_) => MetricType::Counter,
            Values::Number(_) | Values::Flag(_) | Values::Flags(..) | Values::OfAlarms(_) => {
                MetricType::Gauge
            }
            Values::Label(..) => MetricType::Info,
            Values::Reconstruction => MetricType::Histogram,
        };
        Self {
            name,
            kind,
            unit: "",
            meaning,
            values,
        }
    }

    const fn of(self, unit: &'static str) -> Self {
        Self { unit, ..self }
    }

    fn encode(&self, snapshot: &Snapshot, encoder: &mut DescriptorEncoder) -> fmt::Result {
        let is_empty = match self.values {
            Values::Number(value) => value(snapshot).is_none(),
            Values::OfAlarms(_) => snapshot.alarms.is_empty(),
            _ => false,
        };
        if is_empty {
            return Ok(());
        }
        let unit = Unit::Other(self.unit.to_owned());
        let unit = (!self.unit.is_empty()).then_some(&unit);
        let mut metric = encoder.encode_descriptor(self.name, self.meaning, unit, self.kind)?;
        let flag = |flag: bool| ConstGauge::new(f64::from(u8::from(flag)));
        match self.values {
            Values::Count(count) => ConstCounter::new(count(snapshot)).encode(metric),
            Values::Number(value) => match value(snapshot) {
                Some(value) => ConstGauge::new(value).encode(metric),
                None => Ok(()),
            },
            Values::Flag(value) => flag(value(snapshot)).encode(metric),
            Values::Flags(label, values) => values(snapshot)
                .into_iter()
                .try_for_each(|(of, on)| flag(on).encode(metric.encode_family(&[(label, of)])?)),
            Values::OfAlarms(value) => snapshot.alarms.iter().try_for_each(|alarm| {
                let (name, severity) = (alarm.rule.name.as_str(), alarm.rule.severity.word());
                let labels = [("name", name), ("severity", severity)];
                flag(value(alarm)).encode(metric.encode_family(&labels)?)
            }),
            Values::Label(label, value) => metric.encode_info(&[(label, value)]),
            Values::Reconstruction => {
                let maps = &snapshot.maps;
                let mut buckets: Vec<(f64, u64)> =
                    RECONSTRUCTION_S.into_iter().zip(maps.within).collect();
                let below: u64 = maps.within.iter().sum();
                buckets.push((f64::INFINITY, maps.count.saturating_sub(below)));
                metric.encode_histogram::<[(&str, &str); 0]>(maps.sum_s, maps.count, &buckets, None)
            }
        }
    }
}

/// Every metric, in the order of the page.
const METRICS: [Metric; 25] = [
    Metric::new(
        "tactus_frames",
        "Frames from the rig or recording",
        Values::Count(|at| at.health.counts.acquired),
    ),
    Metric::new(
        "tactus_durable_frames",
        "Frames on disk",
        Values::Count(|at| at.health.counts.durable),
    ),
    Metric::new(
        "tactus_failed_frames",
        "Frames that failed and are not in the record",
        Values::Count(|at| at.health.counts.failed),
    ),
    Metric::new(
        "tactus_dropped_frames",
        "Frames that were late, or that the disk did not accept",
        Values::Count(|at| at.health.counts.dropped),
    ),
    Metric::new(
        "tactus_overloads",
        "Readings over range",
        Values::Count(|at| at.health.counts.overloads),
    ),
    Metric::new(
        "tactus_well",
        "1 if the daemon has no problem, and no alarm of a rule is active or cannot be evaluated; alarms that are shelved or out of service do not count",
        Values::Flag(|at| at.well),
    ),
    Metric::new(
        "tactus_simulated",
        "Whether voltages are simulated",
        Values::Flag(|at| at.health.simulated),
    ),
    Metric::new(
        "tactus_source_unverified",
        "Whether the state of the source is unknown",
        Values::Flag(|at| at.health.source == "unknown"),
    ),
    Metric::new(
        "tactus_backlog_frames",
        "Frames of the running session that are not on disk yet",
        Values::Number(|at| Some(at.health.session.as_ref()?.backlog() as f64)),
    ),
    Metric::new(
        "tactus_last_frame_age",
        "Time since the last reading of the last frame on disk",
        Values::Number(|at| Some(at.health.age?.as_secs_f64())),
    )
    .of("seconds"),
    Metric::new(
        "tactus_period",
        "Time from the start of one frame of the running session to the start of the next",
        Values::Number(|at| Some(at.health.session.as_ref()?.period.as_secs_f64())),
    )
    .of("seconds"),
    Metric::new(
        "tactus_baseline_age",
        "Age of the baseline",
        Values::Number(|at| Some(at.health.baseline.as_ref()?.1.as_secs_f64())),
    )
    .of("seconds"),
    Metric::new(
        "tactus_disk_free",
        "Bytes that may still be written to the record",
        Values::Number(|at| Some(at.health.space.free? as f64)),
    )
    .of("bytes"),
    Metric::new(
        "tactus_disk_left",
        "Time until the disk is full at the rate of the running session",
        Values::Number(|at| at.health.space.days()),
    )
    .of("days"),
    Metric::new(
        "tactus_relay_life_used",
        "Used part of the life of the relay that will be worn out first",
        Values::Number(|at| Some(at.health.relays.as_ref()?.used)),
    )
    .of("ratios"),
    Metric::new(
        "tactus_relay_life_left",
        "Measuring time until that relay reaches its rated life",
        Values::Number(|at| Some(at.health.relays.as_ref()?.left()?.as_secs_f64())),
    )
    .of("seconds"),
    Metric::new(
        "process_resident_memory",
        "Memory of the daemon",
        Values::Number(|at| Some(at.resident? as f64)),
    )
    .of("bytes"),
    Metric::new(
        "tactus_instrument_up",
        "Whether the instrument answers",
        Values::Flags("role", |at| {
            let up = at.health.rig_fault.is_none();
            let roles = at.health.instruments.iter();
            roles.map(|role| (*role, up)).collect()
        }),
    ),
    Metric::new(
        "tactus_state",
        "State of the daemon: 1 for the present one",
        Values::Flags("state", |at| {
            let on = |state| (state, at.health.state == state);
            STATES.map(on).to_vec()
        }),
    ),
    Metric::new(
        "tactus_trouble",
        "Whether the built-in alarm is active; for each one that sends notifications",
        Values::Flags("kind", |at| {
            let on = |kind| (kind, at.troubles.contains(&kind));
            built_in::notified().map(on).collect()
        }),
    ),
    Metric::new(
        "tactus_alarm_active",
        "Whether the alarm of a rule of [[alarm]] is active; it stays so while it cannot be judged",
        Values::OfAlarms(|alarm| alarm.state.active),
    ),
    Metric::new(
        "tactus_alarm_unjudged",
        "1 if the alarm of a rule cannot be evaluated: its condition may hold unnoticed. 0 while nothing is measured",
        Values::OfAlarms(|alarm| alarm.state.invalid.is_some()),
    ),
    Metric::new(
        "tactus_alarm_set_aside",
        "Whether a person has shelved the alarm or taken it out of service",
        Values::OfAlarms(Alarm::is_put_aside),
    ),
    Metric::new(
        "tactus_build",
        "Version of the daemon",
        Values::Label("version", env!("CARGO_PKG_VERSION")),
    ),
    Metric::new(
        "tactus_reconstruction",
        "Computing time of maps",
        Values::Reconstruction,
    )
    .of("seconds"),
];

impl Collector for Snapshot {
    fn encode(&self, mut encoder: DescriptorEncoder) -> fmt::Result {
        METRICS
            .iter()
            .try_for_each(|metric| metric.encode(self, &mut encoder))
    }
}

/// A metric, as the reference page shows it.
#[derive(Debug, Clone)]
pub struct MetricRow {
    /// Name on the page `/metrics`, with its unit.
    pub name: String,
    /// The type of OpenMetrics: `counter`, `gauge`, `histogram` or `info`.
    pub kind: String,
    /// Empty for a plain number.
    pub unit: &'static str,
    /// What it counts or measures.
    pub meaning: &'static str,
    /// The label of its samples; empty for a single sample.
    pub label: &'static str,
}

/// Every metric of the daemon, in the order of its page.
pub fn metrics() -> Vec<MetricRow> {
    let row = |metric: &Metric| {
        let joint = if metric.unit.is_empty() { "" } else { "_" };
        MetricRow {
            name: format!("{}{joint}{}", metric.name, metric.unit),
            kind: metric.kind.as_str().to_owned(),
            unit: metric.unit,
            meaning: metric.meaning,
            label: match metric.values {
                Values::Flags(label, _) | Values::Label(label, _) => label,
                Values::OfAlarms(_) => "name, severity",
                _ => "",
            },
        }
    };
    METRICS.iter().map(row).collect()
}
