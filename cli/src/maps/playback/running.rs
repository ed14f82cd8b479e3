//! The running session, for maps that the live page makes in addition to those of the daemon.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};

use imaging::Method;
use imaging::recorded::Recording;
use survey::{Reading, Volts};
use web::{PlayedMap, ProvisionalMap, RunningModel};

use super::session::{is_fast, prepared, shown_values};
use crate::failure::Failure;
use crate::maps::follower::Follower;
use crate::maps::reconstruction::Reconstruction;
use crate::options::choices::TrackedArguments;

/// A session that a daemon is recording.
pub(super) struct RunningSession {
    path: PathBuf,
    is_fast: bool,
    /// Built for the first requested map.
    model: OnceLock<Result<Built, String>>,
}

/// The inputs of its maps.
struct Built {
    unloaded: Vec<Reading>,
    one_step: Reconstruction,
    /// The tracked baseline at the begin of the session; `None` if it is not tracked.
    begin: Option<Mutex<Follower>>,
}

impl RunningSession {
    pub(super) fn open(path: &Path) -> Result<Self, Failure> {
        let recording = Recording::from_session(path, None, false)?;
        Ok(Self {
            is_fast: is_fast(&recording),
            path: path.to_owned(),
            model: OnceLock::new(),
        })
    }

    fn model(&self) -> Result<&Built, String> {
        let built = self
            .model
            .get_or_init(|| Built::new(&self.path).map_err(|why| why.to_string()));
        built.as_ref().map_err(Clone::clone)
    }
}

impl Built {
    fn new(path: &Path) -> Result<Self, Failure> {
        let recording = Recording::from_session(path, None, false)?;
        let tracking = Reconstruction::tracking_of(&recording)?;
        let begin = Follower::new(tracking, &TrackedArguments::default(), &recording)?;
        Ok(Self {
            one_step: prepared(Some(Method::OneStep), &recording)?,
            begin: begin.map(Mutex::new),
            unloaded: recording.unloaded.readings,
        })
    }

    /// A frame, and the baseline to compare it with.
    fn compare(&self, readings: &[Option<f64>]) -> (Vec<Reading>, Vec<Reading>) {
        let each = readings.iter().map(|reading| match reading {
            Some(volts) => Reading::Ok(Volts(*volts)),
            None => Reading::NotMeasured,
        });
        let readings: Vec<Reading> = each.collect();
        match &self.begin {
            Some(begin) => {
                let begin = begin.lock().unwrap_or_else(PoisonError::into_inner);
                begin.compare(&readings)
            }
            None => (self.unloaded.clone(), readings),
        }
    }
}

impl RunningModel for RunningSession {
    fn is_fast(&self) -> bool {
        self.is_fast
    }

    fn provisional(&self, readings: &[Option<f64>]) -> Result<ProvisionalMap, String> {
        let model = self.model()?;
        let (baseline, readings) = model.compare(readings);
        let map = model.one_step.map(&baseline, &readings);
        let map = map.map_err(|why| why.to_string())?;
        let pressure = model
            .one_step
            .pressure(&map)
            .map_err(|why| why.to_string())?;
        let baseline = match &model.begin {
            Some(_) => "the baseline as it was when the session began",
            None => "the baseline as it was recorded",
        };
        let (unit, values) = shown_values(&map, pressure.as_ref());
        Ok(ProvisionalMap {
            unit: PlayedMap::unit_of(unit),
            provisional: format!(
                "provisional: {} until the map of the session's method is ready, {baseline}",
                map.method
            ),
            values,
            method: map.method,
        })
    }

    fn deviation(&self, readings: &[Option<f64>]) -> Result<Vec<f32>, String> {
        let model = self.model()?;
        let (baseline, readings) = model.compare(readings);
        let found = model.one_step.map_deviation(&baseline, &readings);
        let found = found.map_err(|why| why.to_string())?;
        Ok(found.into_iter().map(|sd| sd as f32).collect())
    }
}
