//! Converts the daemon's data to the wire types of D-Bus.

use std::collections::BTreeMap;

use dbus::json::DiscoverLine;
use dbus::{
    BaselineDetails, BaselineReport, Discovery, GeometryDetails, PlanDetails, PlanReport,
    RelayWear, SessionDetails, SessionSummary, TestDetails, TestLine, TestReport,
};
use survey::{Baseline, Volts, printable, printable_json};

use crate::instruments::relay_wear::Wear;
use crate::instruments::rig_plan::RigPlan;
use crate::preparation::costs;
use crate::recording::stream_sink::volts;
use crate::session::controller::Recovery;
use imaging::Geometry;
use imaging::quantities::RegionSettings;
use self_test::{Report, ReportLine};
use survey::nanoseconds;

/// The plan of a frame.
pub(crate) fn plan(rig: &RigPlan) -> PlanReport {
    let counts = rig.plan.counts();
    let fraction = rig.meter.resolution;
    let planned = rig
        .plan
        .resolution(fraction, rig.meter.range, rig.meter.averages);
    let mut more = PlanDetails {
        wiring: Some(rig.plan.wiring.name.clone()),
        electrodes: Some(rig.plan.protocol.electrodes() as u64),
        extra_readings: Some(counts.extra_readings as u64),
        nplc: Some(rig.meter.nplc),
        autozero: Some(rig.meter.autozero),
        averages: Some(u64::from(rig.meter.averages)),
        channel_delay_s: Some(rig.meter.channel_delay.as_secs_f64()),
        settle_s: Some(rig.plan.settle.as_secs_f64()),
        reversal: Some(rig.plan.reversal),
        zero_every: Some(rig.zero_every.unwrap_or(0)),
        range_v: Some(rig.meter.range.0),
        planned_ranges: Some(rig.plan.has_ranges()),
        range_changes: Some(counts.range_changes as u64),
        range_time_s: Some(counts.range_changes as f64 * rig.timing.range_command.as_secs_f64()),
        noise_fixed_v: Some(planned.fixed.0),
        noise_v: Some(planned.rms.0),
        noise_median_v: Some(planned.median.0),
        skip: Some(rig.skip as u64),
        half: Some(rig.half),
        source_current_max_a: Some(rig.limits.source_current.0),
        relay_current_max_a: Some(rig.limits.relay_current.0),
        relay_voltage_max_v: Some(rig.limits.relay_voltage.0),
        ..PlanDetails::default()
    };
    for cost in costs(rig) {
        more.set_cost(cost);
    }
    PlanReport {
        steps: counts.steps as u64,
        injections: counts.injections as u64,
        readings: counts.readings as u64,
        relay_moves: counts.relay_moves as u64,
        reading_messages: counts.reading_messages as u64,
        duration_s: rig.plan.duration(&rig.timing).as_secs_f64(),
        current_a: rig.plan.current.0,
        compliance_v: rig.plan.compliance.0,
        lines: rig.plan.steps.iter().map(ToString::to_string).collect(),
        more,
    }
}

/// The measuring settings of a plan with cost and gain of each, as in `tactus plan --json`.
pub(crate) fn measuring(more: &PlanDetails) -> BTreeMap<String, serde_json::Value> {
    let of_the_rig = ["wiring", "electrodes", "extra_readings"];
    // each value is a variant: its signature and itself
    let variants = serde_json::to_value(more).ok();
    let variants = variants.as_ref().and_then(serde_json::Value::as_object);
    let keys = variants.into_iter().flatten().filter(|(key, _)| {
        !of_the_rig.contains(&key.as_str()) && !key.ends_with("_max_a") && !key.ends_with("_max_v")
    });
    keys.map(|(key, variant)| (key.clone(), variant["value"].clone()))
        .collect()
}

