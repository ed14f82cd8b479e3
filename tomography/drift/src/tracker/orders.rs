//! User orders: the user knows the load on the sheet, so orders overrule the tracker's conclusions from readings.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::innovation::{Frame, Steady};
use super::{Answer, Judgement, Tracker};
use crate::DriftError;

/// An order that states the load on the sheet. It takes effect with the next frame that can be judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TrackingOrder {
    /// The sheet is empty: the frame becomes the baseline, and all anchors are deleted.
    EmptyNow,
    /// The sheet is loaded: nothing is learnt until [`TrackingOrder::EmptyNow`]. A slow loss of conductance shown by an
    /// anchor counts as part of the load.
    LoadedNow,
    /// The change since the anchors is ageing: all anchors are deleted.
    ForgetAnchor,
}

impl TrackingOrder {
    /// All orders.
    pub const ALL: [Self; 3] = [Self::EmptyNow, Self::LoadedNow, Self::ForgetAnchor];

    /// The name of the order in records and on command lines.
    pub fn name(self) -> &'static str {
        match self {
            Self::EmptyNow => "empty-now",
            Self::LoadedNow => "loaded-now",
            Self::ForgetAnchor => "forget-anchor",
        }
    }

    /// The order with this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|order| order.name() == name)
    }

    /// Whether both orders can wait for the same frame: a sheet cannot be both empty and loaded.
    fn agrees_with(self, other: Self) -> bool {
        self != other && (self == Self::ForgetAnchor || other == Self::ForgetAnchor)
    }
}

impl Tracker {
    /// Accepts an order for the next frame that can be judged. Of two contradictory orders the later one counts.
    pub fn order(&mut self, order: TrackingOrder) {
        let waiting = &mut self.state.orders;
        waiting.retain(|earlier| earlier.agrees_with(order));
        waiting.push(order);
    }

    /// Executes the pending orders with this frame; returns true if they determine its judgement.
    pub(super) fn carry_out(
        &mut self,
        answer: &mut Answer,
        frame: &mut Frame,
        now: &Arc<Steady>,
    ) -> Result<bool, DriftError> {
        answer.orders = std::mem::take(&mut self.state.orders);
        let mut judged = false;
        for order in answer.orders.clone() {
            match order {
                TrackingOrder::EmptyNow => {
                    self.begin_again(frame, now);
                    answer.judgement = Judgement::Empty;
                    answer.since_empty_s = 0.0;
                    judged = true;
                }
                TrackingOrder::LoadedNow => self.hold(frame),
                TrackingOrder::ForgetAnchor => self.forget_anchors(),
            }
        }
        Ok(judged)
    }

    /// Makes the frame the baseline, with the uncertainty of one frame. Pairs without readings keep their tracked
    /// values.
    fn begin_again(&mut self, frame: &Frame, now: &Steady) {
        let rows = &frame.rows;
        let measured = |row: usize| rows.binary_search(&row).is_ok();
        let n = frame.data.len();
        let covariance = DMatrix::from_fn(n, n, |i, j| match (measured(i), measured(j)) {
            (true, true) => self.model.noise[(i, j)],
            (false, false) => now.predicted[(i, j)],
            _ => 0.0,
        });
        let step = DVector::from_fn(n, |row, _| if measured(row) { frame.e[row] } else { 0.0 });
        self.state.correct(&step);
        self.state.set_covariance(&covariance);
        self.state.ledger.release();
        self.state.restart();
        self.steady = None;
        self.state.empty_s = self.state.at_s;
        let (baseline, at_s) = (self.state.baseline(), self.state.at_s);
        self.state
            .pace
            .begin_again(&self.prepared.basis.of(&baseline), at_s);
        self.forget_anchors();
    }

    /// Marks the sheet as loaded until a user's order declares it empty.
    fn hold(&mut self, frame: &mut Frame) {
        if !self.state.ledger.loaded() {
            let (pace, at_s) = (self.state.pace.pace, self.state.at_s);
            let (anchors, basis) = (&self.state.anchors, &self.prepared.basis);
            // if readings are missing, or electrodes are faulty, the frame cannot show the loss: the tracked baseline
            // is used instead
            let complete = frame.rows.len() == self.prepared.rows.len();
            let data = match complete {
                true => &frame.data,
                false => &self.state.baseline(),
            };
            let slow = anchors.alarm(&self.model, basis, data, pace, at_s);
            if let Some(alarm) = slow.filter(|alarm| alarm.change < 0.0) {
                // a load that came slowly was learnt as drift
                let learnt = self.model.disc(alarm.centre, alarm.diameter) * alarm.change;
                self.state.correct(&-&learnt);
                frame.e += learnt;
            }
            self.state.ledger.begin(frame.data.len(), false);
            self.state.loaded_frames = 0;
        }
        self.state.ledger.held = true;
    }

    fn forget_anchors(&mut self) {
        self.state.anchors = Default::default();
        let baseline = self.state.baseline();
        self.state.anchors.keep(&baseline, self.state.at_s);
    }
}
