//! `tactus baseline`: records the unloaded sheet, and shows the present baseline.

use std::io::Write;

use chrono::{DateTime, SecondsFormat};
use dbus::{BaselineReport, SessionOptions};
use imaging::tracking::{DriftSummary, TrackingOrder, TrackingSummary};
use serde::Serialize;
use serde_json::json;
use survey::{Amps, Volts};

use crate::args::BaselineRecord;
use crate::connection::Daemon;
use crate::control::session;
use crate::failure::Failure;
use crate::output::Printer;
use crate::output::time::local;

/// The last line of a recording without a warning.
const NO_REMARK: &str = "no warning; if a load was on the sheet during the recording, no map shows it until a new baseline is recorded";

/// The line of `baseline show --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct BaselineLine {
    id: String,
    wall: String,
    frames: u64,
    readings: usize,
    missing: usize,
    /// Root mean square of the valid readings, V.
    rms_v: Option<f64>,
    /// Root mean square over the readings of their standard deviations, V.
    noise_v: Option<f64>,
    simulated: bool,
    current_a: Option<f64>,
    range_v: Option<f64>,
    nplc: Option<f64>,
    settle_s: Option<f64>,
    wiring: Option<String>,
    protocol_hash: Option<String>,
    /// V, in the protocol's order; null for invalid readings.
    volts: Vec<Option<f64>>,
    /// 0 ok, 1 overload, 3 not measured.
    flags: Vec<u8>,
    /// Warnings about its use.
    remarks: Vec<String>,
    /// Summary of the tracked baseline; `None` if it was not tracked.
    tracked: Option<TrackingSummary>,
}

/// Records a baseline and waits until it is complete, unless `--no-wait` is given.
pub(crate) async fn record(
    daemon: &Daemon,
    record: &BaselineRecord,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let options = SessionOptions {
        frames: Some(u64::from(record.frames)),
        note: record.note.clone(),
        ..SessionOptions::default()
    };
    let options = record.about.with(record.measuring.with(options));
    let path = daemon
        .ask("baseline", daemon.manager.record_baseline(&options))
        .await?;
    let session = daemon.session(path.into()).await?;
    session::announce(daemon, &session, printer).await?;
    if record.no_wait {
        return printer.text("`tactus status` shows when it is done");
    }
    session::follow(
        daemon,
        &session,
        Some(u64::from(record.frames)),
        record.within,
        printer,
    )
    .await?;
    let (id, report) = daemon
        .ask("the baseline", async {
            Ok((session.id().await?, daemon.manager.baseline().await?))
        })
        .await?;
    // an aborted recording does not become the baseline
    if report.id != id {
        return Ok(());
    }
    let remarks = report.more.remarks.unwrap_or_default();
    if remarks.is_empty() {
        return printer.text(NO_REMARK);
    }
    remarks
        .into_iter()
        .try_for_each(|text| session::warn(&id, text, printer))
}

/// Makes an earlier baseline the current one.
pub(crate) async fn choose(
    daemon: &Daemon,
    id: &str,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let id = daemon.baseline_id(id).await?;
    let requested = daemon.manager.use_baseline(&id);
    let id = daemon.ask("the baseline", requested).await?;
    // the line of `baseline use --json`; see `docs/reference/json.md`
    printer.record(&json!({ "baseline": id }), |_| {
        format!("baseline {id} is the current one")
    })?;
    session::warn_of(daemon, &id, &id, printer).await
}

/// Gives an order to the tracked baseline of the running session.
pub(crate) async fn order(
    daemon: &Daemon,
    order: TrackingOrder,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let requested = daemon.manager.override_tracking(order.name());
    let from_frame = daemon.ask("the tracked baseline", requested).await?;
    let order = order.name();
    // the line of `baseline empty-now --json` and similar commands; see `docs/reference/json.md`
    let ordered = json!({ "order": order, "from_frame": from_frame });
    printer.record(&ordered, |_| format!("{order}, from frame {from_frame} on"))
}

/// Shows the baseline that the next session will use.
pub(crate) async fn show(
    daemon: &Daemon,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let report = daemon
        .ask("the baseline", daemon.manager.baseline())
        .await?;
    let (shown, wall) = from_report(report);
    printer.record(&shown, |shown| for_a_person(shown, wall))
}

fn from_report(report: BaselineReport) -> (BaselineLine, DateTime<chrono::Utc>) {
    let wall = DateTime::from_timestamp_nanos(report.wall_ns);
    let volts: Vec<Option<f64>> = report
        .volts
        .iter()
        .zip(&report.flags)
        .map(|(&volts, &flag)| Some(volts).filter(|volts| flag == 0 && volts.is_finite()))
        .collect();
    let shown = BaselineLine {
        id: report.id,
        wall: wall.to_rfc3339_opts(SecondsFormat::Nanos, true),
        frames: report.frames,
        readings: volts.len(),
        missing: volts.iter().filter(|volts| volts.is_none()).count(),
        rms_v: rms(volts.iter().flatten().copied()),
        noise_v: rms(report
            .deviation
            .iter()
            .copied()
            .filter(|deviation| deviation.is_finite())),
        simulated: report.simulated,
        current_a: report.more.current_a,
        range_v: report.more.range_v,
        nplc: report.more.nplc,
        settle_s: report.more.settle_s,
        wiring: report.more.wiring,
        protocol_hash: report.more.protocol_hash,
        volts,
        flags: report.flags,
        remarks: report.more.remarks.unwrap_or_default(),
        // a newer daemon may use another format
        tracked: report
            .more
            .tracked
            .and_then(|json| serde_json::from_str(&json).ok()),
    };
    (shown, wall)
}

fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, squares) = values.fold((0_usize, 0.0), |(count, squares), value| {
        (count + 1, squares + value * value)
    });
    (count > 0).then(|| (squares / count as f64).sqrt())
}

fn for_a_person(shown: &BaselineLine, wall: DateTime<chrono::Utc>) -> String {
    let mut text = format!(
        "baseline   {}{}\n\
         recorded   {}, mean of {} frames\n\
         readings   {}, {} of them missing",
        shown.id,
        if shown.simulated { "  (SIMULATED)" } else { "" },
        local(wall),
        shown.frames,
        shown.readings,
        shown.missing,
    );
    if let Some(rms) = shown.rms_v {
        text.push_str(&format!("\nrms        {:.4}", Volts(rms)));
    }
    if let Some(noise) = shown.noise_v {
        text.push_str(&format!(
            "\nnoise      {:.3} (one reading, from frame to frame)",
            Volts(noise)
        ));
    }
    if let Some(current) = shown.current_a {
        text.push_str(&format!("\ncurrent    {}", Amps(current)));
    }
    if let Some(wiring) = &shown.wiring {
        text.push_str(&format!("\nwiring     {wiring}"));
    }
    if let Some(tracked) = &shown.tracked {
        text.push_str(&format!(
            "\ntracked    since {}, until {} (frame {} of {}); last empty {}\n\
             drift      {:.3} since the baseline (rms), standard deviation {:.3}, {} times the built-in rate",
            local(tracked.since),
            local(tracked.until),
            tracked.sequence,
            tracked.session,
            local(tracked.empty),
            Volts(1e-6 * tracked.change_uv),
            Volts(1e-6 * tracked.baseline_sd_uv),
            tracked.pace,
        ));
        if let Some(drift) = &tracked.drift {
            text.push_str(&by_kind(drift));
        }
        if !tracked.masked.is_empty() {
            text.push_str(&format!("\nleft out   electrodes {:?}", tracked.masked));
        }
    }
    for remark in &shown.remarks {
        text.push_str(&format!("\nwarning    {remark}"));
    }
    text
}

/// The drift by kind, one line each.
fn by_kind(drift: &DriftSummary) -> String {
    let volts = |uv: f64| Volts(1e-6 * uv);
    let [x, y] = drift.local_at_mm;
    format!(
        "\n  gain     {:+.2} % ({:.3})\n  \
         contacts {:.1} % rms, largest {:+.1} % at electrode {} ({:.3})\n  \
         field    {:.2} % rms ({:.3})\n  \
         local    largest {:+.2} % at ({x:.0}, {y:.0}) mm ({:.3})",
        drift.gain_percent,
        volts(drift.gain_uv),
        drift.contacts_percent,
        drift.most_changed_percent,
        drift.most_changed_electrode,
        volts(drift.contacts_uv),
        drift.field_percent,
        volts(drift.field_uv),
        drift.local_percent,
        volts(drift.local_uv),
    )
}

#[cfg(test)]
mod tests {
    use crate::control::baseline::*;

    #[test]
    fn a_missing_reading_is_null_and_never_a_number() {
        let (shown, wall) = from_report(BaselineReport {
            id: "b1".into(),
            wall_ns: 1_500_000_000,
            frames: 10,
            volts: vec![-0.3, f64::NAN, 9.9e37],
            flags: vec![0, 1, 1],
            deviation: vec![2e-6, f64::NAN, f64::NAN],
            simulated: true,
            more: dbus::BaselineDetails {
                current_a: Some(1e-3),
                wiring: Some("w".into()),
                remarks: Some(vec!["the noise".into()]),
                ..dbus::BaselineDetails::default()
            },
        });
        assert_eq!(
            serde_json::to_string(&shown).unwrap(),
            "{\"id\":\"b1\",\"wall\":\"1970-01-01T00:00:01.500000000Z\",\"frames\":10,\"readings\":3,\"missing\":2,\
             \"rms_v\":0.3,\"noise_v\":2e-6,\"simulated\":true,\"current_a\":0.001,\"range_v\":null,\"nplc\":null,\
             \"settle_s\":null,\"wiring\":\"w\",\"protocol_hash\":null,\"volts\":[-0.3,null,null],\"flags\":[0,1,1],\"remarks\":[\"the noise\"],\"tracked\":null}"
        );
        let text = for_a_person(&shown, wall);
        assert!(
            text.contains("SIMULATED") && text.contains("2 uV"),
            "{text}"
        );
        assert!(text.contains("\nwarning    the noise"), "{text}");
    }
}
