//! A private broker for a test, on a local port, and a client that receives all its messages.

use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{Packet, Publish};
use rumqttc::v5::{Client, Event, MqttOptions};
use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;

/// Ends a hung test.
const LIMIT: Duration = Duration::from_secs(90);

pub struct Mosquitto {
    folder: TempDir,
    port: u16,
    running: Option<Child>,
}

impl Mosquitto {
    /// Starts a broker with additional lines in its configuration, which may name files of `folder`; `None` (reported,
    /// kind `MOSQUITTO`) if mosquitto is not installed.
    pub fn start(folder: TempDir, more: &str) -> Option<Self> {
        if !needs::program("MOSQUITTO", "mosquitto") {
            return None;
        }
        let port = std::net::TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr());
        let port = port.expect("a port").port();
        let more = more.replace("FOLDER", &folder.path().to_string_lossy());
        // started by root, it would change to another user, who cannot read these files
        let text = format!("listener {port} 127.0.0.1\nuser root\npersistence false\n{more}");
        std::fs::write(folder.path().join("mosquitto.conf"), text).unwrap();
        let mut broker = Self {
            folder,
            port,
            running: None,
        };
        broker.resume();
        Some(broker)
    }

    /// A broker without access control.
    pub fn open() -> Option<Self> {
        Self::start(tempfile::tempdir().unwrap(), "allow_anonymous true\n")
    }

    pub fn port(&self) -> u16 {
        self.port
    }

    /// Starts it again; returns when it accepts connections.
    pub fn resume(&mut self) {
        let log = std::fs::File::create(self.folder.path().join("log")).unwrap();
        let child = Command::new("mosquitto")
            .arg("-c")
            .arg(self.folder.path().join("mosquitto.conf"))
            .stdout(Stdio::null())
            .stderr(log)
            .spawn();
        self.running = Some(child.expect("mosquitto starts"));
        let limit = Instant::now() + LIMIT;
        while std::net::TcpStream::connect(("127.0.0.1", self.port)).is_err() {
            let log = std::fs::read_to_string(self.folder.path().join("log")).unwrap();
            assert!(Instant::now() < limit, "mosquitto does not listen: {log}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Sends the broker a signal.
    pub fn signal(&self, signal: Signal) {
        signal_to(self.running.as_ref().expect("it runs"), signal);
    }

    pub fn kill(&mut self) {
        self.signal(Signal::KILL);
        self.running.take().expect("it runs").wait().unwrap();
    }

    /// A client that has subscribed to all topics.
    pub fn watch(&self) -> Watcher {
        static COUNT: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(0);
        let number = COUNT.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let mut options = MqttOptions::new(format!("watcher-{number}"), "127.0.0.1", self.port);
        options.set_max_packet_size(Some(1 << 20));
        let (client, mut events) = Client::new(options, 10);
        client.subscribe("#", QoS::AtLeastOnce).unwrap();
        let (messages, received) = channel();
        let (subscribed, ready) = channel();
        std::thread::spawn(move || {
            let mut is_subscribed = false;
            for event in events.iter() {
                match event {
                    Ok(Event::Incoming(Packet::SubAck(_))) => {
                        is_subscribed = true;
                        let _waiting = subscribed.send(());
                    }
                    Ok(Event::Incoming(Packet::Publish(message))) => {
                        if messages.send(message).is_err() {
                            return;
                        }
                    }
                    Ok(_) => {}
                    Err(_) if is_subscribed => return,
                    // a broker that has just started may refuse or close a connection; the client reconnects
                    Err(_) => std::thread::sleep(Duration::from_millis(20)),
                }
            }
        });
        ready.recv_timeout(LIMIT).expect("subscribed");
        Watcher {
            _client: client,
            received,
            seen: Vec::new(),
        }
    }
}

impl Drop for Mosquitto {
    fn drop(&mut self) {
        if self.running.is_some() {
            self.kill();
        }
    }
}

pub fn signal_to(child: &Child, signal: Signal) {
    let pid = Pid::from_raw(child.id().try_into().unwrap()).unwrap();
    kill_process(pid, signal).unwrap();
}

pub struct Watcher {
    _client: Client,
    received: Receiver<Publish>,
    /// All messages so far: topic and text.
    pub seen: Vec<(String, String)>,
}

impl Watcher {
    /// The next message of this topic whose JSON is as wanted.
    pub fn wait(
        &mut self,
        topic: &str,
        wanted: impl Fn(&serde_json::Value) -> bool,
    ) -> (Publish, serde_json::Value) {
        let limit = Instant::now() + LIMIT;
        loop {
            let left = limit.saturating_duration_since(Instant::now());
            let message = match self.received.recv_timeout(left) {
                Ok(message) => message,
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                    panic!("never so: {topic}; seen: {:#?}", self.seen)
                }
            };
            let of = String::from_utf8(message.topic.to_vec()).unwrap();
            let text = String::from_utf8(message.payload.to_vec()).unwrap();
            self.seen.push((of.clone(), text.clone()));
            let value = serde_json::from_str(&text).unwrap();
            if of == topic && wanted(&value) {
                return (message, value);
            }
        }
    }
}
