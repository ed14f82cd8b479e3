//! Results of the engine as Python values and exceptions.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use nalgebra::DMatrix;
use numpy::npyffi::NPY_ORDER;
use numpy::{Element, PyArray1, PyArray2, PyArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

/// Time between two checks for Ctrl-C.
pub(crate) const LOOK: Duration = Duration::from_millis(50);

/// Stack of a worker thread, bytes: as large as that of the main thread.
const STACK: usize = 8 << 20;

/// Runs work without the interpreter's lock. A defect of the engine becomes a `RuntimeError`, so that Python code can
/// handle it like any other error.
pub(crate) fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    py.detach(|| catch_unwind(AssertUnwindSafe(work)))
        .map_err(|cause| defect(cause.as_ref()))
}

fn defect(cause: &(dyn Any + Send)) -> PyErr {
    let text = cause
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| cause.downcast_ref::<&str>().copied())
        .unwrap_or("no text");
    PyRuntimeError::new_err(format!("a defect of tactus_eit, please report it: {text}"))
}

/// Passes the number of completed steps from interruptible work to its caller, and the caller's request to stop to the
/// work.
pub(crate) struct Steps {
    count: Option<Sender<Option<usize>>>,
    stopped: Arc<AtomicBool>,
}

impl Steps {
    /// Reports how many steps are done. Returns whether the work is still wanted.
    pub(crate) fn done(&self, steps: usize) -> bool {
        if let Some(count) = &self.count {
            // the send fails only if the caller has left; it has set the flag then
            let _ = count.send(Some(steps));
        }
        self.wanted()
    }

    /// Whether the work is still wanted.
    pub(crate) fn wanted(&self) -> bool {
        !self.stopped.load(Ordering::Relaxed)
    }
}

/// Runs long work on a thread of its own, so that Ctrl-C ends the call at once. The engine cannot stop within a
/// factorisation: the work ends at its next step, and its result is discarded.
///
/// progress: called with the number of completed steps and of all steps; an exception that it raises ends the work. See
/// [`short`] for work that takes less time than the start of a thread.
pub(crate) fn interruptible<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<(&Bound<'_, PyAny>, usize)>,
    work: impl FnOnce(&Steps) -> T + Send + 'static,
) -> PyResult<T> {
    let (sender, messages) = mpsc::channel();
    let stopped = Arc::new(AtomicBool::new(false));
    let steps = Steps {
        count: progress.is_some().then(|| sender.clone()),
        stopped: Arc::clone(&stopped),
    };
    let worker = std::thread::Builder::new()
        .name("tactus_eit".to_owned())
        .stack_size(STACK)
        .spawn(move || {
            let result = catch_unwind(AssertUnwindSafe(|| work(&steps)));
            let _ = sender.send(None);
            result
        })?;
    if let Err(interrupt) = waited(py, &Mutex::new(messages), progress) {
        stopped.store(true, Ordering::Relaxed);
        return Err(interrupt);
    }
    // the worker has reported its end, so that this does not wait
    let result = py.detach(|| worker.join()).and_then(|result| result);
    result.map_err(|cause| defect(cause.as_ref()))
}

/// Runs work on the calling thread, with the same interface as [`interruptible`].
pub(crate) fn short<T: Send>(py: Python<'_>, work: impl FnOnce(&Steps) -> T + Send) -> PyResult<T> {
    let steps = Steps {
        count: None,
        stopped: Arc::default(),
    };
    detached(py, || work(&steps))
}

/// Waits until the worker has ended.
fn waited(
    py: Python<'_>,
    // in a mutex, because without the interpreter's lock only values that threads may share can be used
    messages: &Mutex<Receiver<Option<usize>>>,
    progress: Option<(&Bound<'_, PyAny>, usize)>,
) -> PyResult<()> {
    loop {
        let message = py.detach(|| {
            let messages = messages.lock().unwrap_or_else(PoisonError::into_inner);
            messages.recv_timeout(LOOK)
        });
        py.check_signals()?;
        match (message, progress) {
            (Ok(Some(done)), Some((progress, count))) => {
                progress.call1((done, count))?;
            }
            (Ok(None) | Err(RecvTimeoutError::Disconnected), _) => return Ok(()),
            (Ok(Some(_)) | Err(RecvTimeoutError::Timeout), _) => {}
        }
    }
}

/// A `ValueError` with the whole chain of causes.
pub(crate) fn refused(error: &dyn std::error::Error) -> PyErr {
    PyValueError::new_err(survey::error_chain(error))
}

/// A matrix as an array in Fortran order, without a copy.
pub(crate) fn matrix(py: Python<'_>, matrix: DMatrix<f64>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let (rows, columns) = matrix.shape();
    let values: Vec<f64> = matrix.data.into();
    PyArray1::from_vec(py, values).reshape_with_order([rows, columns], NPY_ORDER::NPY_FORTRANORDER)
}

/// Values in C order as an array of rows.
pub(crate) fn rows<T: Element>(
    py: Python<'_>,
    values: Vec<T>,
    [rows, columns]: [usize; 2],
) -> PyResult<Bound<'_, PyArray2<T>>> {
    PyArray1::from_vec(py, values).reshape_with_order([rows, columns], NPY_ORDER::NPY_CORDER)
}
