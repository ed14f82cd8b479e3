//! Changes that another SQLite tool can make, one statement or script each.

use std::path::Path;

use rusqlite::Connection;
use rusqlite::config::DbConfig;

/// Rows of a table that are changed one by one: the first and the last.
const ROWS: i64 = 2;

struct Column {
    name: String,
    kind: String,
    is_key: bool,
}

fn tables(connection: &Connection) -> Vec<(String, Vec<Column>)> {
    let mut tables = connection
        .prepare("SELECT name FROM sqlite_schema WHERE type = 'table' ORDER BY name")
        .unwrap();
    let names = tables.query_map([], |row| row.get::<_, String>(0)).unwrap();
    names
        .map(|name| {
            let name = name.unwrap();
            let mut columns = connection
                .prepare("SELECT name, type, pk FROM pragma_table_info(?1)")
                .unwrap();
            let columns = columns.query_map([&name], |row| {
                Ok(Column {
                    name: row.get(0)?,
                    kind: row.get(1)?,
                    is_key: row.get::<_, i64>(2)? > 0,
                })
            });
            let columns = columns.unwrap().map(Result::unwrap).collect();
            (name, columns)
        })
        .collect()
}

/// Scripts, one a mutation.
pub fn mutations(path: &Path) -> Vec<String> {
    let connection = open(path);
    let mut all: Vec<String> = [
        "PRAGMA user_version = 3",
        "PRAGMA user_version = 99",
        "PRAGMA application_id = 0",
        "PRAGMA application_id = 7",
        "CREATE TABLE other (x)",
        "CREATE VIEW other AS SELECT 1",
        "CREATE TRIGGER other AFTER INSERT ON event BEGIN SELECT 1; END",
        "CREATE INDEX other ON event (kind)",
        "VACUUM",
        "PRAGMA page_size = 4096; PRAGMA journal_mode = DELETE; VACUUM",
        "PRAGMA journal_mode = DELETE",
        "PRAGMA journal_mode = WAL",
        "ANALYZE",
    ]
    .map(str::to_owned)
    .to_vec();
    for (table, columns) in tables(&connection) {
        let key = &columns.iter().find(|column| column.is_key).unwrap().name;
        let keys: Vec<i64> = connection
            .prepare(&format!("SELECT {key} FROM {table} ORDER BY {key}"))
            .unwrap()
            .query_map([], |row| row.get(0))
            .unwrap()
            .map(Result::unwrap)
            .collect();
        assert!(!keys.is_empty(), "{table} has no row to change");
        all.extend([
            format!("DROP TABLE {table}"),
            format!("DELETE FROM {table}"),
            format!("ALTER TABLE {table} RENAME TO other"),
            format!("ALTER TABLE {table} ADD COLUMN other"),
            format!("UPDATE {table} SET {key} = {key} + 1000000"),
        ]);
        let rest: Vec<&str> = columns
            .iter()
            .filter(|column| !column.is_key)
            .map(|column| column.name.as_str())
            .collect();
        let rest = rest.join(", ");
        let (first, last) = (keys[0], keys[keys.len() - 1]);
        let count = keys.len() as i64;
        let chosen =
            (0..ROWS.min(count)).map(|n| keys[(n * (count - 1) / (ROWS - 1).max(1)) as usize]);
        for row in chosen {
            all.push(format!("DELETE FROM {table} WHERE {key} = {row}"));
            for to in [last + 1, last + 2, first - 1] {
                all.push(format!(
                    "INSERT INTO {table} ({key}, {rest}) SELECT {to}, {rest} FROM {table} WHERE {key} = {row}"
                ));
                all.push(format!(
                    "UPDATE {table} SET {key} = {to} WHERE {key} = {row}"
                ));
            }
            for column in columns.iter().filter(|column| !column.is_key) {
                let Column { name, kind, .. } = column;
                let mut values = vec!["NULL".to_owned()];
                values.extend(match kind.as_str() {
                    "INTEGER" => vec![format!("{name} + 1"), "0".into(), format!("-{name}")],
                    "REAL" => vec![format!("{name} * 1.0000001"), "0.0".into()],
                    "TEXT" => vec![
                        "''".into(),
                        format!("{name} || 'x'"),
                        format!("{name} || ' '"),
                        format!("replace({name}, 'a', 'b')"),
                    ],
                    "BLOB" => vec![
                        "x''".into(),
                        format!("CAST({name} || x'00' AS BLOB)"),
                        format!("zeroblob(length({name}))"),
                    ],
                    _ => vec![
                        format!("{name} + 1"),
                        format!("CAST({name} AS BLOB)"),
                        format!("CAST({name} AS TEXT)"),
                    ],
                });
                for value in values {
                    all.push(format!(
                        "UPDATE {table} SET {name} = {value} WHERE {key} = {row}"
                    ));
                }
                if row != first {
                    all.push(format!(
                        "UPDATE {table} SET {name} = (SELECT {name} FROM {table} WHERE {key} = {first}) WHERE {key} = {row}"
                    ));
                }
            }
        }
        if count > 1 {
            // two rows are exchanged
            all.push(format!(
                "UPDATE {table} SET {key} = -7 WHERE {key} = {first};
                 UPDATE {table} SET {key} = {first} WHERE {key} = {last};
                 UPDATE {table} SET {key} = {last} WHERE {key} = -7"
            ));
            all.push(format!("DELETE FROM {table} WHERE {key} > {first}"));
            // a copy of the last row replaces the first
            all.push(format!(
                "DELETE FROM {table} WHERE {key} = {first};
                 INSERT INTO {table} ({key}, {rest}) SELECT {first}, {rest} FROM {table} WHERE {key} = {last}"
            ));
        }
    }
    all.extend(of_the_closing());
    all
}

fn of_the_closing() -> Vec<String> {
    [
        "UPDATE session SET closed_ns = NULL, closed_reason = NULL",
        "UPDATE session SET closed_ns = 1, closed_reason = 'otherwise'",
        "DELETE FROM frame WHERE sequence > 60; DELETE FROM event WHERE id > 2",
        "DELETE FROM late_map WHERE sequence > 40",
        "DELETE FROM reference; DELETE FROM frame WHERE reference > 0",
    ]
    .map(str::to_owned)
    .to_vec()
}

/// Makes the change; `false` if SQLite refuses it or it changes nothing.
pub fn apply(path: &Path, script: &str) -> bool {
    let connection = open(path);
    let done = connection.execute_batch(script).is_ok();
    done && (!script.starts_with("UPDATE") || connection.changes() > 0)
}

fn open(path: &Path) -> Connection {
    let connection = Connection::open(path).unwrap();
    connection
        .execute_batch("PRAGMA foreign_keys = OFF; PRAGMA ignore_check_constraints = ON")
        .unwrap();
    // do not merge the journal of an interrupted session
    connection
        .set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)
        .unwrap();
    connection
}
