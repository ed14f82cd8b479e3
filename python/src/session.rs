//! Sessions as arrays, read by the crate `logbook`.

use std::path::{Path, PathBuf};

use imaging::recorded::SessionParts;
use logbook::{FrameRecord, LogbookError};
use numpy::PyArray1;
use pyo3::exceptions::{PyFileNotFoundError, PyOSError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use survey::{QualityFlag, Reading};

use crate::arguments::Expected;
use crate::outcome::{detached, rows};
use crate::protocol::Protocol;

/// Frames between two checks for Ctrl-C.
const FRAMES_AT_A_TIME: usize = 256;

/// A session with all its parts. ``tactus_eit.open_session`` wraps it in the class Session.
#[pyclass(frozen, module = "tactus_eit._native")]
pub(crate) struct SessionFile {
    path: PathBuf,
    about: About,
}

/// Everything in the session except its frames.
struct About {
    header: logbook::SessionHeader,
    baseline: Option<survey::Baseline>,
    events: Vec<logbook::Event>,
    closed: Option<String>,
    frames: u64,
}

/// Columns of the table of frames.
#[derive(Default)]
struct Columns {
    sequence: Vec<i64>,
    time_us: Vec<i64>,
    monotonic_s: Vec<f64>,
    duration_s: Vec<f64>,
    current_a: Vec<f64>,
    quality: Vec<u8>,
    voltages: Vec<f64>,
    status: Vec<u8>,
    damaged: Vec<String>,
}

#[pymethods]
impl SessionFile {
    #[new]
    fn new(py: Python<'_>, path: &Bound<'_, PyAny>) -> PyResult<Self> {
        let path = Expected {
            name: "path",
            about: "the path of a session file, ID.tactus",
        }
        .path(path)?;
        let about = detached(py, || About::read(&path))?.map_err(|fault| unread(&path, &fault))?;
        Ok(Self { path, about })
    }

    /// The frames from sequence number `first` to `last`: a dict of arrays with a row for each frame.
    #[pyo3(signature = (first, last=None))]
    fn frames<'py>(
        &self,
        py: Python<'py>,
        first: u64,
        last: Option<u64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let readings = self.about.header.protocol.len();
        let columns = detached(py, || self.columns(first, last.unwrap_or(u64::MAX)))??;
        let count = columns.sequence.len();
        let frames = PyDict::new(py);
        frames.set_item("sequence", PyArray1::from_vec(py, columns.sequence))?;
        frames.set_item("time_us", PyArray1::from_vec(py, columns.time_us))?;
        frames.set_item("monotonic", PyArray1::from_vec(py, columns.monotonic_s))?;
        frames.set_item("duration", PyArray1::from_vec(py, columns.duration_s))?;
        frames.set_item("current", PyArray1::from_vec(py, columns.current_a))?;
        frames.set_item("quality", PyArray1::from_vec(py, columns.quality))?;
        frames.set_item("voltages", rows(py, columns.voltages, [count, readings])?)?;
        frames.set_item("status", rows(py, columns.status, [count, readings])?)?;
        frames.set_item("damaged", columns.damaged)?;
        Ok(frames)
    }

    /// Metadata by name.
    #[getter]
    fn attributes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let header = &self.about.header;
        let attributes = PyDict::new(py);
        attributes.set_item("id", header.session())?;
        attributes.set_item("kind", header.kind.as_str())?;
        attributes.set_item("started", header.started.to_rfc3339())?;
        attributes.set_item("closed", self.about.closed.clone())?;
        attributes.set_item("simulated", header.simulated)?;
        attributes.set_item("note", &header.note)?;
        attributes.set_item("build", &header.build)?;
        attributes.set_item("protocol_hash", header.protocol.hash())?;
        attributes.set_item("geometry_hash", header.geometry_hash.as_deref())?;
        attributes.set_item("config_toml", &header.config_toml)?;
        for (name, text) in header.about.entries() {
            attributes.set_item(name, text)?;
        }
        Ok(attributes)
    }

    /// The protocol.
    #[getter]
    fn protocol(&self) -> Protocol {
        Protocol(self.about.header.protocol.clone())
    }

    /// The baseline, V, NaN for a missing reading: shape (readings,); None without a baseline.
    #[getter]
    fn baseline<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        let baseline = self.about.baseline.as_ref()?;
        Some(PyArray1::from_vec(
            py,
            baseline.readings.iter().map(volts).collect(),
        ))
    }

    /// Standard deviation of each reading of the baseline, V: shape (readings,); None without a baseline.
    #[getter]
    fn baseline_deviation<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        let baseline = self.about.baseline.as_ref()?;
        let deviation = baseline.deviation.iter().map(|one| one.unwrap_or(f64::NAN));
        Some(PyArray1::from_vec(py, deviation.collect()))
    }

    /// Time (us since 1970 UTC), kind and text of each event.
    #[getter]
    fn events(&self) -> Vec<(i64, &str, &str)> {
        let each = self.about.events.iter();
        each.map(|event| {
            (
                event.at.timestamp_micros(),
                event.kind.as_str(),
                event.text.as_str(),
            )
        })
        .collect()
    }

    fn __len__(&self) -> usize {
        usize::try_from(self.about.frames).unwrap_or(usize::MAX)
    }
}

