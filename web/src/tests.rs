//! Routes, headers and refusals over raw TCP.

use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::snapshot::{FrameState, SessionState};
use crate::{Control, HostName, Live, Playback, Recordings, Server, SessionList, Settings, Token};

pub(crate) struct Served {
    port: u16,
    token: String,
    live: Live,
    stop: watch::Sender<bool>,
    serving: JoinHandle<std::io::Result<()>>,
}

async fn served() -> Served {
    served_with(None).await
}

async fn served_with(control: Option<Control>) -> Served {
    served_from(control, Arc::new(NoRecordings)).await
}

/// A source without recorded sessions.
pub(crate) struct NoRecordings;

impl Recordings for NoRecordings {
    fn list(&self) -> Result<SessionList, String> {
        Ok(SessionList::default())
    }

    fn open(&self, _: &str) -> Result<Option<Arc<dyn Playback>>, String> {
        Ok(None)
    }
}

pub(crate) async fn served_from(
    control: Option<Control>,
    recordings: Arc<dyn Recordings>,
) -> Served {
    let token = Token::random().unwrap();
    let settings = Settings {
        listen: vec![([127, 0, 0, 1], 0).into()],
        names: vec!["lab.example.org".parse::<HostName>().unwrap()],
        token: token.clone(),
        control,
    };
    let server = Server::open(settings).await.unwrap();
    let (port, live) = (server.address().port(), Live::default());
    assert_eq!(
        server.url(),
        format!("http://127.0.0.1:{port}/#token={}", token.text())
    );
    let (stop, stopped) = watch::channel(false);
    Served {
        port,
        token: token.text().to_owned(),
        serving: tokio::spawn(server.run(live.clone(), recordings, stopped)),
        live,
        stop,
    }
}

impl Served {
    async fn connected(&self) -> TcpStream {
        TcpStream::connect(("127.0.0.1", self.port)).await.unwrap()
    }

    /// The whole response to a request with these headers.
    async fn ask(&self, line: &str, headers: &[String]) -> String {
        self.ask_with(line, headers, "").await
    }

    /// Like [`Self::ask`], with a body.
    async fn ask_with(&self, line: &str, headers: &[String], body: &str) -> String {
        let mut stream = self.connected().await;
        let text = format!(
            "{line} HTTP/1.1\r\nConnection: close\r\n{}\r\n{body}",
            headers.concat()
        );
        stream.write_all(text.as_bytes()).await.unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).await.unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }

    fn host(&self) -> String {
        format!("Host: 127.0.0.1:{}\r\n", self.port)
    }

    fn bearer(&self) -> String {
        format!("Authorization: Bearer {}\r\n", self.token)
    }

    /// The body of a response.
    pub(crate) async fn bytes(&self, path: &str) -> Vec<u8> {
        let mut stream = self.connected().await;
        let headers = [self.host(), self.bearer()].concat();
        let text = format!("GET {path} HTTP/1.1\r\nConnection: close\r\n{headers}\r\n");
        stream.write_all(text.as_bytes()).await.unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).await.unwrap();
        let end = answer.windows(4).position(|four| four == b"\r\n\r\n");
        answer.split_off(end.unwrap() + 4)
    }

    /// The live state that pages follow.
    pub(crate) fn live(&self) -> Live {
        self.live.clone()
    }

    pub(crate) async fn get(&self, path: &str) -> String {
        self.ask(&format!("GET {path}"), &[self.host(), self.bearer()])
            .await
    }
}

pub(crate) fn code(answer: &str) -> &str {
    answer.split(' ').nth(1).unwrap_or_default()
}

