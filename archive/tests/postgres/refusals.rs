//! Errors name wrong settings and missing rights, and sites are isolated from each other.

use crate::archive;
use crate::authority::{authority, issue};
use crate::server::{DATABASE, PASSWORD, Server};
use crate::site::Site;

fn dsn(server: &Server, more: &str) -> String {
    format!(
        "host={} port={} {more}",
        server.socket().display(),
        server.port()
    )
}

#[test]
fn wrong_settings_are_named_with_what_to_do() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    site.record_session("m1", 1);
    server.add_role("stranger");
    server.sql("CREATE DATABASE empty OWNER owner");
    for (dsn, code, words) in [
        (
            dsn(&server, "dbname=none user=berlin"),
            1,
            "has no database 'none'",
        ),
        (
            dsn(&server, "dbname=empty user=berlin"),
            1,
            "tactus-archive migrate",
        ),
        (
            dsn(&server, "dbname=tactus user=nobody"),
            1,
            "refuses the login of role 'nobody'",
        ),
        (
            dsn(&server, "dbname=tactus user=stranger"),
            1,
            "role 'stranger' may not do this",
        ),
        (
            "host=127.0.0.1 port=1 dbname=tactus user=berlin".into(),
            75,
            "cannot reach PostgreSQL at 127.0.0.1:1",
        ),
        (
            "host=db.example.org dbname=tactus user=berlin".into(),
            78,
            "archive.ca",
        ),
        ("dbname=tactus".into(), 78, "names no user"),
    ] {
        site.configure(&dsn, "");
        let error = site.refused(&["push"], code);
        assert!(error.contains(words), "{dsn}: {error}");
    }
    site.configure(&dsn(&server, "dbname=tactus user=berlin"), "");
    site.write_private("password", "another word");
    let error = site.refused(&["push"], 1);
    assert!(
        error.contains("refuses the login of role 'berlin'"),
        "{error}"
    );
    assert_eq!(server.sql("SELECT count(*) FROM tactus.part"), "0");
    assert!(site.stored().is_empty());
}

#[test]
fn site_of_another_role_is_refused_by_name() {
    let Some((server, berlin)) = archive("berlin") else {
        return;
    };
    let paris = Site::added(&server, "paris");
    berlin.record_session("m1", 1);
    berlin.done(&["push"]);
    // a machine with the credentials of paris and the name of berlin
    let mut thief = Site::new(&server, "berlin");
    thief.configure(&dsn(&server, "dbname=tactus user=paris"), "");
    thief.record_session("m1", 2);
    let error = thief.refused(&["push"], 1);
    assert!(
        error.contains("site 'berlin' belongs to another role than 'paris'"),
        "{error}"
    );
    assert!(thief.stored().is_empty());
    thief.name = "rome".into();
    thief.configure(&dsn(&server, "dbname=tactus user=paris"), "");
    let error = thief.refused(&["push"], 1);
    assert!(error.contains("has no site 'rome'"), "{error}");
    let output = berlin.owner(&server, &["add-site", "berlin", "--role", "paris"]);
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("site 'berlin' belongs to another role")
    );
    // equal part names in two sites are two parts
    paris.record_session("m1", 1);
    paris.done(&["push"]);
    assert_eq!(
        server.sql("SELECT string_agg(site, ',' ORDER BY site) FROM tactus.part"),
        "berlin,paris"
    );
    let seen = paris.done(&["verify"]);
    assert!(
        seen.contains("paris/") && !seen.contains("berlin/"),
        "{seen}"
    );
}

#[test]
fn site_added_with_an_unknown_role_can_be_added_again() {
    let Some((server, owner)) = archive("berlin") else {
        return;
    };
    let add = |role: &str| owner.owner(&server, &["add-site", "paris", "--role", role]);
    let error = String::from_utf8(add("pairs").stderr).unwrap();
    assert!(error.contains("role \"pairs\" does not exist"), "{error}");
    server.add_role("paris");
    let done = add("paris");
    assert!(done.status.success(), "{done:?}");
}

#[test]
fn uploader_can_only_insert_rows_of_its_own_site() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    Site::added(&server, "paris");
    site.record_session("m1", 1);
    site.done(&["push"]);
    for statement in [
        "DELETE FROM tactus.part",
        "UPDATE tactus.part SET bytes = 1",
        "TRUNCATE tactus.event",
        "INSERT INTO tactus.site (name, role) VALUES ('rome', 'paris')",
        "UPDATE tactus.site SET role = 'paris'",
        "DROP TABLE tactus.part",
        "ALTER TABLE tactus.part DISABLE ROW LEVEL SECURITY",
    ] {
        for role in ["berlin", "paris"] {
            let error = server.refusal(role, statement);
            assert!(
                error.contains("permission denied") || error.contains("must be owner"),
                "{statement}: {error}"
            );
        }
    }
    let forged = "INSERT INTO tactus.quantity VALUES ('berlin', 'bed3', 'm1', 99, now(), '{}')";
    let error = server.refusal("paris", forged);
    assert!(error.contains("row-level security"), "{error}");
}

#[test]
fn server_is_trusted_by_its_authority_only() {
    let Some((mut server, site)) = archive("berlin") else {
        return;
    };
    if !needs::program("POSTGRES", "openssl") {
        return;
    }
    let folder = site.folder.path();
    authority(folder, "ca");
    authority(folder, "other");
    issue(folder, "ca", "server");
    for name in ["server.key", "server.crt"] {
        server.write(name, &std::fs::read_to_string(folder.join(name)).unwrap());
    }
    site.record_session("m1", 1);
    let network = format!(
        "host=127.0.0.1 port={} dbname={DATABASE} user=berlin",
        server.port()
    );
    // without TLS on the server
    site.configure(&network, "ca = \"ca.pem\"\n");
    let error = site.refused(&["push"], 1);
    assert!(error.contains("no trusted connection"), "{error}");
    server.kill(rustix::process::Signal::QUIT);
    server.resume();
    site.configure(&network, "ca = \"other.pem\"\n");
    let error = site.refused(&["push"], 1);
    assert!(
        error.contains("no trusted connection") && error.contains("other.pem"),
        "{error}"
    );
    site.configure(&network, "ca = \"none.pem\"\n");
    let error = site.refused(&["push"], 78);
    assert!(
        error.contains("archive.ca") && error.contains("none.pem"),
        "{error}"
    );
    // without a certificate authority the server of this machine is reached without TLS, which it refuses
    site.configure(&network, "");
    let error = site.refused(&["push"], 1);
    assert!(error.contains("refuses the login"), "{error}");
    assert_eq!(server.sql("SELECT count(*) FROM tactus.part"), "0");
    site.configure(&network, "ca = \"ca.pem\"\n");
    site.write_private("password", PASSWORD);
    site.done(&["push"]);
    assert_eq!(server.sql("SELECT count(*) FROM tactus.part"), "1");
}
