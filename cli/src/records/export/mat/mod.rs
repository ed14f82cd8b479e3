//! `tactus export --format mat`: a session as a MAT-file for EIDORS, with a script that loads it.

mod format;

use std::io::Write;
use std::path::Path;

use eit::Mesh;
use imaging::Geometry;
use imaging::recorded::SessionParts;
use logbook::SessionHeader;
use outfile::OutFile;
use survey::{Amps, Dipole, Protocol};

use super::{Written, seconds, volts};
use crate::args::Export;
use crate::failure::Failure;
use crate::output::time::utc;
use crate::output::{Printer, complain};
use crate::records::case_folder;
use format::{MOST_BYTES, Value};

/// The frames of a session, in memory.
#[derive(Default)]
struct Frames {
    sequences: Vec<f64>,
    times: Vec<f64>,
    /// The voltages of one frame after the other.
    voltages: Vec<f64>,
    damaged: usize,
}

/// Writes the file and, next to it, the script, and reports their paths.
pub(super) fn write(
    session: &SessionParts,
    export: &Export,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let header = session.header();
    let existing = export.replacing.existing();
    let script = export.out.with_extension("m");
    let has_script = !outfile::is_stream(&export.out);
    if has_script {
        if export.out.extension().is_some_and(|ending| ending == "m") {
            return Err(Failure::Usage(format!(
                "{}: the extension .m is that of the script next to the file; name a file that ends in .mat",
                export.out.display()
            )));
        }
        outfile::check(&script, existing)?;
    }
    let first = super::first_frame(session)?;
    check_size(session)?;
    let geometry = match case_folder::mesh_of(header, &export.asked.geometry) {
        Ok(geometry) => Some(geometry),
        Err(why) => {
            complain(&format!(
                "tactus: {} is without fmdl, and has no script: {why}",
                export.out.display()
            ));
            None
        }
    };
    let mut file = OutFile::create(&export.out, existing)?;
    file.put(&format::head(&format!(
        "MATLAB 5.0 MAT-file, written by tactus from session {}",
        header.session()
    )))?;
    let frames = read(session, printer)?;
    let stimulations = stimulations(&header.protocol, first.frame.settings.current);
    let count = frames.times.len();
    let mut variables = vec![
        ("session", about(header)),
        (
            "vv",
            Value::Numbers {
                rows: header.protocol.len(),
                columns: count,
                values: frames.voltages,
            },
        ),
        ("times", Value::row(frames.times)),
        ("sequence", Value::row(frames.sequences)),
    ];
    if let Some(baseline) = session.baseline()? {
        let voltages = baseline.readings.iter().map(volts).collect();
        variables.push(("v_homogeneous", Value::column(voltages)));
    }
    if let Some(geometry) = &geometry {
        if geometry.mesh.depth().is_some() {
            complain(
                "tactus: fmdl is the cross-section alone: EIDORS has no model of a tank's depth on a mesh of triangles",
            );
        }
        variables.push(("fmdl", forward_model(geometry, &stimulations)));
        variables.push(("conductance", Value::column(geometry.sigma0.clone())));
    }
    variables.push(("stim", stimulations));
    for (name, value) in variables {
        let written = format::variable(name, &value)
            .map_err(|error| Failure::failed(&format!("{name} cannot be written"), &error))?;
        file.put(&written.ok_or_else(|| too_large(header))?)?;
    }
    let path = file.finish()?;
    Written::table("mat", &path, count, header).report(printer)?;
    if has_script && geometry.is_some() {
        outfile::write(&script, existing, script_text(&path, header).as_bytes())?;
        Written::table("script", &script, count, header).report(printer)?;
    }
    super::check_undamaged(frames.damaged, header)
}

fn read(session: &SessionParts, printer: &Printer<impl Write>) -> Result<Frames, Failure> {
    let mut frames = Frames::default();
    frames.damaged = super::each_frame(session, printer.is_terminal(), |record| {
        frames.sequences.push(record.frame.sequence as f64);
        frames.times.push(seconds(&record));
        let readings = record.frame.readings.iter();
        frames.voltages.extend(readings.map(volts));
        Ok(())
    })?;
    Ok(frames)
}

/// Refuses a session that is too large for the format before its frames are read, which may take hours.
fn check_size(session: &SessionParts) -> Result<(), Failure> {
    let header = session.header();
    let bytes = 8 * header.protocol.len() as u64 * session.len()?;
    match bytes > MOST_BYTES {
        true => Err(too_large(header)),
        false => Ok(()),
    }
}

fn too_large(header: &SessionHeader) -> Failure {
    Failure::Failed(format!(
        "session {} has more voltages than a variable of a MAT-file holds ({} frames of {} readings); MATLAB reads \
         --format nc of any length by ncread",
        header.id,
        MOST_BYTES / (8 * header.protocol.len().max(1) as u64),
        header.protocol.len(),
    ))
}

