//! Attacks by calls open to all users: absurd numbers, abandoned calls, many requests for the list of sessions.

use std::time::{Duration, Instant};

use chrono::{DateTime, Utc};
use dbus::{BUS_NAME, MANAGER_INTERFACE, ROOT_PATH, SESSION_INTERFACE};
use dbus::{Fault, Manager1Proxy, Options};
use logbook::{SessionHeader, SessionWriter};
use survey::{Amps, Frame, Protocol, Reading, Settings, Volts};
use zbus::{Message, Structure, Variant};

use crate::calls::Call;
use crate::flood::{Flood, Width};
use crate::site::{Site, frames, within};
use crate::users::User;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn absurd_numbers_in_a_plan_end_no_session() {
    let Some(site) = Site::prepare().await else {
        return;
    };
    let mut daemon = site.start().await;
    daemon.baseline().await;
    let session = daemon.measure().await;
    let strangers = User::strangers(1, site.stage.path());
    let client = strangers[0].come_to_bus(site.bus.socket()).await.unwrap();
    let manager = Manager1Proxy::new(&client).await.unwrap();
    for option in ["nplc", "settle_ms", "channel_delay_ms"] {
        for number in [
            1e308,
            f64::MAX,
            1.9e19,
            f64::INFINITY,
            f64::NAN,
            -1.0,
            -1e308,
        ] {
            let options = Options::new().with(option, number);
            let answer = within(manager.plan_with(&options)).await;
            assert!(
                matches!(&answer, Err(Fault::InvalidOption(why)) if why.contains(option)),
                "{option} = {number}: {answer:?}\nthe session is {}: {}\n{}",
                session.state().await.unwrap(),
                session.last_error().await.unwrap(),
                daemon.daemon.log()
            );
        }
    }
    for averages in [0, u64::from(u32::MAX) + 2, u64::MAX] {
        let options = Options::new().with("averages", averages);
        let answer = within(manager.plan_with(&options)).await;
        assert!(
            matches!(&answer, Err(Fault::InvalidOption(_))),
            "{averages}: {answer:?}"
        );
    }
    let held = session.frames_durable().await.unwrap();
    frames(&session, held + 1).await;
    daemon.stop_by_command("system", &session).await;
    daemon.assert_nothing_missed(&session).await;
    daemon.assert_unharmed();
}

/// More calls than may be pending in total.
const LEFT_BEHIND: usize = 1_100;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn callers_who_left_hold_no_place() {
    let Some(site) = Site::prepare().await else {
        return;
    };
    let mut daemon = site.start().await;
    daemon.baseline().await;
    let session = daemon.measure().await;
    let strangers = User::strangers(1, site.stage.path());
    let before = daemon.size();
    let path = session.inner().path().to_owned();
    let begun = Instant::now();
    for _ in 0..LEFT_BEHIND {
        let client = strangers[0].come_to_bus(site.bus.socket()).await.unwrap();
        let wait = Message::method_call(path.clone(), "Wait")
            .destination(BUS_NAME)
            .interface(SESSION_INTERFACE)
            .build(&())
            .unwrap();
        client.send(&wait).await.unwrap();
        // all earlier messages have reached the daemon when this reply arrives
        let broker = Some("org.freedesktop.DBus");
        client
            .call_method(broker, "/org/freedesktop/DBus", broker, "GetId", &())
            .await
            .unwrap();
        client.close().await.unwrap();
    }
    println!(
        "{LEFT_BEHIND} calls of Wait were left behind in {:.1?}",
        begun.elapsed()
    );
    for way in ["system", "peer"] {
        let status = site.tactus(way, &["status", "--json"]);
        assert_eq!(status.code, Some(0), "{status:?}");
    }
    let took = daemon.stop_by_command("system", &session).await;
    println!("then `tactus stop` on system took {took:.2?}");
    daemon.assert_nothing_missed(&session).await;
    daemon.assert_unharmed();
    daemon.shrinks_to(before).await;
}

/// Number of sessions in the record, and frames of each.
const SESSIONS: usize = 20;
const FRAMES: usize = 300;
const WIDTH: Width = Width {
    connections: 18,
    at_once: 60,
};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_list_that_many_ask_for_delays_no_frame_or_stop() {
    let Some(site) = Site::prepare().await else {
        return;
    };
    for number in 0..SESSIONS {
        record(&site, &format!("m20260101t0000{number:02}_000"));
    }
    let mut daemon = site.start().await;
    daemon.baseline().await;
    let strangers = User::strangers(1, site.stage.path());
    for way in ["system", "peer"] {
        let session = daemon.measure().await;
        let before = daemon.size();
        let options = Variant::from(std::collections::HashMap::<String, Variant<'static>>::new());
        let list = Call {
            path: ROOT_PATH.to_owned(),
            interface: MANAGER_INTERFACE.to_owned(),
            member: "ListSessions".to_owned(),
            body: Some(Structure::builder().append_field(options).build().unwrap()),
        };
        let flood = Flood::begin(&site.bus, &strangers, WIDTH, vec![list]).await;
        let begun = Instant::now();
        let held = session.frames_durable().await.unwrap();
        frames(&session, held + 2).await;
        let took = daemon.stop_by_command(way, &session).await;
        let (answers, lasted) = (flood.answered(), begun.elapsed());
        println!(
            "{answers} answers of ListSessions in {lasted:.1?}: `tactus stop` on {way} took {took:.2?}: {:?}",
            flood.end().await
        );
        daemon.assert_nothing_missed(&session).await;
        daemon.assert_unharmed();
        daemon.shrinks_to(before).await;
    }
}

/// Writes a closed session to the record.
fn record(site: &Site, id: &str) {
    let folder = site.stage.state_path();
    std::fs::create_dir_all(&folder).unwrap();
    let at = DateTime::<Utc>::from_timestamp(1_767_225_600, 0).unwrap();
    let protocol = Protocol::sheffield(8).unwrap();
    let frame = Frame {
        readings: vec![Reading::Ok(Volts(0.1)); protocol.len()],
        sequence: 0,
        monotonic: Duration::ZERO,
        wall: at,
        duration: Duration::ZERO,
        settings: Settings {
            protocol_hash: protocol.hash(),
            current: Amps(1e-3),
            range: Volts(1.0),
            nplc: 0.02,
            settle: Duration::ZERO,
            wiring: "pairs-34924a".into(),
            precautions: Default::default(),
        },
        compliance: vec![],
        extra: vec![],
        simulated: true,
    };
    let mut writer = SessionWriter::create(&folder, &SessionHeader::new(id, at, protocol)).unwrap();
    let frames = vec![frame; FRAMES];
    writer
        .append_all(frames.iter().map(|frame| (frame, None)))
        .unwrap();
    writer.close(at, "asked to stop").unwrap();
}
