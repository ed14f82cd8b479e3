//! Limits of the daemon, for one client and for all together.

use std::os::fd::OwnedFd;

use crate::stage::broker::Broker;
use crate::stage::{Running, SMALL, Stage, within};
use dbus::stream::{Body, Decoder};
use dbus::{Address, ConnectError, Fault, Manager1Proxy, Options, Session1Proxy};
use tokio::task::JoinSet;
use zbus::Connection;

async fn connect(stage: &Stage) -> Result<Connection, ConnectError> {
    let address = Address::Unix(stage.path().join("run/peer"));
    let (connection, _) = within(dbus::connect(Some(&address))).await?;
    Ok(connection)
}

async fn open(session: &Session1Proxy<'_>) -> Result<OwnedFd, Fault> {
    let stream = within(session.open_stream(&Options::new())).await?;
    Ok(OwnedFd::from(stream))
}

fn too_many(answer: Result<OwnedFd, Fault>, whose: &str) {
    assert!(
        matches!(&answer, Err(Fault::LimitsExceeded(why)) if why.contains(whose)),
        "{answer:?}"
    );
}

/// Retries until a slot is free: it is released when the daemon detects that a client has left.
async fn at_last<T, E>(mut attempt: impl AsyncFnMut() -> Result<T, E>) -> T {
    within(async {
        loop {
            match attempt().await {
                Ok(done) => return done,
                Err(_) => tokio::task::yield_now().await,
            }
        }
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn one_user_has_32_peer_connections_and_more_are_closed() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let mut connections = Vec::new();
    // the first is the connection of the test stage
    for _ in 1..32 {
        connections.push(connect(&stage).await.unwrap());
    }
    for _ in 0..3 {
        let error = connect(&stage).await.unwrap_err();
        assert!(
            matches!(&error, ConnectError::Busy { cause, .. } if cause.starts_with("you have 32")),
            "{error:?}"
        );
    }
    // existing clients are not affected
    assert_eq!(within(daemon.manager.state()).await.unwrap(), "idle");
    drop(connections.pop());
    connections.push(at_last(async || connect(&stage).await).await);
    let (_, log) = daemon.terminate().await;
    let text = log
        .lines()
        .filter(|line| line.contains("to the peer socket was closed: you have 32 connections"));
    assert_eq!(text.count(), 1, "{log}");
}

/// A session whose frames are taken on request, so that nothing is sent on its streams between the requests.
async fn step_session(daemon: &Running) -> Session1Proxy<'static> {
    daemon.baseline(1).await;
    daemon.start(Options::new().with("step", true)).await
}

#[tokio::test(flavor = "multi_thread")]
async fn one_user_has_sixteen_streams_on_all_connections() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let session = step_session(&daemon).await;
    let theirs = of_session(&session, &connect(&stage).await.unwrap()).await;
    let mut streams = Vec::new();
    for _ in 0..8 {
        streams.push(open(&session).await.unwrap());
        streams.push(open(&theirs).await.unwrap());
    }
    for another in [&session, &theirs] {
        too_many(open(another).await, "you have 16 open streams");
    }
    // a closed stream is released, although nothing has been written to it
    drop(streams.pop());
    streams.push(at_last(async || open(&session).await).await);
    too_many(open(&theirs).await, "you have 16 open streams");

    // and all streams receive the frame and the end
    within(session.step(1)).await.unwrap();
    within(session.stop()).await.unwrap();
    for stream in streams {
        let read = tokio::task::spawn_blocking(move || {
            let mut bytes = Vec::new();
            std::io::Read::read_to_end(&mut std::fs::File::from(stream), &mut bytes).map(|_| bytes)
        });
        let bytes = within(read).await.unwrap().unwrap();
        let mut decoder = Decoder::new();
        decoder.push(&bytes);
        let mut bodies = Vec::new();
        while let Some(record) = decoder.next_record().unwrap() {
            bodies.push(record.body);
        }
        assert!(matches!(bodies.first(), Some(Body::Frame { .. })));
        assert!(matches!(bodies.last(), Some(Body::End { .. })));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn one_user_has_thirty_two_calls_that_wait() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let session = step_session(&daemon).await;
    let mut calls = JoinSet::new();
    let other = connect(&stage).await.unwrap();
    let theirs = of_session(&session, &other).await;
    for _ in 0..19 {
        for session in [session.clone(), theirs.clone()] {
            calls.spawn(async move { session.wait().await });
        }
    }
    for _ in 32..38 {
        let answer = within(calls.join_next()).await.unwrap().unwrap();
        assert!(
            matches!(&answer, Err(Fault::LimitsExceeded(why)) if why.contains("you have 32 calls that wait")),
            "{answer:?}"
        );
    }
    // methods with an immediate reply, and stopping, have separate slots
    assert_eq!(session.state().await.unwrap(), "running");
    within(daemon.manager.health()).await.unwrap();
    within(theirs.stop()).await.unwrap();
    while let Some(answer) = within(calls.join_next()).await {
        answer.unwrap().unwrap();
    }
    daemon.manager.plan().await.unwrap();
}

async fn of_session(
    session: &Session1Proxy<'_>,
    connection: &Connection,
) -> Session1Proxy<'static> {
    Session1Proxy::builder(connection)
        .path(session.inner().path().to_owned())
        .build()
        .await
        .unwrap()
}

