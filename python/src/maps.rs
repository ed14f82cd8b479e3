//! Reconstruction, and figures of merit of its maps.

use std::sync::{Arc, OnceLock};

use eit::ReconstructError;
use eit::metrics::{Image, likeness as compared};
use imaging::{Model, ReconstructionSettings};
use numpy::{PyArray1, PyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use survey::{MapQuality, Reading, Reason, Volts};

use crate::arguments::{Expected, Values};
use crate::baseline::{Recorded, unlike};
use crate::forward::Forward;
use crate::outcome::{Steps, detached, interruptible, rows, short};

/// An array with a row for each frame, and a count for each frame.
type RowsAndCounts<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<i64>>);

/// Verdict on a map, and the kind, electrode and text of each reason.
type JudgedMap = (&'static str, Vec<(String, Option<usize>, String)>);

/// A prepared reconstruction. The classes OneStep and TotalVariation create it from their parameters.
#[pyclass(frozen, module = "tactus_eit._native")]
pub(crate) struct Maps {
    model: Arc<Model>,
    /// The model with a check of each frame. Its preparation takes as long as a set-up, so that it is made when maps
    /// are first judged.
    judging: OnceLock<Arc<Model>>,
    origin: Arc<(ReconstructionSettings, Recorded)>,
    notes: Vec<String>,
    readings: usize,
}

#[pymethods]
impl Maps {
    /// settings: ReconstructionSettings as JSON. sigma0: S per square, None to fit it to the baseline. current: A.
    /// noise: V, None to estimate it from the frames of the baseline. baseline: V, shape (frames, readings), NaN for a
    /// missing reading.
    #[new]
    #[pyo3(signature = (forward, settings, sigma0, current, noise, baseline))]
    fn new(
        py: Python<'_>,
        forward: &Forward,
        settings: &str,
        sigma0: Option<&Bound<'_, PyAny>>,
        current: &Bound<'_, PyAny>,
        noise: Option<&Bound<'_, PyAny>>,
        baseline: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let settings: ReconstructionSettings = serde_json::from_str(settings)
            .map_err(|fault| PyValueError::new_err(fault.to_string()))?;
        let recorded = Recorded::new(py, forward, sigma0, current, noise, baseline)?;
        let made = interruptible(py, None, move |_| {
            let model = imaging::unjudged(&settings, &recorded.conditions())?;
            Ok((model, settings, recorded))
        })?
        .map_err(|fault| unlike(&fault))?;
        let (model, settings, recorded) = made;
        let mut notes = recorded.fitted.notes.clone();
        notes.extend(model.notes.iter().cloned());
        Ok(Self {
            model: Arc::new(model),
            judging: OnceLock::new(),
            notes,
            readings: forward.protocol.get().0.len(),
            origin: Arc::new((settings, recorded)),
        })
    }

    /// Maps of frames (V, shape (frames, readings), NaN for a missing reading): relative changes of conductance, shape
    /// (frames, region), and the number of readings left out of each frame, shape (frames,). baselines: one for each
    /// frame, by default that of the constructor. progress: called after each frame with the number of completed frames
    /// and of all frames.
    #[pyo3(signature = (frames, baselines=None, progress=None))]
    fn maps<'py>(
        &self,
        py: Python<'py>,
        frames: &Bound<'py, PyAny>,
        baselines: Option<&Bound<'py, PyAny>>,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<RowsAndCounts<'py>> {
        let given = rows_of_readings(frames, "frames", self.readings)?;
        let count = given.shape[0];
        let others = baselines
            .map(|rows| self.of_each(rows, count))
            .transpose()?;
        let (model, origin) = (Arc::clone(&self.model), Arc::clone(&self.origin));
        let (each, region) = (self.readings, self.recorded().region());
        let work = move |steps: &Steps| {
            let mut values = Vec::with_capacity(count * region);
            let mut masked = Vec::with_capacity(count);
            for (row, frame) in given.values.chunks_exact(each).enumerate() {
                let frame = readings(frame);
                let baseline = others
                    .as_ref()
                    .map_or(&origin.1.unloaded.readings, |rows| &rows[row]);
                let map = model.reconstructor.reconstruct(baseline, &frame);
                let map = map.map_err(|fault| (row, fault))?;
                values.extend_from_slice(&map.values);
                masked.push(map.masked as i64);
                if !steps.done(row + 1) {
                    break;
                }
            }
            Ok((values, masked))
        };
        let made = match progress {
            None if count == 1 && !self.model.slow => short(py, work),
            _ => interruptible(py, progress.map(|progress| (progress, count)), work),
        }?;
        let (values, masked) = made.map_err(|(row, fault)| unmapped(row, &fault))?;
        Ok((
            rows(py, values, [count, region])?,
            PyArray1::from_vec(py, masked),
        ))
    }

    /// Quality of the map of each frame: its verdict, and the kind, electrode (from 0, or None) and text of each
    /// reason. progress: as for maps.
    #[pyo3(signature = (frames, progress=None))]
    fn judged(
        &self,
        py: Python<'_>,
        frames: &Bound<'_, PyAny>,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Vec<JudgedMap>> {
        let given = rows_of_readings(frames, "frames", self.readings)?;
        let (model, origin) = (Arc::clone(&self.model), Arc::clone(&self.origin));
        let (each, judging) = (self.readings, self.judging.get().cloned());
        let progress = progress.map(|progress| (progress, given.shape[0]));
        let made = interruptible(py, progress, move |steps| {
            let (settings, recorded) = origin.as_ref();
            let conditions = recorded.conditions();
            let model = match judging {
                Some(judging) => judging,
                None => Arc::new(imaging::judging(
                    model.as_ref().clone(),
                    settings,
                    &conditions,
                )?),
            };
            let mut judged = Vec::with_capacity(given.shape[0]);
            for (row, frame) in given.values.chunks_exact(each).enumerate() {
                let map = model.reconstruct(&recorded.unloaded.readings, &readings(frame));
                let map = match map {
                    Ok(map) => map,
                    Err(fault) => return Ok(Err((row, fault))),
                };
                // not reached without a quality: a model of `imaging::judging` judges all its maps
                let quality = map.quality.unwrap_or_else(|| MapQuality::of(&[]));
                let reason = |reason: Reason| {
                    let from_zero = reason.electrode.map(|number| number.saturating_sub(1));
                    (reason.kind, from_zero, reason.text)
                };
                let reasons = quality.reasons.into_iter().map(reason).collect();
                judged.push((quality.verdict.word(), reasons));
                if !steps.done(row + 1) {
                    break;
                }
            }
            Ok(Ok((model, judged)))
        })?;
        let (model, judged) = made
            .map_err(|fault| unlike(&fault))?
            .map_err(|(row, fault)| unmapped(row, &fault))?;
        // an error means that another thread has set the same model
        let _ = self.judging.set(model);
        Ok(judged)
    }

    /// Name of the method.
    #[getter]
    fn method(&self) -> &str {
        self.model.reconstructor.method()
    }

    /// Decisions and assumptions of the set-up, a sentence each.
    #[getter]
    fn notes(&self) -> Vec<String> {
        let mut notes = self.notes.clone();
        let assumptions = self.model.reconstructor.assumptions().into_iter();
        let others: Vec<String> = assumptions.filter(|one| !notes.contains(one)).collect();
        notes.extend(others);
        notes
    }

    /// Mean of the frames of the baseline, V, NaN where a reading is missing: shape (readings,).
    #[getter]
    fn baseline<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let each = self.recorded().unloaded.readings.iter();
        PyArray1::from_vec(
            py,
            each.map(|reading| reading.volts().map_or(f64::NAN, |volts| volts.0))
                .collect(),
        )
    }

    /// Standard deviation of one reading over the frames of the baseline, V; None for a single frame.
    #[getter]
    fn deviation(&self) -> Option<f64> {
        self.recorded().unloaded.noise
    }

    /// Conductance at the baseline, S per square: shape (triangles,).
    #[getter]
    fn sigma0<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.recorded().fitted.geometry.sigma0)
    }

    /// Signal-to-noise ratio of the readings divided by that of a map; None if it is not defined.
    fn noise_figure(&self, py: Python<'_>) -> PyResult<Option<f64>> {
        detached(py, || self.model.reconstructor.noise_figure())
    }
}

