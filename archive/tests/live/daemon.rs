//! A fake daemon on a bus: it reports what a test sets.

use std::path::Path;
use std::sync::{Arc, Mutex};

use dbus::{
    AlarmReport, EventDetails, Fault, LatestQuantities, MapDetails, ROOT_PATH, SessionStatus,
    Status,
};
use tokio::net::UnixListener;
use tokio::runtime::Runtime;
use zbus::Connection;
use zbus::connection::Builder;
use zbus::interface;
use zbus::object_server::SignalEmitter;

/// The state that the fake daemon reports.
#[derive(Debug, Clone, Default)]
pub struct Report {
    pub status: Status,
    pub alarms: Vec<AlarmReport>,
    /// Error of the list of alarms; empty if it succeeds.
    pub alarms_fault: String,
    /// JSON of the running session's quantities.
    pub quantities: Option<String>,
    /// Number of status requests.
    asked: u64,
}

type Shared = Arc<Mutex<Report>>;

struct Manager1(Shared);
struct Alarms1(Shared);
struct Session1(Shared);

#[interface(name = "org.tactus.Tactus1.Manager1")]
impl Manager1 {
    #[zbus(out_args("status"))]
    async fn status(&self) -> Result<Status, Fault> {
        let mut report = self.0.lock().unwrap();
        report.asked += 1;
        Ok(report.status.clone())
    }

    #[zbus(signal)]
    async fn happened(
        emitter: &SignalEmitter<'_>,
        wall_ns: i64,
        kind: &str,
        text: &str,
        details: EventDetails,
    ) -> zbus::Result<()>;
}

#[interface(name = "org.tactus.Tactus1.Alarms1")]
impl Alarms1 {
    #[zbus(out_args("alarms"))]
    async fn list(&self) -> Result<Vec<AlarmReport>, Fault> {
        let report = self.0.lock().unwrap();
        match report.alarms_fault.is_empty() {
            true => Ok(report.alarms.clone()),
            false => Err(Fault::Failed(report.alarms_fault.clone())),
        }
    }
}

#[interface(name = "org.tactus.Tactus1.Session1")]
impl Session1 {
    #[zbus(out_args("quantities"))]
    async fn quantities(&self) -> Result<LatestQuantities, Fault> {
        let nothing = || Fault::NoFrame("the session has no quantities yet".into());
        let json = self
            .0
            .lock()
            .unwrap()
            .quantities
            .clone()
            .ok_or_else(nothing)?;
        Ok(LatestQuantities {
            sequence: 17,
            wall_ns: 1_800_000_000_000_000_000,
            json,
            simulated: true,
        })
    }
}

pub struct Daemon {
    runtime: Option<Runtime>,
    report: Shared,
    connections: Arc<Mutex<Vec<Connection>>>,
}

impl Daemon {
    /// Listens at `peer`.
    pub fn start(peer: &Path, report: Report) -> Self {
        let report = Arc::new(Mutex::new(report));
        let connections = Arc::new(Mutex::new(Vec::new()));
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .unwrap();
        let _ = std::fs::remove_file(peer);
        let listener = runtime
            .block_on(async { UnixListener::bind(peer) })
            .unwrap();
        let (shared, all) = (Arc::clone(&report), Arc::clone(&connections));
        runtime.spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                let stream = stream.into_std().unwrap();
                let served = Builder::unix_stream(stream)
                    .server(zbus::Guid::generate())
                    .p2p()
                    .serve_at(ROOT_PATH, Manager1(Arc::clone(&shared)))
                    .serve_at(ROOT_PATH, Alarms1(Arc::clone(&shared)))
                    .serve_at(
                        dbus::session_path("m1").unwrap(),
                        Session1(Arc::clone(&shared)),
                    )
                    .build();
                if let Ok(connection) = served.await {
                    all.lock().unwrap().push(connection);
                }
            }
        });
        Self {
            runtime: Some(runtime),
            report,
            connections,
        }
    }

    /// Changes what is reported, without a signal.
    pub fn change(&self, change: impl FnOnce(&mut Report)) {
        let mut report = self.report.lock().unwrap();
        let asked = report.asked;
        change(&mut report);
        report.asked = asked;
    }

    /// Number of status requests.
    pub fn requests(&self) -> u64 {
        self.report.lock().unwrap().asked
    }

    pub fn wait_until_requested(&self, count: u64) {
        crate::server::wait_until(
            || self.requests() >= count,
            || "the daemon is not asked".to_owned(),
        );
    }

    /// Reports an event on the bus.
    pub fn happen(&self) {
        let connections = self.connections.lock().unwrap().clone();
        let runtime = self.runtime.as_ref().unwrap();
        for connection in connections {
            runtime.block_on(async {
                let manager = connection
                    .object_server()
                    .interface::<_, Manager1>(ROOT_PATH);
                let manager = manager.await.unwrap();
                let details = EventDetails::default();
                // a closed connection gets no signal
                let _ =
                    Manager1::happened(manager.signal_emitter(), 0, "alarm-active", "x", details)
                        .await;
            });
        }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.connections.lock().unwrap().clear();
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(std::time::Duration::from_secs(10));
        }
    }
}

/// A daemon with a session of `frames` frames, an alarm and quantities of two regions.
pub fn report(frames: u64) -> Report {
    let session = SessionStatus {
        id: Some("m1".to_owned()),
        kind: Some("measurement".to_owned()),
        state: Some("running".to_owned()),
        frames_durable: Some(frames),
        map_sequence: Some(frames),
        map: Some(MapDetails {
            largest_loss: Some(0.25),
            ..MapDetails::default()
        }),
        ..SessionStatus::default()
    };
    let status = Status {
        state: Some("acquiring".to_owned()),
        simulated: Some(true),
        version: Some("0.1.0".to_owned()),
        session: Some(session),
        health: Some(dbus::Health {
            well: Some(false),
            troubles: Some(vec!["disk-days: the disk is full in 3 days".to_owned()]),
            ..dbus::Health::default()
        }),
        ..Status::default()
    };
    let heel = AlarmReport {
        name: Some("heel".to_owned()),
        severity: Some("major".to_owned()),
        level: Some("major".to_owned()),
        active: Some(true),
        acknowledged: Some(false),
        cause: Some("ppi 9.1 kPa, above 8 kPa".to_owned()),
        ..AlarmReport::default()
    };
    let hip = AlarmReport {
        name: Some("hip".to_owned()),
        level: Some("invalid".to_owned()),
        ..AlarmReport::default()
    };
    let quantities = "{\"known\":true,\"reason\":null,\"unit\":\"pressure\",\"regions\":[\
        {\"name\":\"sheet\",\"values\":{\"load\":412.5,\"contact\":1200.0}},\
        {\"name\":\"heel\",\"values\":{\"load\":90.0}}],\"spots\":[],\"changes\":[]}";
    Report {
        status,
        alarms: vec![heel, hip],
        quantities: Some(quantities.to_owned()),
        ..Report::default()
    }
}
