//! A method gives the same maps in the daemon, in `tactus replay` and in `tactus-lab reconstruct`.

use std::fmt::Write;
use std::path::Path;

use crate::test_rig::{self, Needs, ask, baseline, measure};

fn lab(line: &str) {
    let words = format!("tactus-lab {line}");
    let ended = lab::run(words.split_whitespace().map(Into::into));
    assert_eq!(ended, std::process::ExitCode::SUCCESS, "{line}");
}

fn numbers(path: &Path) -> Vec<Vec<f64>> {
    let table = eit::Table::read(path).expect("maps are written");
    let number = |value: Option<f64>| value.expect("a number");
    table
        .rows
        .into_iter()
        .map(|row| row.into_iter().map(number).collect())
        .collect()
}

#[test]
fn replay_and_reconstruct_answer_alike_for_one_frame() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::QUIET) else {
        return;
    };
    let at = |name: &str| stage.path().join(name).display().to_string();
    let (case, frames) = (at("tank"), at("frames.csv"));
    lab(&format!(
        "mesh --preset disc-tank --set electrodes=8 --set fineness=0.5 --out {case}"
    ));
    let mesh = eit::Case::read(Path::new(&case)).expect("a case").mesh;
    // unloaded, and with a press
    let mut sigma = String::new();
    for loss in [0.0, 0.5] {
        let row: Vec<String> = (0..mesh.triangles().len())
            .map(|triangle| {
                let [x, y] = mesh.centroid(triangle);
                let under = (x - 0.05).hypot(y - 0.02) < 0.03;
                (1e-3 * if under { 1.0 - loss } else { 1.0 }).to_string()
            })
            .collect();
        writeln!(sigma, "{}", row.join(",")).expect("a string");
    }
    std::fs::write(at("sigma.csv"), sigma).expect("the folder can be written");
    lab(&format!(
        "forward --case {case} --sigma-rows {} --out {frames}",
        at("sigma.csv")
    ));
    for options in [
        "",
        "--noise-v 2e-6",
        "--loss-only",
        "--method one-step",
        "--method one-step --noise-v 2e-6 --prior gaussian:15",
        "--method one-step --choose l-curve",
        "--method one-step --choose noise-figure:1.5 --map-error 1e-3",
        "--method one-step --lambda 0.01",
        "--method tv --gap 1e-4",
        "--method tv --noise-v 2e-6 --loss-only",
        "--method tv --lambda 1e-6",
        "--method tv-paper",
        "--method one-step --noise-v 2e-6 --tracked --period-s 600",
    ] {
        let [offline, again] = ["reconstructed.csv", "replayed.csv"].map(at);
        lab(&format!(
            "reconstruct --force --case {case} --frames {frames} --baseline first:1 {options} --out {offline}"
        ));
        let mut words = vec!["replay", &case, "--frames", &frames, "--no-map", "--force"];
        words.extend(["--baseline", "first:1", "--out", &again]);
        words.extend(options.split_whitespace());
        ask(&stage, &words);
        let [offline, again] = [offline, again].map(|path| numbers(Path::new(&path)));
        assert!(
            offline[1].iter().any(|value| *value < -0.05),
            "'{options}' finds the press"
        );
        assert!(offline == again, "'{options}'");
    }
}

#[test]
fn an_exported_case_opens_as_it_is() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let _daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    let id = measure(&stage, 2);
    let at = |name: &str| stage.path().join(name).display().to_string();
    let [table, case] = ["out.csv", "out.case"].map(at);
    ask(&stage, &["export", &id, "--format", "csv", "--out", &table]);
    let [offline, again] = ["offline.csv", "again.csv"].map(at);
    lab(&format!("reconstruct --case {case} --out {offline}"));
    let lines = ask(&stage, &["replay", &case, "--no-map", "--out", &again]);
    assert_eq!(lines.len(), 2);
    for (line, frame) in lines.iter().zip(1..) {
        assert_eq!(line["frame"], frame, "the session's own number");
        assert_eq!(line["simulated"], true, "the folder says it");
        assert!(line["noise"].is_number(), "the baseline's noise: {line}");
    }
    let [offline, again] = [offline, again].map(|path| numbers(Path::new(&path)));
    assert_eq!(offline.len(), 2);
    assert!(offline == again, "the maps are equal");
    let beside = |name: &str| std::fs::read_to_string(at(name)).expect("written beside the maps");
    for name in ["offline", "again"] {
        let frames = beside(&format!("{name}.frames.csv"));
        assert!(
            frames.starts_with("frame,label,time_utc,found_x_m"),
            "{frames}"
        );
        let triangles = beside(&format!("{name}.triangles.csv"));
        assert_eq!(triangles.lines().count(), 1 + offline[0].len());
    }
    assert!(beside("again.csv").starts_with("frame,e"));
}

#[test]
fn best_decides_for_each_frame_in_daemon_and_replay_alike() {
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        let method = "method = \"one-step\"\nnoise_uv = 2.0\n";
        assert!(config.contains(method), "{config}");
        config.replace(
            method,
            "method = \"best\"\nchoose = \"evidence\"\nmap_every = 2\n",
        )
    }) else {
        return;
    };
    let _daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    let id = measure(&stage, 9);
    // every second frame has a map, from the first on; in instant time a later map may be missed
    let maps = ask(&stage, &["replay", &id, "--no-map"]);
    assert_eq!(maps.len(), 9);
    let same = |frame: usize| maps[frame - 1]["verified"].as_bool();
    for frame in [2, 4, 6, 8] {
        assert_eq!(same(frame), None, "{}", maps[frame - 1]);
    }
    assert_eq!(same(1), Some(true), "{}", maps[0]);
    let mut made = [3, 5, 7, 9].into_iter().filter_map(same);
    assert!(made.all(|same| same), "{maps:?}");
}