#[tokio::test]
async fn only_exact_hosts_are_served() {
    let served = served().await;
    let port = served.port;
    for (host, wanted) in [
        (format!("127.0.0.1:{port}"), "200"),
        (format!("LOCALHOST:{port}"), "200"),
        (format!("[::1]:{port}"), "200"),
        ("lab.example.org".to_owned(), "200"),
        // a page of an attacker, whose host name resolves to this machine (DNS rebinding)
        (format!("attacker.example:{port}"), "403"),
        (format!("localhost.attacker.example:{port}"), "403"),
        (format!("127.0.0.1.attacker.example:{port}"), "403"),
        ("127.0.0.1".to_owned(), "403"),
        ("127.0.0.1:1".to_owned(), "403"),
        (String::new(), "403"),
    ] {
        let headers = [format!("Host: {host}\r\n"), served.bearer()];
        let answer = served.ask("GET /api/state", &headers).await;
        assert_eq!(code(&answer), wanted, "{host}: {answer}");
    }
    let twice = [
        served.host(),
        "Host: attacker.example\r\n".to_owned(),
        served.bearer(),
    ];
    let answer = served.ask("GET /api/state", &twice).await;
    assert!(["400", "403"].contains(&code(&answer)), "{answer}");
}

#[tokio::test]
async fn an_address_in_use_is_refused_beside_a_free_one() {
    let taken = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let settings = Settings {
        listen: vec![([127, 0, 0, 1], 0).into(), taken.local_addr().unwrap()],
        names: Vec::new(),
        token: Token::random().unwrap(),
        control: None,
    };
    let refused = Server::open(settings).await.unwrap_err();
    assert_eq!(refused.kind(), std::io::ErrorKind::AddrInUse);
}

#[tokio::test]
async fn data_need_the_token_and_the_page_does_not() {
    let served = served().await;
    for (path, _, _) in crate::page::FILES {
        let answer = served.ask(&format!("GET {path}"), &[served.host()]).await;
        assert_eq!(code(&answer), "200", "{path}");
        assert!(!answer.contains(&served.token), "{path} contains the token");
    }
    let wrong = [
        String::new(),
        "Authorization: Bearer \r\n".to_owned(),
        format!("Authorization: Basic {}\r\n", served.token),
        format!("Authorization: Bearer {}x\r\n", served.token),
        format!("Authorization: Bearer {}\r\n", &served.token[1..]),
        format!("Cookie: token={}\r\n", served.token),
    ];
    for path in [
        "/api/state",
        "/api/state/1",
        "/api/geometry",
        "/api/colours",
        "/api/map/1",
        "/api/provisional/1",
        "/api/deviation",
        "/api/history/24/sheet",
        "/api/sessions",
        "/api/sessions/m1",
        "/api/sessions/m1/course",
        "/api/sessions/m1/maps/quick/frame/1",
        "/api/sheets",
        "/api/sheets/berlin/bed3",
    ] {
        for header in &wrong {
            let headers = [served.host(), header.clone()];
            let answer = served.ask(&format!("GET {path}"), &headers).await;
            assert_eq!(code(&answer), "401", "{path} with {header}");
        }
    }
    let answer = served
        .ask(
            &format!("GET /api/state?token={}", served.token),
            &[served.host()],
        )
        .await;
    assert_eq!(
        code(&answer),
        "401",
        "a token in the address would be in logs"
    );
}

#[tokio::test]
async fn other_sites_and_other_methods_are_refused() {
    let served = served().await;
    for (site, wanted) in [
        ("same-origin", "200"),
        ("none", "200"),
        ("same-site", "403"),
        ("cross-site", "403"),
    ] {
        let headers = [
            served.host(),
            served.bearer(),
            format!("Sec-Fetch-Site: {site}\r\n"),
        ];
        let answer = served.ask("GET /api/state", &headers).await;
        assert_eq!(code(&answer), wanted, "{site}");
    }
    for method in ["POST", "PUT", "DELETE", "OPTIONS"] {
        let headers = [served.host(), served.bearer()];
        let answer = served.ask(&format!("{method} /api/state"), &headers).await;
        assert_eq!(code(&answer), "405", "{method}");
    }
}

