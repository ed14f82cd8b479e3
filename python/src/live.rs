//! The stream of a running daemon.

use std::io::Read;
use std::os::unix::net::UnixStream;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use dbus::stream::{Body, Decoder, Record, StreamError};
use dbus::{Address, ConnectError, Fault, Manager1Proxy, Session1Proxy, StreamOptions};
use numpy::PyArray1;
use pyo3::exceptions::{
    PyConnectionError, PyLookupError, PyOSError, PyPermissionError, PyRuntimeError, PyTimeoutError,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use zbus::proxy::CacheProperties;

use crate::arguments::Expected;
use crate::outcome::{LOOK, Steps, detached, interruptible, rows};

/// The stream of a session. ``tactus_eit.connect`` wraps it in the class Live.
#[pyclass(frozen, module = "tactus_eit._native")]
pub(crate) struct Stream {
    reader: Mutex<Option<Reader>>,
    about: About,
}

/// Properties of the session, as the daemon reports them when the stream is opened.
struct About {
    address: String,
    session: String,
    kind: String,
    method: String,
    path: String,
    simulated: bool,
    geometry: Option<dbus::Geometry>,
    baseline: Option<dbus::BaselineReport>,
}

struct Reader {
    stream: UnixStream,
    decoder: Decoder,
    bytes: Vec<u8>,
}

/// Result of one attempt to read a record.
enum Look {
    Record(Box<Record>),
    /// No complete record yet.
    Nothing,
    /// The stream has ended.
    End,
    Closed,
}

/// The requested stream.
struct Wanted {
    address: Option<Address>,
    session: Option<String>,
    options: StreamOptions,
    deadline: Option<Instant>,
}

#[derive(Debug, thiserror::Error)]
enum OpenError {
    #[error(transparent)]
    Connect(#[from] ConnectError),
    #[error(transparent)]
    Fault(#[from] Fault),
    #[error("argument 'session': {0}")]
    BadId(#[from] dbus::BadId),
    #[error(
        "argument 'session': no session {0} runs, or ran a moment ago; open_session reads a session that has ended"
    )]
    Unknown(String),
    #[error("the connection to the daemon failed")]
    Bus(#[from] zbus::Error),
    #[error("the stream cannot be opened")]
    System(#[from] std::io::Error),
    #[error(
        "no session to follow within 'timeout'; `tactus start` starts one, `tactus status` shows what the daemon does"
    )]
    Timeout,
    #[error("stopped by the caller")]
    Stopped,
}

#[pymethods]
impl Stream {
    /// address: "system", "session", "unix:PATH", or None for the first bus that has a daemon. session: its id, or None
    /// for the session that runs, or that starts within `timeout` s (None: without limit). ring: records held for a
    /// slow reader.
    #[new]
    #[pyo3(signature = (address, session, frames, maps, deviations, ring, timeout))]
    fn new(
        py: Python<'_>,
        address: Option<&str>,
        session: Option<String>,
        frames: bool,
        maps: bool,
        deviations: bool,
        ring: u64,
        timeout: Option<f64>,
    ) -> PyResult<Self> {
        let about =
            "\"system\", \"session\", \"unix:PATH\", or None for the first that has a daemon";
        let expected = Expected {
            name: "address",
            about,
        };
        let address = address
            .map(|text| text.parse::<Address>())
            .transpose()
            .map_err(|fault| expected.value_error(&fault.to_string()))?;
        let wanted = Wanted {
            address,
            session,
            options: StreamOptions {
                frames: Some(frames),
                maps: Some(maps),
                pressure: Some(maps),
                quality: Some(maps),
                injections: None,
                deviations: Some(deviations),
                ring: Some(ring),
            },
            deadline: deadline(timeout),
        };
        let (stream, about) = interruptible(py, None, move |steps| {
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build()?;
            // the connection to the bus ends here: a client that does not read would block the daemon's signals
            runtime.block_on(async {
                match wanted.deadline {
                    None => open(&wanted, steps).await,
                    Some(at) => tokio::time::timeout_at(at.into(), open(&wanted, steps))
                        .await
                        .unwrap_or(Err(OpenError::Timeout)),
                }
            })
        })?
        .map_err(|fault| unopened(&fault))?;
        Ok(Self {
            reader: Mutex::new(Some(Reader {
                stream,
                decoder: Decoder::new(),
                bytes: vec![0; 64 * 1024],
            })),
            about,
        })
    }

    /// The next record as a dict of its fields; None at the end of the stream. Raises TimeoutError after `timeout` s
    /// without a record.
    fn next<'py>(
        &self,
        py: Python<'py>,
        timeout: Option<f64>,
    ) -> PyResult<Option<Bound<'py, PyDict>>> {
        let deadline = deadline(timeout);
        loop {
            let look = detached(py, || self.look())?;
            py.check_signals()?;
            match look? {
                Look::Record(record) => return fields(py, *record).map(Some),
                Look::End => return Ok(None),
                Look::Closed => return Err(PyRuntimeError::new_err("the stream is closed")),
                Look::Nothing if deadline.is_some_and(|at| at <= Instant::now()) => {
                    return Err(PyTimeoutError::new_err(format!(
                        "no record of {} came within {} s",
                        self.about.session,
                        timeout.unwrap_or_default()
                    )));
                }
                Look::Nothing => {}
            }
        }
    }

    /// Ends the stream.
    fn close(&self, py: Python<'_>) {
        py.detach(|| {
            let mut reader = self.reader.lock().unwrap_or_else(PoisonError::into_inner);
            reader.take();
        });
    }

    /// Metadata by name.
    #[getter]
    fn attributes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let about = &self.about;
        let attributes = PyDict::new(py);
        attributes.set_item("address", &about.address)?;
        attributes.set_item("session", &about.session)?;
        attributes.set_item("kind", &about.kind)?;
        attributes.set_item("method", &about.method)?;
        attributes.set_item("path", &about.path)?;
        attributes.set_item("simulated", about.simulated)?;
        if let Some(geometry) = &about.geometry {
            let nodes = geometry.nodes.clone();
            let triangles: Vec<i64> = geometry.triangles.iter().map(|n| i64::from(*n)).collect();
            let electrodes = geometry.electrodes.clone();
            let counts = [nodes.len() / 2, triangles.len() / 3, electrodes.len() / 2];
            attributes.set_item("mesh_hash", &geometry.mesh_hash)?;
            attributes.set_item("nodes", rows(py, nodes, [counts[0], 2])?)?;
            attributes.set_item("triangles", rows(py, triangles, [counts[1], 3])?)?;
            attributes.set_item("electrode_centres", rows(py, electrodes, [counts[2], 2])?)?;
        }
        if let Some(baseline) = &about.baseline {
            attributes.set_item("baseline", PyArray1::from_slice(py, &baseline.volts))?;
            let deviation = PyArray1::from_slice(py, &baseline.deviation);
            attributes.set_item("baseline_deviation", deviation)?;
        }
        Ok(attributes)
    }
}

