//! MAT-files, read by scipy and Octave.

use std::process::Command;

use super::{BEFORE_VOLTAGES, Cells, bits, python, read, tables};
use crate::scene::{done, session_at_thirds_of_a_second, session_without_baseline};

const EXPORT: [&str; 6] = [
    "export",
    "m2027",
    "--format",
    "mat",
    "--preset",
    "disc-tank",
];

/// The transposed matrix: one row for each of its columns.
fn transposed(values: &[f64], columns: usize) -> Vec<f64> {
    let column = |at| values.iter().skip(at).step_by(columns).copied();
    (0..columns).flat_map(column).collect()
}

#[test]
fn mat_has_the_bits_of_the_tables() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    session_at_thirds_of_a_second(folder.path());
    let (frames, baseline) = tables(folder.path(), "m2027");
    let written = done(
        folder.path(),
        &[&EXPORT[..], &["-o", "out.mat", "--json"]].concat(),
    );
    assert!(written.contains("\"what\":\"script\""), "{written}");
    let read = read(&python, "read_mat.py", &folder.path().join("out.mat"));
    assert_eq!(read["vv"].shape, [208, 3], "a column a frame");
    let voltages = frames.block(BEFORE_VOLTAGES);
    assert_eq!(
        bits(transposed(&read["vv"].numbers(), 3)),
        bits(voltages.clone()),
        "voltages to the bit, NaN where missing"
    );
    assert!(voltages[208 + 7].is_nan());
    assert_eq!(read["v_homogeneous"].shape, [208, 1]);
    assert_eq!(
        read["v_homogeneous"].bits(),
        bits(baseline.numbers("mean_V"))
    );
    assert_eq!(read["sequence"].numbers(), [1.0, 2.0, 3.0]);
    let seconds = [
        1_800_000_001.0,
        1_800_000_002.333_333,
        1_800_000_003.666_666,
    ];
    assert_eq!(read["times"].numbers(), seconds);
    assert_eq!(read["session[0].id"].values, ["m20270115_1"]);
    assert_eq!(read["session[0].note"].values, ["three frames"]);
    assert_eq!(read["session[0].simulated"].numbers(), [1.0]);

    // every reading that the stimulation patterns describe is compared with the baseline table
    let mut readings = 0;
    for at in 0..16 {
        let field = |field: &str| &read[&format!("stim[{at}].{field}")];
        assert_eq!(field("stimulation").values, ["Amp"]);
        let (current, measured) = (field("stim_pattern"), field("meas_pattern"));
        assert_eq!(current.shape, [16, 1]);
        assert_eq!(field("stim_pattern:sparse").values, ["2"]);
        assert_eq!(measured.shape, [13, 16]);
        for row in measured.numbers().chunks(16) {
            let cell = |column: &str| baseline.numbers(column)[readings] as usize;
            let mut injected = [0.0; 16];
            injected[cell("source")] = 1e-3;
            injected[cell("sink")] = -1e-3;
            assert_eq!(current.numbers(), injected, "reading {readings}");
            let mut read = [0.0; 16];
            read[cell("v_plus")] = 1.0;
            read[cell("v_minus")] = -1.0;
            assert_eq!(row, read, "reading {readings}");
            readings += 1;
        }
        let inner = &read[&format!("fmdl[0].stimulation[{at}].meas_pattern")];
        assert_eq!(inner, measured);
    }
    assert_eq!(readings, 208);
    assert!(!read.contains_key("stim[16].stimulation"));
}