#[tokio::test]
async fn commands_need_permission_origin_media_type_and_token() {
    // no daemon listens there: a command that passes all checks ends with 409
    let folder = tempfile::tempdir().unwrap();
    let address = dbus::Address::Unix(folder.path().join("nobody"));
    let open = served_with(Some(Control {
        address: Some(address),
    }))
    .await;
    let closed = served().await;
    let body = r#"{"call": "stop"}"#;
    let json = "Content-Type: application/json\r\n";
    let form = "Content-Type: text/plain\r\n";
    let site = |site: &str| format!("Sec-Fetch-Site: {site}\r\n");
    let bearer = open.bearer();
    for (served, path, headers, body, wanted) in [
        (
            &open,
            "/api/control",
            vec![json.to_owned(), bearer.clone()],
            body,
            "409",
        ),
        (
            &open,
            "/api/control",
            vec![json.to_owned(), bearer.clone(), site("same-origin")],
            body,
            "409",
        ),
        (
            &open,
            "/api/control",
            vec![json.to_owned(), bearer.clone(), site("cross-site")],
            body,
            "403",
        ),
        (
            &open,
            "/api/control",
            vec![json.to_owned(), bearer.clone(), site("none")],
            body,
            "403",
        ),
        (
            &open,
            "/api/control",
            vec![form.to_owned(), bearer.clone()],
            body,
            "415",
        ),
        (&open, "/api/control", vec![bearer.clone()], body, "415"),
        (&open, "/api/control", vec![json.to_owned()], body, "401"),
        (
            &open,
            "/api/state",
            vec![json.to_owned(), bearer.clone()],
            body,
            "405",
        ),
        (
            &open,
            "/api/control",
            vec![json.to_owned(), bearer.clone()],
            r#"{"call": "format-disk"}"#,
            "400",
        ),
        (
            &open,
            "/api/control",
            vec![json.to_owned(), bearer.clone()],
            r#"{"call": "press", "x_m": 0}"#,
            "400",
        ),
        (
            &closed,
            "/api/control",
            vec![json.to_owned(), closed.bearer()],
            body,
            "403",
        ),
    ] {
        let length = format!("Content-Length: {}\r\n", body.len());
        let mut sent = vec![served.host(), length];
        sent.extend(headers.clone());
        let line = format!("POST {path}");
        let answer = served.ask_with(&line, &sent, body).await;
        assert_eq!(code(&answer), wanted, "{path} {headers:?}: {answer}");
    }
    let long = format!(
        r#"{{"call": "acknowledge", "name": "{}"}}"#,
        "a".repeat(10_000)
    );
    let length = format!("Content-Length: {}\r\n", long.len());
    let headers = [open.host(), bearer, json.to_owned(), length];
    let answer = open.ask_with("POST /api/control", &headers, &long).await;
    assert_eq!(code(&answer), "413", "{answer}");
    assert!(closed.get("/api/state").await.contains("\"control\":false"));
    assert!(open.get("/api/state").await.contains("\"control\":true"));
}

#[tokio::test]
async fn every_answer_has_the_headers_and_no_cookie() {
    let served = served().await;
    let refused = served.ask("GET /api/state", &[served.host()]).await;
    for answer in [served.get("/").await, served.get("/nothing").await, refused] {
        let lower = answer.to_ascii_lowercase();
        for header in [
            "content-security-policy: default-src 'none'; script-src 'self'",
            "frame-ancestors 'none'",
            "x-content-type-options: nosniff",
            "cross-origin-resource-policy: same-origin",
            "referrer-policy: no-referrer",
            "cache-control: no-store",
        ] {
            assert!(lower.contains(header), "{header} in {answer}");
        }
        assert!(
            !lower.contains("set-cookie") && !lower.contains("access-control"),
            "{answer}"
        );
    }
    // the page loads nothing from other hosts and contains no inline script
    let page = served.get("/").await;
    assert!(!page.contains("http://") && !page.contains("https://") && !page.contains("<script>"));
}

