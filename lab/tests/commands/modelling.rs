//! `mesh`, `forward`, `jacobian` and `transfer` by command lines: output and errors.

use std::path::{Path, PathBuf};

use crate::program::{done, lab, numbers, words};

/// A change of a file's lines.
type Change<'a> = &'a dyn Fn(Vec<String>) -> Vec<String>;

struct Tank {
    _folder: tempfile::TempDir,
    root: PathBuf,
}

impl Tank {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().to_owned();
        done(&words(
            "mesh --preset disc-tank --set electrodes=8 --set fineness=0.5 --out {}",
            &[&root.join("tank")],
        ));
        Self {
            _folder: folder,
            root,
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    fn put(&self, name: &str, rows: &[Vec<f64>]) {
        let text = |row: &Vec<f64>| {
            let fields: Vec<String> = row.iter().map(|value| format!("{value:e}")).collect();
            fields.join(",") + "\n"
        };
        std::fs::write(self.path(name), rows.iter().map(text).collect::<String>()).unwrap();
    }

    fn elements(&self) -> usize {
        numbers(&self.path("tank/elems.csv")).len()
    }
}

fn refused(line: &str, paths: &[&Path]) -> String {
    let output = lab(&words(line, paths));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    message
}

/// Gives the last reading of a case another current than that of the others.
fn put_another_current(case: &Path) {
    let protocol = case.join("protocol.csv");
    let text = std::fs::read_to_string(&protocol).unwrap();
    let (but_the_last, _) = text.rsplit_once(',').unwrap();
    std::fs::write(&protocol, format!("{but_the_last},2e-3\n")).unwrap();
}

#[test]
fn a_sheet_is_fitted_to_readings_at_one_current() {
    let tank = Tank::new();
    let [case, volts, fitted] = ["tank", "v.csv", "fitted"].map(|name| tank.path(name));
    let line = "forward --case {} --sigma homog --out {}";
    done(&words(line, &[&case, &volts]));
    put_another_current(&case);
    let line = "sheet --case {} --frames {} --out {}";
    let message = refused(line, &[&case, &volts, &fitted]);
    assert!(message.contains("several currents"), "{message}");
    assert!(!fitted.exists());
}

#[test]
fn drift_is_estimated_of_readings_at_one_current() {
    let tank = Tank::new();
    let [case, volts, maps] = ["tank", "v.csv", "maps.csv"].map(|name| tank.path(name));
    put_another_current(&case);
    let line = "forward --case {} --sigma homog --out {}";
    done(&words(line, &[&case, &volts]));
    let line = "reconstruct --method one-step --noise-v 2e-6 --case {} --frames {} --out {}";
    for (options, says) in [
        (" --tracked --period-s 1", "--tracked is for"),
        (" --drift frame", "--drift frame is for"),
        (" --sd", "--sd is for"),
    ] {
        let message = refused(&format!("{line}{options}"), &[&case, &volts, &maps]);
        assert!(
            message.contains(says) && message.contains("protocol.csv injects different currents"),
            "{options}: {message}"
        );
        assert!(!maps.exists(), "{options}");
    }
    done(&words(line, &[&case, &volts, &maps]));

    let set = tank.path("set");
    let line = "judge --set presses-10 --count 1 --measure fineness=0.4 --out {}";
    done(&words(line, &[&set]));
    put_another_current(&set);
    let mut line = words("evaluate --set {} --method", &[&set]);
    line.push("one-step --drift frame".into());
    let output = lab(&line);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("--drift frame is for"), "{message}");
}

