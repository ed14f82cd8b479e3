//! The messages of a frame are replayed to instruments after power on, whose replies are the same; if one reply is
//! altered, the first difference is named.

use crate::test_rig::{self, Needs, baseline};

#[test]
fn replayed_transcript_names_an_altered_reply() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let _guard = test_rig::start(&stage);
    baseline(&stage, 2);
    let file = stage.path().join("frame.jsonl").display().to_string();
    let spoken = stage.tactus(&["transcript", "--out", &file]);
    let spoken = spoken.and_then(|spoken| spoken.succeeded());
    let spoken = spoken.unwrap_or_else(|fault| panic!("{fault}"));
    assert!(
        spoken.stdout.contains("tactus-sim replay"),
        "{}",
        spoken.stdout
    );
    let again = stage
        .tactus(&["transcript", "--out", &file])
        .expect("it runs");
    assert_eq!(again.code, Some(1), "nobody's file is overwritten");

    let profile = stage.path().join("profile.toml").display().to_string();
    let scene = stage.path().join("scene.toml").display().to_string();
    let play = |file: &str| {
        let args = ["replay", file, "--profile", &profile, "--scene", &scene];
        stage.run("tactus-sim", &args).expect("it runs")
    };
    let played = play(&file);
    assert_eq!(played.code, Some(0), "{}{}", played.stdout, played.stderr);
    assert!(played.stdout.contains("as recorded"), "{}", played.stdout);
    println!("{}", played.stdout.trim_end());

    let text = std::fs::read_to_string(&file).expect("it was written");
    // change one reply in the middle: the level read back from the source
    let altered = text.replacen("1.000000E-03", "1.100000E-03", 1);
    let differs = |(one, other): (&str, &str)| one != other;
    let line = 1 + text
        .lines()
        .zip(altered.lines())
        .position(differs)
        .expect("the source answered 1 mA");
    let false_file = stage.path().join("altered.jsonl").display().to_string();
    std::fs::write(&false_file, altered).expect("the folder is there");
    let played = play(&false_file);
    assert_eq!(played.code, Some(1), "{}{}", played.stdout, played.stderr);
    let named = format!("altered.jsonl:{line}:");
    assert!(
        played.stderr.contains(&named) && played.stderr.contains("6221"),
        "{}",
        played.stderr
    );
    println!("{}", played.stderr.trim_end());
}
