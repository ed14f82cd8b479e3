//! Sizes of the preset meshes, from keyword arguments.

use pyo3::prelude::*;

use crate::arguments::Expected;

/// Converts a length in m to the mm of the presets: a decimal number of m becomes exactly the same decimal number of
/// mm.
pub(crate) fn millimetres(name: &str, metres: Option<&Bound<'_, PyAny>>) -> PyResult<Option<f64>> {
    let expected = Expected {
        name,
        about: "a length in m, above 0",
    };
    let metres = metres.map(|metres| expected.positive(metres)).transpose()?;
    Ok(metres.map(|metres| {
        let picometres = (1e12 * metres).round();
        match picometres > 0.0 && picometres < 9e15 {
            true => picometres / 1e9,
            false => 1e3 * metres,
        }
    }))
}

pub(crate) fn electrodes(name: &str, given: Option<&Bound<'_, PyAny>>) -> PyResult<Option<usize>> {
    let expected = Expected {
        name,
        about: "a number of electrodes from 1 to 256",
    };
    let Some(given) = given else { return Ok(None) };
    match expected.count(given)? {
        count @ 1..=256 => Ok(Some(count)),
        count => Err(expected.value_error(&format!("it is {count}"))),
    }
}

pub(crate) fn fine(fineness: Option<&Bound<'_, PyAny>>) -> PyResult<f64> {
    let expected = Expected {
        name: "fineness",
        about: "a number from 0.25 to 8",
    };
    fineness.map_or(Ok(1.0), |given| expected.number(given))
}

pub(crate) fn seeded(seeding: Option<&Bound<'_, PyAny>>) -> PyResult<u32> {
    let expected = Expected {
        name: "seeding",
        about: "an integer from 0 to 4294967295",
    };
    let count = seeding.map_or(Ok(0), |given| expected.count(given))?;
    u32::try_from(count).map_err(|_| expected.value_error(&format!("it is {count}")))
}
