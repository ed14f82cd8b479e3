//! Computes maps on a separate thread. If a method is slow, hangs or fails, frames are recorded without a map; no frame
//! is lost.

mod deviations;
mod followed;
mod injections;
mod quantified;

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{
    Receiver, RecvTimeoutError, SyncSender, TryRecvError, TrySendError, sync_channel,
};
use std::time::{Duration, Instant};

use eit::Pressure;
use logbook::MapRecord;
use rig::InjectionReadings;
use survey::{Baseline, Frame, Map, Reading, nanoseconds};
use tokio::sync::mpsc::{self, WeakSender};

use crate::panics::containment;
use crate::recording::recorder_message::RecorderMessage;
use crate::recording::session_status::SessionStatus;
use deviations::Deviations;
use followed::Followed;
pub(crate) use followed::TrackingContext;
use imaging::quantities::FrameQuantities;
use imaging::tracking::{Judgement, TrackingOrder, seconds};
use imaging::{Model, Tracked};
use injections::{Injections, SharedTracking};
use quantified::Quantified;
pub(crate) use quantified::QuantityContext;
use survey::error_chain as chain;

/// Maximum time to hold a frame for its map.
const MAP_TIMEOUT: Duration = Duration::from_secs(2);
/// The same if other frames are waiting. Long enough for a fast method on a busy machine.
const BUSY_MAP_TIMEOUT: Duration = Duration::from_millis(250);
/// Maximum time that a session waits for the preparation of its tracked baseline.
const PREPARATION_TIMEOUT: Duration = Duration::from_secs(30);
/// Maximum number of frames that wait to be followed; further frames are not followed.
const FRAMES_TO_FOLLOW: usize = 1024;
/// Time between two checks of whether more frames are waiting.
const POLL_INTERVAL: Duration = Duration::from_millis(2);

/// Inputs of the reconstruction.
pub(crate) struct ReconstructionContext {
    pub baseline: Baseline,
    pub model: Model,
    pub centroids: Vec<[f64; 2]>,
    pub areas: Vec<f64>,
    /// Standard deviation of one reading, in the baseline's unit; `None` if unknown.
    pub reading_noise: Option<f64>,
    /// `None` if the baseline is not tracked.
    pub tracking: Option<TrackingContext>,
    /// `None` if no quantities are computed.
    pub quantities: Option<QuantityContext>,
    pub status: Arc<SessionStatus>,
}

/// The result for one frame.
#[derive(Debug)]
pub(crate) struct TimedOutcome {
    pub outcome: Result<Mapped, Failure>,
    /// Quantities of the map, or the reason why there are none; `None` if the session has no quantities.
    pub quantities: Option<FrameQuantities>,
    /// Computing time.
    pub took: Duration,
    /// Sentences about the tracked baseline, for the record.
    pub remarks: Vec<String>,
    /// Sentences about the quantities, for the record.
    pub quantity_remarks: Vec<String>,
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
    /// Why the calibration gives no pressure; `None` if it does, or without a calibration.
    pub refused: Option<String>,
    /// The comparison of the frame with the tracked baseline.
    pub tracked: Option<Tracked>,
    /// The frame, and the readings that it was compared with.
    readings: Vec<Reading>,
    baseline: Vec<Reading>,
}

impl Mapped {
    /// Whether the frame was judged against the tracked baseline.
    fn is_judged(&self) -> bool {
        let tracked = self.tracked.as_ref();
        tracked.is_some_and(|tracked| tracked.judgement != Judgement::Unknown)
    }
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
    /// An earlier map is still being computed: this frame gets none.
    Busy,
    /// The method is not used any more.
    Suspended,
}

/// A request to the thread that computes maps.
enum Request {
    Frame(FrameRequest),
    /// An operator's order to the tracked baseline, for the following frames.
    Order(TrackingOrder),
}

/// A frame for the thread that computes maps.
struct FrameRequest {
    readings: Vec<Reading>,
    sequence: u64,
    at_s: f64,
    wall_ns: i64,
    /// Whether a map is wanted; otherwise only the tracked baseline is updated.
    map: bool,
}

/// Computes one map at a time, and updates the tracked baseline with all frames.
pub(crate) struct ReconstructionWorker {
    ask: Option<SyncSender<Request>>,
    answers: Receiver<TimedOutcome>,
    under_way: bool,
    follows: bool,
    /// Frames that the baseline could not follow, because too many were waiting.
    not_followed: u64,
    /// Orders that did not fit in the queue yet.
    orders: VecDeque<TrackingOrder>,
    /// Taken when its thread is started.
    injections: Option<Injections>,
}

