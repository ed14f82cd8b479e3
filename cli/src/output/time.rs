//! Wall time as text.

use chrono::{DateTime, Local, Utc};

// format of JSON and TOML; for tables see `imaging::recorded::table_time`
pub(crate) use dbus::json::utc;

/// Wall time in text output: local time to the second, with its offset from UTC.
pub(crate) fn local(time: DateTime<Utc>) -> String {
    time.with_timezone(&Local)
        .format("%Y-%m-%d %H:%M:%S %:z")
        .to_string()
}
