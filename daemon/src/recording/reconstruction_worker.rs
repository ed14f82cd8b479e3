//! Computes maps on a separate thread: a method that is slow, hangs or fails leaves frames without a map, but never
//! delays or loses their record.

use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::time::{Duration, Instant};

use eit::Pressure;
use logbook::MapRecord;
use survey::{Baseline, Map, Reading};
use tokio::sync::mpsc::WeakSender;

use crate::panics::containment;
use crate::recording::recorder_message::RecorderMessage;
use imaging::Model;
use survey::error_chain as chain;

/// Maximum time to hold a frame for its map.
const MAP_TIMEOUT: Duration = Duration::from_secs(2);
/// The same if other frames are waiting; long enough for a quick method on a busy machine.
const BUSY_MAP_TIMEOUT: Duration = Duration::from_millis(250);
/// Time between two checks whether more frames are waiting.
const POLL_INTERVAL: Duration = Duration::from_millis(2);

/// Inputs of the reconstruction.
pub(crate) struct ReconstructionContext {
    pub baseline: Baseline,
    pub model: Model,
    pub centroids: Vec<[f64; 2]>,
    pub areas: Vec<f64>,
    /// Standard deviation of one reading, in the baseline's unit; `None` if unknown.
    pub reading_noise: Option<f64>,
    pub build: String,
}

/// Result of a frame.
#[derive(Debug)]
pub(crate) struct TimedOutcome {
    pub outcome: Result<Mapped, Failure>,
    /// Computing time.
    pub took: Duration,
}

/// A map and the values derived from it.
#[derive(Debug)]
pub(crate) struct Mapped {
    pub map: Map,
    /// Position of the load, m; `None` if no loss is above the noise.
    pub found: Option<[f64; 2]>,
    /// The largest loss that noise alone causes.
    pub noise: Option<f64>,
    pub pressure: Option<Pressure>,
    pub record: MapRecord,
    /// Why there is no pressure, if the method is calibrated.
    pub refused: Option<String>,
}

/// Why there is no map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Failure {
    /// The method refuses this frame.
    Refused(String),
    /// The method's code failed; it is not used again.
    Broken(String),
}

/// Result of an attempt.
pub(crate) enum MapOutcome {
    Ready(Box<TimedOutcome>),
    /// Not ready; returned later by [`ReconstructionWorker::late`].
    Late,
    /// An earlier map is still being computed: this frame has none.
    Busy,
    /// The method is not used any more.
    Suspended,
}

/// Computes one map at a time.
pub(crate) struct ReconstructionWorker {
    ask: Option<SyncSender<Vec<Reading>>>,
    answers: Receiver<TimedOutcome>,
    under_way: bool,
}

impl ReconstructionWorker {
    /// `recorder` is notified whenever a map is ready.
    ///
    /// # Errors
    /// No thread can be started.
    pub(crate) fn start(
        context: ReconstructionContext,
        recorder: WeakSender<RecorderMessage>,
    ) -> std::io::Result<Self> {
        let (ask, requested) = sync_channel::<Vec<Reading>>(1);
        let (answer, answers) = sync_channel(1);
        std::thread::Builder::new()
            .name("maps".to_owned())
            .spawn(move || {
                // a method that fails here fails again with the first frame, where it is reported
                let noise = containment::run(|| context.noise()).ok().flatten();
                while let Ok(readings) = requested.recv() {
                    let begun = Instant::now();
                    // a failure costs maps, not the session
                    let outcome = containment::run(|| context.make(&readings, noise))
                        .unwrap_or_else(|panicked| Err(Failure::Broken(panicked.message)));
                    let broken = matches!(outcome, Err(Failure::Broken(_)));
                    let took = begun.elapsed();
                    let made = TimedOutcome { outcome, took };
                    if answer.send(made).is_err() {
                        return;
                    }
                    // a full queue wakes the recorder as well
                    if let Some(recorder) = recorder.upgrade() {
                        let _ = recorder.try_send(RecorderMessage::MapReady);
                    }
                    if broken {
                        return;
                    }
                }
            })?;
        Ok(Self {
            ask: Some(ask),
            answers,
            under_way: false,
        })
    }

    /// Requests a map and waits for it, at most two seconds; a quarter of a second if others are waiting (`busy`).
    pub(crate) fn make(&mut self, readings: &[Reading], busy: impl Fn() -> bool) -> MapOutcome {
        if self.under_way {
            return MapOutcome::Busy;
        }
        let Some(ask) = &self.ask else {
            return MapOutcome::Suspended;
        };
        if ask.send(readings.to_vec()).is_err() {
            self.ask = None;
            return MapOutcome::Suspended;
        }
        self.under_way = true;
        let begun = Instant::now();
        loop {
            match self.answers.recv_timeout(POLL_INTERVAL) {
                Ok(made) => return MapOutcome::Ready(Box::new(self.arrived(made))),
                Err(RecvTimeoutError::Timeout) if begun.elapsed() > map_timeout(busy()) => {
                    return MapOutcome::Late;
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return self.gone(),
            }
        }
    }

    /// The late map, if it is ready now.
    pub(crate) fn late(&mut self) -> Option<TimedOutcome> {
        if !self.under_way {
            return None;
        }
        match self.answers.try_recv() {
            Ok(made) => Some(self.arrived(made)),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                self.gone();
                None
            }
        }
    }

    /// Waits for the late map as long as for the map of a record.
    pub(crate) fn last(&mut self) -> Option<TimedOutcome> {
        if !self.under_way {
            return None;
        }
        let made = self.answers.recv_timeout(MAP_TIMEOUT).ok()?;
        Some(self.arrived(made))
    }

    fn arrived(&mut self, made: TimedOutcome) -> TimedOutcome {
        self.under_way = false;
        if matches!(made.outcome, Err(Failure::Broken(_))) {
            self.ask = None;
        }
        made
    }

    fn gone(&mut self) -> MapOutcome {
        (self.under_way, self.ask) = (false, None);
        MapOutcome::Suspended
    }
}

fn map_timeout(busy: bool) -> Duration {
    if busy { BUSY_MAP_TIMEOUT } else { MAP_TIMEOUT }
}

impl ReconstructionContext {
    /// The largest loss that noise alone causes in a map.
    fn noise(&self) -> Option<f64> {
        imaging::map_noise(&self.model, &self.baseline.readings, self.reading_noise?)
    }

    fn make(&self, readings: &[Reading], noise: Option<f64>) -> Result<Mapped, Failure> {
        let map = self
            .model
            .reconstruct(&self.baseline.readings, readings)
            .map_err(|error| Failure::Refused(chain(&error)))?;
        let record = MapRecord::new(
            &map,
            self.model.hash.clone(),
            self.build.clone(),
            eit::cpu_features(),
        );
        // if the calibration rejects a map, the map is kept and the session reports the reason
        let pressure = self
            .model
            .calibration
            .as_ref()
            .map(|calibration| calibration.pressure(self.model.reconstructor.mesh(), &map))
            .transpose();
        let (pressure, refused) = match pressure {
            Ok(pressure) => (pressure, None),
            Err(error) => (None, Some(chain(&error))),
        };
        Ok(Mapped {
            found: map.found_above(noise, &self.centroids, &self.areas),
            noise,
            map,
            pressure,
            record,
            refused,
        })
    }
}
