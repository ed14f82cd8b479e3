//! A small client of W3C WebDriver: JSON over HTTP/1.1 to chromedriver.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::{Value, json};

/// Timeout for a condition on a page.
pub(super) const PATIENCE: Duration = Duration::from_secs(240);

/// A browser with one window.
pub struct Browser {
    driver: Child,
    port: u16,
    session: String,
}

impl Browser {
    /// Starts a headless browser with an empty profile; `None` (reported) if it is not installed.
    pub fn start(profile: &Path, width: u32, height: u32) -> Option<Self> {
        if !(needs::program("BROWSER", "chromium") && needs::program("BROWSER", "chromedriver")) {
            return None;
        }
        let mut driver = Command::new("chromedriver")
            .arg("--port=0")
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("chromedriver starts");
        let lines = BufReader::new(driver.stdout.take().expect("it is piped")).lines();
        let port = lines
            .map_while(Result::ok)
            .find_map(|line| {
                let (_, port) = line.split_once("started successfully on port ")?;
                port.trim_end_matches('.').parse().ok()
            })
            .expect("chromedriver says its port");
        let mut browser = Self {
            driver,
            port,
            session: String::new(),
        };
        let arguments = [
            "--headless=new".to_owned(),
            // as root, and with the small /dev/shm of a container
            "--no-sandbox".to_owned(),
            "--disable-dev-shm-usage".to_owned(),
            format!("--window-size={width},{height}"),
            format!("--user-data-dir={}", profile.display()),
        ];
        let wanted = json!({"capabilities": {"alwaysMatch": {
            "goog:chromeOptions": {"args": arguments},
            "timeouts": {"script": PATIENCE.as_millis() as u64},
        }}});
        let begun = browser.ask("POST", "/session", Some(&wanted));
        browser.session = begun["sessionId"].as_str().expect("a session").to_owned();
        Some(browser)
    }

    /// Opens an address and waits until it is loaded.
    pub fn open(&self, url: &str) {
        self.of_session("POST", "/url", Some(&json!({"url": url})));
    }

    /// The value of an expression on the page.
    pub fn value(&self, expression: &str) -> Value {
        let script = json!({"script": format!("return ({expression});"), "args": []});
        self.of_session("POST", "/execute/sync", Some(&script))
    }

    /// Runs an asynchronous script on the page; returns the value that it passes to its first argument, a callback.
    pub fn asynchronous(&self, script: &str) -> Value {
        let script = json!({"script": script, "args": []});
        self.of_session("POST", "/execute/async", Some(&script))
    }

    /// Waits until an expression on the page is true.
    ///
    /// # Panics
    /// It does not become true within two minutes; the text of the page is shown.
    pub fn until(&self, expression: &str) {
        let script = format!(
            "const done = arguments[0]; const end = Date.now() + {}; \
             const check = () => {{ if ({expression}) done(true); else if (Date.now() > end) done(document.body.innerText); \
             else setTimeout(check, 20); }}; check();",
            PATIENCE.as_millis() / 2
        );
        assert_eq!(
            self.asynchronous(&script),
            true,
            "{expression} does not become true on the page"
        );
    }

    /// Writes a PNG of the window.
    pub fn screenshot(&self, path: &Path) {
        let text = self.of_session("GET", "/screenshot", None);
        let file = std::fs::File::create(path).expect("the picture can be written");
        let mut decoder = Command::new("base64")
            .arg("-d")
            .stdin(Stdio::piped())
            .stdout(file)
            .spawn()
            .expect("base64 of coreutils");
        let mut input = decoder.stdin.take().expect("it is piped");
        input
            .write_all(text.as_str().expect("base64").as_bytes())
            .expect("it reads");
        drop(input);
        assert!(decoder.wait().expect("it ends").success());
    }

