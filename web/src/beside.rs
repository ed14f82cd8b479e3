//! Maps of a running session that this process computes in addition to those of the daemon, from the readings that the
//! daemon sends: a provisional map while a slow method works, and standard deviations on request.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::playback::Recordings;
use crate::running::{DEVIATION, RunningModel};
use crate::snapshot::Live;

/// Least time between two maps of standard deviations, for any number of pages.
const DEVIATIONS: Duration = Duration::from_secs(2);
/// Time after which a session that could not be read is tried again.
const AGAIN: Duration = Duration::from_secs(10);
/// Time after the last request for the state at which no page counts as open: an open page requests it at least every
/// half of this time.
const WATCHED: Duration = Duration::from_secs(30);

/// Standard deviations of a frame of a session.
#[derive(Debug, Serialize)]
pub(crate) struct DeviationMap {
    /// Id of the session.
    session: String,
    /// Number of the frame.
    sequence: u64,
    unit: &'static str,
    #[serde(skip)]
    pub(crate) values: Vec<f32>,
}

type Opened = Result<Arc<dyn RunningModel>, String>;
/// Session, sequence, time of the request, and its result.
type Requested = (String, u64, Instant, Result<Arc<DeviationMap>, String>);

/// Opens the running session when a map of it is needed.
pub(crate) struct Beside {
    recordings: Arc<dyn Recordings>,
    /// Session, time of the attempt to open it, and its result.
    opened: Mutex<Option<(String, Instant, Opened)>>,
    /// When a page last read the state.
    watched: Mutex<Option<Instant>>,
    /// The last request; the lock is held while a map is computed.
    deviation: Mutex<Option<Requested>>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Beside {
    pub(crate) fn new(recordings: Arc<dyn Recordings>) -> Self {
        Self {
            recordings,
            opened: Mutex::default(),
            watched: Mutex::default(),
            deviation: Mutex::default(),
        }
    }

    /// Records that a page reads the state.
    pub(crate) fn set_watched(&self) {
        *locked(&self.watched) = Some(Instant::now());
    }

    fn is_watched(&self) -> bool {
        locked(&self.watched).is_some_and(|at| at.elapsed() < WATCHED)
    }

    /// The model of a session. The first call also prepares the session's method, which can take long.
    fn model(&self, id: &str) -> Opened {
        let mut opened = locked(&self.opened);
        if let Some((of, at, found)) = opened.as_ref()
            && of == id
            && (found.is_ok() || at.elapsed() < AGAIN)
        {
            return found.clone();
        }
        let found = self.recordings.running(id).and_then(|model| {
            model.ok_or_else(|| format!("the record of {id} cannot be read from here"))
        });
        *opened = Some((id.to_owned(), Instant::now(), found.clone()));
        found
    }

    /// Standard deviations of the last frame. Within [`DEVIATIONS`] after a computation, those of that earlier frame.
    ///
    /// # Errors
    /// A sentence why the standard deviations are unknown.
    pub(crate) fn deviation(&self, live: &Live) -> Result<Arc<DeviationMap>, String> {
        let mut last = locked(&self.deviation);
        let (session, sequence, readings) = {
            let followed = live.subscribe();
            let snapshot = followed.borrow();
            let session = snapshot.state.session.as_ref();
            let session = session.map(|session| session.id.clone());
            let session = session.ok_or("no session runs")?;
            let (sequence, readings) = snapshot.readings.clone().ok_or("no frame has come yet")?;
            (session, sequence, readings)
        };
        if let Some((of, number, at, made)) = last.as_ref()
            && *of == session
            && (*number == sequence || at.elapsed() < DEVIATIONS)
        {
            return made.clone();
        }
        let model = self.model(&session);
        let made = model.and_then(|model| model.deviation(&readings));
        let made = made.map(|values| {
            Arc::new(DeviationMap {
                session: session.clone(),
                sequence,
                unit: DEVIATION,
                values,
            })
        });
        *last = Some((session, sequence, Instant::now(), made.clone()));
        made
    }
}

/// Runs for ever: while a page is open, shows a provisional map of each frame if the session's own method is slow.
pub(crate) async fn show_provisional(beside: Arc<Beside>, live: Live) {
    let mut followed = live.subscribe();
    let mut last = None;
    loop {
        let found = {
            let snapshot = followed.borrow_and_update();
            let session = snapshot.state.session.as_ref();
            let frame = snapshot.state.frame.as_ref().filter(|frame| !frame.map);
            session
                .zip(frame)
                .zip(snapshot.readings.clone())
                .filter(|((_, frame), (of, _))| *of == frame.sequence)
                .map(|((session, _), (of, readings))| ((session.id.clone(), of), readings))
        };
        let found = found.filter(|(frame, _)| last.as_ref() != Some(frame) && beside.is_watched());
        if let Some((frame, readings)) = found {
            let (beside, (id, sequence)) = (Arc::clone(&beside), frame.clone());
            let session = id.clone();
            last = Some(frame);
            let made = tokio::task::spawn_blocking(move || {
                let model = beside.model(&id).ok().filter(|model| !model.is_fast())?;
                model.provisional(&readings).ok()
            });
            // if there is no provisional map, the page waits for the session's own map
            if let Ok(Some(made)) = made.await {
                live.show_provisional(&session, sequence, made);
            }
        }
        if followed.changed().await.is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::running::ProvisionalMap;
    use crate::snapshot::{FrameState, SessionState};
    use crate::tests::{code, served_from};
    use crate::{Playback, SessionList};
    use std::sync::atomic::{AtomicU64, Ordering};

    /// A session with a slow method; the value of its maps is the first reading.
    #[derive(Default, Clone)]
    struct Slow(Arc<AtomicU64>);

    impl RunningModel for Slow {
        fn is_fast(&self) -> bool {
            false
        }

        fn provisional(&self, readings: &[Option<f64>]) -> Result<ProvisionalMap, String> {
            Ok(ProvisionalMap {
                method: "one-step".to_owned(),
                unit: "lost share",
                provisional: "provisional: of a test".to_owned(),
                values: vec![readings[0].ok_or("no reading")? as f32],
            })
        }

        fn deviation(&self, readings: &[Option<f64>]) -> Result<Vec<f32>, String> {
            self.0.fetch_add(1, Ordering::Relaxed);
            Ok(vec![
                readings[0].ok_or("a reading is missing")? as f32,
                f32::NAN,
            ])
        }
    }

    impl Recordings for Slow {
        fn list(&self) -> Result<SessionList, String> {
            Ok(SessionList::default())
        }

        fn open(&self, _: &str) -> Result<Option<Arc<dyn Playback>>, String> {
            Ok(None)
        }

        fn running(&self, id: &str) -> Result<Option<Arc<dyn RunningModel>>, String> {
            Ok((id == "m1").then(|| Arc::new(self.clone()) as Arc<dyn RunningModel>))
        }
    }

    /// A frame of a session with one reading.
    fn frame(live: &Live, id: &str, sequence: u64, reading: Option<f64>) {
        live.change(|snapshot| {
            snapshot.state.session = Some(SessionState {
                id: id.to_owned(),
                ..SessionState::default()
            });
            snapshot.state.frame = Some(FrameState {
                sequence,
                ..FrameState::default()
            });
            snapshot.readings = Some((sequence, vec![reading].into()));
        });
    }

    #[tokio::test]
    async fn a_slow_map_is_preceded_by_a_provisional_one() {
        let served = served_from(None, Arc::new(Slow::default())).await;
        let live = served.live();
        // no page is open yet
        frame(&live, "m1", 6, Some(0.5));
        served.get("/api/state").await;
        assert_eq!(code(&served.get("/api/provisional/6").await), "404");
        frame(&live, "m1", 7, Some(0.25));
        let mut followed = live.subscribe();
        let shown =
            followed.wait_for(|now| now.state.frame.as_ref().is_some_and(|frame| frame.map));
        let shown = tokio::time::timeout(Duration::from_secs(30), shown).await;
        let state = shown.unwrap().unwrap().state.frame.clone().unwrap();
        assert_eq!(state.provisional.as_deref(), Some("provisional: of a test"));
        assert_eq!(
            served.bytes("/api/provisional/7").await,
            0.25_f32.to_le_bytes()
        );
        // the daemon's map has another address
        assert_eq!(code(&served.get("/api/map/7").await), "404");
        assert_eq!(code(&served.get("/api/provisional/6").await), "404");
        let own = FrameState {
            sequence: 7,
            map: true,
            ..FrameState::default()
        };
        live.change(|snapshot| snapshot.state.frame = Some(own.clone()));
        // a provisional map that arrives after the daemon's map is ignored
        let late = Slow::default().provisional(&[Some(0.5)]).unwrap();
        live.show_provisional("m1", 7, late);
        assert_eq!(live.subscribe().borrow().state.frame, Some(own));
    }

    #[test]
    fn a_provisional_map_of_another_session_is_not_shown() {
        let live = Live::default();
        let made = || Slow::default().provisional(&[Some(0.5)]).unwrap();
        let is_shown = || live.provisional(1).is_some();
        frame(&live, "m2", 1, Some(0.25));
        live.show_provisional("m1", 1, made());
        assert!(!is_shown());
        live.show_provisional("m2", 1, made());
        assert!(is_shown());
    }

    #[tokio::test]
    async fn deviations_have_a_rate_and_a_reason_without() {
        let slow = Slow::default();
        let served = served_from(None, Arc::new(slow.clone())).await;
        let live = served.live();
        let refused = served.get("/api/deviation").await;
        assert!(
            code(&refused) == "409" && refused.contains("no session runs"),
            "{refused}"
        );
        frame(&live, "m1", 1, Some(0.25));
        let first = served.bytes("/api/deviation").await;
        assert!(first.ends_with(&[0.25_f32.to_le_bytes(), f32::NAN.to_le_bytes()].concat()));
        let head = String::from_utf8_lossy(&first).into_owned();
        assert!(head.contains(r#""session":"m1""#), "{head}");
        // a frame later, within two seconds: the same reply, still with the number of the first frame
        frame(&live, "m1", 2, None);
        assert_eq!(served.bytes("/api/deviation").await, first);
        assert_eq!(slow.0.load(Ordering::Relaxed), 1);
        // a frame of another session is handled at once
        frame(&live, "m2", 1, Some(0.5));
        let refused = served.get("/api/deviation").await;
        assert!(
            refused.contains("the record of m2 cannot be read from here"),
            "{refused}"
        );
        frame(&live, "m1", 3, None);
        let refused = served.get("/api/deviation").await;
        assert!(refused.contains("a reading is missing"), "{refused}");
    }
}
