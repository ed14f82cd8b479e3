//! Recorded presses as a training set (`dataset --recorded`), and trainings that learn nothing. A simulated sheet on a
//! finer mesh replaces a real one.

use std::path::Path;

use crate::program::{done, lab, numbers, words};

const TRAIN: &str = "train linear --force --profile matched --dataset {} --case {} --out {}";

/// Runs the program and expects success; returns standard output.
fn printed(line: &str, paths: &[&Path]) -> String {
    let output = lab(&words(line, paths));
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{message}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn refused(line: &str, paths: &[&Path]) -> String {
    let output = lab(&words(line, paths));
    assert!(!output.status.success(), "{line} was done");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Distances between the positions found in maps and the presses, mm, sorted.
fn errors_mm(case: &Path, presses: &Path, maps: &Path) -> Vec<f64> {
    let mesh = eit::Case::read(case).unwrap().mesh;
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    let maps = numbers(maps);
    let mut errors: Vec<f64> = std::fs::read_to_string(presses)
        .unwrap()
        .lines()
        .skip(1)
        .map(|line| {
            let field = |k: usize| -> f64 { line.split(',').nth(k).unwrap().parse().unwrap() };
            let map = survey::Map::relative(mesh.hash(), maps[field(0) as usize - 1].clone(), "");
            let found = map.found(&centroids, &areas).unwrap();
            1e3 * (found[0] - field(1)).hypot(found[1] - field(2))
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    errors
}

#[test]
fn a_map_learnt_from_recorded_presses_finds_others() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (known, other) = (at("known"), at("other"));
    let judge = "judge --set masses";
    done(&words(
        &format!("{judge} --seed 3 --count 620 --out {{}}"),
        &[&known],
    ));
    done(&words(
        &format!("{judge} --seed 9 --count 24 --out {{}}"),
        &[&other],
    ));
    let (set, model, maps) = (at("set"), at("pressed.safetensors"), at("maps.csv"));
    let line = "dataset --recorded {} --case {} --out {}";
    let made = printed(line, &[&known, &known, &set]);
    assert!(
        made.contains("620 presses") && made.contains("largest reading"),
        "{made}"
    );
    assert!(printed(line, &[&known, &known, &set]).contains("exists already"));
    let trained = printed(TRAIN, &[&set, &known, &model]);
    let line = "reconstruct --case {} --model {} --frames {} --out {}";
    done(&words(
        line,
        &[&known, &model, &other.join("frames.csv"), &maps],
    ));
    let errors = errors_mm(&known, &other.join("presses.csv"), &maps);
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    println!(
        "{trained}\nlocation error of presses not in the set, mm: mean {mean:.2}, {errors:.1?}"
    );
    assert!(mean < 6.0, "{mean}");

    // positions shuffled among the frames: nothing can be learnt
    let mixed = at("mixed");
    std::fs::create_dir(&mixed).unwrap();
    std::fs::copy(known.join("frames.csv"), mixed.join("frames.csv")).unwrap();
    let text = std::fs::read_to_string(known.join("presses.csv")).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let mut shuffled = String::from("frame,x_m,y_m,diameter_m,mass_kg\n");
    for (row, line) in lines.iter().enumerate().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        // the position of a press in a distant row
        let elsewhere: Vec<&str> = lines[1 + (row * 277) % 620].split(',').collect();
        shuffled += &format!(
            "{},{},{},{},{}\n",
            fields[0], elsewhere[1], elsewhere[2], fields[3], fields[5]
        );
    }
    std::fs::write(mixed.join("presses.csv"), shuffled).unwrap();
    let (set, nothing) = (at("mixed-set"), at("nothing.safetensors"));
    done(&words(
        "dataset --recorded {} --case {} --out {}",
        &[&mixed, &known, &set],
    ));
    for kind in ["linear", "rbf"] {
        let train = TRAIN.replace("linear", kind);
        let message = refused(&train, &[&set, &known, &nothing]);
        assert!(
            message.contains("has learnt nothing") && message.contains("empty maps"),
            "{message}"
        );
        assert!(!nothing.exists());
    }
}

#[test]
fn presses_without_a_known_mass_make_a_set() {
    let folder = tempfile::tempdir().unwrap();
    let [judged, set] = ["judged", "set"].map(|name| folder.path().join(name));
    done(&words(
        "judge --set presses-10 --count 3 --measure fineness=0.4 --out {}",
        &[&judged],
    ));
    let table = std::fs::read_to_string(judged.join("presses.csv")).unwrap();
    assert!(
        table.lines().skip(1).all(|line| line.ends_with(",0.5,")),
        "{table}"
    );
    let line = "dataset --yes --recorded {} --case {} --out {}";
    let made = printed(line, &[&judged, &judged, &set]);
    assert!(made.contains("3 presses"), "{made}");
}

/// A folder of recorded presses on a tank of 8 electrodes (40 readings), all frames alike.
fn recording(folder: &Path, presses: &str) {
    std::fs::create_dir_all(folder).unwrap();
    let row = |label: &str| format!("{label}{}\n", ",0.001".repeat(40));
    let header: String = (0..40).map(|k| format!(",m{k}")).collect();
    let frames: String = (1..=4).map(|k| row(&format!("r{k}"))).collect();
    std::fs::write(
        folder.join("frames.csv"),
        format!("frame{header}\n{frames}"),
    )
    .unwrap();
    std::fs::write(folder.join("presses.csv"), presses).unwrap();
}

#[test]
fn recorded_presses_that_cannot_be_used_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let case = at("tank");
    let line = "mesh --preset disc-tank --set radius_mm=100.0 --set electrodes=8 --set fineness=0.5 --out {}";
    done(&words(line, &[&case]));
    let metres = "frame,x_m,y_m,diameter_m\n";
    let millimetres = "frame,x_mm,y_mm,diameter_mm\n";
    for (table, expected) in [
        // mm in columns of m, and the reverse
        (
            format!("{metres}2,20,30,10\n3,-40,10,10\n"),
            vec![
                "presses.csv:2",
                "(20000, 30000) mm",
                "-100.0 to 100.0 mm",
                "name the columns x_mm",
            ],
        ),
        (
            format!("{millimetres}2,0.02,0.03,0.01\n3,-0.04,0.01,0.01\n"),
            vec!["presses.csv:2", "(0.02, 0.03) mm", "name the columns x_m"],
        ),
        // one press outside of the tank, not all
        (
            format!("{metres}2,0.02,0.03,0.01\n3,-0.14,0.01,0.01\n"),
            vec!["presses.csv:3", "(-140, 10) mm", "outside of the sheet"],
        ),
        (
            format!("{metres}2,0.02,0.03,0.01\n3,-0.04,0.01,0.01\n"),
            vec!["2 presses for 40 readings", "38 more", "--yes"],
        ),
        (
            format!("{metres}9,0.02,0.03,0.01\n"),
            vec![
                "presses.csv:2",
                "frame 9",
                "numbered 1 to 4",
                "'r1' to 'r4'",
            ],
        ),
        (
            // a valid label, and a frame number that is not an integer
            format!("{metres}r4,0.02,0.03,0.01\n2.5,0.02,0.03,0.01\n"),
            vec!["presses.csv:3", "frame 2.5 does not exist"],
        ),
        (
            format!("{metres}2,0.02,x,0.01\n"),
            vec!["presses.csv:2", "y_m is 'x'"],
        ),
        (
            format!("{metres}2,0.02,0.03,0\n"),
            vec!["presses.csv:2", "diameter_m is '0'"],
        ),
        (
            "frame,x_m,diameter_m\n".to_owned(),
            vec!["presses.csv:1", "column 'y_m' is missing"],
        ),
        (
            "frame,x_m,y_m,diameter_m,mass_kg\n2,0.02,0.03,0.01,0\n".to_owned(),
            vec!["presses.csv:2", "mass_kg is 0"],
        ),
        (
            // a blank field is an unknown value
            "frame,x_m,y_m,diameter_m,mass_kg\n2,0.02,0.03,0.01,1\n3,-0.04,0.01,0.01,\n".to_owned(),
            vec!["presses.csv:3", "neither mass_kg nor loss"],
        ),
        (
            "frame,x_m,y_m,diameter_m,mass_kg\n2,0.02,0.03,0.01\n".to_owned(),
            vec!["presses.csv:2", "mass_kg is ''"],
        ),
    ] {
        let recorded = at("recorded");
        recording(&recorded, &table);
        let yes = if expected[0].starts_with("2 presses") {
            ""
        } else {
            " --yes"
        };
        let out = at("set");
        let line = format!("dataset --recorded {{}} --case {{}} --out {{}}{yes}");
        let message = refused(&line, &[&recorded, &case, &out]);
        for words in expected {
            assert!(message.contains(words), "{words:?} is not in: {message}");
        }
        assert!(!out.exists(), "{table}");
    }
    // frames without any change
    let recorded = at("alike");
    let places = (0..40).map(|k| format!("{},{},0.03,0.02\n", 1 + k % 4, 0.001 * f64::from(k)));
    recording(
        &recorded,
        &format!("{metres}{}", places.collect::<String>()),
    );
    let set = at("alike-set");
    done(&words(
        "dataset --recorded {} --case {} --out {}",
        &[&recorded, &case, &set],
    ));
    let model = at("model.safetensors");
    let message = refused(TRAIN, &[&set, &case, &model]);
    assert!(message.contains("has learnt nothing"), "{message}");
    assert!(!model.exists());
}