    /// A command of the browser's own protocol, e.g. to emulate a phone.
    pub fn command(&self, name: &str, parameters: &Value) -> Value {
        let command = json!({"cmd": name, "params": parameters});
        self.of_session("POST", "/goog/cdp/execute", Some(&command))
    }

    /// Emulates a network with this throughput and latency.
    pub fn slow_link(&self, bytes_per_s: u32, delay_ms: u32) {
        let conditions = json!({"network_conditions": {"offline": false, "latency": delay_ms,
            "download_throughput": bytes_per_s, "upload_throughput": bytes_per_s}});
        self.of_session("POST", "/chromium/network_conditions", Some(&conditions));
    }

    /// Clicks at an offset from the middle of an element, CSS pixels; the whole element must be in view. The browser
    /// finds the element at the moment of the click, so a row that appears above it does not matter.
    pub fn click(&self, selector: &str, x: i64, y: i64) {
        let wanted = json!({"using": "css selector", "value": selector});
        let element = self.of_session("POST", "/element", Some(&wanted));
        self.act(&json!({"type": "pointer", "id": "mouse", "actions": [
            {"type": "pointerMove", "duration": 0, "origin": element, "x": x, "y": y},
            {"type": "pointerDown", "button": 0}, {"type": "pointerUp", "button": 0}]}));
    }

    /// Presses and releases keys one after the other; names of W3C WebDriver, e.g. `\u{E012}` for the left arrow.
    pub fn keys(&self, keys: &str) {
        let events = keys.chars().flat_map(|key| {
            ["keyDown", "keyUp"].map(|kind| json!({"type": kind, "value": key.to_string()}))
        });
        let events: Vec<Value> = events.collect();
        self.act(&json!({"type": "key", "id": "keyboard", "actions": events}));
    }

    fn act(&self, source: &Value) {
        let actions = json!({"actions": [source]});
        self.of_session("POST", "/actions", Some(&actions));
    }

    /// A request of this session, e.g. for another window.
    pub fn of_session(&self, method: &str, path: &str, body: Option<&Value>) -> Value {
        self.ask(method, &format!("/session/{}{path}", self.session), body)
    }

    /// Sends one request; returns the `value` of its reply.
    fn ask(&self, method: &str, path: &str, body: Option<&Value>) -> Value {
        let body = body.map(Value::to_string).unwrap_or_default();
        let mut stream =
            TcpStream::connect(("127.0.0.1", self.port)).expect("chromedriver listens");
        stream
            .set_read_timeout(Some(2 * PATIENCE))
            .expect("a timeout can be set");
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nConnection: close\r\nContent-Type: application/json\r\n\
             Content-Length: {}\r\n\r\n{body}",
            self.port,
            body.len()
        )
        .expect("chromedriver reads");
        let answer: Value = serde_json::from_slice(&content(stream)).expect("JSON");
        assert!(
            answer["value"]["error"].is_null(),
            "{method} {path}: {answer}"
        );
        answer["value"].clone()
    }
}

/// Reads the body of a reply, up to its length: chromedriver does not close the connection.
fn content(stream: TcpStream) -> Vec<u8> {
    let mut reader = BufReader::new(stream);
    let mut length = 0;
    loop {
        let mut line = String::new();
        reader.read_line(&mut line).expect("chromedriver answers");
        let line = line.trim().to_ascii_lowercase();
        if let Some(number) = line.strip_prefix("content-length:") {
            length = number.trim().parse().expect("a number");
        }
        if line.is_empty() {
            break;
        }
    }
    let mut content = vec![0; length];
    reader.read_exact(&mut content).expect("the whole body");
    content
}

impl Drop for Browser {
    fn drop(&mut self) {
        // closes the browser's processes; the driver may have ended already
        if let Ok(mut stream) = TcpStream::connect(("127.0.0.1", self.port)) {
            let _ = write!(
                stream,
                "DELETE /session/{} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nConnection: close\r\n\r\n",
                self.session, self.port
            );
            let _ = content(stream);
        }
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}