#[test]
fn batch_of_conductances_gives_same_readings_on_any_threads() {
    let tank = Tank::new();
    let elements = tank.elements();
    let rows: Vec<Vec<f64>> = (0..12)
        .map(|k| {
            (0..elements)
                .map(|t| 1e-3 * if t % 12 == k { 0.3 } else { 1.0 })
                .collect()
        })
        .collect();
    tank.put("many.csv", &rows);
    let read = |name: &str| std::fs::read(tank.path(name)).unwrap();
    for threads in ["1", "2", "8"] {
        let line = format!("forward --case {{}} --sigma-rows {{}} --out {{}} --threads {threads}");
        let out = tank.path(&format!("v{threads}.csv"));
        done(&words(
            &line,
            &[&tank.path("tank"), &tank.path("many.csv"), &out],
        ));
    }
    assert_eq!(read("v1.csv"), read("v2.csv"));
    assert_eq!(read("v1.csv"), read("v8.csv"));
    // each row equals the result for that conductance alone
    let many = numbers(&tank.path("v1.csv"));
    assert_eq!((many.len(), many[0].len()), (12, 40));
    for k in [0, 7] {
        let standing: Vec<Vec<f64>> = rows[k].iter().map(|value| vec![*value]).collect();
        tank.put("one.csv", &standing);
        for (plain, most) in [("", 0.0), (" --plain", 1e-12)] {
            let line = format!("forward --force --case {{}} --sigma {{}} --out {{}}{plain}");
            done(&words(
                &line,
                &[
                    &tank.path("tank"),
                    &tank.path("one.csv"),
                    &tank.path("v.csv"),
                ],
            ));
            let one = numbers(&tank.path("v.csv"));
            let size = many[k].iter().fold(0.0_f64, |most, v| most.max(v.abs()));
            for (alone, row) in one.iter().zip(&many[k]) {
                assert!((alone[0] - row).abs() <= most * size);
            }
        }
    }
}

#[test]
fn sensitivities_to_regions_cells_logarithms_and_contacts() {
    let tank = Tank::new();
    let region: Vec<Vec<f64>> = (0..tank.elements())
        .filter(|t| t % 3 == 0)
        .map(|t| vec![t as f64])
        .collect();
    tank.put("tank/roi.csv", &region);
    let table = |options: &str| {
        let line = format!("jacobian --force --case {{}} --sigma homog --out {{}}{options}");
        done(&words(&line, &[&tank.path("tank"), &tank.path("J.csv")]));
        numbers(&tank.path("J.csv"))
    };
    let whole = table("");
    let part = table(" --region");
    assert_eq!(part[5][2], whole[5][6]);
    assert_eq!(part[0].len(), region.len());
    let logarithm = table(" --of ln-sigma");
    assert!((logarithm[3][3] / (1e-3 * whole[3][3]) - 1.0).abs() < 1e-14);
    assert_eq!(table(" --of contact")[0].len(), 8);
    let centres = tank.path("centres.csv");
    let cells = table(&format!(" --cells-mm 40 --centres {}", centres.display()));
    assert_eq!(cells[0].len(), numbers(&centres).len());
    let (sum, all): (f64, f64) = (cells[9].iter().sum(), part[9].iter().sum());
    assert!((sum / all - 1.0).abs() < 1e-12);
    for options in ["--of contact --region", "--cells-mm 0", "--cells-mm nan"] {
        let line = format!("jacobian --force --case {{}} --sigma homog --out {{}} {options}");
        let output = lab(&words(&line, &[&tank.path("tank"), &tank.path("J.csv")]));
        assert_eq!(output.status.code(), Some(2), "{options}");
    }
}

#[test]
fn transfer_matrices_are_inverse_and_read_what_the_model_reads() {
    let tank = Tank::new();
    done(&words(
        "transfer --case {} --sigma homog --admittance {} --impedance {}",
        &[&tank.path("tank"), &tank.path("Y.csv"), &tank.path("Z.csv")],
    ));
    done(&words(
        "forward --force --case {} --sigma homog --out {}",
        &[&tank.path("tank"), &tank.path("v.csv")],
    ));
    let (y, z) = (numbers(&tank.path("Y.csv")), numbers(&tank.path("Z.csv")));
    let readings = numbers(&tank.path("v.csv"));
    let protocol = numbers(&tank.path("tank/protocol.csv"));
    for (measurement, reading) in protocol.iter().zip(&readings) {
        let [_, source, sink, plus, minus, current] = measurement[..] else {
            panic!("six columns");
        };
        let at = |to: f64, from: f64| z[to as usize][from as usize];
        let volts = at(plus, source) - at(plus, sink) - at(minus, source) + at(minus, sink);
        assert!((current * volts - reading[0]).abs() < 1e-13);
    }
    for (row, values) in y.iter().enumerate() {
        assert!(values.iter().sum::<f64>().abs() < 1e-15);
        for (column, impedance) in z.iter().enumerate() {
            // Z is symmetric: its rows are its columns
            let sum: f64 = values.iter().zip(impedance).map(|(y, z)| y * z).sum();
            let wanted = f64::from(u8::from(row == column)) - 0.125;
            assert!((sum - wanted).abs() < 1e-12);
        }
    }
    let neither = lab(&words(
        "transfer --case {} --sigma homog",
        &[&tank.path("tank")],
    ));
    assert_eq!(neither.status.code(), Some(2));
}

