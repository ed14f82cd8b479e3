//! Tracks the baseline over time: a state in data space (299 values and their covariance), learnt only from frames
//! without load.
//!
//! Between frames the covariance grows by the drift. A frame without load corrects the state; learning stops while the
//! sheet is loaded. Steps from one frame to the next show when a load came or was removed, without any baseline.

mod anchors;

pub mod bits;
mod deviation;
mod injections;
mod innovation;
mod judging;
mod load;
mod orders;
mod pace;
mod state;
mod unlearnt;

use std::collections::BTreeMap;
use std::sync::Arc;

use eit::linear_algebra::{product, view};
use nalgebra::{DMatrix, DVector};
use survey::Reading;

use crate::DriftError;
use crate::basis::{Basis, PER_DAY};
use crate::disc::DiscFit;
use crate::electrodes::{ElectrodeCheck, ElectrodeFault};
use crate::kinds::DriftKinds;
use crate::model::DriftModel;
use crate::whitened::Whitened;
pub use anchors::AnchorAlarm;
use innovation::{CONTACT_SD, Frame, Steady};
pub use orders::TrackingOrder;
pub use state::TrackerState;

const DAY_S: f64 = 86_400.0;
/// Relative difference up to which intervals share one covariance.
const SAME_INTERVAL: f64 = 0.02;
/// Seconds for which a faulty electrode must be healthy before it is used again.
const HEALED_S: f64 = 3600.0;
/// Largest number of electrodes that may be masked.
pub const MOST_MASKED: usize = 3;

/// Load state of the sheet in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Judgement {
    /// The sheet is empty; the baseline learns from the frame.
    Empty,
    /// The sheet is loaded.
    Loaded,
    /// Too few electrodes are usable.
    Unknown,
}

/// A step between two frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// Whether conductance was lost (a load came), not regained.
    pub came: bool,
    /// Whether the same load is on the sheet before and after the step: it grew (foam creeps under a load), moved or
    /// recovered.
    pub same_load: bool,
    /// A disc fitted to the change.
    pub fit: DiscFit,
}

/// Result for one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// Empty, loaded or unknown.
    pub judgement: Judgement,
    /// Improvement of chi squared by the best disc; `None` for a loaded frame that was not tested.
    pub score: Option<f64>,
    /// Chi squared per row of the innovation; `None` like `score`.
    pub chi: Option<f64>,
    /// The load that came or was removed with this frame.
    pub event: Option<Event>,
    /// Number of loads on the sheet.
    pub loads: usize,
    /// A slow change that cannot be distinguished from ageing.
    pub anchor: Option<AnchorAlarm>,
    /// Whether this frame was compared with the anchors; every sixth frame without load is.
    pub compared: bool,
    /// A fault of electrodes that this frame shows.
    pub fault: Option<ElectrodeFault>,
    /// Masked electrodes: their readings are not used.
    pub masked: Vec<usize>,
    /// Pace of the drift relative to the built-in rates.
    pub pace: f64,
    /// Whether the innovations agree with the assumed drift; `None` while loaded.
    pub agrees: Option<bool>,
    /// Seconds since the last frame without load.
    pub since_empty_s: f64,
    /// Whether the time of the frame was before that of the previous frame.
    pub clock_went_back: bool,
    /// User orders executed with this frame.
    pub orders: Vec<TrackingOrder>,
    /// Whether the sheet counts as loaded because of a user's order.
    pub held: bool,
}

/// Tracks the drift of one sheet.
#[derive(Clone)]
pub struct Tracker {
    model: Arc<DriftModel>,
    prepared: Arc<Prepared>,
    state: TrackerState,
    /// The covariance of the innovation and quantities derived from the state, while the covariance is reused.
    steady: Option<Arc<Steady>>,
    /// For the step between two frames: its variance in units of daily growth, and the squares of the load test.
    of_steps: Option<(f64, Arc<DVector<f64>>)>,
    /// The last frame in the coordinates of the basis; derived from the state.
    last_in_basis: Option<DVector<f64>>,
    /// For each electrode that was faulty: changes of the data for the possible changes of its contact; derived from
    /// the sheet.
    lost_contacts: BTreeMap<usize, Arc<DMatrix<f64>>>,
}

/// Quantities that depend on the sheet alone.
struct Prepared {
    basis: Basis,
    check: ElectrodeCheck,
    per_day: DMatrix<f64>,
    rows: Vec<usize>,
}

