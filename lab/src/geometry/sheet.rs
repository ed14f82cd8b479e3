//! `tactus-lab sheet`: fits the sheet (with the unevenness of its spraying) to a baseline and writes it as a case
//! folder.

use eit::Case;
use imaging::recorded::{Recording, TableOptions};
use imaging::tracking::sheet_fit;
use imaging::{Conditions, Geometry};
use serde_json::json;
use studies::Failure;
use survey::{Amps, Electrode, Reading};

use super::{frames, one_current, read};
use crate::args::SheetOptions;
use crate::output::print_line;

/// Relative misfit of the fitted readings above which the fit is unreliable.
const POOR: f64 = 0.05;

/// Fits the sheet and writes the folder.
pub(crate) fn sheet(options: &SheetOptions) -> Result<(), Failure> {
    let mut case = read(&options.case)?;
    let (baseline, current) = baseline(options, &case)?;
    let geometry = Geometry::of_case(&case, options.case.display().to_string());
    let conditions = Conditions::live(&geometry, &case.protocol, current);
    let fit = sheet_fit(&conditions, &baseline, 0.0)
        .map_err(|fault| Failure::of("the sheet cannot be fitted to the baseline", &fault))?;
    case.sigma = [("homog".to_owned(), fit.sigma.clone())].into();
    case.contact_ohm_m.clone_from(&fit.contact_ohm_m);
    case.write(&options.out, options.replacing.existing())
        .map_err(|fault| Failure::of("cannot write the case", &fault))?;
    let implausible: Vec<usize> = fit
        .implausible
        .iter()
        .map(|&electrode| Electrode(electrode).number())
        .collect();
    if options.json {
        let line = json!({
            "case": options.out.display().to_string(),
            "gain": fit.gain,
            "unevenness": fit.unevenness,
            "misfit": fit.misfit,
            "nominal_misfit": fit.nominal_misfit,
            "implausible_contacts": implausible,
        });
        print_line!("{}", survey::printable_json(line.to_string()));
    } else {
        print_line!(
            "{}: conductance uneven by {:.1} % (rms), {:.3} times the nominal readings; it explains the readings of \
             the baseline within {:.2} % (rms), the nominal sheet within {:.1} %",
            options.out.display(),
            100.0 * fit.unevenness,
            fit.gain,
            100.0 * fit.misfit,
            100.0 * fit.nominal_misfit,
        );
    }
    if fit.misfit > POOR {
        eprintln!(
            "tactus-lab: the readings of the fitted sheet differ from the baseline by {:.0} %: check geometry, electrode order and contacts before it is used",
            100.0 * fit.misfit
        );
    }
    for number in implausible {
        eprintln!("tactus-lab: the contact of electrode {number} is implausible");
    }
    Ok(())
}

/// The baseline and the current of its readings: those of a session if one is given, otherwise of the case.
fn baseline(options: &SheetOptions, case: &Case) -> Result<(Vec<Reading>, Amps), Failure> {
    let readings = case.protocol.len();
    if let Some(path) = &options.session {
        let recording = Recording::from_session(path, options.baseline.as_ref(), false)
            .map_err(|fault| Failure::of("cannot read the session", &fault))?;
        if recording.protocol.len() != readings {
            return Err(Failure::usage(format!(
                "session {} has {} readings, the case {} has {readings}",
                recording.name,
                recording.protocol.len(),
                options.case.display()
            )));
        }
        return Ok((recording.unloaded.readings, recording.current));
    }
    let attempt = "cannot fit a sheet to readings at several currents";
    let current = one_current(&options.case, case, attempt)?;
    let table = TableOptions {
        frames: options.frames.as_deref(),
        baseline: options.baseline.as_ref(),
        negate: false,
    };
    let table = frames(&options.case, &table, readings)?;
    Ok((table.unloaded.readings, current))
}