/// Sends a call of Wait and disconnects without waiting for the reply.
async fn wait_and_disconnect(connection: Connection, session: &Session1Proxy<'_>) {
    let call = zbus::message::Message::method_call(session.inner().path(), "Wait")
        .destination(dbus::BUS_NAME)
        .interface(dbus::SESSION_INTERFACE)
        .build(&())
        .unwrap();
    connection.send(&call).await.unwrap();
    let _ = connection.close().await;
}

/// Whether a call of Wait is accepted: it is not rejected during twenty replies on the same connection.
async fn waits(session: &Session1Proxy<'_>) -> Result<(), ()> {
    let answered = async {
        for _ in 0..20 {
            session.state().await.unwrap();
        }
    };
    tokio::select! {
        biased;
        answer = session.wait() => {
            assert!(matches!(answer, Err(Fault::LimitsExceeded(_))), "{answer:?}");
            Err(())
        }
        () = answered => Ok(()),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn waiting_calls_end_when_their_callers_leave() {
    let stage = Stage::new(&SMALL.replace("[bus]", "[bus]\nsystem = true"));
    let Some(broker) = Broker::start(stage.path()) else {
        return;
    };
    let daemon = stage.start_on_bus(&broker.address).await;
    let session = step_session(&daemon).await;
    for _ in 0..1100 {
        wait_and_disconnect(broker.connect().await, &session).await;
    }
    for _ in 0..100 {
        let connection = at_last(async || connect(&stage).await).await;
        wait_and_disconnect(connection, &session).await;
    }
    // the slots are free again on both transports; stopping needs no slot
    let on_bus = broker.connect().await;
    for connection in [&on_bus, &connect(&stage).await.unwrap()] {
        let theirs = of_session(&session, connection).await;
        within(at_last(async || waits(&theirs).await)).await;
    }
    let manager = Manager1Proxy::new(&on_bus).await.unwrap();
    within(manager.health()).await.unwrap();
    within(of_session(&session, &on_bus).await.stop())
        .await
        .unwrap();
    assert_eq!(within(manager.state()).await.unwrap(), "idle");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_looks_does_not_hold_up_a_stop() {
    let stage = Stage::new(&SMALL.replace("[bus]", "[bus]\nsystem = true"));
    let Some(broker) = Broker::start(stage.path()) else {
        return;
    };
    let daemon = stage.start_on_bus(&broker.address).await;
    let first = daemon.baseline(1).await.path().await.unwrap();
    for number in 0..20 {
        let copy = stage.path().join(format!("state/copy_{number}.tactus"));
        std::fs::copy(&first, copy).unwrap();
    }
    for on_bus in [false, true] {
        let session = daemon.start(Options::new().with("every_s", 0.05)).await;
        let own = match on_bus {
            true => broker.connect().await,
            false => connect(&stage).await.unwrap(),
        };
        let own = of_session(&session, &own).await;
        let mut frames = own.receive_frame_done().await.unwrap();
        within(dbus::next(&mut frames)).await.unwrap();
        // signals that nobody reads would delay the replies on this connection
        drop(frames);
        let mut looks = JoinSet::new();
        for _ in 0..18 {
            let manager = Manager1Proxy::new(&broker.connect().await).await.unwrap();
            for _ in 0..30 {
                let (lists, plans) = (manager.clone(), manager.clone());
                looks.spawn(async move { lists.list_sessions(&Options::new()).await.map(drop) });
                looks.spawn(async move {
                    let options = Options::new().with("nplc", 0.2);
                    plans.plan_with(&options).await.map(drop)
                });
            }
        }
        let requested = std::time::Instant::now();
        let stopped = within(own.stop()).await;
        let took = requested.elapsed();
        println!("stopped after {:.1} ms", 1e3 * took.as_secs_f64());
        stopped.unwrap();
        // one second on an idle machine
        assert!(took.as_secs() < 10, "{took:?}");
        assert_eq!(own.frames_failed().await.unwrap(), 0);
        while let Some(look) = within(looks.join_next()).await {
            let look = look.unwrap();
            assert!(
                matches!(look, Ok(()) | Err(Fault::LimitsExceeded(_))),
                "{look:?}"
            );
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn ten_thousand_sessions_hold_up_neither_start_nor_list() {
    const SESSIONS: usize = 10_000;
    let stage = Stage::new(SMALL);
    let begun = std::time::Instant::now();
    let daemon = stage.start().await;
    println!(
        "ready with no session: {:.0} ms",
        1e3 * begun.elapsed().as_secs_f64()
    );
    let first = daemon.baseline(1).await.path().await.unwrap();
    daemon.terminate().await;
    for number in 0..SESSIONS {
        let name = format!("state/copy_{number}.tactus");
        std::fs::hard_link(&first, stage.path().join(name)).unwrap();
    }
    let start = async |what: &str| {
        let begun = std::time::Instant::now();
        let daemon = stage.start().await;
        let took = begun.elapsed();
        println!(
            "ready with {SESSIONS} sessions, {what}: {:.0} ms",
            1e3 * took.as_secs_f64()
        );
        // one second on an idle machine
        assert!(took.as_secs() < 60, "{took:?}");
        daemon
    };
    let daemon = start("nothing known of them").await;
    // while the session files are being read, the state is correct and the daemon can be stopped
    assert_eq!(within(daemon.manager.state()).await.unwrap(), "idle");
    let (status, _) = daemon.terminate().await;
    assert!(status.success());

    // a session is started after the files have been read: its baseline is in one of them
    let daemon = start("nothing known of them").await;
    let session = daemon.start(Options::new().with("step", true)).await;
    within(session.stop()).await.unwrap();
    let listed = async |daemon: &Running| {
        let begun = std::time::Instant::now();
        let listed = within(daemon.manager.list_sessions(&Options::new()))
            .await
            .unwrap();
        let took = begun.elapsed();
        println!(
            "{} of {SESSIONS} sessions listed in {:.1} ms",
            listed.len(),
            1e3 * took.as_secs_f64()
        );
        assert_eq!(listed.len(), 1000);
        // 50 ms on an idle machine
        assert!(took.as_secs() < 30, "{took:?}");
        listed
    };
    assert_eq!(listed(&daemon).await[0].kind, "measurement");
    listed(&daemon).await;
    daemon.terminate().await;

    let daemon = start("known from before").await;
    assert!(
        !within(daemon.manager.baseline_id())
            .await
            .unwrap()
            .is_empty()
    );
    listed(&daemon).await;
}
