//! Calibration from relative loss to kPa: fitted to presses of known mass, tested on others.

use std::path::Path;
use std::process::{Command, Output};

fn lab(words: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tactus-lab"))
        .args(words)
        .current_dir(folder)
        .output()
        .unwrap()
}

fn done(output: Output) -> String {
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn known_masses_come_back_in_newtons() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    done(lab(
        &["judge", "--set", "masses", "--seed", "3", "--out", "known"],
        at,
    ));
    let method = "one-step --loss-only";
    let fitted = done(lab(
        &[
            "calibrate",
            "--case",
            "known",
            "--method",
            method,
            "--noise-v",
            "2e-6",
            "--out",
            "sheet.toml",
            "--json",
        ],
        at,
    ));
    println!("{fitted}");
    // other positions, another seed
    done(lab(
        &[
            "judge", "--set", "masses", "--seed", "9", "--count", "12", "--out", "judged",
        ],
        at,
    ));
    let frames = [
        "reconstruct",
        "--case",
        "judged",
        "--frames",
        "judged/frames.csv",
        "--method",
        "one-step",
    ];
    let with = [
        "--loss-only",
        "--noise-v",
        "2e-6",
        "--calibration",
        "sheet.toml",
        "--json",
        "--out",
        "kpa.csv",
    ];
    let message = done(lab(&[&frames[..], &with[..]].concat(), at));
    let found: Vec<f64> = message
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap())
        .map(|frame| {
            assert_eq!(frame["unit"], "kPa");
            frame["newtons"].as_f64().unwrap()
        })
        .collect();
    let presses = std::fs::read_to_string(at.join("judged/presses.csv")).unwrap();
    let masses: Vec<f64> = presses
        .lines()
        .skip(1)
        .map(|line| line.rsplit(',').next().unwrap().parse().unwrap())
        .collect();
    assert_eq!(found.len(), masses.len() + 1);
    assert!(found[0] < 1.0, "nothing on the sheet: {} N", found[0]);
    let off: Vec<f64> = found[1..]
        .iter()
        .zip(&masses)
        .map(|(n, kg)| n / (9.80665 * kg) - 1.0)
        .collect();
    let rms = (off.iter().map(|x| x * x).sum::<f64>() / off.len() as f64).sqrt();
    println!(
        "force on presses that the fit has not seen: rms {:.1} %, {off:.2?}",
        100.0 * rms
    );
    assert!(rms < 0.2, "{off:?}");
    // the same maps without a calibration have no pressure
    let bare = done(lab(
        &[
            &frames[..],
            &[
                "--loss-only",
                "--noise-v",
                "2e-6",
                "--json",
                "--out",
                "maps.csv",
            ][..],
        ]
        .concat(),
        at,
    ));
    assert!(!bare.contains("kPa") && bare.contains("relative loss of conductance"));
    // maps of another method are refused
    let foreign = lab(
        &[
            &frames[..],
            &[
                "--noise-v",
                "2e-6",
                "--calibration",
                "sheet.toml",
                "--out",
                "x.csv",
            ][..],
        ]
        .concat(),
        at,
    );
    assert!(!foreign.status.success());
    let why = String::from_utf8_lossy(&foreign.stderr).into_owned();
    assert!(why.contains("loss"), "{why}");
}

/// Relative force errors of presses that were not used for the fit, on an unevenly sprayed sheet.
fn on_an_uneven_sheet(at: &Path, fitted: bool) -> Vec<f64> {
    let run = |words: &str| {
        let method = ["--method", "one-step --loss-only"];
        let words: Vec<&str> = words
            .split(' ')
            .flat_map(|word| {
                if word == "METHOD" {
                    method.to_vec()
                } else {
                    vec![word]
                }
            })
            .collect();
        done(lab(&words, at))
    };
    let case = if fitted { "fitted" } else { "known" };
    run("judge --set masses --seed 3 --spray 0.1 --spray-seed 5 --force --out known");
    run("judge --set masses --seed 9 --count 12 --spray 0.1 --spray-seed 5 --force --out judged");
    if fitted {
        let line = run("sheet --case known --json --force --out fitted");
        let line: serde_json::Value = serde_json::from_str(&line).unwrap();
        let unevenness = line["unevenness"].as_f64().unwrap();
        assert!((0.05..0.15).contains(&unevenness), "{line}");
        assert!(line["misfit"].as_f64() < Some(0.01), "{line}");
        assert!(line["nominal_misfit"].as_f64() > Some(0.05), "{line}");
    }
    run(&format!(
        "calibrate --case {case} --frames known/frames.csv --presses known/presses.csv METHOD --noise-v 2e-6 --force --out sheet.toml"
    ));
    let found = run(&format!(
        "reconstruct --case {case} --frames judged/frames.csv --method one-step --loss-only --noise-v 2e-6 --calibration sheet.toml \
         --json --force --out kpa.csv"
    ));
    let newtons = found.lines().skip(1).map(|line| {
        let frame: serde_json::Value = serde_json::from_str(line).unwrap();
        frame["newtons"].as_f64().unwrap()
    });
    let presses = std::fs::read_to_string(at.join("judged/presses.csv")).unwrap();
    let masses = presses.lines().skip(1).map(|line| {
        let mass: f64 = line.rsplit(',').next().unwrap().parse().unwrap();
        9.80665 * mass
    });
    newtons
        .zip(masses)
        .map(|(found, force)| found / force - 1.0)
        .collect()
}