#[test]
fn mat_has_the_mesh_of_the_case_folder() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    session_at_thirds_of_a_second(folder.path());
    let tables = ["--preset", "disc-tank", "-o", "out.csv"];
    done(
        folder.path(),
        &[&["export", "m2027", "--format", "csv"][..], &tables].concat(),
    );
    done(
        folder.path(),
        &[&EXPORT[..], &["--out", "out.mat"]].concat(),
    );
    let read = read(&python, "read_mat.py", &folder.path().join("out.mat"));
    let case = |name: &str| Cells::read(&folder.path().join("out.case").join(name));
    let nodes = case("nodes.csv");
    assert_eq!(read["fmdl[0].nodes"].shape, [nodes.rows.len(), 2]);
    assert_eq!(read["fmdl[0].nodes"].bits(), bits(nodes.block(0)));
    let elements = case("elems.csv").block(0);
    let from_zero = |name: &str| -> Vec<f64> {
        let numbers = read[name].numbers();
        numbers.into_iter().map(|number| number - 1.0).collect()
    };
    assert_eq!(from_zero("fmdl[0].elems"), elements);
    // a side that belongs to one triangle only is part of the boundary
    let mut sides = std::collections::BTreeMap::new();
    for corner in elements.chunks(3) {
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            let [a, b] = [corner[a] as usize, corner[b] as usize];
            *sides.entry((a.min(b), a.max(b))).or_insert(0) += 1;
        }
    }
    let single = sides.iter().filter(|(_, count)| **count == 1);
    let single: Vec<_> = single.map(|(side, _)| *side).collect();
    let mut boundary: Vec<_> = from_zero("fmdl[0].boundary")
        .chunks(2)
        .map(|side| (side[0] as usize, side[1] as usize))
        .map(|(a, b)| (a.min(b), a.max(b)))
        .collect();
    boundary.sort_unstable();
    assert_eq!(boundary, single);
    let (edges, contacts) = (case("electrode_edges.csv"), case("electrodes.csv"));
    let ends = edges.block(0);
    for electrode in 0..16 {
        let of = ends.chunks(3).filter(|edge| edge[0] == electrode as f64);
        let mut nodes: Vec<usize> = of
            .flat_map(|edge| [edge[1] as usize, edge[2] as usize])
            .collect();
        nodes.sort_unstable();
        nodes.dedup();
        let found = from_zero(&format!("fmdl[0].electrode[{electrode}].nodes"));
        let found: Vec<usize> = found.into_iter().map(|node| node as usize).collect();
        assert_eq!(found, nodes);
        let contact = read[&format!("fmdl[0].electrode[{electrode}].z_contact")].bits();
        let wanted = contacts.numbers("z_contact_ohm_m")[electrode];
        assert_eq!(contact, bits([wanted]));
    }
    assert_eq!(read["fmdl[0].type"].values, ["fwd_model"]);
    assert_eq!(read["fmdl[0].gnd_node"].numbers(), [1.0]);
    assert_eq!(read["conductance"].shape, [elements.len() / 3, 1]);
}

/// Runs the script with substitutes for the functions of EIDORS, which print their arguments.
#[test]
fn octave_loads_the_file_and_runs_the_script() {
    if !needs::program("OCTAVE", "octave") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    session_at_thirds_of_a_second(folder.path());
    let (frames, _) = tables(folder.path(), "m2027");
    done(
        folder.path(),
        &[&EXPORT[..], &["--out", "out.mat"]].concat(),
    );
    let given = "function img = inv_solve(imdl, before, after)\n\
                 printf('%s %d %d\\n', imdl.fwd_model.type, columns(imdl.fwd_model.elems), numel(imdl.fwd_model.electrode));\n\
                 printf('%.17g ', after); printf('\\n'); printf('%d\\n', any(isnan(before)));\n\
                 stim = imdl.fwd_model.stimulation(16);\n\
                 printf('%d %d %d\\n', numel(imdl.fwd_model.stimulation), size(stim.meas_pattern));\n\
                 img = numel(imdl.jacobian_bkgnd.value) == rows(imdl.fwd_model.elems);\nend\n";
    std::fs::write(folder.path().join("inv_solve.m"), given).unwrap();
    let shown = "function show_fem(img)\nprintf('%d\\n', img);\nend\n";
    std::fs::write(folder.path().join("show_fem.m"), shown).unwrap();
    let octave = ["--no-gui", "--norc", "--quiet", "--eval", "out"];
    let printed = needs::run(
        Command::new("octave")
            .args(octave)
            .current_dir(folder.path()),
    );
    let printed = printed.unwrap();
    let lines: Vec<&str> = printed.lines().collect();
    assert_eq!(lines[0], "fwd_model 3 16", "{printed}");
    let last: Vec<f64> = lines[1]
        .split_whitespace()
        .map(|n| n.parse().unwrap())
        .collect();
    assert_eq!(
        bits(last),
        bits(frames.block(BEFORE_VOLTAGES)[2 * 208..].to_vec())
    );
    assert_eq!(lines[2..], ["0", "16 13 16", "1"], "{printed}");
}

