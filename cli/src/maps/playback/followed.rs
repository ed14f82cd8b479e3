//! Tracks the baseline of a recorded session once, in the background. Keeps states to start from, quantities, and
//! unrelieved times.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

use imaging::quantities::{QuantityRow, Rows, STORED_S};
use imaging::recorded::Recording;

use crate::failure::Failure;
use crate::maps::compared::Compared;
use crate::maps::follower::Follower;
use crate::maps::quantities::stored_in_one_unit;
use crate::maps::quantities::usable::unusable;
use crate::maps::reconstruction::Reconstruction;
use crate::options::choices::TrackedArguments;

/// States of the tracked baseline that are kept: 0.4 MB each for 26 electrodes.
const STATES: usize = 64;
/// Most frames for which a map is made.
const MAPS: usize = 5000;
/// Maps of the unrelieved time that are kept.
const UNRELIEVED: usize = 256;

/// The results for a session so far.
#[derive(Default)]
pub(super) struct Known {
    /// Frames of the session.
    total: usize,
    /// Number of frames that were tracked.
    done: usize,
    /// Number of the first frame that was not tracked yet.
    next: u64,
    /// The tracked baseline before some frames, the oldest first; empty if the baseline is not tracked.
    states: Vec<Follower>,
    /// Rows with spans of [`STORED_S`].
    rows: Vec<QuantityRow>,
    /// The source of the rows.
    source: String,
    /// Number of a frame and the unrelieved time of each triangle after it, s.
    unrelieved: Vec<(u64, Arc<[f32]>)>,
    /// Why the unrelieved times are unknown.
    no_unrelieved: Option<String>,
    failed: Option<String>,
    ended: bool,
}

impl Known {
    /// Share of the frames that were tracked.
    pub(super) fn progress(&self) -> f64 {
        match self.ended {
            true => 1.0,
            false => self.done as f64 / self.total.max(1) as f64,
        }
    }

    pub(super) fn failed(&self) -> Option<&str> {
        self.failed.as_deref()
    }

    pub(super) fn rows(&self) -> (&[QuantityRow], &str) {
        (&self.rows, &self.source)
    }

    /// The last state before a frame; `None` without one.
    pub(super) fn state(&self, sequence: u64) -> Option<&Follower> {
        let before = self
            .states
            .partition_point(|state| state.next() <= sequence);
        before.checked_sub(1).map(|last| &self.states[last])
    }

    /// An error unless all frames before this one were tracked: that they are not yet, or why they never will be.
    pub(super) fn reaches(&self, sequence: u64) -> Result<(), String> {
        if self.ended || self.next >= sequence {
            return Ok(());
        }
        match &self.failed {
            Some(why) => Err(why.clone()),
            None => Err(format!(
                "the baseline has been tracked through {} of {} frames so far; this map needs more",
                self.done, self.total
            )),
        }
    }

    /// The unrelieved times after the last frame with a map up to this one, and the number of that frame.
    pub(super) fn unrelieved(&self, sequence: u64) -> Result<(u64, Arc<[f32]>), String> {
        if let Some(why) = &self.no_unrelieved {
            return Err(why.clone());
        }
        self.reaches(sequence)?;
        let before = self.unrelieved.partition_point(|(of, _)| *of <= sequence);
        let last = before
            .checked_sub(1)
            .map(|last| self.unrelieved[last].clone());
        last.ok_or_else(|| "no frame up to this one has a map that can be used".to_owned())
    }
}

/// A session that is tracked in the background until this is dropped.
pub(super) struct Followed {
    shared: Arc<Shared>,
}

struct Shared {
    known: Mutex<Known>,
    cancelled: AtomicBool,
}

