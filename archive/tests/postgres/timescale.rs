//! Debian does not package TimescaleDB: one test needs an installation; the others create a stand-in for the parts of
//! the extension that a migration uses. They check that the right statements are sent and that a refusal changes
//! nothing, not the behaviour of TimescaleDB itself.

use rustix::process::Signal;

use crate::server::Server;
use crate::site::Site;

/// Stand-in for the extension, its list of hypertables, and `create_hypertable` with its check of keys.
const STAND_IN: &str = "SET allow_system_table_mods = on;
    CREATE SCHEMA timescale;
    INSERT INTO pg_catalog.pg_extension (oid, extname, extowner, extnamespace, extrelocatable, extversion)
        VALUES (900001, 'timescaledb', 10, 'timescale'::regnamespace, false, '2.17.0');
    CREATE SCHEMA timescaledb_information;
    CREATE TABLE timescaledb_information.hypertables (hypertable_schema name, hypertable_name name, every interval);
    CREATE FUNCTION timescale.create_hypertable(relation regclass, time_column_name name, chunk_time_interval interval, migrate_data boolean)
    RETURNS void LANGUAGE plpgsql AS $$
    BEGIN
        IF EXISTS (SELECT FROM pg_index i WHERE i.indrelid = relation AND i.indisunique AND NOT EXISTS (
            SELECT FROM pg_attribute a WHERE a.attrelid = relation AND a.attname = time_column_name AND a.attnum = ANY (i.indkey)))
        THEN
            RAISE EXCEPTION 'cannot create a unique index without the column \"%\" (used in partitioning)', time_column_name;
        END IF;
        INSERT INTO timescaledb_information.hypertables VALUES ('tactus', 'quantity', chunk_time_interval);
    END $$;";

const KEY: &str = "SELECT pg_get_constraintdef(oid) FROM pg_constraint WHERE conrelid = 'tactus.quantity'::regclass AND contype = 'p'";

fn migrate(server: &Server, owner: &Site) -> serde_json::Value {
    let output = owner.owner(server, &["migrate", "--json"]);
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn quantities_are_a_hypertable_where_there_is_timescaledb() {
    let Some(server) = Server::start() else {
        return;
    };
    let owner = Site::new(&server, "owner");
    let line = migrate(&server, &owner);
    assert_eq!(line["timescaledb"], serde_json::Value::Null, "{line}");
    assert_eq!(server.sql(KEY), "PRIMARY KEY (site, daq, session, line)");
    let site = Site::added(&server, "berlin");
    site.record_session("m1", 1);
    site.done(&["push"]);
    // installed later
    server.sql(STAND_IN);
    let line = migrate(&server, &owner);
    assert_eq!(line["timescaledb"], "used", "{line}");
    assert_eq!(
        server.sql(KEY),
        "PRIMARY KEY (site, daq, session, line, begin)"
    );
    let made = "SELECT count(*), min(every) FROM timescaledb_information.hypertables";
    assert_eq!(server.sql(made), "1|7 days");
    // a second migration changes nothing
    assert_eq!(migrate(&server, &owner)["timescaledb"], "used");
    assert_eq!(server.sql(made), "1|7 days");
    site.record_session("m2", 2);
    site.done(&["push"]);
    assert_eq!(site.done(&["push"]), "");
    assert_eq!(server.sql("SELECT count(*) FROM tactus.quantity"), "9");
    assert_eq!(
        server.sql("SELECT count(*) FROM tactus.quantity_value"),
        "27"
    );
}

#[test]
fn refusal_of_timescaledb_leaves_the_plain_table() {
    let Some(server) = Server::start() else {
        return;
    };
    let owner = Site::new(&server, "owner");
    let refusal = "CREATE OR REPLACE FUNCTION timescale.create_hypertable(relation regclass, time_column_name name, chunk_time_interval interval, migrate_data boolean)
        RETURNS void LANGUAGE plpgsql AS $$ BEGIN RAISE EXCEPTION 'no licence'; END $$";
    server.sql(&format!("{STAND_IN} {refusal}"));
    let line = migrate(&server, &owner);
    assert_eq!(line["applied"][0], "0001-catalogue", "{line}");
    assert_eq!(line["timescaledb"], "refused: no licence", "{line}");
    assert_eq!(server.sql(KEY), "PRIMARY KEY (site, daq, session, line)");
    let site = Site::added(&server, "berlin");
    site.record_session("m1", 1);
    site.done(&["push"]);
    assert_eq!(server.sql("SELECT count(*) FROM tactus.quantity"), "3");
}

#[test]
fn a_real_timescaledb_keeps_quantities_by_week() {
    let Some(mut server) = Server::start() else {
        return;
    };
    let available = "SELECT count(*) FROM pg_available_extensions WHERE name = 'timescaledb'";
    if server.sql(available) == "0" {
        needs::lacking(
            "TIMESCALEDB",
            "TimescaleDB is not installed for this PostgreSQL (Apache edition: build it with -DAPACHE_ONLY=1)",
        );
        return;
    }
    let owner = Site::new(&server, "owner");
    let line = migrate(&server, &owner);
    assert_eq!(line["timescaledb"], serde_json::Value::Null, "{line}");
    let site = Site::added(&server, "berlin");
    site.record_session("m1", 1);
    site.done(&["push"]);
    // the extension is installed when the catalogue already has rows
    server.kill(Signal::INT);
    server.write(
        "data/postgresql.auto.conf",
        "shared_preload_libraries = 'timescaledb'\ntimescaledb.telemetry_level = 'off'\n",
    );
    server.resume();
    server.sql("CREATE EXTENSION timescaledb");
    assert_eq!(migrate(&server, &owner)["timescaledb"], "used");
    assert_eq!(
        server.sql(KEY),
        "PRIMARY KEY (site, daq, session, line, begin)"
    );
    let every = "SELECT time_interval FROM timescaledb_information.dimensions WHERE hypertable_name = 'quantity'";
    assert_eq!(server.sql(every), "7 days");
    let rows = "SELECT count(*) FROM tactus.quantity";
    assert_eq!(server.sql(rows), "3", "the rows before are moved");
    assert_eq!(migrate(&server, &owner)["timescaledb"], "used", "once");
    site.record_session("m2", 2);
    site.done(&["push"]);
    assert_eq!(site.done(&["push"]), "", "nothing is entered twice");
    assert_eq!(server.sql(rows), "9");
    assert_eq!(
        server.sql("SELECT count(*) FROM tactus.quantity_value"),
        "27"
    );
    // another site sees only its own rows
    let paris = Site::added(&server, "paris");
    paris.record_session("m1", 1);
    paris.done(&["push"]);
    assert_eq!(
        server.sql("SET ROLE paris; SELECT count(*) FROM tactus.quantity"),
        "3"
    );
    assert_eq!(server.sql(rows), "12");
    // old weeks are dropped as whole chunks
    let dropped = "SELECT count(*) FROM (SELECT drop_chunks('tactus.quantity', created_before => now() + interval '1 day')) AS chunk";
    assert_ne!(server.sql(dropped), "0");
    assert_eq!(server.sql(rows), "0");
}
