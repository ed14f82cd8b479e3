//! The lines of `tactus watch`: as JSON, and in words.

use chrono::{DateTime, Local};
use imaging::Tracked;
use imaging::quantities::FrameQuantities;
use imaging::tracking::AfterInjection;
use serde::Serialize;
use survey::MapQuality;

use crate::maps::drawing;

/// A line of `watch --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub(crate) enum WatchLine {
    /// A frame with its map's results.
    Frame(Box<FrameLine>),
    /// The load after an injection.
    Injection(Box<InjectionLine>),
    /// The standard deviation of a map.
    Deviation(Box<DeviationLine>),
    /// The session has ended.
    Ended { session: String, reason: String },
}

#[derive(Debug, Serialize)]
pub(crate) struct FrameLine {
    pub(crate) session: String,
    pub(crate) sequence: u64,
    pub(crate) wall: String,
    pub(crate) simulated: bool,
    /// Number of records lost just before this one, because this client was too slow.
    pub(crate) gap: u64,
    pub(crate) readings: usize,
    pub(crate) overloads: usize,
    pub(crate) not_measured: usize,
    /// `None` without a map.
    pub(crate) method: Option<String>,
    pub(crate) largest_loss: Option<f64>,
    /// Whether `largest_loss` is above `noise`; `None` if the noise is unknown.
    pub(crate) significant: Option<bool>,
    /// The largest loss due to noise alone.
    pub(crate) noise: Option<f64>,
    pub(crate) found_mm: Option<[f64; 2]>,
    /// Unit of the displayed map; `None` without a map.
    pub(crate) unit: Option<&'static str>,
    /// Force on the sheet; present with a calibration.
    pub(crate) newtons: Option<f64>,
    pub(crate) largest_kpa: Option<f64>,
    pub(crate) quality: Option<MapQuality>,
    /// Result of the tracked baseline; `None` if the baseline is not tracked.
    pub(crate) tracked: Option<Tracked>,
    /// `None` without a map.
    pub(crate) quantities: Option<FrameQuantities>,
}

#[derive(Debug, Serialize)]
pub(crate) struct InjectionLine {
    pub(crate) session: String,
    /// The frame that is being measured.
    pub(crate) frame: u64,
    pub(crate) wall: String,
    pub(crate) simulated: bool,
    /// Number of records lost just before this one, because this client was too slow.
    pub(crate) gap: u64,
    pub(crate) after: AfterInjection,
}

#[derive(Debug, Serialize)]
pub(crate) struct DeviationLine {
    pub(crate) session: String,
    pub(crate) sequence: u64,
    pub(crate) wall: String,
    pub(crate) simulated: bool,
    /// Number of records lost just before this one, because this client was too slow.
    pub(crate) gap: u64,
    pub(crate) mesh_hash: String,
    /// Standard deviation of the change of ln conductance for each triangle of the region; `None` if the frame gives no
    /// information about it.
    pub(crate) deviations: Vec<Option<f64>>,
}

/// A line about records that this reader lost.
fn missed(records: u64) -> String {
    match records {
        0 => String::new(),
        _ => format!("-- {records} records were not shown: this reader is too slow --\n"),
    }
}

/// The line as text.
pub(crate) fn sentence(line: &WatchLine, wall: DateTime<chrono::Utc>) -> String {
    match line {
        WatchLine::Ended { session, reason } => format!("{session} ended: {reason}"),
        WatchLine::Injection(seen) => {
            let [plus, minus] = seen.after.electrodes;
            format!(
                "{}{} frame {}, after {plus}-{minus}  {}  {}{}",
                missed(seen.gap),
                seen.session,
                seen.frame,
                wall.with_timezone(&Local).format("%H:%M:%S%.3f%:z"),
                seen.after,
                if seen.simulated { "  SIMULATED" } else { "" }
            )
        }
        WatchLine::Deviation(seen) => {
            let mut known: Vec<f64> = seen.deviations.iter().copied().flatten().collect();
            known.sort_by(f64::total_cmp);
            let mut text = format!(
                "{}{} frame {}, standard deviation of ln conductance: ",
                missed(seen.gap),
                seen.session,
                seen.sequence
            );
            match known.get(known.len() / 2) {
                Some(median) => text.push_str(&format!(
                    "median {median:.3} over {:.0} % of the triangles, not known for the others",
                    100.0 * known.len() as f64 / seen.deviations.len() as f64
                )),
                None => text.push_str("not known for any triangle"),
            }
            if seen.simulated {
                text.push_str("  SIMULATED");
            }
            text
        }
        WatchLine::Frame(seen) => {
            let mut text = missed(seen.gap);
            text.push_str(&format!(
                "{} frame {}  {}",
                seen.session,
                seen.sequence,
                wall.with_timezone(&Local).format("%H:%M:%S%.3f%:z")
            ));
            match seen.largest_loss {
                Some(loss) => {
                    match seen.significant {
                        Some(false) => text.push_str("  "),
                        _ => text.push_str(&format!("  found {}  ", drawing::place(seen.found_mm))),
                    }
                    text.push_str(&drawing::map_summary(
                        loss,
                        seen.newtons.zip(seen.largest_kpa),
                        seen.noise,
                    ));
                }
                None => text.push_str("  no map"),
            }
            if let Some(quality) = seen.quality.as_ref().filter(|quality| !quality.is_silent()) {
                text.push_str(&format!("  {quality}"));
            }
            if let Some(tracked) = &seen.tracked {
                text.push_str(&format!("  {tracked}"));
            }
            if let Some(summary) = seen.quantities.as_ref().and_then(FrameQuantities::summary) {
                text.push_str(&format!("  {summary}"));
            }
            for (count, what) in [
                (seen.overloads, "overloads"),
                (seen.not_measured, "not measured"),
            ] {
                if count > 0 {
                    text.push_str(&format!("  {count} {what}"));
                }
            }
            if seen.simulated {
                text.push_str("  SIMULATED");
            }
            text
        }
    }
}
