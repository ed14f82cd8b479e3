//! Sessions that begin while the daemon stops, reloads or panics, and the reconnection of a lost rig.

use std::sync::Arc;

use dbus::{Fault, Options};
use survey::Amps;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::timeout;

use crate::preparation::prepare;
use crate::recording::session_status::SessionStatus;
use crate::session::controller::Controller;
use crate::session::controller::resume::NotResumed;
use crate::session::panics::follow_panics;
use crate::session::panics::tests::{DEADLINE, alone, in_real_time};

/// Starts to record a baseline. When this returns, the checks have passed, and the start waits for the rig, which the
/// caller has locked: there is no session yet.
async fn starting(controller: &Arc<Controller>) -> JoinHandle<Result<Arc<SessionStatus>, Fault>> {
    let starting = Arc::clone(controller);
    let start = tokio::spawn(async move {
        let options = Options::new().with("frames", 100_u64);
        starting.record_baseline(&options).await
    });
    while controller.beginning.try_lock().is_ok() {
        tokio::task::yield_now().await;
    }
    start
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_begins_while_the_daemon_stops_is_ended() {
    let _alone = alone().await;
    let folder = tempfile::tempdir().unwrap();
    let (controller, sheet) = in_real_time(folder.path()).await;
    let rig = controller.source.lock().await;
    let start = starting(&controller).await;
    let stopping = Arc::clone(&controller);
    let stop = tokio::spawn(async move { stopping.shut_down("SIGTERM", true).await });
    while !controller.inner().stopping {
        tokio::task::yield_now().await;
    }
    drop(rig);
    stop.await.unwrap().unwrap();
    let status = start.await.unwrap().unwrap();
    assert_eq!(status.ended().await.reason, "SIGTERM");
    assert_eq!(sheet.source_output(), (false, Amps(0.0)));
    assert!(controller.active().is_none());
    let refused = controller.record_baseline(&Options::new()).await;
    assert!(matches!(refused, Err(Fault::SessionActive(_))));
    assert!(matches!(
        controller.test_instruments().await,
        Err(Fault::SessionActive(_))
    ));
    assert_eq!(sheet.source_output(), (false, Amps(0.0)));
}

#[tokio::test(flavor = "multi_thread")]
async fn one_task_looks_for_a_rig_that_is_lost_twice() {
    let _alone = alone().await;
    let folder = tempfile::tempdir().unwrap();
    let (controller, _) = in_real_time(folder.path()).await;
    // the rig cannot be reconnected while this is locked
    let _rig = controller.source.lock().await;
    controller.rig_lost("the source is gone");
    let first = controller.inner().recovery.clone().unwrap();
    controller.rig_lost("the switch is gone");
    let second = controller.inner().recovery.clone().unwrap();
    assert_eq!(second.what, "the switch is gone");
    assert_eq!(second.since, first.since);
}

#[test]
fn a_test_of_the_rig_does_not_end_a_waiting_resumption() {
    let busy = Fault::SessionActive("the rig is being tested".into());
    assert!(matches!(NotResumed::from(busy), NotResumed::Later(_)));
}

#[tokio::test]
async fn a_reload_during_a_start_waits_for_the_sessions_end() {
    let _alone = alone().await;
    let folder = tempfile::tempdir().unwrap();
    let (controller, _) = in_real_time(folder.path()).await;
    let current = || controller.runtime().setup.config.survey.current_ua;
    let before = current();
    let rig = controller.source.lock().await;
    let start = starting(&controller).await;
    let path = folder.path().join("config.toml");
    let other = std::fs::read_to_string(&path).unwrap();
    let other = other.replace("[survey]\n", "[survey]\ncurrent_ua = 250.0\n");
    std::fs::write(&path, other).unwrap();
    let prepared = prepare(&path).unwrap_or_else(|problems| panic!("{problems:?}"));
    let reloading = Arc::clone(&controller);
    let reload = tokio::spawn(async move { reloading.take_or_wait(prepared).await });
    // on one thread, this runs the reload until it waits
    tokio::task::yield_now().await;
    drop(rig);
    let status = start.await.unwrap().unwrap();
    let text = reload.await.unwrap().unwrap();
    assert!(
        text.contains(&format!("when session {} ends", status.facts.id)),
        "{text}"
    );
    assert_eq!(current(), before);
    status.stop("a test");
    status.ended().await;
    while current() == before {
        tokio::task::yield_now().await;
    }
}

#[tokio::test]
async fn a_panic_while_a_session_begins_ends_it() {
    let _alone = alone().await;
    let folder = tempfile::tempdir().unwrap();
    let (controller, sheet) = in_real_time(folder.path()).await;
    let (panicked, panics) = watch::channel(String::new());
    tokio::spawn(follow_panics(Arc::clone(&controller), panics));
    let rig = controller.source.lock().await;
    let start = starting(&controller).await;
    panicked.send_replace("a place".to_owned());
    // on one thread, this runs the task that handles the panic until it waits
    tokio::task::yield_now().await;
    drop(rig);
    let status = start.await.unwrap().unwrap();
    let end = timeout(DEADLINE, status.ended()).await.unwrap();
    assert!(end.faulted && end.reason.contains("a place"), "{end:?}");
    assert!(!sheet.source_output().0);
}