impl ReconstructionWorker {
    /// Starts the thread. `recorder` is notified whenever a map is ready. Blocks until tracking of the baseline is
    /// prepared, for [`PREPARATION_TIMEOUT`] at most, so that the first frame does not wait for that.
    ///
    /// # Errors
    /// No thread can be started.
    pub(crate) fn start(
        context: ReconstructionContext,
        recorder: WeakSender<RecorderMessage>,
    ) -> std::io::Result<Self> {
        let wanted = context.tracking.is_some();
        let (ask, requested) = sync_channel::<Request>(FRAMES_TO_FOLLOW);
        let (answer, answers) = sync_channel(1);
        let (ready, prepared) = sync_channel::<bool>(1);
        let shared = SharedTracking::default();
        let injections = Injections {
            tracking: shared.clone(),
            method: Arc::clone(&context.model.reconstructor),
            status: Arc::clone(&context.status),
        };
        std::thread::Builder::new()
            .name("maps".to_owned())
            .spawn(move || run(context, &requested, &answer, &recorder, &shared, ready))?;
        // the sender is dropped after the preparation, or by a panic
        let follows = match prepared.recv_timeout(PREPARATION_TIMEOUT) {
            Ok(follows) => follows,
            Err(RecvTimeoutError::Timeout) => wanted,
            Err(RecvTimeoutError::Disconnected) => false,
        };
        Ok(Self {
            ask: Some(ask),
            answers,
            under_way: false,
            follows,
            not_followed: 0,
            orders: VecDeque::new(),
            injections: Some(injections),
        })
    }

    /// Updates the tracked baseline with a frame that gets no map.
    pub(crate) fn follow(&mut self, frame: &Frame) {
        if !self.follows {
            return;
        }
        self.send_orders();
        let Some(ask) = &self.ask else {
            return;
        };
        match ask.try_send(request(frame, false)) {
            Ok(()) => {}
            Err(TrySendError::Full(_)) => self.not_followed += 1,
            Err(TrySendError::Disconnected(_)) => self.ask = None,
        }
    }

    /// Starts the thread that receives the readings of each injection; `None` if the baseline is not tracked or the
    /// thread was already started.
    pub(crate) fn take_injections(&mut self) -> Option<mpsc::Sender<InjectionReadings>> {
        let injections = self.injections.take().filter(|_| self.follows)?;
        let started = injections.start();
        started
            .inspect_err(|cause| tracing::warn!("no thread for injections: {cause}"))
            .ok()
    }

    /// Whether the baseline is tracked.
    pub(crate) fn follows(&self) -> bool {
        self.follows && self.ask.is_some()
    }

    /// Gives an operator's order to the tracked baseline, for the frames after this call.
    pub(crate) fn order(&mut self, order: TrackingOrder) {
        self.orders.push_back(order);
        self.send_orders();
    }

    /// Sends the waiting orders. An order that does not fit in the queue is sent before the next frame.
    fn send_orders(&mut self) {
        while let (Some(ask), Some(order)) = (&self.ask, self.orders.front()) {
            match ask.try_send(Request::Order(*order)) {
                Ok(()) => drop(self.orders.pop_front()),
                Err(TrySendError::Full(_)) => return,
                Err(TrySendError::Disconnected(_)) => self.ask = None,
            }
        }
    }

    /// Number of frames that the baseline could not follow since the last call.
    pub(crate) fn take_not_followed(&mut self) -> u64 {
        std::mem::take(&mut self.not_followed)
    }