impl Tracker {
    /// Starts at the first baseline, recorded without load at this time, s.
    ///
    /// # Errors
    /// A model without noise.
    pub fn new(model: Arc<DriftModel>, at_s: f64) -> Result<Self, DriftError> {
        let state = TrackerState::new(&model, at_s);
        Self::restore(model, state)
    }

    /// Continues from a state of the same sheet. If the noise of the model is unchanged, later results have the same
    /// bits as without the interruption.
    ///
    /// # Errors
    /// A state of another mesh, baseline or build, or a damaged one.
    pub fn restore(model: Arc<DriftModel>, mut state: TrackerState) -> Result<Self, DriftError> {
        state.check(&model)?;
        let basis = Basis::new(&model)?;
        state.take_noise(&model, &basis);
        let prepared = Arc::new(Prepared {
            basis,
            check: ElectrodeCheck::new(&model),
            per_day: model.drift(&PER_DAY),
            rows: (0..model.pairs().len()).collect(),
        });
        let mut tracker = Self {
            model,
            prepared,
            state,
            steady: None,
            of_steps: None,
            last_in_basis: None,
            lost_contacts: BTreeMap::new(),
        };
        let masked = tracker.state.masked();
        tracker.prepare_lost(&masked)?;
        Ok(tracker)
    }

    /// The whole state.
    pub fn state(&self) -> &TrackerState {
        &self.state
    }

    /// The model of the sheet.
    pub fn model(&self) -> &Arc<DriftModel> {
        &self.model
    }

    /// Tracked change of the data since the first baseline, V.
    pub fn baseline(&self) -> DVector<f64> {
        self.state.baseline()
    }

    /// The drift since the first baseline, by kind; `days`: age of that baseline.
    ///
    /// # Errors
    /// A covariance that cannot be factored.
    pub fn kinds(&self, days: f64) -> Result<DriftKinds, DriftError> {
        let (change, error) = (self.state.baseline(), self.state.covariance());
        self.model.kinds(&change, &error, days, self.state.pace())
    }

    /// Processes a frame recorded at this time, s.
    ///
    /// # Errors
    /// Wrong number of readings, or fewer than half of them have a value.
    pub fn follow(&mut self, frame: &[Reading], at_s: f64) -> Result<Answer, DriftError> {
        let relative = self.model.relative(frame)?;
        let clock_went_back = at_s < self.state.at_s;
        let mut days = (at_s - self.state.at_s).abs() / DAY_S;
        if clock_went_back {
            // the elapsed time is unknown: at least an interval, at most the jump of the clock
            days = days.max(self.state.kept_days.unwrap_or(0.0));
        }
        let masked = self.state.masked();
        if clock_went_back {
            self.state.set_back(at_s);
        }
        self.state.at_s = at_s;
        if self.state.ledger.loaded() && masked.len() <= MOST_MASKED {
            // steps do not show whether an electrode recovered, and a load may hide it, so masked electrodes stay
            // masked; but with too many masked ones no frame could be judged again
            self.mask(&masked)?;
        }
        self.use_again(&masked);
        let rows = self.usable(&relative.rows);
        let step_rows = self.step_rows(&rows);
        let mut frame_now = Frame {
            e: &relative.data - self.state.baseline(),
            step: (!step_rows.is_empty())
                .then(|| &relative.data - DVector::from_column_slice(&self.state.last)),
            in_basis: self.prepared.basis.of(&relative.data),
            data: relative.data,
            rows,
            step_rows,
            days,
        };
        let mut now = self.innovation(days, &frame_now.rows)?;
        let mut white = whitened(&now, &frame_now);
        let fault = self.fault(frame, &frame_now, &now, &white)?;
        if let Some(fault) = fault {
            self.mask(&fault.electrodes(self.model.mesh().electrodes()))?;
            frame_now.rows = self.usable(&relative.rows);
            frame_now.step_rows = self.step_rows(&frame_now.rows);
            if frame_now.step_rows.is_empty() {
                frame_now.step = None;
            }
        }
        if fault.is_none() && !self.state.ledger.loaded() {
            let ill = self.still_ill(&frame_now, &relative.rows)?;
            self.mask(&ill)?;
        }
        frame_now.clear_lost_rows();
        let mut answer = Answer {
            judgement: Judgement::Unknown,
            score: None,
            chi: None,
            event: None,
            loads: self.state.ledger.loads(),
            anchor: None,
            compared: false,
            fault,
            masked: self.state.masked(),
            pace: self.state.pace.pace,
            agrees: None,
            since_empty_s: at_s - self.state.empty_s,
            clock_went_back,
            orders: Vec::new(),
            held: self.state.ledger.held,
        };
        if answer.masked.len() > MOST_MASKED || 2 * frame_now.rows.len() < self.prepared.rows.len()
        {
            self.predict(&now);
            self.state.last = Vec::new(); // no step can be taken from such a frame
            self.last_in_basis = None;
            return Ok(answer);
        }
        if fault.is_some() {
            now = self.innovation(days, &frame_now.rows)?;
        }
        let event = self.event(&frame_now)?;
        self.state.last = frame_now.data.as_slice().to_vec();
        self.last_in_basis = Some(frame_now.in_basis.clone());
        self.state.last_rows.clone_from(&frame_now.rows);
        let judged = self.carry_out(&mut answer, &mut frame_now, &now)?;
        if fault.is_some() || !answer.orders.is_empty() {
            white = whitened(&now, &frame_now);
        }
        if judged {
            // judged by a user's order
        } else if self.state.ledger.loaded() {
            self.loaded(&mut answer, &frame_now, event, &now, &white)?;
        } else {
            self.maybe_empty(&mut answer, &frame_now, event, &now, &white)?;
        }
        answer.loads = self.state.ledger.loads();
        answer.held = self.state.ledger.held;
        answer.pace = self.state.pace.pace;
        Ok(answer)
    }

