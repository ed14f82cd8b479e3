//! `tactus-lab forward`, `tactus-lab jacobian` and `tactus-lab transfer`.

use std::sync::Arc;
use std::time::Instant;

use eit::{Case, Forward, Parameters, Workspace, digits, frames_text, matrix_text};
use outfile::Existing;
use rayon::prelude::*;

use studies::evaluation::median;
use studies::{Failure, progress, write};

use super::mesh::read;
use crate::args::{ForwardOptions, JacobianOptions, Of, TransferOptions};

/// Number of runs for the median of `--timing`.
const RUNS: usize = 21;

/// A conductance and its name.
struct Named {
    name: String,
    sigma: Vec<f64>,
}

/// Computes readings, and the electrode voltages if requested.
pub(crate) fn forward(options: &ForwardOptions) -> Result<(), Failure> {
    let case = read(&options.case)?;
    let conductances = conductances(options, &case)?;
    if options.potentials.is_some() && conductances.len() != 1 {
        return Err(Failure::usage(
            "--potentials takes one conductance; give one at a time",
        ));
    }
    let model = model(&case)?;
    let failed = |fault| Failure::of("the forward model", &fault);
    let mut workspace = model.workspace(&case.protocol).map_err(failed)?;
    if options.plain {
        workspace = workspace.plain();
    }
    let refused =
        |named: &Named, fault| Failure::of(&format!("the forward model of {}", named.name), &fault);
    for named in &conductances {
        let admitted = model
            .admit(&named.sigma)
            .map_err(|fault| refused(named, fault))?;
        if admitted.floored > 0 {
            let first = named.sigma.iter().position(|value| *value == 0.0);
            eprintln!(
                "tactus-lab: {}: {} triangles have no conductance (the first is element {}) and are given {:e} of the \
                 largest",
                named.name,
                admitted.floored,
                first.unwrap_or_default(),
                eit::FLOOR
            );
        }
    }
    let solve = |workspace: &mut Workspace<'_>, named: &Named| -> Result<Vec<f64>, Failure> {
        let readings = workspace
            .readings(&named.sigma)
            .map_err(|fault| refused(named, fault))?;
        let at_current = readings.iter().zip(&case.currents);
        Ok(at_current.map(|(volts, current)| volts * current).collect())
    };
    if let [one] = &conductances[..] {
        let readings = solve(&mut workspace, one)?;
        let text = readings.iter().map(|volts| digits(*volts) + "\n").collect();
        write(&options.out, options.replacing.existing(), text)?;
        if let Some(path) = &options.potentials {
            let existing = options.replacing.existing();
            potentials(&case, &mut workspace, one, path, existing)?;
        }
    } else {
        if let Some(first) = conductances.first() {
            workspace = workspace
                .about(&first.sigma)
                .map_err(|fault| refused(first, fault))?;
        }
        let bar = progress::bar(conductances.len(), "forward");
        let solved: Result<Vec<_>, Failure> = pool(options.threads)?.install(|| {
            conductances
                .par_iter()
                .map_init(
                    || workspace.clone(),
                    |workspace, named| {
                        let readings = solve(workspace, named)?;
                        bar.inc(1);
                        Ok(readings.into_iter().map(Some).collect())
                    },
                )
                .collect()
        });
        bar.finish_and_clear();
        write(
            &options.out,
            options.replacing.existing(),
            frames_text(&solved?),
        )?;
    }
    if options.timing {
        let mut times = Vec::with_capacity(RUNS);
        for named in conductances.iter().cycle().take(RUNS) {
            let start = Instant::now();
            workspace
                .readings(&named.sigma)
                .map_err(|fault| refused(named, fault))?;
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        eprintln!("forward {:.3} ms", median(&mut times));
    }
    Ok(())
}

/// Conductances of the command line: by name, or the rows of a file.
fn conductances(options: &ForwardOptions, case: &Case) -> Result<Vec<Named>, Failure> {
    let failed = |fault| Failure::of("cannot read the conductance", &fault);
    let Some(path) = &options.sigma_rows else {
        let named = |name: &String| {
            let sigma = case.sigma(name).map_err(failed)?;
            Ok(Named {
                name: name.clone(),
                sigma,
            })
        };
        return options.sigma.iter().map(named).collect();
    };
    let rows = case.sigma_rows(path).map_err(failed)?;
    let named = |(line, sigma)| Named {
        name: format!("{}:{line}", path.display()),
        sigma,
    };
    Ok(rows.into_iter().map(named).collect())
}

