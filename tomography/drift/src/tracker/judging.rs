//! Judges a frame and updates the state: on a sheet that was empty, and on a sheet that was loaded.

use std::sync::Arc;

use super::innovation::{Frame, Steady};
use super::load::REST;
use super::pace::PACES;
use super::{Answer, DAY_S, Event, Judgement, Tracker, whitened};
use crate::DriftError;
use crate::disc::DiscFit;
use crate::whitened::{LOADED, LoadTest, Whitened};

/// Number of frames without load after which the covariance is reused, and after which it is recomputed.
const STEADY_AFTER: u32 = 12;
const RENEWED_EVERY: u32 = 24;
/// Frames between tests whether a loaded sheet is empty again, and between comparisons with anchors.
const TEST_EVERY: u32 = 6;
/// Range of chi squared per row in which frames without load agree with the assumed drift.
const AGREES: [f64; 2] = [0.7, 1.5];
/// After a step back, the load counts as removed if less than this share of its largest signal remains; the rest is
/// recovery of the foam.
const HALF_GONE: f64 = 0.5;
/// Two frames show one load if one disc explains at least this share of the square of their change.
const ONE_LOAD: f64 = 0.95;
/// Factor of the remaining change at the release of a load; local change of this size is allowed for afterwards.
const REST_ALLOWED: f64 = 3.0;

impl Tracker {
    /// Judges a frame of a sheet that was empty before.
    pub(super) fn maybe_empty(
        &mut self,
        answer: &mut Answer,
        frame: &Frame,
        event: Option<LoadTest>,
        now: &Arc<Steady>,
        white: &Whitened,
    ) -> Result<(), DriftError> {
        let best = now.atoms.best(white.data(), &self.model, 1).pop();
        answer.score = best.map(|test| test.score);
        answer.chi = Some(white.chi_per_row());
        let above = best.filter(|test| test.score > LOADED);
        let came = event.is_some_and(|event| event.change < 0.0);
        if came || above.is_some_and(|test| test.change < 0.0) {
            self.state.ledger.begin(frame.data.len(), came);
            self.state.ledger.follow(&frame.e);
            self.state.loaded_frames = 0;
            self.predict(now);
            answer.judgement = Judgement::Loaded;
            if self.leave_lock_out(answer, frame)? {
                return Ok(());
            }
            if !came {
                self.state.ledger.comes = true;
                return Ok(());
            }
            let starts = now.atoms.best(white.data(), &self.model, 3);
            let fit = white.fit_disc_from(&self.model, &starts)?;
            self.state.ledger.lies_at(fit.disc);
            self.state.ledger.comes = !fit.accepted;
            answer.event = Some(Event {
                came,
                same_load: false,
                fit,
            });
            return Ok(());
        }
        answer.judgement = Judgement::Empty;
        answer.agrees = answer.chi.map(|chi| (AGREES[0]..=AGREES[1]).contains(&chi));
        if let Some(test) = above {
            // conductance was regained: a load that had been learnt as drift was removed
            self.predict(now);
            self.allow_local(test.change.abs());
            let now = self.innovation(0.0, &frame.rows)?;
            self.learn(answer, frame, &now, &whitened(&now, frame));
        } else {
            self.learn(answer, frame, now, white);
        }
        if answer.anchor.is_some_and(|anchor| anchor.change < 0.0) {
            self.maybe_loaded_slowly(answer, frame);
        }
        Ok(())
    }

    /// A change too slow to show against the tracked baseline is a load if it is faster than the sheet may age. The
    /// tracked baseline is then reset to the anchor, and nothing is learnt until the load is removed.
    fn maybe_loaded_slowly(&mut self, answer: &mut Answer, frame: &Frame) {
        let (pace, at_s) = (self.state.pace.pace, self.state.at_s);
        let basis = &self.prepared.basis;
        let (model, anchors) = (&self.model, &mut self.state.anchors);
        let Some((baseline, kept_s)) = anchors.load(model, basis, &frame.data, pace, at_s) else {
            return;
        };
        let days = (at_s - kept_s) / DAY_S;
        let e = &frame.data - &baseline;
        self.state.set_baseline(&baseline);
        let drifted = &self.prepared.per_day;
        self.state.add_covariance(drifted, pace * pace * days);
        self.state.restart();
        self.steady = None;
        self.state.ledger.begin(e.len(), false);
        self.state.ledger.follow(&e);
        self.state.loaded_frames = 0;
        self.state.empty_s = kept_s;
        answer.judgement = Judgement::Loaded;
        answer.agrees = None;
        answer.since_empty_s = at_s - kept_s;
    }

