//! The class `Protocol`.

use numpy::PyArray2;
use pyo3::prelude::*;
use survey::{Dipole, Electrode, Measurement};

use crate::arguments::{Expected, pairs};
use crate::outcome::{refused, rows};

/// More electrodes than any instrument has. The number of readings grows with its square.
const MOST_ELECTRODES: usize = 1024;

/// The measurements of a frame, in order: the electrodes through which the current flows, and those between which the
/// voltage is measured.
///
/// Electrodes are counted from 0. Made by ``Protocol.sheffield``, ``Protocol.from_pairs`` or ``Protocol.from_case``.
///
/// >>> import tactus_eit
/// >>> protocol = tactus_eit.Protocol.sheffield(16)
/// >>> len(protocol), protocol.electrodes
/// (208, 16)
/// >>> protocol.inject[0], protocol.measure[0]
/// (array([0, 1]), array([2, 3]))
#[pyclass(frozen, eq, module = "tactus_eit")]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Protocol(pub(crate) survey::Protocol);

#[pymethods]
impl Protocol {
    /// The Sheffield pattern: current through each pair of electrodes with ``skip`` others between them, and for each
    /// the voltages of all such pairs that share no electrode with it.
    ///
    /// electrodes: 4 to 1024. With ``skip=0``, ``electrodes * (electrodes - 3)`` readings.
    #[staticmethod]
    #[pyo3(signature = (electrodes, skip=None))]
    fn sheffield(electrodes: &Bound<'_, PyAny>, skip: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let expected = Expected {
            name: "electrodes",
            about: "a number of electrodes from 4 to 1024",
        };
        let count = expected.count(electrodes)?;
        if !(4..=MOST_ELECTRODES).contains(&count) {
            return Err(expected.value_error(&format!("it is {count}")));
        }
        let between = Expected {
            name: "skip",
            about: "how many electrodes lie between the two of a pair, 0 to electrodes - 2",
        };
        let skip = skip.map_or(Ok(0), |skip| between.count(skip))?;
        if skip > count - 2 {
            return Err(between.value_error(&format!("it is {skip} of {count} electrodes")));
        }
        survey::Protocol::new(count, survey::skip(count, skip).collect())
            .map(Self)
            .map_err(|fault| refused(&fault))
    }

    /// A protocol from pairs of electrodes, one row a reading.
    ///
    /// inject: integers of shape (readings, 2): where the current enters, and where it leaves.
    /// measure: integers of shape (readings, 2): a reading is the voltage of the first minus that of the second.
    /// electrodes: their number; by default one more than the largest index.
    #[staticmethod]
    #[pyo3(signature = (inject, measure, electrodes=None))]
    fn from_pairs(
        inject: &Bound<'_, PyAny>,
        measure: &Bound<'_, PyAny>,
        electrodes: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let driven = Expected {
            name: "inject",
            about: "integers of shape (readings, 2), source and sink of each reading, counted from 0",
        };
        let sensed = Expected {
            name: "measure",
            about: "integers of shape (readings, 2), plus and minus of each reading, counted from 0",
        };
        let drives = pairs(driven, &driven.indices(inject, &[2])?)?;
        let senses = pairs(sensed, &sensed.indices(measure, &[2])?)?;
        if drives.len() != senses.len() {
            return Err(sensed.value_error(&format!(
                "it has {} rows and 'inject' has {}: repeat a pair for each of its readings",
                senses.len(),
                drives.len()
            )));
        }
        let largest = drives
            .iter()
            .chain(&senses)
            .flatten()
            .copied()
            .max()
            .unwrap_or(0);
        let number = Expected {
            name: "electrodes",
            about: "a number of electrodes from 2 to 1024",
        };
        let count = match electrodes {
            Some(count) => number.count(count)?,
            None => largest.saturating_add(1),
        };
        if count > MOST_ELECTRODES {
            return Err(number.value_error(&format!("there would be {count}")));
        }
        let pair = |[plus, minus]: [usize; 2]| Dipole {
            plus: Electrode(plus),
            minus: Electrode(minus),
        };
        let both = drives.into_iter().zip(senses);
        let measurements = both.map(|(drive, sense)| Measurement {
            drive: pair(drive),
            sense: pair(sense),
        });
        survey::Protocol::new(count, measurements.collect())
            .map(Self)
            .map_err(|fault| driven.value_error(&fault.to_string()))
    }

    /// The protocol of a case folder: its ``protocol.csv``.
    ///
    /// electrodes: their number, if the pairs do not name the last one.
    #[staticmethod]
    #[pyo3(signature = (folder, electrodes=None))]
    fn from_case(
        folder: &Bound<'_, PyAny>,
        electrodes: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let folder = Expected {
            name: "folder",
            about: "the path of a case folder",
        }
        .path(folder)?;
        let number = Expected {
            name: "electrodes",
            about: "a number of electrodes",
        };
        let electrodes = electrodes.map(|count| number.count(count)).transpose()?;
        let (protocol, _) = eit::read_protocol(&folder.join("protocol.csv"), electrodes)
            .map_err(|fault| refused(&fault))?;
        Ok(Self(protocol))
    }

    /// The protocol of an EIDORS fwd_model with its stimulation, as ``scipy.io.loadmat(...)["fmdl"]`` returns it; see
    /// ``tactus_eit.eidors``.
    #[staticmethod]
    fn from_eidors<'py>(py: Python<'py>, model: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        py.import("tactus_eit.eidors")?
            .call_method1("protocol", (model,))
    }

    /// The protocol with electrode ``e`` renamed to ``order[e]``, where ``order`` is as ``check`` returns it.
    ///
    /// order: integers of shape (electrodes,), each electrode once.
    fn renumbered(&self, order: &Bound<'_, PyAny>) -> PyResult<Self> {
        let about = format!(
            "a permutation of 0 to {}, shape ({},)",
            self.0.electrodes() - 1,
            self.0.electrodes()
        );
        let expected = Expected {
            name: "order",
            about: &about,
        };
        let order = expected.indices(order, &[1])?.values;
        let mut seen = vec![false; self.0.electrodes()];
        for electrode in &order {
            match seen.get_mut(*electrode) {
                Some(seen) if !*seen => *seen = true,
                _ => {
                    return Err(expected.value_error(&format!(
                        "electrode {electrode} is named twice or does not exist"
                    )));
                }
            }
        }
        if order.len() != seen.len() {
            return Err(expected.shape_error(&[order.len()]));
        }
        let pair = |pair: Dipole| Dipole {
            plus: Electrode(order[pair.plus.0]),
            minus: Electrode(order[pair.minus.0]),
        };
        let renumbered = self.0.measurements().iter();
        let renumbered = renumbered.map(|one| Measurement {
            drive: pair(one.drive),
            sense: pair(one.sense),
        });
        survey::Protocol::new(self.0.electrodes(), renumbered.collect())
            .map(Self)
            .map_err(|fault| refused(&fault))
    }

    /// Number of electrodes.
    #[getter]
    fn electrodes(&self) -> usize {
        self.0.electrodes()
    }

    /// Source and sink electrode of each reading: shape (readings, 2), from 0.
    #[getter]
    fn inject<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        self.pairs(py, |one| one.drive)
    }

    /// Plus and minus electrode of each reading: shape (readings, 2), from 0.
    #[getter]
    fn measure<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        self.pairs(py, |one| one.sense)
    }

    /// SHA-256 of the protocol, hexadecimal, as in session files.
    #[getter]
    fn hash(&self) -> String {
        self.0.hash()
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }

    fn __hash__(&self) -> u64 {
        use std::hash::{DefaultHasher, Hash, Hasher};
        let mut hasher = DefaultHasher::new();
        self.0.hash().hash(&mut hasher);
        hasher.finish()
    }

    fn __repr__(&self) -> String {
        format!(
            "<Protocol of {} readings, {} electrodes>",
            self.0.len(),
            self.0.electrodes()
        )
    }
}

impl Protocol {
    fn pairs<'py>(
        &self,
        py: Python<'py>,
        pair: impl Fn(&Measurement) -> Dipole,
    ) -> PyResult<Bound<'py, PyArray2<i64>>> {
        let both = self.0.measurements().iter().map(pair);
        let values = both
            .flat_map(|pair| [pair.plus.0 as i64, pair.minus.0 as i64])
            .collect();
        rows(py, values, [self.0.len(), 2])
    }
}