    /// Requests a map and waits for it, for [`MAP_TIMEOUT`] at most, or [`BUSY_MAP_TIMEOUT`] if other frames are
    /// waiting (`busy`).
    pub(crate) fn make(&mut self, frame: &Frame, busy: impl Fn() -> bool) -> MapOutcome {
        if self.under_way {
            self.follow(frame);
            return MapOutcome::Busy;
        }
        self.send_orders();
        let Some(ask) = &self.ask else {
            return MapOutcome::Suspended;
        };
        if ask.send(request(frame, true)).is_err() {
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

    /// Ends the thread, and waits until it has stored the tracked baseline and the last quantities, for twice
    /// [`MAP_TIMEOUT`] at most. Returns the late map, if it is ready by then.
    pub(crate) fn finish(&mut self) -> Option<TimedOutcome> {
        self.ask = None;
        let until = Instant::now() + 2 * MAP_TIMEOUT;
        let left = || until.saturating_duration_since(Instant::now());
        let mut last = None;
        // fails when the thread has ended, or after the timeout
        while let Ok(made) = self.answers.recv_timeout(left()) {
            last = Some(self.arrived(made));
        }
        last
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

fn request(frame: &Frame, map: bool) -> Request {
    Request::Frame(FrameRequest {
        readings: frame.readings.clone(),
        sequence: frame.sequence,
        at_s: seconds(frame.wall),
        wall_ns: nanoseconds(frame.wall),
        map,
    })
}

/// The thread that computes maps; ends when the worker is dropped or the method's code fails.
fn run(
    mut context: ReconstructionContext,
    requested: &Receiver<Request>,
    answer: &SyncSender<TimedOutcome>,
    recorder: &WeakSender<RecorderMessage>,
    shared: &SharedTracking,
    ready: SyncSender<bool>,
) {
    // a method that panics here panics again with the first frame, where that is reported
    let noise = containment::run(|| context.noise()).ok().flatten();
    let mut remarks = Vec::new();
    let mut followed = context.start_to_follow(&mut remarks);
    let mut quantity_remarks = Vec::new();
    let mut quantified = context.start_to_quantify(&mut quantity_remarks);
    let _ = ready.send(followed.is_some());
    let mut deviations = followed.as_ref().and_then(|_| context.start_deviations());
    while let Ok(request) = requested.recv() {
        let request = match request {
            Request::Frame(request) => request,
            Request::Order(order) => {
                if let Some(followed) = &mut followed {
                    followed.order(order);
                }
                continue;
            }
        };
        let begun = Instant::now();
        // a panic ends the maps, not the session
        let outcome =
            containment::run(|| context.make(&request, &mut followed, shared, noise, &mut remarks))
                .unwrap_or_else(|panicked| Some(Err(Failure::Broken(panicked.message))));
        let Some(outcome) = outcome else {
            continue;
        };
        let broken = matches!(outcome, Err(Failure::Broken(_)));
        let judged = outcome.as_ref().is_ok_and(Mapped::is_judged);
        let quantities = quantified.as_mut().map(|quantified| {
            quantified.take(
                request.sequence,
                request.at_s,
                &outcome,
                &mut quantity_remarks,
            )
        });
        let made = TimedOutcome {
            outcome,
            quantities,
            took: begun.elapsed(),
            remarks: std::mem::take(&mut remarks),
            quantity_remarks: std::mem::take(&mut quantity_remarks),
        };
        if answer.send(made).is_err() {
            return;
        }
        // not needed if the queue is full: other messages wake the recorder, too
        if let Some(recorder) = recorder.upgrade() {
            let _ = recorder.try_send(RecorderMessage::MapReady);
        }
        if let (Some(deviations), Some(followed), true) = (&mut deviations, &followed, judged) {
            deviations.take(followed.tracking(), &request);
        }
        if broken {
            return;
        }
    }
    if let Some(followed) = followed {
        followed.keep();
    }
    if let Some(quantified) = quantified {
        quantified.finish();
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

    /// Starts tracking of the baseline, if that is configured and possible.
    fn start_to_follow(&mut self, remarks: &mut Vec<String>) -> Option<Followed> {
        let context = self.tracking.take()?;
        let started = containment::run(|| Followed::start(context, &self.baseline))
            .unwrap_or_else(|panicked| Err(panicked.message));
        match started {
            Ok((followed, found)) => {
                remarks.extend(found);
                Some(followed)
            }
            Err(why) => {
                remarks.push(format!(
                    "maps are compared with the baseline as it was recorded, because it cannot be tracked: {why}"
                ));
                None
            }
        }
    }

    /// Starts the thread that computes the standard deviation of maps for readers of the stream.
    fn start_deviations(&self) -> Option<Deviations> {
        let method = Arc::clone(&self.model.reconstructor);
        Deviations::start(method, &self.status)
            .inspect_err(|cause| tracing::warn!("no thread for standard deviations: {cause}"))
            .ok()
    }

    fn start_to_quantify(&mut self, remarks: &mut Vec<String>) -> Option<Quantified> {
        match Quantified::new(self.quantities.take()?, &self.model, remarks) {
            Ok(quantified) => Some(quantified),
            Err(why) => {
                remarks.push(format!("the session has no quantities: {why}"));
                None
            }
        }
    }

    /// Updates the tracked baseline with the frame and computes its map; `None` if no map is wanted.
    fn make(
        &self,
        request: &FrameRequest,
        followed: &mut Option<Followed>,
        shared: &SharedTracking,
        noise: Option<f64>,
        remarks: &mut Vec<String>,
    ) -> Option<Result<Mapped, Failure>> {
        let tracked = match followed {
            None => None,
            Some(following) => match following.follow(request) {
                Ok(frame) => {
                    let wanted = self.status.readers.want_injections();
                    shared.set(Some(following.tracking()).filter(|_| wanted));
                    remarks.extend(following.changes(&frame));
                    Some(frame)
                }
                Err(why) => return Some(Err(Failure::Refused(why))).filter(|_| request.map),
            },
        };
        if !request.map {
            return None;
        }
        let (baseline, readings) = match &tracked {
            Some(frame) => (&frame.baseline, &frame.readings),
            None => (&self.baseline.readings, &request.readings),
        };
        let mapped = self.map(baseline, readings, noise);
        Some(mapped.map(|mapped| Mapped {
            tracked: tracked.map(|frame| frame.tracked),
            ..mapped
        }))
    }

    fn map(
        &self,
        baseline: &[Reading],
        readings: &[Reading],
        noise: Option<f64>,
    ) -> Result<Mapped, Failure> {
        let map = self
            .model
            .reconstruct(baseline, readings)
            .map_err(|error| Failure::Refused(chain(&error)))?;
        let record = MapRecord::new(
            &map,
            self.model.hash.clone(),
            crate::BUILD.to_owned(),
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
            tracked: None,
            readings: readings.to_vec(),
            baseline: baseline.to_vec(),
        })
    }
}
