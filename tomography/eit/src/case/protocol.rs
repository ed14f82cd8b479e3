//! Protocol files of a case.

use std::fmt::Write as _;
use std::path::Path;

use survey::{Dipole, Electrode, Measurement, Protocol};

use super::text::digits;
use super::{CaseError, Table};

/// Columns of the file.
const COLUMNS: [&str; 6] = ["meas", "source", "sink", "v_plus", "v_minus", "current_A"];

/// Reads a protocol file and the current of each reading (A; 1 if the column is missing). Without `electrodes` the
/// number of electrodes is the largest number named.
///
/// # Errors
/// A fault in the file, naming its line, or a protocol that is refused.
pub fn read_protocol(
    path: &Path,
    electrodes: Option<usize>,
) -> Result<(Protocol, Vec<f64>), CaseError> {
    let table = Table::read(path)?;
    let mut measurements = Vec::new();
    let mut currents = Vec::new();
    let mut largest = 0;
    for (line, row) in table.in_units(&COLUMNS)?.numbers(5, 6)? {
        let electrode = |column: usize, what| {
            match electrodes {
                Some(count) => table.below(line, "electrode", row[column], count),
                None => table.index(line, what, row[column]),
            }
            .map(Electrode)
        };
        let question = Measurement {
            drive: Dipole {
                plus: electrode(1, "source")?,
                minus: electrode(2, "sink")?,
            },
            sense: Dipole {
                plus: electrode(3, "v_plus")?,
                minus: electrode(4, "v_minus")?,
            },
        };
        for dipole in [question.drive, question.sense] {
            largest = largest.max(dipole.plus.0).max(dipole.minus.0);
        }
        measurements.push(question);
        currents.push(row.get(5).copied().unwrap_or(1.0));
    }
    Protocol::new(electrodes.unwrap_or(largest + 1), measurements)
        .map(|protocol| (protocol, currents))
        .map_err(|cause| CaseError::Protocol {
            path: path.to_owned(),
            cause,
        })
}

/// A protocol as the text of its file.
pub fn protocol_text(protocol: &Protocol, currents: &[f64]) -> String {
    let mut text = COLUMNS.join(",") + "\n";
    for (meas, (question, current)) in protocol.measurements().iter().zip(currents).enumerate() {
        let Measurement { drive, sense } = question;
        let _ = writeln!(
            text,
            "{meas},{},{},{},{},{}",
            drive.plus.0,
            drive.minus.0,
            sense.plus.0,
            sense.minus.0,
            digits(*current)
        );
    }
    text
}
