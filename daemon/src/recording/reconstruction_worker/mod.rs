//! Computes maps on a separate thread: a method that is slow, hangs or fails leaves frames without a map, but never
//! delays or loses their record.

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
/// The same if other frames are waiting; long enough for a quick method on a busy machine.
const BUSY_MAP_TIMEOUT: Duration = Duration::from_millis(250);
/// Maximum time that a session waits for the preparation of its tracked baseline.
const PREPARATION_TIMEOUT: Duration = Duration::from_secs(30);
/// Most frames that wait to be followed; further ones are not.
const FRAMES_TO_FOLLOW: usize = 1024;
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
    /// `None` where the baseline is not followed.
    pub tracking: Option<TrackingContext>,
    /// `None` where no quantities are computed.
    pub quantities: Option<QuantityContext>,
    pub status: Arc<SessionStatus>,
}

/// Result of a frame.
#[derive(Debug)]
pub(crate) struct TimedOutcome {
    pub outcome: Result<Mapped, Failure>,
    /// Quantities of the map, or why there are none.
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
    /// Why there is no pressure, if the method is calibrated.
    pub refused: Option<String>,
    /// What the tracked baseline says of the frame.
    pub tracked: Option<Tracked>,
    /// What the map was made of: the frame, and what it was compared with.
    readings: Vec<Reading>,
    baseline: Vec<Reading>,
}

impl Mapped {
    /// Whether the tracked baseline judged the frame.
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
    /// An earlier map is still being computed: this frame has none.
    Busy,
    /// The method is not used any more.
    Suspended,
}

/// What the thread of maps is asked for.
enum Request {
    Frame(FrameRequest),
    /// An order of a person to the tracked baseline, for the frames after it.
    Order(TrackingOrder),
}

/// A frame for the thread of maps.
struct FrameRequest {
    readings: Vec<Reading>,
    sequence: u64,
    at_s: f64,
    wall_ns: i64,
    /// Whether a map is wanted; otherwise the baseline only follows the frame.
    map: bool,
}

/// Computes one map at a time, and follows the baseline through all frames.
pub(crate) struct ReconstructionWorker {
    ask: Option<SyncSender<Request>>,
    answers: Receiver<TimedOutcome>,
    under_way: bool,
    follows: bool,
    /// Frames that the baseline could not follow, because too many were waiting.
    not_followed: u64,
    /// Orders for which the queue had no place yet.
    orders: VecDeque<TrackingOrder>,
    /// Until its thread is started.
    injections: Option<Injections>,
}

impl ReconstructionWorker {
    /// `recorder` is notified whenever a map is ready. Blocks until the baseline is prepared to be followed, so that the first
    /// frame does not wait for that.
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
        // it ends with the thread's preparation, whether that succeeded or not
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

    /// Lets the baseline follow a frame that gets no map.
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

    /// Starts to take the readings of each injection; `None` where the baseline is not followed.
    pub(crate) fn take_injections(&mut self) -> Option<mpsc::Sender<InjectionReadings>> {
        let injections = self.injections.take().filter(|_| self.follows)?;
        let started = injections.start();
        started
            .inspect_err(|cause| tracing::warn!("no thread for injections: {cause}"))
            .ok()
    }

    /// Whether the baseline is followed.
    pub(crate) fn follows(&self) -> bool {
        self.follows && self.ask.is_some()
    }

    /// Gives an order of a person to the tracked baseline, for the frames after this call.
    pub(crate) fn order(&mut self, order: TrackingOrder) {
        self.orders.push_back(order);
        self.send_orders();
    }

    /// An order that finds no place in the queue is sent before the next frame that does.
    fn send_orders(&mut self) {
        while let (Some(ask), Some(order)) = (&self.ask, self.orders.front()) {
            match ask.try_send(Request::Order(*order)) {
                Ok(()) => drop(self.orders.pop_front()),
                Err(TrySendError::Full(_)) => return,
                Err(TrySendError::Disconnected(_)) => self.ask = None,
            }
        }
    }

    /// Frames that the baseline could not follow since the last call.
    pub(crate) fn take_not_followed(&mut self) -> u64 {
        std::mem::take(&mut self.not_followed)
    }

    /// Requests a map and waits for it, at most two seconds; a quarter of a second if others are waiting (`busy`).
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

    /// Ends the thread, and waits until it has kept the tracked baseline and the last quantities, twice as long as for a map at most.
    /// Returns the late map, if it was made by then.
    pub(crate) fn finish(&mut self) -> Option<TimedOutcome> {
        self.ask = None;
        let until = Instant::now() + 2 * MAP_TIMEOUT;
        let left = || until.saturating_duration_since(Instant::now());
        let mut last = None;
        // fails when the thread has ended, or time is over
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

/// The thread of maps, until no more frames come or the method's code fails.
fn run(
    mut context: ReconstructionContext,
    requested: &Receiver<Request>,
    answer: &SyncSender<TimedOutcome>,
    recorder: &WeakSender<RecorderMessage>,
    shared: &SharedTracking,
    ready: SyncSender<bool>,
) {
    // a method that fails here fails again with the first frame, where it is reported
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
        // a failure costs maps, not the session
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
        // a full queue wakes the recorder as well
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

    /// Starts to follow the baseline, if that is asked for and possible.
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

    /// Starts to compute the standard deviation of maps for readers of the stream.
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

    /// The map of a frame, after the baseline has followed it; `None` where no map is wanted.
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
