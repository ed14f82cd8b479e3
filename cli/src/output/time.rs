//! Wall time as text.

use chrono::{DateTime, Local, SecondsFormat, Utc};

/// Wall time in JSON and TOML: UTC. Tables have `imaging::recorded::table_time`.
pub(crate) fn utc(time: DateTime<Utc>) -> String {
    time.to_rfc3339_opts(SecondsFormat::AutoSi, true)
}

/// Wall time for people: local, to the second, with the offset from UTC.
pub(crate) fn local(time: DateTime<Utc>) -> String {
    time.with_timezone(&Local)
        .format("%Y-%m-%d %H:%M:%S %:z")
        .to_string()
}
