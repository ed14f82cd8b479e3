//! Sessions that begin while the daemon stops, and the search for a lost rig.

use std::sync::Arc;

use dbus::{Fault, Options};
use survey::Amps;

use crate::session::controller::resume::NotResumed;
use crate::session::panics::tests::{alone, in_real_time};

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_begins_while_the_daemon_stops_is_ended() {
    let _alone = alone().await;
    let folder = tempfile::tempdir().unwrap();
    let (controller, sheet) = in_real_time(folder.path()).await;
    // the start waits for the rig: it has passed its checks, and there is no session yet
    let rig = controller.source.lock().await;
    let starting = Arc::clone(&controller);
    let start = tokio::spawn(async move {
        let options = Options::new().with("frames", 100_u64);
        starting.record_baseline(&options).await
    });
    while controller.beginning.try_lock().is_ok() {
        tokio::task::yield_now().await;
    }
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
    // nobody finds it while this is locked
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
