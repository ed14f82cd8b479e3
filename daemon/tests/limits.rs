//! What one client, and all together, may have of the daemon at once.

mod stage;

use std::os::fd::OwnedFd;

use bus::stream::{Body, Decoder};
use bus::{Address, ConnectError, Fault, Options, Session1Proxy};
use stage::{Running, SMALL, Stage, within};
use tokio::task::JoinSet;
use zbus::Connection;

async fn come(stage: &Stage) -> Result<Connection, ConnectError> {
    let address = Address::Unix(stage.path().join("run/peer"));
    let (connection, _) = within(bus::connect(Some(&address))).await?;
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

/// Tries until there is a place: one that was left is given back when the daemon notices.
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
async fn one_user_has_thirty_two_connections_to_the_peer_socket_and_more_are_closed() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let mut connections = Vec::new();
    // the first is the stage's own
    for _ in 1..32 {
        connections.push(come(&stage).await.unwrap());
    }
    for _ in 0..3 {
        assert!(come(&stage).await.is_err());
    }
    // who is there is not disturbed
    assert_eq!(within(daemon.manager.state()).await.unwrap(), "idle");
    drop(connections.pop());
    connections.push(at_last(async || come(&stage).await).await);
    let (_, log) = daemon.terminate().await;
    let said = log
        .lines()
        .filter(|line| line.contains("to the peer socket was closed: you have 32 connections"));
    assert_eq!(said.count(), 1, "{log}");
}

/// A session whose frames are taken one by one, so that nothing is said on its streams meanwhile.
async fn quiet(daemon: &Running) -> Session1Proxy<'static> {
    daemon.baseline(1).await;
    daemon.start(Options::new().with("step", true)).await
}

#[tokio::test(flavor = "multi_thread")]
async fn one_client_has_eight_streams_and_all_together_sixty_four() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let session = quiet(&daemon).await;
    let mut streams = Vec::new();
    let mut clients = Vec::new();
    for _ in 0..8 {
        let connection = come(&stage).await.unwrap();
        let theirs = Session1Proxy::builder(&connection)
            .path(session.inner().path().to_owned())
            .build()
            .await
            .unwrap();
        for _ in 0..8 {
            streams.push(open(&theirs).await.unwrap());
        }
        too_many(open(&theirs).await, "you have 8 open streams");
        clients.push(theirs);
    }
    too_many(open(&session).await, "all together have 64 open streams");
    // one that is closed is given back, though nothing has been written to it
    drop(streams.pop());
    streams.push(at_last(async || open(&session).await).await);
    too_many(open(&clients[7]).await, "all together have 64 open streams");

    // and they all hear of the frame and of the end
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
async fn one_client_has_sixty_four_calls_under_way() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let session = quiet(&daemon).await;
    let mut calls = JoinSet::new();
    for _ in 0..70 {
        let session = session.clone();
        calls.spawn(async move { session.wait().await });
    }
    for _ in 64..70 {
        let answer = within(calls.join_next()).await.unwrap().unwrap();
        assert!(
            matches!(&answer, Err(Fault::LimitsExceeded(why)) if why.contains("you have 64 calls")),
            "{answer:?}"
        );
    }
    // properties are answered at once, and another client's calls as well
    assert_eq!(session.state().await.unwrap(), "running");
    let other = come(&stage).await.unwrap();
    let theirs = Session1Proxy::builder(&other)
        .path(session.inner().path().to_owned())
        .build()
        .await
        .unwrap();
    within(theirs.stop()).await.unwrap();
    while let Some(answer) = within(calls.join_next()).await {
        answer.unwrap().unwrap();
    }
    daemon.manager.plan().await.unwrap();
}
