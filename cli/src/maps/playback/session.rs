//! An open session: quick and exact maps of any of its frames.

use std::any::Any;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use chrono::DateTime;
use eit::Pressure;
use imaging::quantities::{
    FrameQuantities, LoadUnit, Quantifier, Quantity, RegionSettings, joined,
};
use imaging::recorded::{Origin, RecordedFrame, Recording};
use imaging::{Method, MethodArguments, TrackedFrame};
use render::Sheet;
use survey::{Map, Reading};
use web::{Course, DEVIATION, EventState, MapKind, Overview, Place, Playback, PlayedMap};

use super::followed::Followed;
use super::history::span_of;
use crate::args::MapOptions;
use crate::failure::Failure;
use crate::maps::compared::Compared;
use crate::maps::follower::Follower;
use crate::maps::reconstruction::Reconstruction;
use crate::maps::session_settings;
use crate::options::choices::TrackedArguments;

/// A session for playback.
pub(super) struct PlayedSession {
    path: PathBuf,
    overview: Overview,
    sheet: Sheet,
    quick: Mutex<Quick>,
    /// Built for the first requested exact map.
    exact: Mutex<Option<Exact>>,
    followed: Followed,
    /// Keeps the file in the cache while the session is played.
    _kept: Kept,
}

/// A guard that keeps the file of a session in the cache, if it is in one.
pub(super) type Kept = Option<Box<dyn Any + Send + Sync>>;

/// A fast method.
struct Quick {
    recording: Recording,
    reconstruction: Arc<Reconstruction>,
    /// Whether it is the session's own method.
    own: bool,
}

/// The session's own method.
struct Exact {
    recording: Recording,
    reconstruction: Arc<Reconstruction>,
    quantifier: Quantifier,
    /// The tracked baseline after the frame that was requested last.
    follower: Option<Follower>,
    /// Number of that frame, and its tracked baseline; `None` if it is not tracked.
    last: Option<(u64, Option<TrackedFrame>)>,
}

impl PlayedSession {
    /// Opens a session and starts to track its baseline. `id`: the id that the page uses.
    pub(super) fn open(path: &Path, id: &str, kept: Kept) -> Result<Self, Failure> {
        let recording = Recording::from_session(path, None, false)?;
        let own = is_fast(&recording);
        let method = (!own).then_some(Method::OneStep);
        let reconstruction = Arc::new(prepared(method, &recording)?);
        let overview = Overview {
            id: id.to_owned(),
            ..overview(&recording)?
        };
        Ok(Self {
            path: path.to_owned(),
            overview,
            sheet: reconstruction.field.sheet.clone(),
            followed: Followed::start(path, Arc::clone(&reconstruction)),
            quick: Mutex::new(Quick {
                recording,
                reconstruction,
                own,
            }),
            exact: Mutex::new(None),
            _kept: kept,
        })
    }

    fn quick(&self) -> MutexGuard<'_, Quick> {
        self.quick.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn played(&self, place: Place, kind: MapKind) -> Result<PlayedMap, Failure> {
        let frame = {
            let quick = self.quick();
            let frame = found(&quick.recording, place)?;
            if kind == MapKind::Quick {
                return self.at_once(&quick, &frame);
            }
            frame
        };
        match kind {
            MapKind::Exact | MapKind::Deviation => self.exactly(&frame, kind),
            MapKind::Quick | MapKind::Unrelieved => self.unrelieved(&frame),
        }
    }

    fn at_once(&self, quick: &Quick, frame: &RecordedFrame) -> Result<PlayedMap, Failure> {
        let known = self.followed.known();
        let state = known.state(frame.sequence);
        let (baseline, readings);
        let (baseline, readings, since): (&[Reading], &[Reading], String) = match state {
            Some(follower) => {
                (baseline, readings) = follower.compare(&frame.readings);
                let since = format!(
                    "the baseline as it was before frame {}",
                    follower.next().max(1)
                );
                (&baseline, &readings, since)
            }
            None => (
                &quick.recording.unloaded.readings,
                &frame.readings,
                "the baseline as it was recorded".to_owned(),
            ),
        };
        // so that the frames after this one are tracked meanwhile
        drop(known);
        let map = quick.reconstruction.map(baseline, readings)?;
        let pressure = quick.reconstruction.pressure(&map)?;
        let method = match quick.own {
            true => String::new(),
            false => format!("{} in place of the session's method, ", map.method),
        };
        let provisional = format!("provisional: {method}{since}");
        Ok(PlayedMap {
            provisional: Some(provisional),
            ..shown(frame, &map, pressure.as_ref(), &quick.reconstruction)
        })
    }

