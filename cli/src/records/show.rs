//! `tactus sessions show`: the conditions under which a session was taken.

use std::io::Write;

use chrono::{DateTime, Utc};
use imaging::noise::rms_deviation;
use imaging::recorded::SessionParts;
use logbook::{About, InstrumentRecord, LogbookError};
use serde::Serialize;
use survey::{Amps, Baseline, Settings, printable};

use crate::args::Global;
use crate::failure::{Failure, chain};
use crate::maps::session_settings;
use crate::output::Printer;
use crate::output::time::{local, utc};
use crate::session_files;

/// The line of `sessions show --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct SessionDetails {
    id: String,
    kind: &'static str,
    simulated: bool,
    started: DateTime<Utc>,
    ended: Option<DateTime<Utc>>,
    reason: Option<String>,
    last_frame: Option<DateTime<Utc>>,
    duration_s: Option<f64>,
    frames: u64,
    bytes: u64,
    parts: Vec<String>,
    electrodes: usize,
    readings: usize,
    settings: Option<Measured>,
    method: Option<String>,
    model_hash: Option<String>,
    calibration: Option<String>,
    baseline: Option<BaselineDetails>,
    about: About,
    note: String,
    instruments: Vec<InstrumentRecord>,
    modules: Vec<String>,
    geometry_hash: Option<String>,
    config_hash: String,
    build: String,
    unread: Unread,
}

/// Why parts of the session cannot be read; the fields from these parts are `None`.
#[derive(Debug, Serialize)]
struct Unread {
    configuration: Option<String>,
    last_frame: Option<String>,
}

/// The settings with which the frames were taken.
#[derive(Debug, Serialize)]
struct Measured {
    current_a: f64,
    range_v: f64,
    planned_ranges: bool,
    nplc: f64,
    settle_s: f64,
    averages: u32,
    autozero: bool,
    reversal: bool,
    wiring: String,
}

#[derive(Debug, Serialize)]
struct BaselineDetails {
    id: String,
    frames: usize,
    taken: DateTime<Utc>,
    noise_v: Option<f64>,
}

impl From<&Settings> for Measured {
    fn from(settings: &Settings) -> Self {
        let precautions = &settings.precautions;
        Self {
            current_a: settings.current.0,
            range_v: settings.range.0,
            planned_ranges: precautions.planned_ranges,
            nplc: settings.nplc,
            settle_s: settings.settle.as_secs_f64(),
            averages: precautions.averages,
            autozero: precautions.autozero,
            reversal: precautions.reversal,
            wiring: settings.wiring.clone(),
        }
    }
}

impl From<&Baseline> for BaselineDetails {
    fn from(baseline: &Baseline) -> Self {
        Self {
            id: baseline.id.clone(),
            frames: baseline.frames,
            taken: baseline.wall,
            noise_v: rms_deviation(baseline),
        }
    }
}

/// Reads header, first and last frame, baseline and sizes; no other frame is read.
pub(crate) fn run(
    global: &Global,
    named: &str,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let session = SessionParts::open(&session_files::session_file(global, named)?)?;
    let details = details(&session)?;
    printer.record(&details, page)
}

/// The entries that `sessions show` prints about a session, a name and a text each.
pub(crate) fn entries(session: &SessionParts) -> Result<Vec<(String, String)>, Failure> {
    Ok(lines(&details(session)?))
}

fn details(session: &SessionParts) -> Result<SessionDetails, Failure> {
    let header = session.header();
    let last_part = session.each().last().unwrap_or(&session.each()[0]);
    let (last, last_unread) = match session.last() {
        Ok(last) => (last, None),
        Err(error @ LogbookError::Damaged { .. }) => (None, Some(chain(&error))),
        Err(other) => return Err(other.into()),
    };
    let baseline = session.baseline()?;
    let closed = last_part.closed();
    let (kept, config_unread) = match session_settings::read_config(header) {
        Ok(kept) => (Some(kept), None),
        Err(error) => (None, Some(chain(&error))),
    };
    let settings = last
        .as_ref()
        .map(|record| &record.frame.settings)
        .or(baseline
            .as_ref()
            .filter(|_| last_unread.is_none())
            .map(|baseline| &baseline.settings));
    let span = last
        .as_ref()
        .map(|record| (record.frame.wall - header.started).as_seconds_f64());
    Ok(SessionDetails {
        id: header.id.clone(),
        kind: header.kind.as_str(),
        simulated: header.simulated,
        started: header.started,
        ended: closed.map(|closing| closing.at),
        reason: closed.map(|closing| closing.reason.clone()),
        last_frame: last.as_ref().map(|record| record.frame.wall),
        duration_s: closed
            .map(|closing| (closing.at - header.started).as_seconds_f64())
            .or(span),
        frames: session.len()?,
        bytes: session
            .each()
            .iter()
            .filter_map(|part| Some(std::fs::metadata(part.path()).ok()?.len()))
            .sum(),
        parts: session
            .each()
            .iter()
            .map(|part| part.path().display().to_string())
            .collect(),
        electrodes: header.protocol.electrodes(),
        readings: header.protocol.len(),
        settings: settings.map(Measured::from),
        method: last
            .as_ref()
            .and_then(|record| record.map.as_ref())
            .map(|map| map.method.clone())
            .or(kept
                .as_ref()
                .filter(|_| !header.config_toml.is_empty() && header.model_hash.is_none())
                .map(|kept| kept.model.method.unwrap_or_default().name().to_owned())),
        model_hash: header.model_hash.clone(),
        calibration: kept
            .and_then(|kept| kept.model.calibration)
            .map(|path| path.display().to_string()),
        baseline: baseline.as_ref().map(BaselineDetails::from),
        about: header.about.clone(),
        note: header.note.clone(),
        instruments: header.instruments.clone(),
        modules: header.modules.clone(),
        geometry_hash: header.geometry_hash.clone(),
        config_hash: header.config_hash.clone(),
        build: header.build.clone(),
        unread: Unread {
            configuration: config_unread,
            last_frame: last_unread,
        },
    })
}

