//! Follows a daemon: queries its status each second, and reads its events and the stream of the running session.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use dbus::json::Alarm;
use dbus::stream::{Body, Decoder, Record};
use dbus::{Address, Alarms1Proxy, Fault, Manager1Proxy, Session1Proxy, StreamOptions};
use serde_json::{Value, json};
use tokio::io::AsyncReadExt;
use tokio::net::UnixStream;
use tokio::time::{MissedTickBehavior, interval, sleep};
use zbus::Connection;

use crate::snapshot::{DaemonState, EventState, FrameState, Live, SessionState};

/// Interval of the queries of the status.
const STATUS_INTERVAL: Duration = Duration::from_secs(1);
/// Time between two attempts to reach a daemon.
const RETRY_INTERVAL: Duration = Duration::from_secs(2);
/// Timeout of a call.
const PATIENCE: Duration = Duration::from_secs(10);
/// Records that the daemon buffers for this reader.
const RING: u64 = 64;
/// Most frames that wait for their maps.
const FRAMES: usize = 1024;

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Keeps `live` up to date, and reconnects for ever. `address`: of the bus; `None` for the default addresses.
pub async fn follow(address: Option<Address>, live: Live) {
    loop {
        let lost = match connected(address.as_ref(), &live).await {
            Ok(()) => "the daemon has closed the connection".to_owned(),
            Err(error) => error.to_string(),
        };
        live.change(|snapshot| {
            snapshot.state.trouble = Some(lost);
            snapshot.state.daemon = None;
            snapshot.state.session = None;
            snapshot.state.alarms.clear();
        });
        sleep(RETRY_INTERVAL).await;
    }
}

/// One connection, until it ends.
async fn connected(address: Option<&Address>, live: &Live) -> Result<(), Failure> {
    let (connection, _) = tokio::time::timeout(PATIENCE, dbus::connect(address)).await??;
    let manager: Manager1Proxy<'_> = dbus::proxy(&connection, dbus::ROOT_PATH).await?;
    let alarms = Alarms1Proxy::new(&connection).await?;
    let mut events = manager.receive_happened().await?;
    let mut ticks = interval(STATUS_INTERVAL);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut following: Option<Following> = None;
    loop {
        tokio::select! {
            _ = ticks.tick() => {
                let status = tokio::time::timeout(PATIENCE, manager.status()).await??;
                let session = status.session.as_ref().map(session_state);
                let running = status.session.as_ref().and_then(|session| session.id.clone());
                let mut trouble = None;
                if running.as_deref() != following.as_ref().map(|following| following.id.as_str()) {
                    following = None;
                    if let Some(id) = running {
                        // the session may have ended since the status; if not, the next status opens it again
                        let opening = Following::open(&connection, &manager, id.clone(), session.clone(), live);
                        // it makes four calls
                        let opened = tokio::time::timeout(4 * PATIENCE, opening).await;
                        match opened.unwrap_or_else(|late| Err(late.into())) {
                            Ok(opened) => following = Some(opened),
                            Err(error) => trouble = Some(format!("the frames of {id} cannot be read: {error}")),
                        }
                    }
                }
                let listed = tokio::time::timeout(PATIENCE, alarms.list()).await??;
                let listed = listed.into_iter().map(Alarm::from).collect();
                live.change(|snapshot| {
                    snapshot.state.alarms = listed;
                    snapshot.state.trouble = trouble;
                    snapshot.state.daemon = Some(daemon_state(&status));
                    snapshot.set_session(session);
                });
            }
            event = dbus::next(&mut events) => {
                let Some(event) = event else { return Ok(()) };
                if let Ok(event) = event.args() {
                    let event = EventState {
                        wall_ms: event.wall_ns / 1_000_000,
                        kind: event.kind.to_owned(),
                        text: event.text.to_owned(),
                    };
                    live.change(|snapshot| snapshot.add_event(event));
                }
            }
            ended = read(&mut following, live) => {
                ended?;
                // the next status names the session that runs then
                following = None;
            }
        }
    }
}

