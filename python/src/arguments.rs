//! Converts arguments from Python to Rust values. An argument that does not fit is a `TypeError` (kind of value) or a
//! `ValueError` (shape, value); the message has the name of the argument, what is expected, and how to correct it.

use std::path::PathBuf;

use numpy::{PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::PyClass;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// An array from Python: shape, and values in C order.
#[derive(Debug, Clone)]
pub(crate) struct Values<T> {
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Vec<T>,
}

/// The requirements for an argument.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Expected<'a> {
    /// Name of the argument.
    pub(crate) name: &'a str,
    /// Its meaning, shape and unit, for the message.
    pub(crate) about: &'a str,
}

/// The name of an object's class.
fn class_of(object: &Bound<'_, PyAny>) -> String {
    let class = object.get_type().name();
    class.map_or_else(|_| "object".to_owned(), |name| name.to_string())
}

impl Expected<'_> {
    pub(crate) fn type_error(&self, fault: &str) -> PyErr {
        PyTypeError::new_err(self.message(fault))
    }

    pub(crate) fn value_error(&self, fault: &str) -> PyErr {
        PyValueError::new_err(self.message(fault))
    }

    /// The error for an object of an unsuitable class.
    fn class_error(&self, object: &Bound<'_, PyAny>) -> PyErr {
        self.type_error(&format!("it is a {}", class_of(object)))
    }

    /// An object of a class of this package.
    pub(crate) fn instance<T: PyClass>(&self, object: &Bound<'_, PyAny>) -> PyResult<Py<T>> {
        let instance = object.cast::<T>().map_err(|_| self.class_error(object))?;
        Ok(instance.clone().unbind())
    }

    /// A file or folder.
    pub(crate) fn path(&self, object: &Bound<'_, PyAny>) -> PyResult<PathBuf> {
        object.extract().map_err(|_| self.class_error(object))
    }

    fn message(&self, fault: &str) -> String {
        format!("argument '{}': {fault}; expected {}", self.name, self.about)
    }

    /// Converts an object to a `numpy` array of any numeric type; returns the array and the kind of its dtype.
    fn array<'py>(&self, object: &Bound<'py, PyAny>) -> PyResult<(Bound<'py, PyAny>, String)> {
        let numpy = object.py().import("numpy")?;
        if object.is_instance(&numpy.getattr("ma")?.getattr("MaskedArray")?)? {
            return Err(
                self.type_error("a masked array loses its mask here: pass array.filled(numpy.nan)")
            );
        }
        let array = numpy
            .call_method1("asarray", (object,))
            .map_err(|cause| self.refused(object, &cause))?;
        let kind: String = array.getattr("dtype")?.getattr("kind")?.extract()?;
        match kind.as_str() {
            "f" | "i" | "u" => Ok((array, kind)),
            "c" => Err(self.type_error("the values are complex: pass their real part")),
            "b" => {
                Err(self.type_error("the values are booleans: use numpy.flatnonzero for indices"))
            }
            _ => {
                let dtype = array.getattr("dtype")?.str()?;
                Err(self.type_error(&format!(
                    "an array of dtype {dtype} is not numeric: convert it with numpy.asarray(..., dtype=float)"
                )))
            }
        }
    }

    /// The error for an object that numpy cannot convert. Interrupts and memory errors are passed on.
    fn refused(&self, object: &Bound<'_, PyAny>, cause: &PyErr) -> PyErr {
        let py = object.py();
        if !(cause.is_instance_of::<PyTypeError>(py) || cause.is_instance_of::<PyValueError>(py)) {
            return cause.clone_ref(py);
        }
        self.type_error(&format!(
            "numpy makes no array of this {} ({})",
            class_of(object),
            cause.value(py)
        ))
    }

    /// Numbers, finite or not; the number of dimensions must be in `dimensions`.
    pub(crate) fn floats_or_nan(
        &self,
        object: &Bound<'_, PyAny>,
        dimensions: &[usize],
    ) -> PyResult<Values<f64>> {
        let (array, _) = self.array(object)?;
        let values = self.contiguous::<f64>(&array, "float64")?;
        self.dimensions(&values.shape, dimensions)?;
        Ok(values)
    }

    /// Finite numbers; the number of dimensions must be in `dimensions`.
    pub(crate) fn floats(
        &self,
        object: &Bound<'_, PyAny>,
        dimensions: &[usize],
    ) -> PyResult<Values<f64>> {
        let values = self.floats_or_nan(object, dimensions)?;
        self.finite(&values, "remove or replace it")?;
        Ok(values)
    }

    /// Refuses values that are not finite.
    pub(crate) fn finite(&self, values: &Values<f64>, mend: &str) -> PyResult<()> {
        match values.values.iter().position(|value| !value.is_finite()) {
            None => Ok(()),
            Some(at) => {
                let value = values.values[at];
                // in Python's notation
                let value = if value.is_nan() {
                    "nan".to_owned()
                } else {
                    value.to_string()
                };
                Err(self.value_error(&format!("{} is {value}: {mend}", place(at, &values.shape))))
            }
        }
    }

    /// Integers from 0 on; the number of dimensions must be in `dimensions`.
    pub(crate) fn indices(
        &self,
        object: &Bound<'_, PyAny>,
        dimensions: &[usize],
    ) -> PyResult<Values<usize>> {
        let (array, kind) = self.array(object)?;
        let empty = array.getattr("size")?.extract::<usize>()? == 0;
        let Values { shape, values } = match kind.as_str() {
            "u" => {
                let unsigned = self.contiguous::<u64>(&array, "uint64")?;
                self.converted(unsigned)?
            }
            "i" => {
                let signed = self.contiguous::<i64>(&array, "int64")?;
                self.converted(signed)?
            }
            // numpy converts an empty list to an array of floats
            _ if empty => Values {
                shape: array.getattr("shape")?.extract()?,
                values: Vec::new(),
            },
            _ => {
                return Err(self.type_error(
                    "the values are floats, and indices are integers: use .astype(int)",
                ));
            }
        };
        self.dimensions(&shape, dimensions)?;
        Ok(Values { shape, values })
    }

    fn converted<T: Copy + std::fmt::Display + TryInto<usize>>(
        &self,
        given: Values<T>,
    ) -> PyResult<Values<usize>> {
        let mut values = Vec::with_capacity(given.values.len());
        for (at, value) in given.values.iter().enumerate() {
            values.push((*value).try_into().map_err(|_| {
                let place = place(at, &given.shape);
                self.value_error(&format!(
                    "{place} is {value}, and indices are counted from 0"
                ))
            })?);
        }
        Ok(Values {
            shape: given.shape,
            values,
        })
    }

    fn contiguous<T: numpy::Element + Copy>(
        &self,
        array: &Bound<'_, PyAny>,
        dtype: &str,
    ) -> PyResult<Values<T>> {
        let numpy = array.py().import("numpy")?;
        // asarray and not ascontiguousarray, which would give a number one dimension
        let array = numpy.call_method1("asarray", (array, dtype, "C"))?;
        let array = array
            .cast::<PyArrayDyn<T>>()
            .map_err(|_| self.type_error("numpy makes no array of this"))?;
        let shape = array.shape().to_vec();
        let borrowed = array
            .try_readonly()
            .map_err(|_| self.value_error("the array is being written to: pass a copy"))?;
        let values = borrowed
            .as_slice()
            .map_err(|_| {
                self.value_error("the array is not contiguous: pass numpy.ascontiguousarray(...)")
            })?
            .to_vec();
        Ok(Values { shape, values })
    }

    fn dimensions(&self, shape: &[usize], dimensions: &[usize]) -> PyResult<()> {
        if dimensions.contains(&shape.len()) {
            return Ok(());
        }
        Err(self.shape_error(shape))
    }

    pub(crate) fn shape_error(&self, shape: &[usize]) -> PyErr {
        self.value_error(&format!("its shape is {}", tuple(shape)))
    }

    /// One finite number.
    pub(crate) fn number(&self, object: &Bound<'_, PyAny>) -> PyResult<f64> {
        Ok(self.floats(object, &[0])?.values[0])
    }

    /// A number above zero.
    pub(crate) fn positive(&self, object: &Bound<'_, PyAny>) -> PyResult<f64> {
        let value = self.number(object)?;
        if value > 0.0 {
            return Ok(value);
        }
        Err(self.value_error(&format!("it is {value}, and must be above 0")))
    }

    /// A count or an index.
    pub(crate) fn count(&self, object: &Bound<'_, PyAny>) -> PyResult<usize> {
        Ok(self.indices(object, &[0])?.values[0])
    }
}

/// The pairs in an array of shape `(n, 2)`.
pub(crate) fn pairs<T: Copy>(expected: Expected<'_>, given: &Values<T>) -> PyResult<Vec<[T; 2]>> {
    match given.shape[..] {
        [_, 2] => Ok(given
            .values
            .chunks_exact(2)
            .map(|pair| [pair[0], pair[1]])
            .collect()),
        _ => Err(expected.shape_error(&given.shape)),
    }
}

/// A shape in Python's notation.
pub(crate) fn tuple(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        more => {
            let lengths: Vec<String> = more.iter().map(usize::to_string).collect();
            format!("({})", lengths.join(", "))
        }
    }
}

/// The index of an element in C order, in Python's notation.
fn place(at: usize, shape: &[usize]) -> String {
    if shape.is_empty() {
        return "it".to_owned();
    }
    let mut rest = at;
    let mut index: Vec<String> = Vec::with_capacity(shape.len());
    for length in shape.iter().rev() {
        index.push((rest % length.max(&1)).to_string());
        rest /= length.max(&1);
    }
    index.reverse();
    format!("value [{}]", index.join(", "))
}
