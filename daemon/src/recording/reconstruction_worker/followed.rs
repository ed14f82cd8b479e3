//! The tracked baseline of a session, updated in the thread that computes maps. Its state is stored in the folder of
//! the sessions, and restored by the next session with the same baseline.

use std::path::PathBuf;

use imaging::recorded::SessionParts;
use imaging::tracking::{
    Doubtful, KeptTracking, Orders, TrackingOrder, TrackingState, keep, kept, seconds,
};
use imaging::{Conditions, Geometry, TrackedFrame, Tracking};
use logbook::LogbookError;
use survey::{Amps, Baseline, Protocol, error_chain as chain};

use super::FrameRequest;

/// Time between two stored states, s. After a restart, the frames since the last stored state are followed again.
const KEPT_EVERY_S: f64 = 3600.0;

/// Inputs for tracking a session's baseline.
pub(crate) struct TrackingContext {
    pub geometry: Geometry,
    pub protocol: Protocol,
    pub current: Amps,
    /// Standard deviation of one reading, V.
    pub noise_v: f64,
    /// Folder of the sessions.
    pub folder: PathBuf,
    /// Id of the session, without the number of its part.
    pub session: String,
    /// Sequence of its last frame if it is resumed; otherwise 0.
    pub after: u64,
}

/// Updates the tracked baseline with each frame of a session.
pub(super) struct Followed {
    tracking: Tracking,
    folder: PathBuf,
    baseline: String,
    session: String,
    sequence: u64,
    kept_s: f64,
    /// The state that was last reported: masked electrodes, reason for doubt, slow change.
    masked: Vec<usize>,
    reason: Option<Doubtful>,
    slow_change: bool,
}

impl Followed {
    /// Fits the sheet, and restores the state of the session, or of the last session with this baseline. Also returns
    /// remarks for the record.
    ///
    /// # Errors
    /// Why the baseline cannot be tracked.
    pub(super) fn start(
        context: TrackingContext,
        baseline: &Baseline,
    ) -> Result<(Self, Vec<String>), String> {
        let conditions = Conditions::live(&context.geometry, &context.protocol, context.current);
        let at_s = seconds(baseline.wall);
        let tracking = Tracking::new(&conditions, &baseline.readings, context.noise_v, at_s)
            .map_err(|error| chain(&error))?;
        let mut followed = Self {
            tracking,
            folder: context.folder,
            baseline: baseline.id.clone(),
            session: context.session,
            sequence: 0,
            kept_s: at_s,
            masked: Vec::new(),
            reason: None,
            slow_change: false,
        };
        let mut remarks = Vec::new();
        if let Err(why) = followed.restore(context.after) {
            remarks.push(format!(
                "the tracked baseline of earlier sessions cannot be used; tracking begins again at baseline {}: {why}",
                baseline.id
            ));
        }
        followed.catch_up(context.after)?;
        Ok((followed, remarks))
    }

    /// Restores the latest state of the baseline if it is from this session or if this session is new; otherwise the
    /// state with which this session began.
    fn restore(&mut self, after: u64) -> Result<(), String> {
        let failed = |error: LogbookError| chain(&error);
        let latest: Option<KeptTracking> = kept(&self.folder, &self.baseline).map_err(failed)?;
        if let Some(kept) = latest {
            if kept.session == self.session && kept.sequence <= after {
                self.sequence = kept.sequence;
                return self.set(kept.state);
            }
            if after == 0 {
                self.set(kept.state)?;
                // replay starts from this state
                return keep(&self.folder, &self.session, &self.tracking.state()).map_err(failed);
            }
        }
        match kept(&self.folder, &self.session).map_err(failed)? {
            Some(begun) => self.set(begun),
            None => Ok(()),
        }
    }

    fn set(&mut self, state: TrackingState) -> Result<(), String> {
        self.tracking.restore(state).map_err(|error| chain(&error))
    }

