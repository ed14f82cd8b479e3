//! Wall time as text.

use chrono::{DateTime, Local, Utc};

// in JSON and TOML; tables have `imaging::recorded::table_time`
pub(crate) use dbus::json::utc;

/// Wall time for people: local, to the second, with the offset from UTC.
pub(crate) fn local(time: DateTime<Utc>) -> String {
    time.with_timezone(&Local)
        .format("%Y-%m-%d %H:%M:%S %:z")
        .to_string()
}