impl Shared {
    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Followed {
    /// Starts to track a session. `reconstruction`: makes the maps of which quantities are computed.
    pub(super) fn start(path: &Path, reconstruction: Arc<Reconstruction>) -> Self {
        let shared = Arc::new(Shared {
            known: Mutex::default(),
            cancelled: AtomicBool::new(false),
        });
        let (of_thread, path) = (Arc::clone(&shared), path.to_owned());
        thread::spawn(move || {
            let failed = follow(&path, &reconstruction, &of_thread).err();
            let mut known = of_thread.known();
            known.ended = failed.is_none();
            known.failed = failed.map(|why| why.to_string());
        });
        Self { shared }
    }

    pub(super) fn known(&self) -> MutexGuard<'_, Known> {
        self.shared.known()
    }
}

impl Drop for Followed {
    fn drop(&mut self) {
        self.shared.cancelled.store(true, Ordering::Relaxed);
    }
}

fn follow(path: &Path, reconstruction: &Reconstruction, shared: &Shared) -> Result<(), Failure> {
    let recording = Recording::from_session(path, None, false)?;
    let total = recording.len()?;
    shared.known().total = total;
    let folder = logbook::folder_of(path);
    let stored = stored_in_one_unit(folder, &recording.name)?;
    let is_stored = stored.is_some();
    if let Some((rows, left_out)) = stored {
        let mut known = shared.known();
        known.rows = rows;
        known.source = format!("as the daemon computed them{left_out}");
    }
    let tracking = Reconstruction::tracking_of(&recording)?;
    let mut follower = Follower::new(tracking, &TrackedArguments::default(), &recording)?;
    let mut quantifier = reconstruction.quantifier(&recording)?;
    let hold_s = quantifier.settings().hold_s;
    let (every, keep) = (total.div_ceil(MAPS).max(1), total.div_ceil(STATES).max(1));
    let unrelieved_every = total.div_ceil(every * UNRELIEVED).max(1) * every;
    if !is_stored {
        shared.known().source = match every {
            1 => format!("computed with {}", reconstruction.method()),
            _ => format!(
                "computed with {} from one in {every} frames",
                reconstruction.method()
            ),
        };
    }
    let mut rows = Rows::new(STORED_S);
    let mut last_s: Option<f64> = None;
    // whether the unrelieved times of the next frame with a usable map are to be kept
    let mut is_due = false;
    for (index, frame) in recording.frames().filter_map(Result::ok).enumerate() {
        if shared.cancelled.load(Ordering::Relaxed) {
            return Ok(());
        }
        if index.is_multiple_of(keep)
            && let Some(follower) = &follower
        {
            shared.known().states.push(follower.clone());
        }
        if index.is_multiple_of(every) {
            let followed = match &mut follower {
                Some(follower) => Some(follower.follow(&frame)?),
                None => None,
            };
            let compared = Compared::new(&recording, &frame, followed.as_ref());
            let at_s = frame.time_s(None);
            let (quantities, _) = compared.quantities(reconstruction, &mut quantifier, at_s)?;
            let ended = at_s.map(|at_s| rows.take(at_s, &quantities));
            let mut known = shared.known();
            if !is_stored {
                known.rows.extend(ended.unwrap_or_default());
            }
            is_due |= index.is_multiple_of(unrelieved_every);
            if is_due && unusable(&quantities).is_none() {
                let values = quantifier.unrelieved().iter().map(|s| *s as f32);
                known.unrelieved.push((frame.sequence, values.collect()));
                is_due = false;
            }
            let step_s = at_s.zip(last_s).map(|(at_s, last_s)| at_s - last_s);
            if every > 1 && step_s.is_some_and(|step_s| step_s > hold_s) {
                known.no_unrelieved = Some(format!(
                    "unrelieved time is not known: of this long session only one in {every} frames is used, and \
                     these are more than {hold_s} s apart"
                ));
            }
            last_s = at_s;
        } else if let Some(follower) = &mut follower {
            follower.pass(&frame)?;
        }
        let mut known = shared.known();
        (known.done, known.next) = (index + 1, frame.sequence + 1);
    }
    if !is_stored {
        shared.known().rows.extend(rows.end());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;
    use std::time::Duration;

    use chrono::{DateTime, Utc};
    use imaging::quantities::{LoadUnit, Quantity, store};
    use logbook::{SessionHeader, SessionWriter};
    use survey::{Amps, Baseline, Frame, Precautions, Protocol, Reading, Settings, Volts};

    use super::*;
    use crate::args::MapOptions;

    fn at(second: i64) -> DateTime<Utc> {
        DateTime::from_timestamp(1_800_000_000 + second, 0).unwrap()
    }

    /// The session `m1` of two frames on a disc tank in which nothing was measured.
    fn session(folder: &Path) -> PathBuf {
        let protocol = Protocol::sheffield(16).unwrap();
        let settings = Settings {
            precautions: Precautions::default(),
            protocol_hash: protocol.hash(),
            current: Amps(1e-3),
            range: Volts(1.0),
            nplc: 1.0,
            settle: Duration::from_millis(1),
            wiring: "test".into(),
        };
        let baseline = Baseline {
            id: "b1".into(),
            deviation: vec![Some(2e-6); protocol.len()],
            readings: vec![Reading::Ok(Volts(0.1)); protocol.len()],
            frames: 10,
            wall: at(-60),
            settings: settings.clone(),
            simulated: true,
        };
        let header = SessionHeader {
            config_toml: "[geometry]\npreset = \"disc-tank\"\n".into(),
            simulated: true,
            ..SessionHeader::new("m1", at(0), protocol.clone())
        };
        let mut writer = SessionWriter::create(folder, &header).unwrap();
        writer.baseline(&baseline).unwrap();
        for second in [1, 2] {
            let frame = Frame {
                sequence: 0,
                readings: vec![Reading::NotMeasured; protocol.len()],
                extra: Vec::new(),
                monotonic: Duration::from_secs(second),
                wall: at(second as i64),
                duration: Duration::from_millis(500),
                settings: settings.clone(),
                compliance: Vec::new(),
                simulated: true,
            };
            writer.append(&frame, None).unwrap();
        }
        let path = writer.path().to_owned();
        writer.close(at(3), "count reached").unwrap();
        path
    }

    /// The results after tracking all frames of a session.
    fn followed(path: &Path) -> Known {
        let (_, reconstruction) = Reconstruction::of_session(path, &MapOptions::default()).unwrap();
        let shared = Shared {
            known: Mutex::default(),
            cancelled: AtomicBool::new(false),
        };
        follow(path, &reconstruction, &shared).unwrap();
        shared.known.into_inner().unwrap()
    }

    #[test]
    fn frames_without_a_map_have_no_time_without_relief() {
        let folder = tempfile::tempdir().unwrap();
        let known = followed(&session(folder.path()));
        assert_eq!(known.next, 3);
        let refusal = known.unrelieved(2).unwrap_err();
        assert_eq!(
            refusal,
            "no frame up to this one has a map that can be used"
        );
    }

    #[test]
    fn stored_rows_in_another_unit_are_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = session(folder.path());
        let row = |minute: i64, of| QuantityRow {
            begin_s: 1_800_000_000 + 60 * minute,
            region: "sheet".into(),
            quantity: Quantity::Load,
            of,
            min: 1.0,
            mean: 2.0,
            max: 3.0,
            frames: 2,
            known: 2,
        };
        // calibrated from the second minute on
        let calibrated = row(1, LoadUnit::Pressure);
        for row in [row(0, LoadUnit::RelativeLoss), calibrated.clone()] {
            store(folder.path(), "m1", &[row]).unwrap();
        }
        let known = followed(&path);
        let (rows, source) = known.rows();
        assert_eq!(rows, [calibrated]);
        assert!(
            source.ends_with("in another unit than the newest are left out"),
            "{source}"
        );
    }
}
