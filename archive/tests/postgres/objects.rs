//! A bucket as the store, served by moto's S3 server.

use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use crate::archive;
use crate::authority::{authority, issue};
use crate::proxy::{Far, Proxy, ProxyMode};
use crate::server::{DATABASE, Server};
use crate::site::Site;

const MOTO: &[&str] = &["moto[server,s3]==5.2.5"];

/// An S3 server on this machine; ends with the test.
struct Moto {
    child: Child,
    endpoint: String,
}

impl Moto {
    /// `None` (reported, kind `PYTHON`) if it cannot be installed.
    fn start() -> Option<Self> {
        Self::with("http", &[])
    }

    fn with(scheme: &str, more: &[&str]) -> Option<Self> {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
        let python = needs::python(folder, "moto", MOTO)?;
        let port = std::net::TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr());
        let port = port.expect("a port").port();
        let child = Command::new(python)
            .args([
                "-m",
                "moto.server",
                "-H",
                "127.0.0.1",
                "-p",
                &port.to_string(),
            ])
            .args(more)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("moto starts");
        let server = Self {
            child,
            endpoint: format!("{scheme}://127.0.0.1:{port}"),
        };
        crate::server::wait_until(
            || TcpStream::connect(("127.0.0.1", port)).is_ok(),
            || "moto does not listen".to_owned(),
        );
        Some(server)
    }

    /// A request with a signature that this server does not check.
    fn request(&self, method: &str, path: &str, content: &str) -> String {
        use std::io::{Read, Write};
        let address = self.endpoint.trim_start_matches("http://");
        let mut stream = TcpStream::connect(address).unwrap();
        let length = content.len();
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\nHost: {address}\r\nContent-Length: {length}\r\nConnection: close\r\n\
             Authorization: AWS4-HMAC-SHA256 Credential=name/20260101/us-east-1/s3/aws4_request\r\n\r\n{content}"
        )
        .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }
}

impl Drop for Moto {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Configures the site with a bucket as its store and these additional lines in `[archive]`.
fn use_bucket(server: &Server, site: &Site, endpoint: &str, more: &str) {
    let dsn = format!(
        "host={} port={} dbname={DATABASE} user=berlin",
        server.socket().display(),
        server.port()
    );
    site.configure(&dsn, more);
    let path = site.folder.path().join("config.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    let bucket = format!("store = \"s3://parts\"\nstore_endpoint = \"{endpoint}\"\n");
    std::fs::write(&path, text.replace("store = \"store\"\n", &bucket)).unwrap();
}

#[test]
fn bucket_over_tls_is_trusted_by_its_authority_only() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    if !needs::program("POSTGRES", "openssl") {
        return;
    }
    let folder = site.folder.path();
    authority(folder, "ca");
    authority(folder, "other");
    issue(folder, "ca", "server");
    let name = |name: &str| folder.join(name).to_string_lossy().into_owned();
    let (certificate, key) = (name("server.crt"), name("server.key"));
    let Some(moto) = Moto::with("https", &["--ssl-cert", &certificate, "--ssl-key", &key]) else {
        return;
    };
    site.write_private("keys", "name\nsecret\n");
    site.record_session("m1", 2);
    let with_ca = |ca: &str| {
        let lines = format!("store_keys_file = \"keys\"\nstore_ca = \"{ca}.pem\"\n");
        use_bucket(&server, &site, &moto.endpoint, &lines);
    };
    with_ca("none");
    let error = site.refused(&["push"], 78);
    assert!(
        error.contains("archive.store_ca: ") && error.contains("none.pem"),
        "{error}"
    );
    with_ca("other");
    let error = site.refused(&["push"], 1);
    assert!(
        error.contains("no trusted connection to the store https://127.0.0.1"),
        "{error}"
    );
    assert!(error.contains("archive.store_ca"), "{error}");
    assert_eq!(server.sql("SELECT count(*) FROM tactus.part"), "0");
    with_ca("ca");
    let error = site.refused(&["push"], 1);
    assert!(error.contains("NoSuchBucket"), "{error}");
    // create the bucket with boto3
    let python =
        needs::python(Path::new(env!("CARGO_TARGET_TMPDIR")), "moto", MOTO).expect("it serves");
    let program = "import boto3, sys\n\
        boto3.client('s3', endpoint_url=sys.argv[1], verify=sys.argv[2], region_name='us-east-1',\n    \
            aws_access_key_id='name', aws_secret_access_key='secret').create_bucket(Bucket='parts')";
    needs::run(Command::new(python).args(["-c", program, &moto.endpoint, &name("ca.pem")]))
        .unwrap();
    assert_eq!(site.done(&["push"]).matches(": archived as").count(), 2);
    assert_eq!(site.done(&["verify"]).matches(": intact").count(), 2);
}