    /// Corrects the state by a frame without load; `white` is its whitened innovation.
    fn learn(&mut self, answer: &mut Answer, frame: &Frame, now: &Arc<Steady>, white: &Whitened) {
        self.state.correct(&now.correction(white.data()));
        let complete = frame.rows.len() == self.prepared.rows.len();
        let (run, at_s) = (self.state.run, self.state.at_s);
        // the uncertainty of rows without readings grows with each frame
        let renewed =
            !complete || run >= STEADY_AFTER && (run - STEADY_AFTER).is_multiple_of(RENEWED_EVERY);
        if run >= STEADY_AFTER && !renewed && self.state.kept_days == Some(now.days) {
            self.steady = Some(Arc::clone(now));
        } else {
            self.state.set_covariance(&now.corrected());
            self.state.kept_days = Some(now.days);
            self.steady = None;
        }
        self.state.run += 1;
        self.state.empty_s = at_s;
        answer.since_empty_s = 0.0;
        if complete {
            let before = self.state.pace.pace;
            let chosen = self
                .state
                .pace
                .follow(&self.prepared.basis, &frame.in_basis, at_s);
            if chosen.is_some_and(|pace| pace != before) {
                self.state.restart();
                self.steady = None;
            }
            if self.state.run.is_multiple_of(TEST_EVERY) {
                let pace = self.state.pace.pace;
                let (anchors, basis) = (&self.state.anchors, &self.prepared.basis);
                answer.compared = true;
                answer.anchor = anchors.alarm(&self.model, basis, &frame.data, pace, at_s);
            }
        }
        let baseline = self.state.baseline();
        self.state.anchors.keep(&baseline, at_s);
    }

    /// Judges a frame of a sheet that was loaded before.
    pub(super) fn loaded(
        &mut self,
        answer: &mut Answer,
        frame: &Frame,
        event: Option<LoadTest>,
        now: &Arc<Steady>,
        white: &Whitened,
    ) -> Result<(), DriftError> {
        answer.judgement = Judgement::Loaded;
        self.predict(now);
        let mut back_to_empty = false;
        let comes = std::mem::take(&mut self.state.ledger.comes);
        if let (Some(test), Some(step)) = (event, &frame.step) {
            let came = test.change < 0.0;
            let fit = Whitened::new(&self.of_step(frame.days), step, &frame.step_rows)?;
            let mut fit = fit.fit_disc(&self.model)?;
            let whole = match comes && came {
                true => self.as_one_load(frame, white)?,
                false => None,
            };
            let ledger = &mut self.state.ledger;
            let same_load = if let Some(whole) = whole {
                ledger.lies_at(whole.disc);
                fit = whole;
                true
            } else if came {
                let grew = ledger.grew(fit.disc);
                if !grew {
                    ledger.came(&(&frame.e - step), fit.disc);
                    ledger.comes = !fit.accepted;
                }
                grew
            } else {
                let loads = ledger.loads();
                back_to_empty = ledger.went(&frame.e, |off| {
                    let white = Whitened::with(Arc::clone(&now.factor), off, &frame.rows);
                    white.data().norm_squared()
                });
                // recovery of the rest is not the removal of a load
                let all_went = back_to_empty && frame.e.norm() < HALF_GONE * ledger.peak().norm();
                let fewer = ledger.loads() < loads;
                let same = !(fewer || (all_went && !ledger.rest));
                ledger.rest |= all_went;
                same
            };
            answer.event = Some(Event {
                came,
                same_load,
                fit,
            });
        }
        self.state.ledger.follow(&frame.e);
        self.state.loaded_frames += 1;
        if self.state.ledger.held {
            return Ok(());
        }
        if !(back_to_empty || self.state.loaded_frames.is_multiple_of(TEST_EVERY)) {
            return Ok(());
        }
        let found = now.atoms.best(white.data(), &self.model, 1);
        let Some(best) = found.first().copied() else {
            return Ok(());
        };
        answer.score = Some(best.score);
        answer.chi = Some(white.chi_per_row());
        let mut peak = white.clone();
        peak.set(&self.state.ledger.peak());
        let most = now.atoms.best(peak.data(), &self.model, 1);
        let rest = most
            .first()
            .is_none_or(|most| best.score < REST * REST * most.score);
        let alone = self.state.ledger.loads() == 1;
        if best.score < LOADED || (alone && back_to_empty && rest) {
            self.state.ledger.release();
            self.allow_local(REST_ALLOWED * best.change.abs());
            let now = self.innovation(0.0, &frame.rows)?;
            answer.judgement = Judgement::Empty;
            self.learn(answer, frame, &now, &whitened(&now, frame));
        } else {
            self.leave_lock_out(answer, frame)?;
        }
        Ok(())
    }