/// Reads the stream of a session until it ends; without a session it waits for ever.
async fn read(following: &mut Option<Following>, live: &Live) -> Result<(), Failure> {
    match following {
        None => std::future::pending().await,
        Some(following) => following.read(live).await,
    }
}

fn daemon_state(status: &dbus::Status) -> DaemonState {
    let health = status.health.clone().unwrap_or_default();
    let text = |value: &Option<String>| value.clone().unwrap_or_default();
    DaemonState {
        state: text(&status.state),
        simulated: status.simulated.unwrap_or(false),
        source: text(&status.source),
        source_state: text(&status.source_state),
        method: text(&status.method),
        baseline: text(&status.baseline_id),
        baseline_age_s: health.baseline_age_s,
        baseline_remarks: status.baseline_remarks.clone().unwrap_or_default(),
        version: text(&status.version),
        well: health.well,
        troubles: health.troubles.unwrap_or_default(),
        instruments: health.instruments.unwrap_or_default(),
        disk_days: health.disk_days,
        last_error: status.last_error.clone().filter(|text| !text.is_empty()),
        lost: status
            .recovery
            .as_ref()
            .and_then(|recovery| recovery.what.clone()),
    }
}

fn session_state(session: &dbus::SessionStatus) -> SessionState {
    let text = |value: &Option<String>| value.clone().unwrap_or_default();
    SessionState {
        id: text(&session.id),
        kind: text(&session.kind),
        state: text(&session.state),
        frames: session.frames_acquired,
        failed: session.frames_failed,
        dropped: session.frames_dropped,
        map_noise: session.map_noise,
        last_error: session.last_error.clone().filter(|text| !text.is_empty()),
    }
}

/// The stream of a session.
struct Following {
    id: String,
    stream: UnixStream,
    decoder: Decoder,
    bytes: Vec<u8>,
    /// Frames whose maps may still come, the oldest first.
    frames: VecDeque<FrameState>,
    pressure: Option<(u64, Vec<f64>)>,
    /// Records of a frame that arrive before its map, by name, with the number of the frame.
    beside: HashMap<&'static str, (u64, Value)>,
}

impl Following {
    async fn open(
        connection: &Connection,
        manager: &Manager1Proxy<'_>,
        id: String,
        state: Option<SessionState>,
        live: &Live,
    ) -> Result<Self, Failure> {
        let session: Session1Proxy<'_> = dbus::proxy(connection, dbus::session_path(&id)?).await?;
        let geometry = manager.geometry().await?;
        let options = StreamOptions {
            frames: Some(true),
            maps: Some(true),
            pressure: Some(true),
            quality: Some(true),
            injections: None,
            deviations: None,
            ring: Some(RING),
        };
        let descriptor = session.open_stream(&options).await?;
        let stream = std::os::unix::net::UnixStream::from(std::os::fd::OwnedFd::from(descriptor));
        stream.set_nonblocking(true)?;
        live.change(|snapshot| {
            snapshot.geometry = Some(Arc::new(geometry));
            // after a lost stream, the same session is opened again
            snapshot.forget_frames();
            snapshot.set_session(state);
        });
        let mut following = Self {
            id,
            stream: UnixStream::from_std(stream)?,
            decoder: Decoder::new(),
            bytes: vec![0; 64 * 1024],
            frames: VecDeque::new(),
            pressure: None,
            beside: HashMap::new(),
        };
        // a session with a long period may have no new frame for minutes: show the latest map meanwhile
        if let Some(latest) = Fault::available(session.latest_map().await)? {
            let pressure = Fault::available(session.latest_pressure().await)?;
            following.show_latest(latest, pressure, live);
        }
        Ok(following)
    }