impl Stream {
    /// Waits for a record, at most for the read timeout of the stream.
    fn look(&self) -> PyResult<Look> {
        let mut reader = self.reader.lock().unwrap_or_else(PoisonError::into_inner);
        match reader.as_mut() {
            Some(reader) => reader.look(),
            None => Ok(Look::Closed),
        }
    }
}

impl Reader {
    fn look(&mut self) -> PyResult<Look> {
        let garbled = |fault: StreamError| PyConnectionError::new_err(survey::error_chain(&fault));
        if let Some(record) = self.decoder.next_record().map_err(garbled)? {
            return Ok(Look::Record(Box::new(record)));
        }
        match self.stream.read(&mut self.bytes) {
            Ok(0) => return Ok(Look::End),
            Ok(count) => self.decoder.push(&self.bytes[..count]),
            Err(fault) => match fault.kind() {
                std::io::ErrorKind::WouldBlock
                | std::io::ErrorKind::TimedOut
                | std::io::ErrorKind::Interrupted => return Ok(Look::Nothing),
                _ => return Err(fault.into()),
            },
        }
        match self.decoder.next_record().map_err(garbled)? {
            Some(record) => Ok(Look::Record(Box::new(record))),
            None => Ok(Look::Nothing),
        }
    }
}

fn deadline(timeout: Option<f64>) -> Option<Instant> {
    let seconds = Duration::try_from_secs_f64(timeout?).ok()?;
    Instant::now().checked_add(seconds)
}