impl About {
    fn read(path: &Path) -> Result<Self, LogbookError> {
        let parts = SessionParts::open(path)?;
        let events = parts.events()?;
        let last = parts.each().last();
        Ok(Self {
            header: parts.header().clone(),
            baseline: parts.baseline()?,
            closed: last
                .and_then(|part| part.closed())
                .map(|closed| closed.reason.clone()),
            frames: parts.len()?,
            events,
        })
    }
}

impl SessionFile {
    /// Reads the frames. Must be called without the interpreter's lock; takes the lock to check for Ctrl-C.
    fn columns(&self, first: u64, last: u64) -> PyResult<Columns> {
        let parts = SessionParts::open(&self.path).map_err(|fault| unread(&self.path, &fault))?;
        let mut columns = Columns::default();
        // the number of the previous frame; a damaged frame has at least the next number
        let mut before = first.max(1) - 1;
        for (count, record) in parts.frames_from(first).enumerate() {
            if count % FRAMES_AT_A_TIME == 0 {
                Python::attach(|py| py.check_signals())?;
            }
            match record {
                _ if before >= last => break,
                Ok(record) if record.frame.sequence > last => break,
                Ok(record) => {
                    before = record.frame.sequence;
                    columns.add(&record);
                }
                Err(fault) => {
                    before += 1;
                    columns.damaged.push(survey::error_chain(&fault));
                }
            }
        }
        Ok(columns)
    }
}

impl Columns {
    fn add(&mut self, record: &FrameRecord) {
        let frame = &record.frame;
        self.sequence
            .push(i64::try_from(frame.sequence).unwrap_or(i64::MAX));
        self.time_us.push(frame.wall.timestamp_micros());
        self.monotonic_s.push(frame.monotonic.as_secs_f64());
        self.duration_s.push(frame.duration.as_secs_f64());
        self.current_a.push(frame.settings.current.0);
        let raised = QualityFlag::ALL.iter().enumerate();
        let bits = raised.filter(|(_, flag)| record.quality.flags.contains(flag));
        self.quality.push(bits.map(|(bit, _)| 1 << bit).sum());
        self.voltages.extend(frame.readings.iter().map(volts));
        self.status
            .extend(frame.readings.iter().map(|reading| reading.flag()));
    }
}

fn volts(reading: &Reading) -> f64 {
    reading.volts().map_or(f64::NAN, |volts| volts.0)
}

fn unread(path: &Path, fault: &LogbookError) -> PyErr {
    let text = survey::error_chain(fault);
    match path.exists() {
        true => PyOSError::new_err(text),
        false => PyFileNotFoundError::new_err(text),
    }
}

/// The names of the bits of a frame's quality, from the lowest bit.
#[pyfunction]
pub(crate) fn quality_flags() -> Vec<&'static str> {
    QualityFlag::ALL.iter().map(|flag| flag.word()).collect()
}