    fn show_latest(
        &mut self,
        latest: dbus::LatestMap,
        pressure: Option<dbus::LatestPressure>,
        live: &Live,
    ) {
        let parsed = |json: &Option<String>| {
            json.as_deref()
                .and_then(|json| serde_json::from_str(json).ok())
        };
        let quality = latest.more.quality.clone().map(|verdict| {
            json!({"verdict": verdict, "reasons": latest.more.doubts.iter().map(|text| json!({"kind": "", "electrode": null, "text": text})).collect::<Vec<_>>()})
        });
        for (name, value) in [
            ("quality", quality),
            ("tracked", parsed(&latest.more.tracked)),
            ("quantities", parsed(&latest.more.quantities)),
        ] {
            if let Some(value) = value {
                self.beside.insert(name, (latest.sequence, value));
            }
        }
        self.pressure = pressure.map(|pressure| (pressure.sequence, pressure.kpa));
        self.frames.push_back(FrameState {
            sequence: latest.sequence,
            wall_ms: latest.wall_ns / 1_000_000,
            simulated: latest.simulated,
            ..FrameState::default()
        });
        self.show_map(latest.sequence, &latest.values, latest.method, live);
    }

    /// Reads until the session ends.
    async fn read(&mut self, live: &Live) -> Result<(), Failure> {
        loop {
            while let Some(record) = self.decoder.next_record()? {
                if matches!(record.body, Body::End { .. }) {
                    return Ok(());
                }
                self.take(record, live);
            }
            let count = self.stream.read(&mut self.bytes).await?;
            if count == 0 {
                return Ok(());
            }
            self.decoder.push(&self.bytes[..count]);
        }
    }

    fn take(&mut self, record: Record, live: &Live) {
        let sequence = record.sequence;
        let mut keep = |name, json: &str| {
            if let Ok(value) = serde_json::from_str(json) {
                self.beside.insert(name, (sequence, value));
            }
        };
        match record.body {
            Body::Frame { volts, flags } => {
                let frame = FrameState {
                    sequence,
                    wall_ms: record.wall_ns / 1_000_000,
                    simulated: record.simulated,
                    gap: record.gap,
                    readings: flags.len(),
                    missing: flags.iter().filter(|flag| **flag != 0).count(),
                    ..FrameState::default()
                };
                self.frames.push_back(frame.clone());
                if self.frames.len() > FRAMES {
                    self.frames.pop_front();
                }
                let valid = volts
                    .iter()
                    .zip(&flags)
                    .map(|(volts, flag)| (*flag == 0).then_some(*volts));
                let readings = valid.collect();
                live.change(|snapshot| {
                    snapshot.state.frame = Some(frame);
                    snapshot.readings = Some((sequence, readings));
                });
            }
            Body::Map { values, method, .. } => self.show_map(sequence, &values, method, live),
            Body::Pressure { kpa, .. } => self.pressure = Some((sequence, kpa)),
            Body::Quality { json } => keep("quality", &json),
            Body::Tracked { json } => keep("tracked", &json),
            Body::Quantities { json } => keep("quantities", &json),
            // these are not requested, and the end is handled by the caller
            Body::Injection { .. } | Body::Deviation { .. } | Body::End { .. } => {}
        }
    }

    /// Shows a map with the records that came before it. Without a calibration the values are losses, so that a load is
    /// positive.
    fn show_map(&mut self, sequence: u64, values: &[f64], method: String, live: &Live) {
        let pressure = self.pressure.take().filter(|(of, _)| *of == sequence);
        let (unit, shown): (_, Vec<f32>) = match &pressure {
            Some((_, kpa)) => ("kPa", kpa.iter().map(|kpa| *kpa as f32).collect()),
            None => (
                "lost share",
                values.iter().map(|value| -*value as f32).collect(),
            ),
        };
        let mut beside = |name| {
            let (of, value) = self.beside.remove(name)?;
            (of == sequence).then_some(value)
        };
        // the map of a slow method arrives after later frames; the frames before the map's own will have none
        self.frames.retain(|frame| frame.sequence >= sequence);
        if self
            .frames
            .front()
            .is_none_or(|frame| frame.sequence != sequence)
        {
            return;
        }
        let of = self.frames.pop_front().unwrap_or_default();
        let frame = FrameState {
            map: true,
            method: Some(method),
            unit: Some(unit),
            largest_loss: values.iter().map(|value| -value).reduce(f64::max),
            quality: beside("quality"),
            tracked: beside("tracked"),
            quantities: beside("quantities"),
            ..of
        };
        live.change(|snapshot| {
            snapshot.keep_map(sequence, &shown);
            snapshot.state.frame = Some(frame);
        });
    }
}