#[tokio::test]
async fn a_map_is_single_precision_and_old_ones_go() {
    let served = served().await;
    for sequence in 1..=17 {
        let values = [0.5, sequence as f32];
        served
            .live
            .change(|snapshot| snapshot.keep_map(sequence, &values));
    }
    let answer = served.bytes("/api/map/17").await;
    let expected: Vec<u8> = [0.5_f32, 17.0]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    assert_eq!(answer, expected);
    assert_eq!(code(&served.get("/api/map/2").await), "200");
    for path in [
        "/api/map/1",
        "/api/map/18",
        "/api/map/x",
        "/api/map/-1",
        "/api/geometry",
    ] {
        assert_eq!(code(&served.get(path).await), "404", "{path}");
    }
}

#[tokio::test]
async fn maps_are_not_cached_across_sessions() {
    let served = served().await;
    // two sessions, whose frames begin at 1
    for value in [0.25_f32, 0.5] {
        served.live.change(|snapshot| {
            snapshot.maps.clear();
            snapshot.keep_map(1, &[value]);
            snapshot.provisional = Some((1, value.to_le_bytes().to_vec().into()));
        });
        for path in ["/api/map/1", "/api/provisional/1"] {
            let answer = served.get(path).await.to_ascii_lowercase();
            assert!(answer.contains("cache-control: no-store"), "{answer}");
            assert_eq!(served.bytes(path).await, value.to_le_bytes(), "{path}");
        }
    }
}

/// A running session; `None` for an empty id.
fn running(id: &str) -> Option<SessionState> {
    (!id.is_empty()).then(|| SessionState {
        id: id.to_owned(),
        ..SessionState::default()
    })
}

#[tokio::test]
async fn maps_and_geometry_name_their_session() {
    let served = served().await;
    let geometry = dbus::Geometry {
        mesh_hash: String::new(),
        nodes: Vec::new(),
        triangles: Vec::new(),
        outline: Vec::new(),
        outline_lengths: Vec::new(),
        electrodes: Vec::new(),
        more: dbus::GeometryDetails::default(),
    };
    // the session continues, another one begins and ends: the last map stays
    for id in ["m1", "m1", "m2", ""] {
        served.live.change(|snapshot| {
            snapshot.set_session(running(id));
            snapshot.geometry = Some(Arc::new(geometry.clone()));
            snapshot.keep_map(1, &[0.5]);
            snapshot.provisional = Some((1, [0; 4].into()));
        });
        for path in ["/api/map/1", "/api/provisional/1", "/api/geometry"] {
            let answer = served.get(path).await.to_ascii_lowercase();
            let mut lines = answer.lines();
            let named = lines.find_map(|line| line.strip_prefix("tactus-session:"));
            assert_eq!(named.map(str::trim), Some(id), "{path}: {answer}");
        }
    }
}

#[test]
fn frames_of_another_session_go_when_one_begins() {
    let live = Live::default();
    let begin = |id: &str| live.change(|snapshot| snapshot.set_session(running(id)));
    let has_frame = || {
        let followed = live.subscribe();
        let snapshot = followed.borrow();
        let kept = [
            snapshot.state.frame.is_some(),
            snapshot.readings.is_some(),
            snapshot.provisional.is_some(),
            snapshot.map_values(1).is_some(),
        ];
        assert!(kept.iter().all(|one| *one == kept[0]), "{kept:?}");
        kept[0]
    };
    begin("m1");
    live.change(|snapshot| {
        snapshot.state.frame = Some(FrameState::default());
        snapshot.readings = Some((1, vec![Some(0.5)].into()));
        snapshot.provisional = Some((1, [0; 4].into()));
        snapshot.keep_map(1, &[0.5]);
    });
    begin("m1");
    assert!(has_frame(), "it goes on");
    live.change(|snapshot| snapshot.set_session(None));
    assert!(has_frame(), "it has ended");
    begin("m2");
    assert!(!has_frame(), "another one");
}

/// The state in a response.
fn state_of(answer: &[u8]) -> serde_json::Value {
    serde_json::from_slice(answer).unwrap()
}