impl Maps {
    fn recorded(&self) -> &Recorded {
        &self.origin.1
    }

    /// The given baselines, one for each of `count` frames.
    fn of_each(&self, given: &Bound<'_, PyAny>, count: usize) -> PyResult<Vec<Vec<Reading>>> {
        let given = rows_of_readings(given, "baselines", self.readings)?;
        if given.shape[0] != count {
            return Err(PyValueError::new_err(format!(
                "argument 'baselines': it has {} rows; expected one for each of the {count} frames",
                given.shape[0]
            )));
        }
        Ok(given
            .values
            .chunks_exact(self.readings)
            .map(readings)
            .collect())
    }
}

/// Frames in rows as floats, shape (frames, readings); a single frame becomes one row. `missing`: whether NaN is
/// allowed.
#[pyfunction]
pub(crate) fn as_frames<'py>(
    py: Python<'py>,
    volts: &Bound<'py, PyAny>,
    name: &str,
    readings: usize,
    missing: bool,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let about = format!(
        "signed voltages in V, shape (frames, {readings}) or ({readings},), in the order of the protocol"
    );
    let expected = Expected {
        name,
        about: &about,
    };
    let given = expected.floats_or_nan(volts, &[1, 2])?;
    let count = match given.shape[..] {
        [length] if length == readings => 1,
        [count, length] if length == readings && count > 0 => count,
        [length, _] if length == readings => {
            return Err(expected.value_error("frames are in columns: transpose it"));
        }
        _ => return Err(expected.shape_error(&given.shape)),
    };
    if given.values.iter().any(|volts| volts.is_infinite()) {
        expected.finite(
            &given,
            "replace an overload by numpy.nan, and pass missing='mask' to the constructor",
        )?;
    }
    if !missing {
        expected.finite(
            &given,
            "where readings are missing, pass missing='mask' to the constructor",
        )?;
    }
    rows(py, given.values, [count, readings])
}