#[cfg(test)]
mod tests {
    use tokio::net::UnixListener;
    use tokio::sync::Notify;

    use super::*;

    /// A daemon with a session, which does not reply to the query of the geometry.
    struct Manager1(Arc<Notify>);

    #[zbus::interface(name = "org.tactus.Tactus1.Manager1")]
    impl Manager1 {
        async fn status(&self) -> dbus::Status {
            dbus::Status {
                session: Some(dbus::SessionStatus {
                    id: Some("m1".to_owned()),
                    ..dbus::SessionStatus::default()
                }),
                ..dbus::Status::default()
            }
        }

        async fn geometry(&self) -> dbus::Geometry {
            self.0.notify_one();
            std::future::pending().await
        }
    }

    struct Alarms1;

    #[zbus::interface(name = "org.tactus.Tactus1.Alarms1")]
    impl Alarms1 {
        async fn list(&self) -> Vec<dbus::AlarmReport> {
            Vec::new()
        }
    }

    #[tokio::test]
    async fn session_that_is_not_opened_is_not_awaited_for_ever() {
        let folder = tempfile::tempdir().unwrap();
        let peer = folder.path().join("peer");
        let listener = UnixListener::bind(&peer).unwrap();
        let (live, queried) = (Live::default(), Arc::new(Notify::new()));
        tokio::spawn(follow(Some(Address::Unix(peer)), live.clone()));
        let (stream, _) = listener.accept().await.unwrap();
        let _daemon = zbus::connection::Builder::unix_stream(stream.into_std().unwrap())
            .server(zbus::Guid::generate())
            .p2p()
            .serve_at(dbus::ROOT_PATH, Manager1(Arc::clone(&queried)))
            .serve_at(dbus::ROOT_PATH, Alarms1)
            .build()
            .await
            .unwrap();
        queried.notified().await;
        tokio::time::pause();
        tokio::time::advance(PATIENCE).await;
        tokio::time::resume();
        let mut followed = live.subscribe();
        let trouble = followed.wait_for(|snapshot| {
            let trouble = snapshot.state.trouble.as_deref().unwrap_or_default();
            trouble.starts_with("the frames of m1 cannot be read: ")
        });
        let shown = tokio::time::timeout(Duration::from_secs(120), trouble).await;
        shown.expect("it is shown").unwrap();
    }

    fn record(sequence: u64, body: Body) -> Record {
        Record {
            sequence,
            wall_ns: 1_000_000_000 * sequence as i64,
            gap: 0,
            simulated: true,
            body,
        }
    }

    #[tokio::test]
    async fn a_map_that_later_frames_overtook_is_shown() {
        let (stream, _other) = UnixStream::pair().unwrap();
        let mut following = Following {
            id: "m1".to_owned(),
            stream,
            decoder: Decoder::new(),
            bytes: Vec::new(),
            frames: VecDeque::new(),
            pressure: None,
            beside: HashMap::new(),
        };
        let live = Live::default();
        let mut take = |sequence, body| following.take(record(sequence, body), &live);
        let map = || Body::Map {
            values: vec![-0.25],
            mesh_hash: String::new(),
            method: "slow".to_owned(),
        };
        let shown = || {
            let followed = live.subscribe();
            let snapshot = followed.borrow();
            let frame = snapshot.state.frame.as_ref().unwrap();
            (frame.sequence, frame.map, frame.wall_ms)
        };
        for sequence in 1..=3 {
            let (volts, flags) = (vec![0.5, f64::NAN], vec![0, 1]);
            take(sequence, Body::Frame { volts, flags });
        }
        assert_eq!(shown(), (3, false, 3000));
        let readings = live.subscribe().borrow().readings.clone().unwrap();
        assert_eq!((readings.0, &*readings.1), (3, &[Some(0.5), None][..]));
        take(2, map());
        assert_eq!(shown(), (2, true, 2000));
        // the map of an earlier frame, which arrives too late
        take(1, map());
        assert_eq!(shown(), (2, true, 2000));
        take(3, map());
        assert_eq!(shown(), (3, true, 3000));
        // the map of a frame that was never received
        take(9, map());
        assert_eq!(shown(), (3, true, 3000));
    }
}
