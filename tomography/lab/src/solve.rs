//! `tactus-lab forward` and `tactus-lab jacobian`.

use std::time::Instant;

use eit::{Forward, digits, matrix_text};

use crate::args::{ForwardOptions, JacobianOptions};
use crate::failure::{Failure, write};
use crate::geometry;

/// Runs of which `--timing` prints the median.
const RUNS: usize = 21;

/// Readings, and the electrode voltages if asked.
pub(crate) fn forward(options: &ForwardOptions) -> Result<(), Failure> {
    let case = geometry::read(&options.case)?;
    let sigma = case
        .sigma(&options.sigma)
        .map_err(|fault| Failure::of("cannot read the conductance", &fault))?;
    let failed = |fault| Failure::of("the forward model", &fault);
    let forward =
        Forward::new(std::sync::Arc::clone(&case.mesh), &case.contact_ohm_m).map_err(failed)?;
    let admitted = forward.admit(&sigma).map_err(failed)?;
    if admitted.floored > 0 {
        eprintln!(
            "tactus-lab: {} triangles had no conductance and were given {:e} of the largest",
            admitted.floored,
            eit::FLOOR
        );
    }
    let readings = forward.readings(&sigma, &case.protocol).map_err(failed)?;
    let text = readings
        .iter()
        .zip(&case.currents)
        .map(|(volts, current)| digits(volts * current) + "\n")
        .collect();
    write(&options.out, text)?;
    if let Some(path) = &options.potentials {
        let drives = case.protocol.drives();
        let fields = forward.solve(&sigma, &drives).map_err(failed)?;
        let mut rows = fields.electrodes.transpose();
        for (mut row, drive) in rows.row_iter_mut().zip(&drives) {
            let asked = case.protocol.measurements().iter();
            let current = asked
                .zip(&case.currents)
                .find(|(question, _)| question.drive == *drive)
                .map_or(1.0, |(_, current)| *current);
            row *= current;
        }
        write(path, matrix_text(&rows))?;
    }
    if options.timing {
        let mut times = Vec::with_capacity(RUNS);
        for _ in 0..RUNS {
            let start = Instant::now();
            forward.readings(&sigma, &case.protocol).map_err(failed)?;
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        eprintln!("forward {:.3} ms", median(&mut times));
    }
    Ok(())
}

/// The sensitivity at the protocol's currents.
pub(crate) fn jacobian(options: &JacobianOptions) -> Result<(), Failure> {
    let case = geometry::read(&options.case)?;
    let sigma = case
        .sigma(&options.sigma)
        .map_err(|fault| Failure::of("cannot read the conductance", &fault))?;
    let failed = |fault| Failure::of("the forward model", &fault);
    let forward =
        Forward::new(std::sync::Arc::clone(&case.mesh), &case.contact_ohm_m).map_err(failed)?;
    let mut jacobian = forward.jacobian(&sigma, &case.protocol).map_err(failed)?;
    for (mut row, current) in jacobian.row_iter_mut().zip(&case.currents) {
        row *= *current;
    }
    write(&options.out, matrix_text(&jacobian))
}

/// The middle value; 0 of nothing.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}
