//! What the daemon knows, in the plain types of the bus.

use std::collections::BTreeMap;

use dbus::{
    BaselineReport, Options, PlanReport, RelayWear, SeenInstrument, SessionSummary, TestLine,
    TestReport,
};
use survey::{Baseline, printable, printable_json};

use crate::instruments::discovery::{Discovered, Seen};
use crate::instruments::relay_wear::Wear;
use crate::instruments::rig_plan::RigPlan;
use crate::preparation::{costs, resolution};
use crate::recording::recorder::volts;
use crate::session::controller::Recovery;
use imaging::Geometry;
use self_test::{Report, ReportLine};
use survey::nanoseconds;

/// The plan of a frame.
pub(crate) fn plan(rig: &RigPlan) -> PlanReport {
    let counts = rig.plan.counts();
    let fraction = resolution(rig.meter.nplc);
    let planned = rig
        .plan
        .resolution(fraction, rig.meter.range, rig.meter.averages);
    let both_ways = if rig.plan.reversal { 2.0 } else { 1.0 };
    let readings = f64::from(rig.meter.averages) * both_ways;
    let fixed = fraction * rig.meter.range.0 / readings.sqrt();
    let more = Options::new()
        .with("wiring", rig.plan.wiring.name.as_str())
        .with("electrodes", rig.plan.protocol.electrodes() as u64)
        .with("extra_readings", counts.extra_readings as u64)
        .with("nplc", rig.meter.nplc)
        .with("autozero", rig.meter.autozero)
        .with("averages", u64::from(rig.meter.averages))
        .with("channel_delay_s", rig.meter.channel_delay.as_secs_f64())
        .with("settle_s", rig.plan.settle.as_secs_f64())
        .with("reversal", rig.plan.reversal)
        .with("zero_every", rig.zero_every.unwrap_or(0))
        .with("range_v", rig.meter.range.0)
        .with("planned_ranges", rig.plan.has_ranges())
        .with("range_changes", counts.range_changes as u64)
        .with(
            "range_time_s",
            counts.range_changes as f64 * rig.timing.range_command.as_secs_f64(),
        )
        .with("noise_fixed_v", fixed)
        .with("noise_v", planned.rms.0)
        .with("noise_median_v", planned.median.0)
        .with("skip", rig.skip as u64)
        .with("half", rig.half)
        .with("source_current_max_a", rig.limits.source_current.0)
        .with("relay_current_max_a", rig.limits.relay_current.0)
        .with("relay_voltage_max_v", rig.limits.relay_voltage.0);
    let more = costs(rig).into_iter().fold(more, |more, cost| {
        more.with(&format!("cost_{}_s", cost.setting), cost.seconds)
            .with(&format!("gain_{}", cost.setting), cost.gain)
    });
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

/// How each reading of a plan is taken, what each setting costs and gains, as `tactus plan --json` names them.
pub(crate) fn measuring(more: &Options) -> BTreeMap<String, serde_json::Value> {
    let of_the_rig = ["wiring", "electrodes", "extra_readings"];
    let keys = more.0.keys().filter(|key| {
        !of_the_rig.contains(&key.as_str()) && !key.ends_with("_max_a") && !key.ends_with("_max_v")
    });
    keys.filter_map(|key| {
        let whole = || Some(more.whole(key).ok()??.into());
        let flag = || Some(more.flag(key).ok()??.into());
        let number = || Some(more.number(key).ok()??.into());
        let value: serde_json::Value = flag().or_else(whole).or_else(number)?;
        Some((key.clone(), value))
    })
    .collect()
}

/// What is needed to draw a map.
pub(crate) fn geometry(geometry: &Geometry) -> dbus::Geometry {
    let mesh = &geometry.mesh;
    let flat = |points: &[[f64; 2]]| points.iter().flatten().copied().collect::<Vec<f64>>();
    let outline = mesh.outline();
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
        more: geometry_name(geometry),
    }
}