    /// Fits the change in this frame and the previous one by one disc. A load that came during the previous frame
    /// appears in part in each of them, as if at different positions. `None` if one disc does not explain the change.
    fn as_one_load(&self, frame: &Frame, white: &Whitened) -> Result<Option<DiscFit>, DriftError> {
        let fitted = |white: &Whitened| -> Result<Option<DiscFit>, DriftError> {
            let fit = white.fit_disc(&self.model)?;
            let all = white.data().norm_squared();
            Ok(Some(fit).filter(|fit| fit.score > ONE_LOAD * all))
        };
        match self.state.ledger.before_last() {
            None => fitted(white),
            Some(before) => {
                let both = &frame.e - before;
                let of_both = self.of_step(2.0 * frame.days);
                fitted(&Whitened::new(&of_both, &both, &frame.rows)?)
            }
        }
    }

    /// A detected load may be drift that is faster than assumed. Searches the lowest higher pace at which the frame
    /// agrees with an empty sheet and is more probable than with a disc at the present pace; if there is one, adopts
    /// it, learns from the frame and returns true.
    fn leave_lock_out(&mut self, answer: &mut Answer, frame: &Frame) -> Result<bool, DriftError> {
        let before = self.state.clone();
        let now = self.innovation(0.0, &frame.rows)?;
        let (found, white) = self.best_disc(frame, &now);
        let Some(best) = found else {
            return Ok(false);
        };
        let cost = |white: &Whitened| white.log_determinant() + white.data().norm_squared();
        let as_load = cost(&white) - best.score;
        for pace in PACES.into_iter().filter(|pace| *pace > before.pace()) {
            self.state.raise_pace(pace);
            self.steady = None;
            let now = self.innovation(0.0, &frame.rows)?;
            let (found, white) = self.best_disc(frame, &now);
            if found.is_some_and(|best| best.score < LOADED) && cost(&white) < as_load {
                self.state.ledger.release();
                self.state.restart();
                answer.judgement = Judgement::Empty;
                self.learn(answer, frame, &now, &white);
                return Ok(true);
            }
        }
        self.state = before;
        self.steady = None;
        Ok(false)
    }

    /// The best disc of the load test, and the whitened innovation.
    fn best_disc(&self, frame: &Frame, now: &Steady) -> (Option<LoadTest>, Whitened) {
        let white = whitened(now, frame);
        let found = now.atoms.best(white.data(), &self.model, 1);
        (found.first().copied(), white)
    }

    /// Advances the covariance over the elapsed time without learning.
    pub(super) fn predict(&mut self, now: &Steady) {
        self.state.set_covariance(&now.predicted);
        self.state.restart();
        self.steady = None;
    }

    /// Adds local change of this standard deviation to the covariance.
    fn allow_local(&mut self, size: f64) {
        self.state
            .add_covariance(&self.model.local_gram, size * size);
        self.state.pace.changed_locally(&self.prepared.basis, size);
        self.state.restart();
        self.steady = None;
    }
}