#[test]
fn part_altered_on_its_way_to_a_bucket_is_no_part() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    let Some(moto) = Moto::start() else {
        return;
    };
    moto.request("PUT", "/parts", "");
    let far: u16 = moto.endpoint.rsplit(':').next().unwrap().parse().unwrap();
    let proxy = Proxy::to(Far::Port(far));
    site.write_private("keys", "name\nsecret\n");
    let near = format!("http://127.0.0.1:{}", proxy.port());
    use_bucket(&server, &site, &near, "store_keys_file = \"keys\"\n");
    site.record_session("m1", 1);
    // the text at the start of every SQLite file
    proxy.set(ProxyMode::Alter(b"SQLite format 3"));
    let output = site.run(&["push"]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(
        text.contains("m1: NOT ARCHIVED") && text.contains("is damaged: its SHA-256 is"),
        "{text}"
    );
    assert_eq!(server.sql("SELECT count(*) FROM tactus.part"), "0");
    assert!(!site.record().join("m1.archived.json").exists());
    // the damaged object stays and does not count as the part; a person must remove it
    proxy.set(ProxyMode::Open);
    assert_eq!(site.run(&["push"]).status.code(), Some(1));
    let (_, hash) = text.split_once("berlin/bed3/m1/m1.").unwrap();
    let (hash, _) = hash.split_once(".tactus").unwrap();
    moto.request(
        "DELETE",
        &format!("/parts/berlin/bed3/m1/m1.{hash}.tactus"),
        "",
    );
    site.done(&["push"]);
    site.done(&["verify"]);
    // the link is cut in the middle of the next part
    site.record_session("m2", 1);
    proxy.set(ProxyMode::CutBefore(b"SQLite format 3"));
    let error = site.refused(&["push"], 75);
    assert!(error.contains("cannot reach the store"), "{error}");
    proxy.set(ProxyMode::Open);
    site.done(&["push"]);
    assert_eq!(site.done(&["verify"]).matches(": intact").count(), 2);
}

#[test]
fn parts_go_to_a_bucket_once_and_come_back() {
    let Some((server, site)) = archive("berlin") else {
        return;
    };
    let Some(moto) = Moto::start() else {
        return;
    };
    use_bucket(
        &server,
        &site,
        &moto.endpoint,
        "store_keys_file = \"keys\"\n",
    );
    let error = site.refused(&["push"], 78);
    assert!(error.contains("archive.store_keys_file"), "{error}");
    site.write_private("keys", "name\nsecret\n");
    site.record_session("m1", 2);
    let error = site.refused(&["push"], 1);
    assert!(error.contains("NoSuchBucket"), "{error}");
    assert_eq!(server.sql("SELECT count(*) FROM tactus.part"), "0");
    moto.request("PUT", "/parts", "");
    assert_eq!(site.done(&["push"]).matches(": archived as").count(), 2);
    assert_eq!(site.done(&["verify"]).matches(": intact").count(), 2);
    // the catalogue is lost: the stored parts are entered again
    server.sql("DELETE FROM tactus.alarm; DELETE FROM tactus.event; DELETE FROM tactus.part");
    assert_eq!(site.done(&["push"]).matches(": archived as").count(), 2);
    let into = site.folder.path().join("back");
    std::fs::create_dir(&into).unwrap();
    site.done(&["pull", "m1", "--into", &into.to_string_lossy()]);
    for id in ["m1.tactus", "m1_p2.tactus"] {
        let same =
            std::fs::read(into.join(id)).unwrap() == std::fs::read(site.record().join(id)).unwrap();
        assert!(same, "{id}");
    }
    // altered in the bucket
    let name = server.sql("SELECT stored_as FROM tactus.part WHERE part = 'm1'");
    moto.request("PUT", &format!("/parts/{name}"), "another content");
    let output = site.run(&["verify"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stdout).contains("DAMAGED"));
    server.sql("DELETE FROM tactus.alarm; DELETE FROM tactus.event; DELETE FROM tactus.part");
    let output = site.run(&["push"]);
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(
        text.contains("m1: NOT ARCHIVED") && text.contains("m1_p2: archived"),
        "{text}"
    );
    moto.request("DELETE", &format!("/parts/{name}"), "");
    site.done(&["push"]);
    site.done(&["verify"]);
    // the store is offline
    drop(moto);
    site.record_session("m2", 1);
    let error = site.refused(&["push"], 75);
    assert!(error.contains("cannot reach the store"), "{error}");
}