/// What a person calls the geometry.
pub(crate) fn geometry_name(geometry: &Geometry) -> Options {
    Options::new().with("name", geometry.name.as_str())
}

/// A self-test.
pub(crate) fn test(report: Report) -> TestReport {
    let more = Options::new()
        .with("at", report.at)
        .with("wiring", report.wiring)
        .with("simulated", report.simulated)
        .with("current_a", report.current_a)
        .with_some("sheet_ohm", report.sheet_ohm)
        .with_some("misfit", report.misfit)
        .with_some("pauw_ohm", report.pauw_ohm)
        .with_some("pauw_raw_ohm", report.pauw_raw_ohm)
        .with_some("reciprocity", report.reciprocity)
        .with_some("noise_v", report.noise_v)
        .with_some("offset_v", report.offset_v);
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

/// An instrument that is there.
pub(crate) fn seen(seen: Seen) -> SeenInstrument {
    SeenInstrument {
        address: seen.address,
        identity: seen.identity,
        found_by: seen.found_by,
        name: seen.name,
        in_use: seen.in_use,
        proposal: seen.proposal,
        remark: seen.remark,
    }
}

/// What was found, for a person or as JSON, as `tactus instruments discover` prints it.
pub(crate) fn found_lines(found: &Discovered, json: bool) -> Vec<String> {
    let some = |text: &str| Some(text.to_owned()).filter(|text| !text.is_empty());
    let mut lines = Vec::new();
    for seen in &found.seen {
        if json {
            let object = serde_json::json!({
                "event": "instrument",
                "address": some(&seen.address),
                "identity": some(&seen.identity),
                "found_by": seen.found_by,
                "name": some(&seen.name),
                "in_use": seen.in_use,
                "proposal": some(&seen.proposal),
                "remark": some(&seen.remark),
            });
            lines.push(printable_json(object.to_string()));
            continue;
        }
        let said = some(&seen.identity).unwrap_or_else(|| seen.remark.clone());
        lines.push(
            format!(
                "# {} (found by {} {})",
                printable(&said),
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
        lines.push(match json {
            true => printable_json(serde_json::json!({"event": "note", "text": note}).to_string()),
            false => format!("# note: {}", printable(note)),
        });
    }
    if lines.is_empty() {
        lines.extend((!json).then(|| {
            "# no instrument was found; a 6221 announces nothing: tactusd --discover tcp:HOST:1394 asks it".to_owned()
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

/// A baseline.
pub(crate) fn baseline(baseline: &Baseline) -> BaselineReport {
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
        more: Options::new()
            .with("current_a", settings.current.0)
            .with("range_v", settings.range.0)
            .with("nplc", settings.nplc)
            .with("settle_s", settings.settle.as_secs_f64())
            .with("wiring", settings.wiring.as_str())
            .with("protocol_hash", settings.protocol_hash.as_str()),
    }
}

/// A session of the logbook; `active` is the id of the one that runs.
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
        more: Options::new()
            .with("note", without_nul(&summary.note))
            .with_some("reason", ended.map(|closing| without_nul(&closing.reason)))
            .with_some("ended_ns", ended.map(|closing| nanoseconds(closing.at))),
    }
}

/// Text of a session's file, which anybody may have written: the bus carries any character but this one, and one message
/// that has it ends the connection.
fn without_nul(text: &str) -> String {
    text.replace('\0', "\\0")
}

/// A lost rig that is being looked for.
pub(crate) fn recovery(recovery: Option<&Recovery>) -> Options {
    let Some(recovery) = recovery else {
        return Options::new();
    };
    let now = tokio::time::Instant::now();
    let next = recovery
        .next
        .map(|next| next.saturating_duration_since(now).as_secs_f64());
    Options::new()
        .with("what", recovery.what.as_str())
        .with("tries", recovery.tries)
        .with("since_ns", nanoseconds(recovery.since))
        .with("person", recovery.person)
        .with_some("next_s", next)
}