    /// Uses those of these electrodes again that are no longer masked, and allows for the possible change of their
    /// contacts.
    fn use_again(&mut self, were_masked: &[usize]) {
        let masked = self.state.masked();
        for &electrode in were_masked.iter().filter(|one| !masked.contains(one)) {
            let contact = self.of_contact(electrode, CONTACT_SD);
            self.state.add_covariance(&contact, 1.0);
            self.state.restart();
            self.steady = None;
        }
    }

    /// Masks these electrodes until they have been healthy for an hour.
    fn mask(&mut self, electrodes: &[usize]) -> Result<(), DriftError> {
        self.prepare_lost(electrodes)?;
        self.state.mask(electrodes);
        Ok(())
    }

    fn prepare_lost(&mut self, electrodes: &[usize]) -> Result<(), DriftError> {
        for &electrode in electrodes {
            if !self.lost_contacts.contains_key(&electrode) {
                let lost = Arc::new(self.model.lost_contact(electrode)?);
                self.lost_contacts.insert(electrode, lost);
            }
        }
        Ok(())
    }

    /// Allows for any contact impedance of the masked electrodes: their effect on readings of other electrodes is
    /// neither load nor drift. `but`: an electrode being judged, which is excluded.
    fn allow_lost_contacts(&self, covariance: &mut DMatrix<f64>, but: Option<usize>) {
        let masked = self.state.masked().into_iter();
        for electrode in masked.filter(|electrode| Some(*electrode) != but) {
            if let Some(lost) = self.lost_contacts.get(&electrode) {
                *covariance += product(view(lost), view(&lost.transpose()));
            }
        }
    }

    /// The map of the last frame relative to the tracked baseline: change of ln conductance of each triangle of
    /// [`DriftModel::mesh`]. `size`: prior standard deviation of local change.
    ///
    /// # Errors
    /// No frame yet.
    pub fn map(&self, size: f64) -> Result<Vec<f64>, DriftError> {
        self.whitened()?.one_step(&self.model, size)
    }

    /// The last frame relative to the tracked baseline, whitened by noise and drift.
    ///
    /// # Errors
    /// No frame yet.
    pub fn whitened(&self) -> Result<Whitened, DriftError> {
        if self.state.last.is_empty() {
            return Err(DriftError::NoFrame);
        }
        let e = DVector::from_column_slice(&self.state.last) - self.state.baseline();
        let rows = &self.state.last_rows;
        let covariance = self.of_frame(&self.state.covariance());
        Whitened::new(&covariance, &e, rows)
    }
}

/// Whitens the innovation of a frame by its covariance.
fn whitened(now: &Steady, frame: &Frame) -> Whitened {
    Whitened::with(Arc::clone(&now.factor), &frame.e, &frame.rows)
}
