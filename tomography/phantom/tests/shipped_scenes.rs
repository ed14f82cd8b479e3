//! All shipped scenes are valid and can be simulated, and there is one for each effect.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use eit::Preset;
use phantom::{EffectSettings, Phantom, Preview, Scan, Scene};

/// The scene with a coarse mesh, which is sufficient for this test.
fn coarse(name: &str) -> Scene {
    let scene = Scene::open(name).unwrap_or_else(|fault| panic!("{fault}"));
    Scene {
        sheet: Preset::default().remeshed(0.3, 1),
        ..scene
    }
}

#[test]
fn every_shipped_scene_has_a_description_and_starts() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let files: BTreeSet<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|file| file.unwrap().file_name().into_string().unwrap())
        .collect();
    let listed: BTreeSet<String> = Scene::shipped()
        .iter()
        .map(|(name, _)| format!("{name}.toml"))
        .collect();
    assert_eq!(listed, files);
    for (name, text) in Scene::shipped() {
        assert!(Scene::what(text).len() > 10, "{name}");
        let scan = Scan::usual(26).unwrap();
        let mut phantom = Phantom::new(coarse(name)).unwrap();
        let frame = scan.frame(&mut phantom, Duration::ZERO).unwrap();
        assert!(frame.iter().all(|volts| volts.0.is_finite()), "{name}");
        // the baseline is recorded without loads
        assert_eq!(phantom.loads(scan.frame_time()).count(), 0, "{name}");
    }
}

#[test]
fn every_effect_has_a_scene_with_it_alone() {
    for (effect, _) in EffectSettings::ALL {
        let scene = coarse(&format!("effect-{effect}"));
        assert_eq!(scene.effects.names().collect::<Vec<_>>(), [*effect]);
    }
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let scan = Scan {
        every: Duration::from_secs(600),
        ..Scan::usual(26).unwrap()
    };
    let bits = || -> Vec<u64> {
        let mut phantom = Phantom::new(coarse("month")).unwrap();
        (0..6)
            .flat_map(|frame| scan.frame(&mut phantom, scan.begin(frame)).unwrap())
            .map(|volts| volts.0.to_bits())
            .collect()
    };
    assert_eq!(bits(), bits());
}

#[test]
fn a_clean_bench_names_nothing_that_is_negligible() {
    let scene = Scene::open("clean-bench").unwrap();
    let scan = Scan {
        frames: 40,
        ..Scan::usual(26).unwrap()
    };
    let preview = Preview::new(&scene, scan).unwrap();
    let (noise, signal) = (preview.noise(), preview.signal().unwrap());
    for reported in preview
        .predictions()
        .iter()
        .filter(|reported| reported.named)
    {
        let small = reported.volts < 0.1 * noise && reported.volts < 1e-3 * signal;
        assert!(!small, "{reported:?}, noise {noise:e}, signal {signal:e}");
    }
}

#[test]
fn scene_page_names_every_effect() {
    let page = include_str!("../README.md");
    for (effect, what) in EffectSettings::ALL {
        let row = format!("| `{effect}` | {} |", what.trim().trim_end_matches('.'));
        assert!(page.contains(&row), "{row}");
    }
    let example = page.split("```toml").nth(1).unwrap();
    let example = example.split("```").next().unwrap();
    let scene = Scene::parse("README.md", example).unwrap();
    assert_eq!(scene.loads[0].path.len(), 3);
}

#[test]
fn how_to_page_names_every_key_of_a_scene() {
    let page = include_str!("../../../docs/how-to/write-a-scene.md");
    let load = "[[load]]\nshape = \"disc\"\nx_mm = 1\ny_mm = 1";
    for table in [
        "",
        "[paper-sheet]",
        "[disc-tank]",
        "[mesh]",
        "[pressure]",
        "[[contact]]",
        "[[fault]]",
        "[[load]]",
        &format!("{load}\nrepeat = {{ every_s = 1, times = 1 }}\n[[load.path]]"),
        &format!("{load}\n[load.repeat]"),
    ] {
        // the error lists what is allowed
        let text = format!("{table}\nnothing = 1\n");
        let error = Scene::parse("scene.toml", &text).unwrap_err().to_string();
        let (_, known) = error.split_once("expected").expect(&error);
        let keys: Vec<&str> = known.split('`').skip(1).step_by(2).collect();
        assert!(keys.len() > 1, "{error}");
        for key in keys {
            assert!(page.contains(&format!("`{key}`")), "{table}: {key}");
        }
    }
}