#[test]
fn masses_on_an_uneven_sheet_need_the_fitted_sheet() {
    let folder = tempfile::tempdir().unwrap();
    let rms = |off: &[f64]| (off.iter().map(|x| x * x).sum::<f64>() / off.len() as f64).sqrt();
    let worst = |off: &[f64]| off.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    let off = on_an_uneven_sheet(folder.path(), true);
    println!("fitted sheet: rms {:.3}, {off:.3?}", rms(&off));
    assert_eq!(off.len(), 12);
    assert!(rms(&off) < 0.08 && worst(&off) < 0.2, "{off:.3?}");
    // without the fit of the sheet, the errors exceed these limits
    let off = on_an_uneven_sheet(folder.path(), false);
    println!("nominal sheet: rms {:.3}, {off:.3?}", rms(&off));
    assert!(rms(&off) > 0.08 && worst(&off) > 0.2, "{off:.3?}");
}

#[test]
fn sets_of_one_spray_seed_have_one_sheet() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let baseline = |seed: &str, spray_seed: &str| {
        let words = format!(
            "judge --set masses --count 1 --noise-v 0 --spray 0.1 --seed {seed} --spray-seed {spray_seed} --force --out set"
        );
        done(lab(&words.split(' ').collect::<Vec<_>>(), at));
        let read = |name: &str| std::fs::read_to_string(at.join("set").join(name)).unwrap();
        // without the header line
        let frames = read("frames.csv");
        (
            frames.lines().nth(1).unwrap().to_owned(),
            read("presses.csv"),
        )
    };
    let (sheet, presses) = baseline("3", "5");
    let (same, others) = baseline("9", "5");
    assert_eq!(sheet, same);
    assert_ne!(presses, others, "the presses are others");
    assert_ne!(sheet, baseline("3", "6").0);
}

#[test]
fn presses_without_information_are_refused_by_line() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    done(lab(
        &["judge", "--set", "masses", "--count", "6", "--out", "known"],
        at,
    ));
    let path = at.join("known/presses.csv");
    let whole = std::fs::read_to_string(&path).unwrap();
    let tried = |text: String| {
        std::fs::write(&path, text).unwrap();
        let refused = lab(
            &[
                "calibrate",
                "--case",
                "known",
                "--noise-v",
                "2e-6",
                "--out",
                "sheet.toml",
            ],
            at,
        );
        assert!(!refused.status.success());
        String::from_utf8(refused.stderr).unwrap()
    };
    let few: String = whole
        .lines()
        .take(4)
        .map(|line| format!("{line}\n"))
        .collect();
    assert!(tried(few).contains("3 presses are too few"));
    let spoiled = whole.replacen("\n3,", "\nthree,", 1);
    let message = tried(spoiled);
    assert!(
        message.contains("presses.csv:3") && message.contains("frame"),
        "{message}"
    );
    let message = tried(whole.replacen("mass_kg", "mass", 1));
    assert!(message.contains("mass_kg"), "{message}");
    let message = tried(whole.replacen("\n3,", "\n99,", 1));
    assert!(message.contains("frame 99"), "{message}");
    // every second mass in grams instead of kilograms: the error names the worst line with both forces
    let contradictory: String = whole
        .lines()
        .enumerate()
        .map(|(k, line)| match line.rsplit_once(',') {
            Some((before, kg)) if k > 0 && k % 2 == 0 => {
                format!("{before},{}\n", 1e3 * kg.parse::<f64>().unwrap())
            }
            _ => format!("{line}\n"),
        })
        .collect();
    let message = tried(contradictory);
    for word in [
        "contradict each other",
        "the worst is 'line ",
        "N by its mass",
    ] {
        assert!(message.contains(word), "{message}");
    }
    let alike: String = whole
        .lines()
        .enumerate()
        .map(|(k, line)| {
            let mut fields: Vec<&str> = line.split(',').collect();
            if k > 0 {
                (fields[3], fields[5]) = ("0.03", "1");
            }
            format!("{}\n", fields.join(","))
        })
        .collect();
    let message = tried(alike);
    assert!(message.contains("1 different pressures"), "{message}");
    assert!(
        !at.join("sheet.toml").exists(),
        "no file where there is no calibration"
    );
}