fn unmapped(row: usize, fault: &ReconstructError) -> PyErr {
    PyValueError::new_err(format!("row {row} of 'frames': {fault}"))
}

/// Frames in rows; NaN is a missing reading, infinite values are refused.
pub(crate) fn rows_of_readings(
    given: &Bound<'_, PyAny>,
    name: &str,
    readings: usize,
) -> PyResult<Values<f64>> {
    let about =
        format!("signed voltages in V, shape (frames, {readings}), in the order of the protocol");
    let expected = Expected {
        name,
        about: &about,
    };
    let values = expected.floats_or_nan(given, &[2])?;
    if values.shape[1] != readings {
        return Err(expected.shape_error(&values.shape));
    }
    match values.values.iter().any(|volts| volts.is_infinite()) {
        true => Err(expected.value_error("a value is infinite: replace an overload by numpy.nan")),
        false => Ok(values),
    }
}

pub(crate) fn readings(volts: &[f64]) -> Vec<Reading> {
    let reading = |volts: &f64| match volts.is_nan() {
        true => Reading::NotMeasured,
        false => Reading::Ok(Volts(*volts)),
    };
    volts.iter().map(reading).collect()
}

/// GREIT's figures of merit of an image (Adler and others, Physiol. Meas. 30 (2009) S35), as EIDORS computes them.
///
/// image: floats of shape (rows, columns), larger where the target is, NaN outside of the sheet; negate images of
/// losses before. The first axis is x and the second y, first and last pixel centres on -1 and 1.
/// target: x and y of the target in these coordinates, shape (2,).
///
/// Returns a dict: amplitude, position_error, resolution, shape_deformation, ringing, centroid.
///
/// >>> import tactus_eit
/// >>> merit = tactus_eit.merit([[0.0, 0.0, 0.0], [0.0, 4.0, 1.0], [0.0, -1.0, 0.0]], target=(0.0, 1.0))
/// >>> merit["position_error"], merit["ringing"]
/// (0.5, 0.2)
#[pyfunction]
pub(crate) fn merit<'py>(
    py: Python<'py>,
    image: &Bound<'py, PyAny>,
    target: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyDict>> {
    let raster = Expected {
        name: "image",
        about: "floats of shape (rows, columns), NaN outside of the sheet",
    };
    let place = Expected {
        name: "target",
        about: "x and y from -1 to 1, shape (2,)",
    };
    let image = raster.floats_or_nan(image, &[2])?;
    let target = place.floats(target, &[1])?;
    let [x, y] = target.values[..] else {
        return Err(place.shape_error(&target.shape));
    };
    let columns = image.shape[1].max(1);
    let lines: Vec<Vec<f64>> = image.values.chunks(columns).map(<[f64]>::to_vec).collect();
    let merit = detached(py, || Image::new(&lines)?.greit([x, y]))?;
    let merit = merit.map_err(|fault| raster.value_error(&fault.to_string()))?;
    let figures = PyDict::new(py);
    figures.set_item("amplitude", merit.amplitude)?;
    figures.set_item("position_error", merit.position_error)?;
    figures.set_item("resolution", merit.resolution)?;
    figures.set_item("shape_deformation", merit.shape_deformation)?;
    figures.set_item("ringing", merit.ringing)?;
    figures.set_item("centroid", (merit.centroid[0], merit.centroid[1]))?;
    Ok(figures)
}

/// Compares a map with the truth: a dict of correlation (Pearson's, weighted by area), relative_error and dice; all are
/// NaN for a truth without a load.
///
/// values, truth, areas: floats of shape (n,), one a triangle or pixel.
///
/// >>> import tactus_eit
/// >>> tactus_eit.likeness([-1.0, 0.0], [-1.0, 0.0], [1.0, 2.0])["dice"]
/// 1.0
#[pyfunction]
pub(crate) fn likeness<'py>(
    py: Python<'py>,
    values: &Bound<'py, PyAny>,
    truth: &Bound<'py, PyAny>,
    areas: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyDict>> {
    let of = |name| Expected {
        name,
        about: "floats of shape (n,), as many as 'values'",
    };
    let values = of("values").floats(values, &[1])?;
    let [truth, areas] = [("truth", truth), ("areas", areas)].map(|(name, given)| {
        let given = of(name).floats(given, &[1])?;
        match given.shape == values.shape {
            true => Ok(given),
            false => Err(of(name).shape_error(&given.shape)),
        }
    });
    let (truth, areas) = (truth?, areas?);
    if let Some(area) = areas.values.iter().find(|area| **area <= 0.0) {
        return Err(of("areas").value_error(&format!("an area is {area}, and must be above 0")));
    }
    let like = compared(&values.values, &truth.values, &areas.values);
    let figures = PyDict::new(py);
    figures.set_item("correlation", like.correlation)?;
    figures.set_item("relative_error", like.relative_error)?;
    figures.set_item("dice", like.dice)?;
    Ok(figures)
}