    /// Follows the recorded frames after the restored state, up to the last one.
    fn catch_up(&mut self, after: u64) -> Result<(), String> {
        if after == 0 {
            return Ok(());
        }
        let first = logbook::find(&self.folder, &self.session).map_err(|error| chain(&error))?;
        let parts = SessionParts::open(&first).map_err(|error| chain(&error))?;
        let recorded = parts.frames_from(self.sequence + 1);
        let events = parts.events().map_err(|error| chain(&error))?;
        let orders = Orders::recorded(&events, &first, self.sequence);
        let mut orders = orders.map_err(|error| chain(&error))?;
        for frame in recorded.filter_map(|record| Some(record.ok()?.frame)) {
            for order in orders.due(frame.sequence) {
                self.tracking.order(order);
            }
            self.tracking
                .pass(&frame.readings, seconds(frame.wall))
                .map_err(|error| chain(&error))?;
            self.sequence = frame.sequence;
        }
        // orders given after the last frame apply to the next one
        for order in orders.due(u64::MAX) {
            self.tracking.order(order);
        }
        Ok(())
    }

    /// Gives an operator's order to the tracked baseline, for the next frame.
    pub(super) fn order(&mut self, order: TrackingOrder) {
        self.tracking.order(order);
    }

    /// The tracked baseline.
    pub(super) fn tracking(&self) -> &Tracking {
        &self.tracking
    }

    /// Updates the tracked baseline with a frame. Returns the judgement of the frame, and the baseline to compare it
    /// with.
    ///
    /// # Errors
    /// The frame cannot be followed.
    pub(super) fn follow(&mut self, request: &FrameRequest) -> Result<TrackedFrame, String> {
        let (readings, at_s) = (&request.readings, request.at_s);
        self.sequence = request.sequence;
        let frame = match request.map {
            true => self.tracking.follow(readings, at_s),
            // skips the estimate of changes that the tracked baseline does not contain, which takes as long as a map:
            // frames are waiting
            false => self.tracking.judge(readings, at_s),
        };
        let frame = frame.map_err(|error| chain(&error))?;
        // stored also after an order, so that its effect is visible to clients
        if (at_s - self.kept_s).abs() >= KEPT_EVERY_S || !frame.orders.is_empty() {
            self.kept_s = at_s;
            self.keep();
        }
        Ok(frame)
    }

    /// Texts for people about what has changed since the previous frame.
    pub(super) fn changes(&mut self, frame: &TrackedFrame) -> Vec<String> {
        let tracked = &frame.tracked;
        let mut texts = Vec::new();
        for electrode in &tracked.masked {
            if !self.masked.contains(electrode) {
                let fault = tracked
                    .fault
                    .as_deref()
                    .unwrap_or("its readings show a fault");
                texts.push(format!(
                    "electrode {electrode} is left out of the maps: {fault}"
                ));
            }
        }
        for electrode in &self.masked {
            if !tracked.masked.contains(electrode) {
                texts.push(format!(
                    "electrode {electrode} is used again: it was healthy for an hour"
                ));
            }
        }
        self.masked.clone_from(&tracked.masked);
        if self.slow_change != tracked.slow_change.is_some() {
            texts.extend(tracked.slow_change.clone());
            self.slow_change = tracked.slow_change.is_some();
        }
        if self.reason != tracked.reason {
            texts.push(match &tracked.text {
                Some(text) => format!("the map is not known to be true: {text}"),
                None => "the map is known to be true again".to_owned(),
            });
            self.reason = tracked.reason;
        }
        texts
    }

    /// Stores the state. Without it, the next daemon follows the recorded frames again.
    pub(super) fn keep(&self) {
        let kept = KeptTracking {
            session: self.session.clone(),
            sequence: self.sequence,
            state: self.tracking.state(),
            drift: self.tracking.drift().ok(),
        };
        if let Err(error) = keep(&self.folder, &self.baseline, &kept) {
            tracing::warn!("the tracked baseline cannot be stored: {}", chain(&error));
        }
    }
}
