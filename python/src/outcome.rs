//! Results of the engine as Python values and exceptions.

use std::panic::{AssertUnwindSafe, catch_unwind};

use nalgebra::DMatrix;
use numpy::npyffi::NPY_ORDER;
use numpy::{Element, PyArray1, PyArray2, PyArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

/// Runs long work without the interpreter's lock. A defect of the engine becomes a `RuntimeError`, so that Python code can
/// handle it like any other error.
pub(crate) fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    py.detach(|| catch_unwind(AssertUnwindSafe(work)))
        .map_err(|cause| {
            let text = cause
                .downcast_ref::<String>()
                .map(String::as_str)
                .or_else(|| cause.downcast_ref::<&str>().copied())
                .unwrap_or("no text");
            PyRuntimeError::new_err(format!("a defect of tactus_eit, please report it: {text}"))
        })
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