    fn exactly(&self, frame: &RecordedFrame, kind: MapKind) -> Result<PlayedMap, Failure> {
        let mut exact = self.exact.lock().unwrap_or_else(PoisonError::into_inner);
        let exact = match &mut *exact {
            Some(exact) => exact,
            empty => {
                let (own, quick) = {
                    let quick = self.quick();
                    (quick.own, Arc::clone(&quick.reconstruction))
                };
                empty.insert(Exact::new(&self.path, Some(quick).filter(|_| own))?)
            }
        };
        // a map and its deviations are requested for the same frame: reuse the tracked baseline
        let last = exact.last.take();
        let followed = match last.filter(|(of, _)| *of == frame.sequence) {
            Some((_, followed)) => followed,
            None => {
                let start = {
                    let known = self.followed.known();
                    known.reaches(frame.sequence).map_err(Failure::Busy)?;
                    known.state(frame.sequence).cloned()
                };
                exact.follow(start, frame)?
            }
        };
        exact.last = Some((frame.sequence, followed.clone()));
        let compared = Compared::new(&exact.recording, frame, followed.as_ref());
        if kind == MapKind::Deviation {
            let values = compared.deviation(&exact.reconstruction)?;
            let values = values.into_iter().map(|sd| sd as f32).collect();
            let method = exact.reconstruction.method();
            return Ok(values_of(frame, method, DEVIATION, values));
        }
        // a copy for each frame, because quantities over time cannot be computed from single frames
        let mut quantifier = exact.quantifier.clone();
        let (quantities, made) =
            compared.quantities(&exact.reconstruction, &mut quantifier, frame.time_s(None))?;
        let Some((map, pressure)) = made else {
            let why = quantities.reason.unwrap_or_default();
            return Err(Failure::Failed(format!("frame {}: {why}", frame.sequence)));
        };
        Ok(PlayedMap {
            tracked: followed.map(|followed| followed.tracked),
            quantities: Some(without_course(quantities)),
            ..shown(frame, &map, pressure.as_ref(), &exact.reconstruction)
        })
    }

    fn unrelieved(&self, frame: &RecordedFrame) -> Result<PlayedMap, Failure> {
        // this lock is released before `quick` is locked: a quick map locks both in the other order
        let known = self.followed.known().unrelieved(frame.sequence);
        let (of, values) = known.map_err(Failure::Busy)?;
        let quick = self.quick();
        Ok(PlayedMap {
            provisional: Some(format!("as of frame {of}")),
            ..values_of(frame, quick.reconstruction.method(), "s", values.to_vec())
        })
    }
}

impl Exact {
    /// `fast`: the reconstruction, if the session's own method is fast.
    fn new(path: &Path, fast: Option<Arc<Reconstruction>>) -> Result<Self, Failure> {
        let recording = Recording::from_session(path, None, false)?;
        let is_fast = fast.is_some();
        let reconstruction = match fast {
            Some(fast) => fast,
            None => Arc::new(prepared(None, &recording)?),
        };
        let quantifier = reconstruction.quantifier(&recording)?;
        let deviation = reconstruction.deviation().filter(|_| is_fast);
        Ok(Self {
            quantifier: quantifier.with_deviation(deviation),
            recording,
            reconstruction,
            follower: None,
            last: None,
        })
    }

    /// The frame with its tracked baseline, starting from `start` or from the last frame's state, whichever is nearer;
    /// `None` if the baseline is not tracked.
    fn follow(
        &mut self,
        start: Option<Follower>,
        frame: &RecordedFrame,
    ) -> Result<Option<TrackedFrame>, Failure> {
        let nearest = [self.follower.take(), start]
            .into_iter()
            .flatten()
            .filter(|follower| follower.next() <= frame.sequence)
            .max_by_key(Follower::next);
        let Some(mut follower) = nearest else {
            return Ok(None);
        };
        follower.pass_before(&self.recording, frame.sequence)?;
        let followed = follower.follow(frame)?;
        self.follower = Some(follower);
        Ok(Some(followed))
    }
}

impl Playback for PlayedSession {
    fn overview(&self) -> &Overview {
        &self.overview
    }

    fn sheet(&self) -> &Sheet {
        &self.sheet
    }

    fn course(&self, spans: u32) -> Result<Course, String> {
        let known = self.followed.known();
        let (rows, source) = known.rows();
        let span_s = span_of(rows, spans);
        Ok(Course {
            progress: known.progress(),
            failed: known.failed().map(str::to_owned),
            source: source.to_owned(),
            rows: joined(rows, span_s),
            span_s,
        })
    }

    fn map(&self, place: Place, kind: MapKind) -> Result<PlayedMap, String> {
        self.played(place, kind).map_err(|why| why.to_string())
    }
}

/// Whether the session's own method makes a map within a few milliseconds.
pub(super) fn is_fast(recording: &Recording) -> bool {
    let Origin::Session(header) = &recording.origin else {
        return false;
    };
    let stored = session_settings::stored_config(header).ok();
    let one_step =
        stored.is_some_and(|stored| stored.model.method.unwrap_or_default() == Method::OneStep);
    header.model_hash.is_some() || (one_step && !header.config_toml.is_empty())
}