#[tokio::test]
async fn a_change_answers_those_who_wait_and_stop_ends_them() {
    let served = Arc::new(served().await);
    let first = state_of(&served.bytes("/api/state").await);
    let version = first["version"].as_u64().unwrap();
    let next = |version: u64| {
        let served = Arc::clone(&served);
        tokio::spawn(async move { served.bytes(&format!("/api/state/{version}")).await })
    };
    let waits = next(version);
    // a request with a version other than the current one gets an immediate response
    let old = state_of(&next(version + 7).await.unwrap());
    assert_eq!(old["version"], version);
    assert!(!waits.is_finished());
    for sequence in 1..=9 {
        served.live.change(|snapshot| {
            snapshot.state.frame = Some(FrameState {
                sequence,
                ..FrameState::default()
            });
        });
    }
    let limit = Duration::from_secs(30);
    let answer = tokio::time::timeout(limit, waits).await.unwrap().unwrap();
    assert!(state_of(&answer)["version"].as_u64() > Some(version));
    // a slow reader gets the newest state and skips those in between
    let answer = next(version + 1).await.unwrap();
    let newest = state_of(&answer);
    assert_eq!(newest["frame"]["sequence"], 9);
    assert_eq!(newest["version"], version + 9);
    let refused = served.get("/api/state/x").await;
    assert_eq!(code(&refused), "400", "{refused}");

    let waits = next(version + 9);
    // make sure that the request is waiting before the server is stopped
    served.bytes("/api/state").await;
    served.stop.send(true).unwrap();
    tokio::time::timeout(limit, waits).await.unwrap().unwrap();
    let served = Arc::into_inner(served).unwrap();
    let ended = tokio::time::timeout(limit, served.serving).await;
    ended.expect("it ends").unwrap().unwrap();
}

#[tokio::test]
async fn too_many_pages_are_refused() {
    let served = served().await;
    let mut open = Vec::new();
    let version = state_of(&served.bytes("/api/state").await)["version"].clone();
    let line = format!("GET /api/state/{version}");
    let text = format!(
        "{line} HTTP/1.1\r\n{}{}\r\n",
        served.host(),
        served.bearer()
    );
    for _ in 0..32 {
        let mut stream = served.connected().await;
        stream.write_all(text.as_bytes()).await.unwrap();
        open.push(stream);
    }
    // requests arrive in any order; one beyond the limit is refused
    let path = format!("/api/state/{version}");
    let refused = async {
        loop {
            let asked = served.get(&path);
            match tokio::time::timeout(Duration::from_millis(200), asked).await {
                Ok(answer) => return answer,
                Err(_) => continue,
            }
        }
    };
    let answer = tokio::time::timeout(Duration::from_secs(300), refused)
        .await
        .unwrap();
    assert_eq!(code(&answer), "503", "{answer}");
    assert!(answer.contains("close one"), "{answer}");
    // a closed page frees its slot
    open.clear();
    let free =
        async { while code(&served.get(&format!("/api/state/{version}9")).await) != "200" {} };
    tokio::time::timeout(Duration::from_secs(300), free)
        .await
        .unwrap();
}

#[test]
fn a_token_file_must_be_private_and_hold_a_secret() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("token");
    let written = |text: &str, mode: u32| {
        std::fs::write(&file, text).unwrap();
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(mode)).unwrap();
        Token::from_file(&file)
            .map(|token| token.text().to_owned())
            .map_err(|error| error.to_string())
    };
    let secret = "0123456789abcdef0123456789abcdef";
    assert_eq!(
        written(&format!("{secret}\n"), 0o600),
        Ok(secret.to_owned())
    );
    assert!(written(secret, 0o640).unwrap_err().contains("chmod 600"));
    assert!(written("short", 0o600).unwrap_err().contains("32 to 256"));
    assert!(
        written(&format!("{secret} {secret}"), 0o600)
            .unwrap_err()
            .contains("32 to 256")
    );
    for wrong in ["", "a b", "http://x", "x:99999", "x/y"] {
        assert!(wrong.parse::<HostName>().is_err(), "{wrong}");
    }
}