fn potentials(
    case: &Case,
    workspace: &mut Workspace<'_>,
    named: &Named,
    path: &std::path::Path,
    existing: Existing,
) -> Result<(), Failure> {
    let failed = |fault| Failure::of(&format!("the forward model of {}", named.name), &fault);
    let drives = case.protocol.drives();
    let fields = workspace.fields(&named.sigma).map_err(failed)?;
    let mut rows = fields.electrodes.transpose();
    for (mut row, drive) in rows.row_iter_mut().zip(&drives) {
        let measurements = case.protocol.measurements().iter();
        let current = measurements
            .zip(&case.currents)
            .find(|(measurement, _)| measurement.drive == *drive)
            .map_or(1.0, |(_, current)| *current);
        row *= current;
    }
    write(path, existing, matrix_text(&rows))
}

/// The sensitivity at the protocol's currents.
pub(crate) fn jacobian(options: &JacobianOptions) -> Result<(), Failure> {
    let case = read(&options.case)?;
    let sigma = case
        .sigma(&options.sigma)
        .map_err(|fault| Failure::of("cannot read the conductance", &fault))?;
    let model = model(&case)?;
    let failed = |fault| Failure::of("the forward model", &fault);
    let mut parameters = if options.region {
        Parameters::region()
    } else {
        Parameters::elements()
    };
    if let Some(pitch) = options.cells_mm {
        if !(pitch > 0.0 && pitch.is_finite()) {
            return Err(Failure::usage(format!(
                "--cells-mm {pitch}: a positive length is expected, e.g. 5"
            )));
        }
        let (cells, centres) = Parameters::grid(&case.mesh, pitch * 1e-3);
        parameters = cells;
        if let Some(path) = &options.centres {
            let rows = centres
                .iter()
                .map(|[x, y]| format!("{},{}\n", digits(*x), digits(*y)));
            let text = String::from("x_m,y_m\n") + &rows.collect::<String>();
            write(path, options.replacing.existing(), text)?;
        }
    }
    let mut jacobian = match options.of {
        Of::Contact if options.region || options.cells_mm.is_some() => {
            return Err(Failure::usage(
                "--of contact has a column per electrode; --region and --cells-mm do not apply to it",
            ));
        }
        Of::Contact => model.contact_jacobian(&sigma, &case.protocol),
        Of::Sigma => model.sensitivity(&sigma, &case.protocol, &parameters),
        Of::LnSigma => model.sensitivity(&sigma, &case.protocol, &parameters.logarithmic()),
    }
    .map_err(failed)?;
    for (mut row, current) in jacobian.row_iter_mut().zip(&case.currents) {
        row *= *current;
    }
    write(
        &options.out,
        options.replacing.existing(),
        matrix_text(&jacobian),
    )
}

/// `tactus-lab transfer`: Y and Z of Eq. 2.
pub(crate) fn transfer(options: &TransferOptions) -> Result<(), Failure> {
    let case = read(&options.case)?;
    let sigma = case
        .sigma(&options.sigma)
        .map_err(|fault| Failure::of("cannot read the conductance", &fault))?;
    let model = model(&case)?;
    let failed = |fault| Failure::of("the forward model", &fault);
    if let Some(path) = &options.admittance {
        let admittance = model.transfer_admittance(&sigma).map_err(failed)?;
        write(path, options.replacing.existing(), matrix_text(&admittance))?;
    }
    if let Some(path) = &options.impedance {
        let impedance = model.transfer_impedance(&sigma).map_err(failed)?;
        write(path, options.replacing.existing(), matrix_text(&impedance))?;
    }
    Ok(())
}

fn model(case: &Case) -> Result<Forward, Failure> {
    Forward::new(Arc::clone(&case.mesh), &case.contact_ohm_m)
        .map_err(|fault| Failure::of("the forward model", &fault))
}

/// A pool with the requested number of threads.
fn pool(threads: Option<usize>) -> Result<rayon::ThreadPool, Failure> {
    if threads == Some(0) {
        return Err(Failure::usage("--threads 0: at least one is needed"));
    }
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.unwrap_or(0))
        .build()
        .map_err(|fault| Failure::of("cannot start the threads", &fault))
}