async fn open(wanted: &Wanted, steps: &Steps) -> Result<(UnixStream, About), OpenError> {
    let (connection, address) = dbus::connect(wanted.address.as_ref()).await?;
    let manager = Manager1Proxy::builder(&connection)
        .cache_properties(CacheProperties::No)
        .build()
        .await?;
    let id = match &wanted.session {
        Some(id) => id.clone(),
        None => running(&manager, steps).await?,
    };
    let session = Session1Proxy::builder(&connection)
        .path(dbus::session_path(&id)?)
        .cache_properties(CacheProperties::No)
        .build()
        .await?;
    // the stream is opened first, so that it has the frames that arrive during the calls below
    let descriptor = session
        .open_stream(&wanted.options)
        .await
        .map_err(|fault| match fault {
            Fault::Connection(zbus::Error::FDO(standard))
                if matches!(*standard, zbus::fdo::Error::UnknownObject(_)) =>
            {
                OpenError::Unknown(id.clone())
            }
            other => other.into(),
        })?;
    let stream = UnixStream::from(std::os::fd::OwnedFd::from(descriptor));
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(LOOK))?;
    let method = session.method().await?;
    let geometry = match method.is_empty() {
        true => None,
        false => Some(manager.geometry().await?),
    };
    let own = session.baseline_id().await?;
    let baseline = match own.is_empty() {
        true => None,
        false => Some(manager.baseline().await?).filter(|baseline| baseline.id == own),
    };
    let about = About {
        address: address.to_string(),
        kind: session.kind().await?,
        path: session.path().await?,
        simulated: session.simulated().await?,
        session: id,
        method,
        geometry,
        baseline,
    };
    Ok((stream, about))
}

/// The id of the running session; waits until there is one.
async fn running(manager: &Manager1Proxy<'_>, steps: &Steps) -> Result<String, OpenError> {
    loop {
        let path = manager.active_session().await?;
        if let Some(id) = dbus::id_of(path.as_str()) {
            return Ok(id.to_owned());
        }
        if !steps.wanted() {
            return Err(OpenError::Stopped);
        }
        tokio::time::sleep(4 * LOOK).await;
    }
}

/// The Python error for a stream that cannot be opened.
fn unopened(fault: &OpenError) -> PyErr {
    let text = survey::error_chain(fault);
    match fault {
        OpenError::Connect(ConnectError::NotAuthorized { .. })
        | OpenError::Fault(Fault::NotAuthorized(_)) => PyPermissionError::new_err(text),
        OpenError::Connect(_) | OpenError::Bus(_) => PyConnectionError::new_err(text),
        OpenError::Fault(fault) if fault.is_connection() => PyConnectionError::new_err(text),
        OpenError::Fault(Fault::NoSession(_)) | OpenError::BadId(_) | OpenError::Unknown(_) => {
            PyLookupError::new_err(text)
        }
        OpenError::Timeout => PyTimeoutError::new_err(text),
        OpenError::System(_) => PyOSError::new_err(text),
        OpenError::Fault(_) | OpenError::Stopped => PyRuntimeError::new_err(text),
    }
}

/// The fields of a record as a dict; JSON stays text.
fn fields(py: Python<'_>, record: Record) -> PyResult<Bound<'_, PyDict>> {
    let fields = PyDict::new(py);
    fields.set_item("sequence", record.sequence)?;
    fields.set_item("wall_ns", record.wall_ns)?;
    fields.set_item("gap", record.gap)?;
    fields.set_item("simulated", record.simulated)?;
    let kind = match record.body {
        Body::Frame { volts, flags } => {
            fields.set_item("voltages", PyArray1::from_vec(py, volts))?;
            fields.set_item("status", PyArray1::from_vec(py, flags))?;
            "frame"
        }
        Body::Map {
            values,
            mesh_hash,
            method,
        } => {
            fields.set_item("values", PyArray1::from_vec(py, values))?;
            fields.set_item("mesh_hash", mesh_hash)?;
            fields.set_item("method", method)?;
            "map"
        }
        Body::Pressure { kpa, newtons } => {
            let pascal = kpa.iter().map(|kpa| 1e3 * kpa).collect();
            fields.set_item("pressure", PyArray1::from_vec(py, pascal))?;
            fields.set_item("load", newtons)?;
            "pressure"
        }
        Body::Quality { json } => {
            fields.set_item("json", json)?;
            "quality"
        }
        Body::Tracked { json } => {
            fields.set_item("json", json)?;
            "tracked"
        }
        Body::Quantities { json } => {
            fields.set_item("json", json)?;
            "quantities"
        }
        Body::Injection { values, json } => {
            fields.set_item("values", PyArray1::from_vec(py, values))?;
            fields.set_item("json", json)?;
            "injection"
        }
        Body::Deviation { values, mesh_hash } => {
            fields.set_item("deviations", PyArray1::from_vec(py, values))?;
            fields.set_item("mesh_hash", mesh_hash)?;
            "deviation"
        }
        Body::End { reason } => {
            fields.set_item("reason", reason)?;
            "end"
        }
    };
    fields.set_item("kind", kind)?;
    Ok(fields)
}
