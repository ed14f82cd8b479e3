//! Reports of the daemon as the JSON of `tactus status`, `tactus alarms`, `tactus instruments discover` and the live
//! topics: one line for each report, with the same fields in all of them. Neither draws nor prints.

mod alarm;
mod discovery;
mod health;
mod status;

use chrono::{DateTime, SecondsFormat, Utc};

pub use alarm::Alarm;
pub use discovery::DiscoverLine;
pub use health::{ActiveAlarm, Gap, Gaps, Health, InstrumentState, LastFrame, RelayLife};
pub use status::{MapSummary, Recovery, Running, Status};

/// Wall time in JSON: UTC, RFC 3339.
pub fn utc(time: DateTime<Utc>) -> String {
    time.to_rfc3339_opts(SecondsFormat::AutoSi, true)
}

fn utc_of_ns(ns: i64) -> String {
    utc(DateTime::from_timestamp_nanos(ns))
}

/// A text, `None` if it is empty: properties of the bus are never absent.
pub fn nonempty(text: String) -> Option<String> {
    (!text.is_empty()).then_some(text)
}