/// One entry per line.
fn page(shown: &SessionDetails) -> String {
    let lines = lines(shown);
    let width = lines.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    let lines: Vec<String> = lines
        .iter()
        .map(|(name, text)| format!("{:width$}  {}", printable(name), printable(text)))
        .collect();
    lines.join("\n")
}

/// Text in place of a value of the configuration.
const CONFIG_UNREAD: &str = "not known: the stored configuration cannot be read";
/// Text in place of a value of the last frame.
const FRAME_UNREAD: &str = "not known: the last frame cannot be read";

/// Names and texts. Unknown values are left out, unless it matters that they are unknown.
fn lines(shown: &SessionDetails) -> Vec<(String, String)> {
    let mut lines: Vec<(String, String)> = Vec::new();
    let mut push = |name: &str, text: String| {
        if !text.is_empty() {
            lines.push((name.to_owned(), text));
        }
    };
    let simulated = if shown.simulated { " (SIMULATED)" } else { "" };
    push(
        "session",
        format!("{}, {}{simulated}", shown.id, shown.kind),
    );
    push("started", local(shown.started));
    push(
        "ended",
        match (shown.ended, &shown.reason) {
            (Some(ended), Some(reason)) => format!("{}, {reason}", local(ended)),
            _ => "not yet, or its daemon was killed".to_owned(),
        },
    );
    if let Some(seconds) = shown.duration_s {
        let whole = std::time::Duration::from_secs(seconds.max(0.0).round() as u64);
        push("duration", humantime::format_duration(whole).to_string());
    }
    push(
        "size",
        format!(
            "{} frames of {} readings, {} electrodes; {:.3} MB in {} file{}",
            shown.frames,
            shown.readings,
            shown.electrodes,
            shown.bytes as f64 * 1e-6,
            shown.parts.len(),
            if shown.parts.len() == 1 { "" } else { "s" },
        ),
    );
    if let Some(why) = &shown.unread.last_frame {
        push("settings", format!("{FRAME_UNREAD}: {why}"));
    }
    if let Some(taken) = &shown.settings {
        push(
            "settings",
            format!(
                "{}, {}{} V, {} PLC, settling {} ms, averages {}, autozero {}, reversal {}, wiring {}",
                Amps(taken.current_a),
                if taken.planned_ranges {
                    "ranges up to "
                } else {
                    "range "
                },
                taken.range_v,
                taken.nplc,
                1e3 * taken.settle_s,
                taken.averages,
                on_off(taken.autozero),
                on_off(taken.reversal),
                taken.wiring,
            ),
        );
    }
    push(
        "method",
        match (&shown.method, &shown.model_hash) {
            (Some(method), _) => method.clone(),
            (None, Some(hash)) => format!("model {}", imaging::short_hash(hash)),
            (None, None) if shown.unread.configuration.is_some() => CONFIG_UNREAD.to_owned(),
            (None, None) if shown.unread.last_frame.is_some() => FRAME_UNREAD.to_owned(),
            (None, None) => "none recorded".to_owned(),
        },
    );
    push(
        "calibration",
        match (&shown.calibration, &shown.unread.configuration) {
            (Some(file), _) => file.clone(),
            (None, Some(why)) => format!("{CONFIG_UNREAD}: {why}"),
            (None, None) => "none: maps are in relative loss of conductance".to_owned(),
        },
    );
    push(
        "baseline",
        match &shown.baseline {
            None => "none".to_owned(),
            Some(baseline) => {
                let noise = baseline.noise_v.map_or(String::new(), |volts| {
                    format!(", noise of a reading {:.2} uV", 1e6 * volts)
                });
                format!(
                    "{}, {} frames, {}{noise}",
                    baseline.id,
                    baseline.frames,
                    utc(baseline.taken)
                )
            }
        },
    );
    for (name, words) in shown.about.entries() {
        let name = match name {
            "calibration" => "instruments' calibration",
            "wiring" => "wiring of the sheet",
            name => name,
        };
        push(name, words.to_owned());
    }
    push("note", shown.note.clone());
    for instrument in &shown.instruments {
        push(
            &instrument.role,
            format!("{} at {}", instrument.identity, instrument.address),
        );
    }
    push("modules", shown.modules.join("; "));
    push("program", shown.build.clone());
    for part in &shown.parts {
        push("file", part.clone());
    }
    lines
}

fn on_off(set: bool) -> &'static str {
    if set { "on" } else { "off" }
}