/// A structure with the origin of the data.
fn about(header: &SessionHeader) -> Value {
    Value::structure(vec![
        ("id", Value::text(header.session())),
        ("started", Value::text(&utc(header.started))),
        (
            "simulated",
            Value::number(f64::from(u8::from(header.simulated))),
        ),
        ("note", Value::text(&header.note)),
        ("build", Value::text(&header.build)),
        ("protocol_hash", Value::text(&header.protocol.hash())),
    ])
}

/// The stimulations in the form of EIDORS' `mk_stim_patterns`: one for each injection, in the order of the readings.
fn stimulations(protocol: &Protocol, current: Amps) -> Value {
    let electrodes = protocol.electrodes();
    let both = |dipole: Dipole| [(dipole.plus, 1.0), (dipole.minus, -1.0)];
    let injections = protocol
        .measurements()
        .chunk_by(|one, next| one.drive == next.drive);
    let elements = injections.map(|readings| {
        let injected = both(readings[0].drive);
        let measured = readings.iter().enumerate().flat_map(|(row, one)| {
            both(one.sense).map(|(electrode, sign)| (row, electrode.0, sign))
        });
        vec![
            Value::text("Amp"),
            Value::Sparse {
                rows: electrodes,
                columns: 1,
                entries: injected
                    .map(|(electrode, sign)| (electrode.0, 0, sign * current.0))
                    .to_vec(),
            },
            Value::Sparse {
                rows: readings.len(),
                columns: electrodes,
                entries: measured.collect(),
            },
        ]
    });
    Value::Structs {
        fields: vec!["stimulation", "stim_pattern", "meas_pattern"],
        elements: elements.collect(),
    }
}

/// EIDORS' forward model; nodes and triangles count from 1.
fn forward_model(geometry: &Geometry, stimulations: &Value) -> Value {
    let mesh: &Mesh = &geometry.mesh;
    let electrodes = mesh
        .electrode_edges()
        .iter()
        .zip(&geometry.contact_ohm_m)
        .map(|(edges, &contact)| {
            let mut nodes: Vec<usize> = edges.iter().flatten().copied().collect();
            nodes.sort_unstable();
            nodes.dedup();
            let nodes = nodes.into_iter().map(from_one).collect();
            vec![Value::row(nodes), Value::number(contact)]
        });
    let electrodes = Value::Structs {
        fields: vec!["nodes", "z_contact"],
        elements: electrodes.collect(),
    };
    let default = || Value::text("eidors_default");
    Value::structure(vec![
        ("type", Value::text("fwd_model")),
        ("name", Value::text(&geometry.name)),
        ("nodes", matrix(mesh.nodes(), |position| position)),
        ("elems", matrix(mesh.triangles(), from_one)),
        ("boundary", matrix(&mesh.boundary(), from_one)),
        ("electrode", electrodes),
        ("gnd_node", Value::number(1.0)),
        ("stimulation", stimulations.clone()),
        ("normalize_measurements", Value::number(0.0)),
        ("solve", default()),
        ("jacobian", default()),
        ("system_mat", default()),
    ])
}

fn from_one(index: usize) -> f64 {
    (index + 1) as f64
}

/// A matrix from its rows.
fn matrix<T: Copy, const N: usize>(rows: &[[T; N]], value: impl Fn(T) -> f64) -> Value {
    let columns = (0..N).flat_map(|column| rows.iter().map(move |row| row[column]));
    Value::Numbers {
        rows: rows.len(),
        columns: N,
        values: columns.map(value).collect(),
    }
}

/// The script, which reconstructs the change of the last frame with EIDORS.
fn script_text(path: &Path, header: &SessionHeader) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    format!(
        "\
% The last frame of session {} as a change of conductance, by EIDORS (https://eidors.org; run its startup.m first).
load(fullfile(fileparts(mfilename('fullpath')), '{}'));
if ~exist('v_homogeneous', 'var'), v_homogeneous = vv(:, 1); end  % a session without a baseline: against its first frame
v_loaded = vv(:, end);
missing = isnan(v_homogeneous) | isnan(v_loaded);  % no change where a reading is missing
v_loaded(missing) = 0; v_homogeneous(missing) = 0;
imdl = struct('type', 'inv_model', 'name', session.id, 'fwd_model', fmdl, 'reconst_type', 'difference');
imdl.solve = @inv_solve_diff_GN_one_step; imdl.RtR_prior = @prior_laplace;
imdl.hyperparameter.value = 0.03; imdl.jacobian_bkgnd.value = conductance;
img = inv_solve(imdl, v_homogeneous, v_loaded); show_fem(img);
",
        header.session(),
        name.replace('\'', "''"),
    )
}