/// A reconstruction that does not track the baseline itself. `method`: replaces the session's own method.
pub(super) fn prepared(
    method: Option<Method>,
    recording: &Recording,
) -> Result<Reconstruction, Failure> {
    let asked = MapOptions {
        method: MethodArguments {
            method,
            ..MethodArguments::default()
        },
        tracked: TrackedArguments {
            tracked: Some(false),
            ..TrackedArguments::default()
        },
        ..MapOptions::default()
    };
    Reconstruction::new(&asked, recording)
}

fn found(recording: &Recording, place: Place) -> Result<RecordedFrame, Failure> {
    let frame = match place {
        Place::Frame(sequence) => {
            let next = recording.frames_from(sequence).next().transpose()?;
            next.filter(|frame| frame.sequence == sequence)
        }
        // a frame within this millisecond is included
        Place::Time(ms) => {
            let end_us = ms.checked_mul(1000).and_then(|us| us.checked_add(999));
            match end_us.and_then(DateTime::from_timestamp_micros) {
                Some(time) => recording.frame_at(time)?,
                None => None,
            }
        }
    };
    frame.ok_or_else(|| Failure::Failed(format!("{} has no frame there", recording.name)))
}

fn wall_ms(frame: &RecordedFrame) -> i64 {
    frame.wall.map_or(0, |wall| wall.timestamp_millis())
}

fn shown(
    frame: &RecordedFrame,
    map: &Map,
    pressure: Option<&Pressure>,
    reconstruction: &Reconstruction,
) -> PlayedMap {
    let (unit, values) = shown_values(map, pressure);
    PlayedMap {
        noise: reconstruction.noise.filter(|_| pressure.is_none()),
        ..values_of(frame, &map.method, PlayedMap::unit_of(unit), values)
    }
}

/// Values of a frame's triangles, without further results.
fn values_of(
    frame: &RecordedFrame,
    method: &str,
    unit: &'static str,
    values: Vec<f32>,
) -> PlayedMap {
    PlayedMap {
        sequence: frame.sequence,
        wall_ms: wall_ms(frame),
        method: method.to_owned(),
        unit,
        provisional: None,
        noise: None,
        tracked: None,
        quantities: None,
        values,
    }
}

/// The values of a map as a page shows them: pressures with a calibration, otherwise losses, so that a load is
/// positive.
pub(super) fn shown_values(map: &Map, pressure: Option<&Pressure>) -> (LoadUnit, Vec<f32>) {
    match pressure {
        Some(pressure) => (
            LoadUnit::Pressure,
            pressure.kpa.iter().map(|kpa| *kpa as f32).collect(),
        ),
        None => (
            LoadUnit::RelativeLoss,
            map.values.iter().map(|change| -*change as f32).collect(),
        ),
    }
}

/// Removes the quantities that depend on all frames before.
fn without_course(mut quantities: FrameQuantities) -> FrameQuantities {
    for region in &mut quantities.regions {
        region.values = region.values.filter_map(|quantity, value| {
            let of_course = [
                Quantity::Dose,
                Quantity::Unrelieved,
                Quantity::UnrelievedArea,
                Quantity::Speed,
                Quantity::Path,
                // the hot spots depend on the earlier ones
                Quantity::HotSpots,
            ];
            (!of_course.contains(&quantity)).then_some(value)
        });
        (region.dose_mm, region.unrelieved_mm) = (None, None);
    }
    quantities.changes.clear();
    quantities
}

fn overview(recording: &Recording) -> Result<Overview, Failure> {
    let ends = recording.ends()?;
    let (first_frame, last_frame) =
        ends.ok_or_else(|| Failure::Failed(format!("{} has no readable frame", recording.name)))?;
    let first = found(recording, Place::Frame(first_frame))?;
    let last = recording.frame_at(DateTime::<chrono::Utc>::MAX_UTC)?;
    let events = recording.events()?.into_iter().map(|event| EventState {
        wall_ms: event.at.timestamp_millis(),
        kind: event.kind,
        text: event.text,
    });
    let note = match &recording.origin {
        Origin::Session(header) => header.note.clone(),
        Origin::Folder(_) => String::new(),
    };
    // a region that the daemon refused has no quantities and is not drawn
    let (_, regions) = session_settings::of_quantities(&recording.origin)?;
    let regions = regions.iter().filter_map(RegionSettings::shape);
    Ok(Overview {
        regions: regions.collect(),
        id: recording.name.clone(),
        note,
        simulated: recording.simulated == Some(true),
        first_frame,
        last_frame,
        first_ms: wall_ms(&first),
        last_ms: last.as_ref().map_or(wall_ms(&first), wall_ms),
        events: events.collect(),
    })
}