/// The same as text: the settings in use with their units, and the cost of each for a frame.
pub(crate) fn measuring_words(more: &PlanDetails) -> [(&'static str, Vec<String>); 2] {
    let settings = measuring(more).into_iter().filter_map(|(key, value)| {
        let unused = value == false || value.as_f64() == Some(0.0);
        if key.starts_with("cost_") || key.starts_with("gain_") || (unused && key != "autozero") {
            return None;
        }
        let (name, value) = match (key.rsplit_once('_'), value.as_f64()) {
            (Some((name, "v")), Some(volts)) => (name, format!("{:.3}", Volts(volts))),
            (Some((name, "s")), Some(seconds)) if seconds < 1.0 => {
                (name, format!("{:.1} ms", 1e3 * seconds))
            }
            (Some((name, "s")), Some(seconds)) => (name, format!("{seconds:.1} s")),
            _ => match value.as_bool() {
                Some(on) => (key.as_str(), if on { "on" } else { "off" }.to_owned()),
                None => (key.as_str(), value.to_string()),
            },
        };
        Some(format!("{} {value}", name.replace('_', " ")))
    });
    let costs = more.costs();
    let costs = costs.iter().map(ToString::to_string);
    [
        ("measuring", settings.collect()),
        ("cost in a frame", costs.collect()),
    ]
}

/// The data for drawing a map.
pub(crate) fn geometry(geometry: &Geometry, regions: &[RegionSettings]) -> dbus::Geometry {
    let mesh = &geometry.mesh;
    let flat = |points: &[[f64; 2]]| points.iter().flatten().copied().collect::<Vec<f64>>();
    let outline = mesh.outline();
    let shapes: Vec<_> = regions.iter().filter_map(RegionSettings::shape).collect();
    dbus::Geometry {
        mesh_hash: mesh.hash().to_owned(),
        nodes: flat(mesh.nodes()),
        triangles: mesh
            .region()
            .iter()
            .flat_map(|&triangle| mesh.triangles()[triangle])
            .map(|node| node as u32)
            .collect(),
        outline: outline.iter().flat_map(|points| flat(points)).collect(),
        outline_lengths: outline.iter().map(|points| points.len() as u32).collect(),
        electrodes: flat(&mesh.electrode_centres()),
        more: GeometryDetails {
            name: Some(geometry.name.clone()),
            regions: Some(serde_json::json!(shapes).to_string()),
        },
    }
}

/// A self-test.
pub(crate) fn test(report: Report) -> TestReport {
    let more = TestDetails {
        at: Some(report.at),
        wiring: Some(report.wiring),
        simulated: Some(report.simulated),
        current_a: Some(report.current_a),
        sheet_ohm: report.sheet_ohm,
        misfit: report.misfit,
        pauw_ohm: report.pauw_ohm,
        pauw_raw_ohm: report.pauw_raw_ohm,
        reciprocity: report.reciprocity,
        noise_v: report.noise_v,
        offset_v: report.offset_v,
    };
    let line = |line: ReportLine| TestLine {
        subject: line.subject,
        check: line.check.to_owned(),
        verdict: line.verdict.word().to_owned(),
        measured: line.measured.unwrap_or(f64::NAN),
        expected: line.expected.unwrap_or(f64::NAN),
        unit: line.unit.to_owned(),
        text: line.text,
    };
    TestReport {
        passed: report.passed,
        findings: report.findings,
        lines: report.lines.into_iter().map(line).collect(),
        more,
    }
}

/// The instruments found, as text or as JSON, as printed by `tactus instruments discover`.
pub(crate) fn found_lines(found: &Discovery, json: bool) -> Vec<String> {
    let mut lines = Vec::new();
    for seen in &found.seen {
        if json {
            let line = DiscoverLine::from(seen.clone());
            lines.push(printable_json(serde_json::json!(line).to_string()));
            continue;
        }
        let title = match seen.identity.as_str() {
            "" => &seen.remark,
            identity => identity,
        };
        lines.push(
            format!(
                "# {} (found by {} {})",
                printable(title),
                seen.found_by,
                printable(&seen.name)
            )
            .replace(" )", ")"),
        );
        lines.push(match seen.proposal.as_str() {
            "" => format!("# {} {}", printable(&seen.address), printable(&seen.remark)),
            proposal => proposal.to_owned(),
        });
    }
    for note in &found.notes {
        let text = note.clone();
        lines.push(match json {
            true => printable_json(serde_json::json!(DiscoverLine::Note { text }).to_string()),
            false => format!("# note: {}", printable(note)),
        });
    }
    if lines.is_empty() {
        lines.extend((!json).then(|| {
            "# no instrument was found; a 6221 does not announce itself: query it with tactusd --discover tcp:HOST:1394".to_owned()
        }));
    }
    lines
}

/// The wear of one relay.
pub(crate) fn wear(wear: Wear) -> RelayWear {
    RelayWear {
        relay: wear.relay.0,
        purpose: wear.purpose,
        cycles: wear.cycles,
        rated: wear.rated.unwrap_or(0),
        used: wear.used.unwrap_or(f64::NAN),
        left_s: wear.left.map_or(f64::NAN, |left| left.as_secs_f64()),
    }
}

/// A baseline, with remarks for the operator before it is used, and the summary of its tracking.
pub(crate) fn baseline(
    baseline: &Baseline,
    remarks: Vec<String>,
    tracked: Option<String>,
) -> BaselineReport {
    let settings = &baseline.settings;
    BaselineReport {
        id: baseline.id.clone(),
        wall_ns: nanoseconds(baseline.wall),
        frames: baseline.frames as u64,
        volts: volts(&baseline.readings),
        flags: baseline
            .readings
            .iter()
            .map(|reading| reading.flag())
            .collect(),
        deviation: baseline
            .deviation
            .iter()
            .map(|deviation| deviation.unwrap_or(f64::NAN))
            .collect(),
        simulated: baseline.simulated,
        more: BaselineDetails {
            current_a: Some(settings.current.0),
            range_v: Some(settings.range.0),
            nplc: Some(settings.nplc),
            settle_s: Some(settings.settle.as_secs_f64()),
            wiring: Some(settings.wiring.clone()),
            protocol_hash: Some(settings.protocol_hash.clone()),
            remarks: Some(remarks),
            tracked,
        },
    }
}

/// A session of the logbook; `active` is the id of the running one.
pub(crate) fn session(summary: &logbook::SessionSummary, active: Option<&str>) -> SessionSummary {
    let state = match &summary.closed {
        Some(_) => "closed",
        None if active == Some(summary.id.as_str()) => "open",
        None => "interrupted",
    };
    let ended = summary.closed.as_ref();
    SessionSummary {
        id: without_nul(&summary.id),
        kind: summary.kind.as_str().to_owned(),
        state: state.to_owned(),
        started_ns: nanoseconds(summary.started),
        frames: summary.frames,
        simulated: summary.simulated,
        path: summary.path.display().to_string(),
        more: SessionDetails {
            note: Some(without_nul(&summary.note)),
            reason: ended.map(|closing| without_nul(&closing.reason)),
            ended_ns: ended.map(|closing| nanoseconds(closing.at)),
        },
    }
}

/// Text of a session's file, which may come from any writer: D-Bus carries every character but NUL, and one message
/// that contains it ends the connection.
fn without_nul(text: &str) -> String {
    text.replace('\0', "\\0")
}

/// The reconnection of a lost rig.
pub(crate) fn recovery(recovery: Option<&Recovery>) -> dbus::Recovery {
    let Some(recovery) = recovery else {
        return dbus::Recovery::default();
    };
    let now = tokio::time::Instant::now();
    dbus::Recovery {
        what: Some(recovery.what.clone()),
        tries: Some(recovery.tries),
        since_ns: Some(nanoseconds(recovery.since)),
        person: Some(recovery.person),
        next_s: recovery
            .next
            .map(|next| next.saturating_duration_since(now).as_secs_f64()),
    }
}
