//! The tables of the catalogue, version by version.

use serde::Serialize;
use tokio_postgres::{Client, GenericClient};

use super::error::{CatalogueError, Endpoint};

/// Each version's name and statements, in order; version 1 is the first.
const MIGRATIONS: &[(&str, &str)] = &[
    (
        "0001-catalogue",
        include_str!("migrations/0001-catalogue.sql"),
    ),
    ("0002-reading", include_str!("migrations/0002-reading.sql")),
];

/// Creates the function that converts quantities to a hypertable if TimescaleDB is installed.
const HYPERTABLE: &str = include_str!("migrations/hypertable.sql");

/// Key of the advisory lock; an arbitrary number. Programs that migrate at the same time wait for each other.
const LOCK: i64 = 0x7461_6374_7573;

/// The version of the tables that this program uses.
pub(super) const VERSION: i32 = MIGRATIONS.len() as i32;

/// Version of the tables; 0 if there are none. The time of each reply is limited.
pub(super) async fn version(
    client: &impl GenericClient,
    endpoint: &Endpoint,
) -> Result<i32, CatalogueError> {
    let exists = "SELECT to_regclass('tactus.migration') IS NOT NULL";
    let row = endpoint.within(client.query_one(exists, &[])).await?;
    if !row.get::<_, bool>(0) {
        return Ok(0);
    }
    let version = "SELECT coalesce(max(version), 0) FROM tactus.migration";
    let row = endpoint.within(client.query_one(version, &[])).await?;
    Ok(row.get(0))
}

/// Result of a migration.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Migration {
    /// Names of the migrations applied.
    pub applied: Vec<&'static str>,
    /// Whether quantities are in a hypertable: `used`, or `refused: ` and the reason; `None` without TimescaleDB.
    pub timescaledb: Option<String>,
}

/// Brings the tables to the version of this program, all or nothing.
pub(super) async fn apply(
    client: &mut Client,
    endpoint: &Endpoint,
) -> Result<Migration, CatalogueError> {
    let refused = |error| endpoint.refused(error);
    let transaction = client.transaction().await.map_err(refused)?;
    transaction
        .execute("SELECT pg_advisory_xact_lock($1)", &[&LOCK])
        .await
        .map_err(refused)?;
    let has = version(&transaction, endpoint).await?;
    if has > VERSION {
        return Err(CatalogueError::Newer {
            has,
            knows: VERSION,
        });
    }
    let mut applied = Vec::new();
    for (number, (name, statements)) in (1..).zip(MIGRATIONS) {
        if number <= has {
            continue;
        }
        transaction
            .batch_execute(statements)
            .await
            .map_err(refused)?;
        transaction
            .execute(
                "INSERT INTO tactus.migration (version, name) VALUES ($1, $2)",
                &[&number, name],
            )
            .await
            .map_err(refused)?;
        applied.push(*name);
    }
    transaction
        .batch_execute(HYPERTABLE)
        .await
        .map_err(refused)?;
    let row = transaction
        .query_one("SELECT pg_temp.use_timescaledb()", &[])
        .await
        .map_err(refused)?;
    let timescaledb = row.get(0);
    transaction
        .batch_execute("DROP FUNCTION pg_temp.use_timescaledb()")
        .await
        .map_err(refused)?;
    transaction.commit().await.map_err(refused)?;
    Ok(Migration {
        applied,
        timescaledb,
    })
}
