//! The entry that closes a session.

use rusqlite::types::Value;
use rusqlite::{Connection, params_from_iter};

use super::rows;
use crate::row::{HeaderChecksum, RowCounts, closing_checksum};

/// Writes how a session ended and the number of rows of each table. The row is deleted and inserted, not updated:
/// SQLite frees the pages of an updated row only after it has written the new one, so the row, with the protocol,
/// would move to the end of the file, and a file that loses its end would be unreadable. After a deletion the new row
/// uses the old pages, near the beginning of the file.
pub(super) fn write_closing(
    connection: &Connection,
    header_checksum: HeaderChecksum,
    at: i64,
    reason: &str,
    tally: RowCounts,
) -> rusqlite::Result<()> {
    let last = |table: &'static str| -> rusqlite::Result<u64> {
        let key = if table == "baseline" { "only" } else { "id" };
        let sql = format!("SELECT coalesce(max({key}), 0) FROM {table}");
        connection
            .query_row(&sql, [], |row| row.get::<_, i64>(0))
            .map(i64::unsigned_abs)
    };
    let tally = RowCounts {
        baselines: last("baseline")?,
        events: last("event")?,
        references: last("reference")?,
        stretches: last("stretch")?,
        settings: last("settings")?,
        mappers: last("mapper")?,
        ..tally
    };
    let tally = rows::json(serde_json::to_string(&tally))?;
    let transaction = connection.unchecked_transaction()?;
    let columns = |row: &rusqlite::Row<'_>| -> rusqlite::Result<Vec<Value>> {
        (0..row.as_ref().column_count())
            .map(|column| row.get(column))
            .collect()
    };
    let mut row = transaction.query_row("SELECT * FROM session", [], columns)?;
    let closing: [Value; 4] = [
        at.into(),
        reason.to_owned().into(),
        tally.clone().into(),
        closing_checksum(header_checksum, at, reason, &tally)
            .to_vec()
            .into(),
    ];
    // the closing columns are the last ones
    row.truncate(row.len().saturating_sub(closing.len()));
    row.extend(closing);
    transaction.execute("DELETE FROM session", [])?;
    let places = vec!["?"; row.len()].join(", ");
    transaction.execute(
        &format!("INSERT INTO session VALUES ({places})"),
        params_from_iter(row),
    )?;
    transaction.commit()
}
