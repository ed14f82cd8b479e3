//! The case folder written by `export`: mesh, protocol, frames, baseline and provenance. `tactus replay` and
//! `tactus-lab reconstruct` can open it unchanged.

use std::path::Path;

use eit::Case;
use imaging::Geometry;
use imaging::noise::rms_deviation;
use imaging::recorded::{BASELINE, Origin, PROVENANCE, Provenance};
use logbook::SessionHeader;
use outfile::Existing;
use survey::{Amps, Baseline, Protocol, Reading};

use crate::failure::Failure;
use crate::maps::reconstruction::choose_geometry;
use crate::options::choices::GeometryChoice;
use crate::output::complain;
use crate::output::time::utc;

/// Heading of a table that contains only voltages.
pub(crate) fn heading(protocol: &Protocol) -> String {
    let heading: Vec<String> = (0..protocol.len())
        .map(|reading| format!("m{reading}"))
        .collect();
    format!("frame,{}\n", heading.join(","))
}

/// A line of such a table.
pub(crate) fn row(label: &str, readings: &[Reading]) -> String {
    let mut row = label.to_owned();
    for reading in readings {
        row.push(',');
        row.push_str(&cell(*reading));
    }
    row.push('\n');
    row
}

/// The voltage, with enough digits to be read back exactly; empty for a missing reading.
pub(crate) fn cell(reading: Reading) -> String {
    reading
        .volts()
        .map(|volts| volts.0.to_string())
        .unwrap_or_default()
}

/// Writes the folder without the frames.
///
/// # Errors
/// A file cannot be written. An invalid geometry is reported and omitted.
pub(crate) fn write(
    folder: &Path,
    header: &SessionHeader,
    current: Option<Amps>,
    baseline: Option<&Baseline>,
    geometry: &GeometryChoice,
    existing: Existing,
) -> Result<(), Failure> {
    let put =
        |name: &str, text: String| outfile::write(&folder.join(name), existing, text.as_bytes());
    let current = current
        .or(baseline.map(|baseline| baseline.settings.current))
        .unwrap_or(Amps(1.0));
    let currents = vec![current.0; header.protocol.len()];
    match mesh_of(header, geometry) {
        Ok(geometry) => case(&geometry, &header.protocol, currents)
            .write(folder, existing)
            .map_err(|error| Failure::failed("the case folder cannot be written", &error))?,
        Err(why) => {
            complain(&format!(
                "tactus: {} is without a mesh: {why}",
                folder.display()
            ));
            put(
                "protocol.csv",
                eit::protocol_text(&header.protocol, &currents),
            )?;
            Case::remove_mesh(folder, existing)
                .map_err(|error| Failure::failed("the case folder cannot be written", &error))?;
        }
    }
    match baseline {
        Some(baseline) => {
            let table = heading(&header.protocol) + &row("baseline", &baseline.readings);
            put(BASELINE, table)?;
        }
        // the baseline of an earlier export would be taken for that of these frames
        None => outfile::remove(&folder.join(BASELINE), existing)?,
    }
    let provenance = provenance(header, baseline)
        .text()
        .map_err(|error| Failure::failed("the provenance cannot be written", &error))?;
    put(PROVENANCE, provenance)?;
    Ok(())
}

/// The geometry given by options, otherwise the session's.
pub(crate) fn mesh_of(
    header: &SessionHeader,
    requested: &GeometryChoice,
) -> Result<Geometry, String> {
    let named = requested.preset.is_some() || requested.case.is_some();
    if header.config_toml.is_empty() && !named {
        return Err(format!(
            "session {} has no stored configuration; give --preset paper-sheet or disc-tank, or --case DIR with a mesh",
            header.id
        ));
    }
    let origin = Origin::Session(Box::new(header.clone()));
    choose_geometry(requested, &origin, &header.protocol)
        .map(|(geometry, _)| geometry)
        .map_err(|failure| failure.to_string())
}

/// The case without a stated conductance: that of a preset is an assumption, and without `homog`, readers of the case
/// fit one to the baseline.
fn case(geometry: &Geometry, protocol: &Protocol, currents: Vec<f64>) -> Case {
    let mut case = geometry.case_of(protocol.clone(), currents);
    let uniform = geometry.sigma0.windows(2).all(|pair| pair[0] == pair[1]);
    if !geometry.from_case || uniform {
        case.sigma.clear();
    }
    case
}

fn provenance(header: &SessionHeader, baseline: Option<&Baseline>) -> Provenance {
    Provenance {
        session: header.session().to_owned(),
        started: utc(header.started),
        simulated: header.simulated,
        build: header.build.clone(),
        baseline: baseline.map(|baseline| baseline.id.clone()),
        baseline_frames: baseline.map(|baseline| baseline.frames),
        noise_v: baseline.and_then(rms_deviation),
        geometry_hash: header.geometry_hash.clone(),
        config_hash: header.config_hash.clone(),
        note: header.note.clone(),
        instruments: header
            .instruments
            .iter()
            .map(|instrument| {
                let instrument = instrument.clone();
                [instrument.role, instrument.identity, instrument.address]
            })
            .collect(),
        about: header
            .about
            .entries()
            .map(|(name, words)| (name.to_owned(), words.to_owned()))
            .collect(),
    }
}