/// Uses the functions of EIDORS itself: `EIDORS_PATH` is its folder with `startup.m`.
#[test]
fn eidors_solves_the_model_and_runs_the_script() {
    if !needs::program("OCTAVE", "octave") {
        return;
    }
    let Some(eidors) = std::env::var_os("EIDORS_PATH") else {
        needs::lacking("EIDORS", "EIDORS_PATH does not name the folder of EIDORS");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    session_at_thirds_of_a_second(folder.path());
    let table = [
        "export",
        "m2027",
        "--format",
        "csv",
        "--preset",
        "disc-tank",
    ];
    done(folder.path(), &[&table[..], &["-o", "out.csv"]].concat());
    done(folder.path(), &[&EXPORT[..], &["-o", "out.mat"]].concat());
    let case = eit::Case::read(&folder.path().join("out.case")).unwrap();

    let shown = "function show_fem(img)\nprintf('map %d %d\\n', numel(img.elem_data), any(isnan(img.elem_data)));\nend\n";
    std::fs::write(folder.path().join("show_fem.m"), shown).unwrap();
    let script = "warning('off', 'all'); here = pwd; run(fullfile(getenv('EIDORS_PATH'), 'startup.m')); cd(here); load('out.mat'); \
        v = fwd_solve(mk_image(fmdl, conductance)); printf('readings '); printf('%.17g ', v.meas); printf('\\nconductance '); printf('%.17g ', conductance); printf('\\n'); out";
    let printed = needs::run(
        Command::new("octave")
            .args(["--no-gui", "--norc", "--quiet", "--eval", script])
            .env("EIDORS_PATH", eidors)
            .current_dir(folder.path()),
    );
    let printed = printed.unwrap();
    let after = |word: &str| -> Vec<f64> {
        let line = printed.lines().find_map(|line| line.strip_prefix(word));
        let numbers = line
            .unwrap_or_else(|| panic!("{printed}"))
            .split_whitespace();
        numbers.map(|number| number.parse().unwrap()).collect()
    };
    let solved = after("readings ");
    let forward = eit::Forward::new(case.mesh.clone(), &case.contact_ohm_m).unwrap();
    let ohms = forward.readings(&after("conductance "), &case.protocol);
    let ohms = ohms.unwrap();
    assert_eq!(solved.len(), ohms.len());
    let volts = ohms
        .iter()
        .zip(&case.currents)
        .map(|(ohms, amps)| ohms * amps);
    let largest = solved.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    for (ours, theirs) in volts.zip(&solved) {
        assert!((ours - theirs).abs() < 1e-9 * largest, "{ours} {theirs}");
    }
    assert_eq!(after("map "), [case.mesh.triangles().len() as f64, 0.0]);
}

#[test]
fn mat_without_geometry_or_baseline_has_the_rest() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    session_without_baseline(folder.path());
    let export = ["export", "bare", "--format", "mat", "--out", "out.mat"];
    done(folder.path(), &export);
    assert!(!folder.path().join("out.m").exists());
    let read = read(&python, "read_mat.py", &folder.path().join("out.mat"));
    assert_eq!(read["vv"].shape, [208, 3]);
    assert!(read.contains_key("stim[0].stimulation"));
    for name in ["v_homogeneous", "fmdl[0].nodes", "conductance"] {
        assert!(!read.contains_key(name), "{name}");
    }
}
