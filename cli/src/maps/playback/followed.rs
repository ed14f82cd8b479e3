//! Follows the baseline of a recorded session once, in the background: states to start from, quantities, time without relief.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

use imaging::quantities::{QuantityRow, Rows, STORED_S, stored};
use imaging::recorded::Recording;

use crate::failure::Failure;
use crate::maps::compared::Compared;
use crate::maps::follower::Follower;
use crate::maps::reconstruction::Reconstruction;
use crate::options::choices::TrackedArguments;

/// States of the tracked baseline that are kept: 0.4 MB each for 26 electrodes.
const STATES: usize = 64;
/// Most frames of which a map is made.
const MAPS: usize = 5000;
/// Maps of the time without relief that are kept.
const UNRELIEVED: usize = 256;

/// What is known of a session so far.
#[derive(Default)]
pub(super) struct Known {
    /// Frames of the session.
    total: usize,
    /// Frames that were followed.
    done: usize,
    /// Number of the first frame that was not followed yet.
    next: u64,
    /// The tracked baseline before some frames, the oldest first; empty where it is not followed.
    states: Vec<Follower>,
    /// Rows of [`STORED_S`].
    rows: Vec<QuantityRow>,
    /// Where the rows are from.
    source: String,
    /// Number of a frame and the time without relief of each triangle after it, s.
    unrelieved: Vec<(u64, Arc<[f32]>)>,
    /// Why there is no time without relief.
    no_unrelieved: Option<String>,
    failed: Option<String>,
    ended: bool,
}

impl Known {
    /// Share of the frames that were followed.
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

    /// The last state before a frame.
    pub(super) fn state(&self, sequence: u64) -> Option<&Follower> {
        let before = self
            .states
            .partition_point(|state| state.next() <= sequence);
        before.checked_sub(1).map(|last| &self.states[last])
    }

    /// Whether all frames before this one were followed, and why they never will be.
    pub(super) fn reaches(&self, sequence: u64) -> Result<(), String> {
        if self.ended || self.next >= sequence {
            return Ok(());
        }
        match &self.failed {
            Some(why) => Err(why.clone()),
            None => Err(format!(
                "the baseline was followed through {} of {} frames by now; this map needs more",
                self.done, self.total
            )),
        }
    }

    /// The time without relief after the last frame up to this one, and the number of that frame.
    pub(super) fn unrelieved(&self, sequence: u64) -> Result<(u64, Arc<[f32]>), String> {
        if let Some(why) = &self.no_unrelieved {
            return Err(why.clone());
        }
        self.reaches(sequence)?;
        let before = self.unrelieved.partition_point(|(of, _)| *of <= sequence);
        let last = before
            .checked_sub(1)
            .map(|last| self.unrelieved[last].clone());
        last.ok_or_else(|| "no frame before this one has a map".to_owned())
    }
}

/// A session that is followed in the background until this is dropped.
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
    /// Starts to follow a session. `reconstruction`: of the maps that quantities are computed from.
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
    let stored = stored(folder, &recording.name)?;
    let is_stored = stored.is_some();
    if let Some((rows, damaged)) = stored {
        let mut known = shared.known();
        known.rows = rows;
        known.source = match damaged {
            0 => "as the daemon computed them".to_owned(),
            _ => format!("as the daemon computed them; {damaged} minutes are damaged and left out"),
        };
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
                "computed with {} from every {every}th frame",
                reconstruction.method()
            ),
        };
    }
    let mut rows = Rows::new(STORED_S);
    let mut last_s: Option<f64> = None;
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
            let (quantities, _) = compared.quantities(reconstruction, &mut quantifier)?;
            let at_s = frame.at_s();
            let ended = rows.take(at_s, &quantities);
            let mut known = shared.known();
            if !is_stored {
                known.rows.extend(ended);
            }
            if index.is_multiple_of(unrelieved_every) {
                let values = quantifier.unrelieved().iter().map(|s| *s as f32);
                known.unrelieved.push((frame.sequence, values.collect()));
            }
            if every > 1 && last_s.is_some_and(|last_s| at_s - last_s > hold_s) {
                known.no_unrelieved = Some(format!(
                    "time without relief is not known: of this long session every {every}th frame is looked at, and these lie \
                     more than {hold_s} s apart"
                ));
            }
            last_s = Some(at_s);
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
