use serde::Serialize;

use super::utc_of_ns;

/// The daemon's health: `health` of `tactus status --json`.
#[derive(Debug, Default, Serialize)]
pub struct Health {
    /// Whether there is no problem.
    pub well: bool,
    /// The problems, most severe first.
    pub troubles: Vec<ActiveAlarm>,
    /// The last frame since the daemon started.
    pub last_frame: Option<LastFrame>,
    /// Time from the start of one frame to the start of the next, s.
    pub period_s: Option<f64>,
    /// Frames waiting to be written to disk.
    pub backlog: Option<u64>,
    /// Frames that are not in the record.
    pub gaps: Gaps,
    /// The instruments by their roles.
    pub instruments: Vec<InstrumentState>,
    /// Age of the current baseline, s.
    pub baseline_age_s: Option<f64>,
    /// Free bytes on the filesystem of the record.
    pub disk_free_bytes: Option<u64>,
    /// Growth of the record, bytes a day.
    pub disk_bytes_per_day: Option<f64>,
    /// Days until the disk is full.
    pub disk_days: Option<f64>,
    /// The relay that will be worn out first.
    pub relay: Option<RelayLife>,
}

/// A problem.
#[derive(Debug, Serialize)]
pub struct ActiveAlarm {
    /// Its name.
    pub kind: String,
    /// A sentence.
    pub text: String,
}

/// The last frame.
#[derive(Debug, Serialize)]
pub struct LastFrame {
    /// Its session.
    pub session: String,
    /// Its number there.
    pub sequence: u64,
    /// When it was taken.
    pub wall: String,
    /// Time since its last reading, s.
    pub age_s: f64,
}

/// Frames since the daemon started that are not in the record.
#[derive(Debug, Default, Serialize)]
pub struct Gaps {
    /// Failed frames.
    pub failed: u64,
    /// Frames that missed their scheduled time, or that the disk refused.
    pub dropped: u64,
    /// The last one.
    pub last: Option<Gap>,
}

/// A frame that is not in the record.
#[derive(Debug, Serialize)]
pub struct Gap {
    /// When.
    pub at: String,
    /// Why.
    pub text: String,
    /// When, ns since 1970 UTC.
    #[serde(skip)]
    pub at_ns: i64,
}

/// An instrument.
#[derive(Debug, Serialize)]
pub struct InstrumentState {
    /// Its role.
    pub role: String,
    /// Why it cannot be used.
    pub fault: Option<String>,
}

/// The relay that will be worn out first.
#[derive(Debug, Serialize)]
pub struct RelayLife {
    /// Its number.
    pub relay: u32,
    /// Fraction of its rated life that is used.
    pub used: f64,
    /// Measuring time until it reaches its rated life, s.
    pub left_s: Option<f64>,
}

impl From<crate::Health> for Health {
    fn from(reported: crate::Health) -> Self {
        let pairs = |texts: Option<Vec<String>>| {
            texts
                .unwrap_or_default()
                .into_iter()
                .map(|text| match text.split_once(": ") {
                    Some((word, rest)) => (word.to_owned(), rest.to_owned()),
                    None => (text, String::new()),
                })
        };
        Self {
            well: reported.well.unwrap_or(false),
            troubles: pairs(reported.troubles)
                .map(|(kind, text)| ActiveAlarm { kind, text })
                .collect(),
            last_frame: reported.last_frame_session.map(|session| LastFrame {
                session,
                sequence: reported.last_frame_sequence.unwrap_or(0),
                wall: utc_of_ns(reported.last_frame_ns.unwrap_or(0)),
                age_s: reported.last_frame_age_s.unwrap_or(0.0),
            }),
            period_s: reported.period_s,
            backlog: reported.backlog,
            gaps: Gaps {
                failed: reported.total_failed.unwrap_or(0),
                dropped: reported.total_dropped.unwrap_or(0),
                last: reported.last_gap.map(|text| {
                    let at_ns = reported.last_gap_ns.unwrap_or(0);
                    let at = utc_of_ns(at_ns);
                    Gap { at, text, at_ns }
                }),
            },
            instruments: pairs(reported.instruments)
                .map(|(role, state)| InstrumentState {
                    role,
                    fault: state.strip_prefix("fault: ").map(str::to_owned),
                })
                .collect(),
            baseline_age_s: reported.baseline_age_s,
            disk_free_bytes: reported.disk_free_bytes,
            disk_bytes_per_day: reported.disk_bytes_per_day,
            disk_days: reported.disk_days,
            relay: reported.relay.map(|relay| RelayLife {
                relay,
                used: reported.relay_used.unwrap_or(0.0),
                left_s: reported.relay_left_s,
            }),
        }
    }
}
