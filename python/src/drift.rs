//! The tracked baseline of a sheet that drifts.

use std::sync::{Mutex, PoisonError};

use imaging::tracking::{Tracking, TrackingState};
use numpy::PyArray2;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arguments::Expected;
use crate::baseline::Recorded;
use crate::forward::Forward;
use crate::maps::{readings, rows_of_readings};
use crate::outcome::{detached, interruptible, refused, rows};

/// Baselines and frames, each an array with a row for each frame, and the result of tracking for each frame as JSON.
type Followed<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Vec<String>,
);

/// A drifting sheet, tracked from its first baseline on. The class Drift creates it.
#[pyclass(frozen, module = "tactus_eit._native")]
pub(crate) struct Tracker {
    tracking: Mutex<Tracking>,
    readings: usize,
}

#[pymethods]
impl Tracker {
    /// Arguments as for Maps; time: of the baseline, s.
    #[new]
    fn new(
        py: Python<'_>,
        forward: &Forward,
        sigma0: Option<&Bound<'_, PyAny>>,
        current: &Bound<'_, PyAny>,
        noise: Option<&Bound<'_, PyAny>>,
        baseline: &Bound<'_, PyAny>,
        time: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let seconds = Expected {
            name: "time",
            about: "the time of the baseline in s, on the clock of the frames",
        };
        let at_s = seconds.number(time)?;
        let recorded = Recorded::new(py, forward, sigma0, current, noise, baseline)?;
        let conditions = recorded.conditions();
        let known = conditions.noise_v.filter(|_| !conditions.noise_assumed);
        let noise_v = known.ok_or_else(|| {
            PyValueError::new_err(
                "argument 'noise': it is missing; expected the standard deviation of one reading in V, e.g. 2e-6, or several \
                 frames of the baseline",
            )
        })?;
        let tracking = interruptible(py, None, move |_| {
            Tracking::new(
                &recorded.conditions(),
                &recorded.unloaded.readings,
                noise_v,
                at_s,
            )
        })?;
        Ok(Self {
            tracking: Mutex::new(tracking.map_err(|fault| refused(&fault))?),
            readings: forward.protocol.get().0.len(),
        })
    }

    /// Tracks the baseline over frames (V, shape (frames, readings), NaN for a missing reading) at the times (s, shape
    /// (frames,)), in order. Returns for each frame its baseline, the frame with NaN for readings of faulty electrodes,
    /// and the result of tracking as JSON. progress: called after each frame with the number of completed frames and of
    /// all frames.
    #[pyo3(signature = (frames, times, progress=None))]
    fn follow<'py>(
        &self,
        py: Python<'py>,
        frames: &Bound<'py, PyAny>,
        times: &Bound<'py, PyAny>,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Followed<'py>> {
        let given = rows_of_readings(frames, "frames", self.readings)?;
        let count = given.shape[0];
        let about = format!("seconds, shape ({count},), one for each frame, ascending");
        let seconds = Expected {
            name: "times",
            about: &about,
        };
        let times = seconds.floats(times, &[1])?;
        if times.shape != [count] {
            return Err(seconds.shape_error(&times.shape));
        }
        if let Some(pair) = times.values.windows(2).find(|pair| pair[1] <= pair[0]) {
            return Err(seconds.value_error(&format!("{} follows {}", pair[1], pair[0])));
        }
        let mut baselines = Vec::with_capacity(count * self.readings);
        let mut masked = Vec::with_capacity(count * self.readings);
        let mut known = Vec::with_capacity(count);
        let volts = |reading: &survey::Reading| reading.volts().map_or(f64::NAN, |volts| volts.0);
        let each = given.values.chunks_exact(self.readings);
        for (row, (frame, at_s)) in each.zip(times.values).enumerate() {
            let frame = readings(frame);
            let followed = detached(py, || {
                let mut tracking = self.tracking.lock().unwrap_or_else(PoisonError::into_inner);
                tracking.follow(&frame, at_s)
            })?;
            let followed = followed.map_err(|fault| {
                PyValueError::new_err(format!("row {row} of 'frames': {fault}"))
            })?;
            baselines.extend(followed.baseline.iter().map(volts));
            masked.extend(followed.readings.iter().map(volts));
            known.push(json(&followed.tracked)?);
            py.check_signals()?;
            if let Some(progress) = progress {
                progress.call1((row + 1, count))?;
            }
        }
        Ok((
            rows(py, baselines, [count, self.readings])?,
            rows(py, masked, [count, self.readings])?,
            known,
        ))
    }

    /// The state on which later results depend, as JSON.
    fn state(&self, py: Python<'_>) -> PyResult<String> {
        let state = detached(py, || {
            let tracking = self.tracking.lock().unwrap_or_else(PoisonError::into_inner);
            tracking.state()
        })?;
        json(&state)
    }

    /// Continues from a state that state() returned.
    fn restore(&self, py: Python<'_>, state: &str) -> PyResult<()> {
        let about = "the text that state() of the same sheet and baseline returned";
        let expected = Expected {
            name: "state",
            about,
        };
        let state: TrackingState = serde_json::from_str(state)
            .map_err(|fault| expected.value_error(&fault.to_string()))?;
        let restored = detached(py, || {
            let mut tracking = self.tracking.lock().unwrap_or_else(PoisonError::into_inner);
            tracking.restore(state)
        })?;
        restored.map_err(|fault| expected.value_error(&survey::error_chain(&fault)))
    }
}

fn json(value: &impl serde::Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|fault| refused(&fault))
}