#[test]
fn bad_conductances_meshes_and_protocols_are_named() {
    let tank = Tank::new();
    let forward = |sigma: &str| {
        let line = format!("forward --force --case {{}} --sigma {sigma} --out {{}}");
        refused(&line, &[&tank.path("tank"), &tank.path("v.csv")])
    };
    let elements = tank.elements();
    let conductance = |at: usize, value: f64| {
        (0..elements)
            .map(|t| vec![if t == at { value } else { 1e-3 }])
            .collect::<Vec<_>>()
    };
    for (value, word) in [(-1.0, "negative"), (f64::NAN, "not a finite number")] {
        tank.put("bad.csv", &conductance(6, value));
        let message = forward(tank.path("bad.csv").to_str().unwrap());
        assert!(
            message.contains("bad.csv:7") && message.contains(word),
            "{message}"
        );
        let mut rows = vec![vec![1e-3; elements]; 3];
        rows[1][4] = value;
        tank.put("rows.csv", &rows);
        let message = refused(
            "forward --force --case {} --sigma-rows {} --out {}",
            &[
                &tank.path("tank"),
                &tank.path("rows.csv"),
                &tank.path("v.csv"),
            ],
        );
        assert!(
            message.contains("rows.csv:2") && message.contains(word),
            "{message}"
        );
    }
    tank.put("none.csv", &vec![vec![0.0]; elements]);
    let message = forward(tank.path("none.csv").to_str().unwrap());
    assert!(
        message.contains("none.csv") && message.contains("no element conducts"),
        "{message}"
    );
    // a triangle without conductance is a load of 100 %: accepted, with a note
    tank.put("hole.csv", &conductance(6, 0.0));
    let message = done(&words(
        "forward --force --case {} --sigma {} --out {}",
        &[
            &tank.path("tank"),
            &tank.path("hole.csv"),
            &tank.path("v.csv"),
        ],
    ));
    assert!(
        message.contains("hole.csv: 1 triangles") && message.contains("element 6"),
        "{message}"
    );

    let change = |file: &str, change: Change| {
        let path = tank.path("tank").join(file);
        let before = std::fs::read_to_string(&path).unwrap();
        let lines = change(before.lines().map(str::to_owned).collect());
        std::fs::write(&path, lines.join("\n")).unwrap();
        before
    };
    let cases: [(&str, Change, &str); 3] = [
        (
            "elems.csv",
            &|mut lines| {
                let turned: Vec<String> = lines[3].split(',').rev().map(str::to_owned).collect();
                lines[3] = turned.join(",");
                lines
            },
            "elems.csv:4: the mesh is refused: element 2 is inverted",
        ),
        (
            "electrode_edges.csv",
            &|lines| {
                lines
                    .into_iter()
                    .filter(|line| !line.starts_with("5,"))
                    .collect()
            },
            "electrodes.csv:7: the mesh is refused: electrode 6 touches nothing",
        ),
        (
            "protocol.csv",
            &|mut lines| {
                lines[2] = "1,0,1,3,8,1e-3".to_owned();
                lines
            },
            "protocol.csv:3: electrode 8 does not exist",
        ),
    ];
    for (file, fault, wanted) in cases {
        let before = change(file, fault);
        let message = forward("homog");
        assert!(message.contains(wanted), "{message}");
        std::fs::write(tank.path("tank").join(file), before).unwrap();
    }
    // few edges under an electrode: accepted, with a warning that names it
    change("electrode_edges.csv", &|lines| {
        let mut kept = 0;
        lines
            .into_iter()
            .filter(|line| {
                kept += usize::from(line.starts_with("5,"));
                !line.starts_with("5,") || kept <= 3
            })
            .collect()
    });
    let message = done(&words(
        "forward --force --case {} --sigma homog --out {}",
        &[&tank.path("tank"), &tank.path("v.csv")],
    ));
    assert!(
        message.contains("electrode 6 of 8 has fewer than 4 edges"),
        "{message}"
    );
}
