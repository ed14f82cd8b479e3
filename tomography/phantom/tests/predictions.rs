//! Compares the predicted size of each effect with the rms in a simulation with the effect.

use std::collections::BTreeSet;
use std::time::Duration;

use phantom::{EffectSettings, Phantom, Prediction, Preview, Scan, Scene};
use survey::Volts;

/// The scan with which an effect is compared.
#[derive(Clone, Copy)]
enum Taken {
    /// Some frames over a day.
    Day,
    /// Some frames over a day, with a load that changes.
    Pressed,
    /// One frame without settling time, with an integration of a thousandth of a cycle.
    Hurried,
}

use Taken::{Day, Hurried, Pressed};

/// Effects that only the simulated instruments apply; tested in `simulator/tests/simulated_rig/relays.rs`.
const IN_WIRES: [&str; 3] = ["channel-resistance", "lead-resistance", "wear"];

const LOAD: &str = "[[load]]
shape = \"disc\"
diameter_mm = 30
x_mm = 90
y_mm = 100
mass_g = 900
to_s = 80000
path = [{ at_s = 30000, mass_g = 3000 }, { at_s = 60000, mass_g = 600 }]
";

/// Each effect with its parameters, scan and number of seeds. Effects that draw one number per frame need many seeds.
const EFFECTS: [(&str, &str, Taken, u64); 43] = [
    ("electrode-placement", "", Day, 4),
    ("foam", "", Pressed, 1),
    ("gauge-law", "", Pressed, 1),
    ("exponential-law", "", Pressed, 1),
    ("log-law", "", Pressed, 1),
    ("hysteresis", "", Pressed, 1),
    ("creep", "", Pressed, 1),
    ("power-law-creep", "", Pressed, 1),
    ("set", "", Pressed, 1),
    ("stretch", "", Pressed, 1),
    ("body-contact", "", Pressed, 1),
    ("channel-resistance", "", Day, 1),
    ("lead-resistance", "", Day, 1),
    ("wear", "", Day, 1),
    ("self-heating", "", Day, 1),
    ("crosstalk", "", Hurried, 1),
    ("relay-bounce", "", Hurried, 1),
    ("spray", "std = 0.2", Day, 12),
    ("temperature", "", Day, 1),
    ("humidity", "", Day, 1),
    ("long-drift", "", Day, 12),
    (
        "crack",
        "from_mm = [60, 60]\nto_mm = [150, 160]\nwidth_mm = 12.0\ndays = 0.2",
        Day,
        1,
    ),
    ("contact-spread", "", Day, 6),
    ("contact-drift", "", Day, 6),
    ("detachment", "electrode = 3\nfrom_s = 30000.0", Day, 1),
    ("short", "electrodes = [4, 5]\nto_s = 40000.0", Day, 1),
    ("isolation", "", Day, 1),
    ("current-error", "", Day, 1),
    ("current-noise", "", Day, 1),
    ("output-resistance", "", Day, 1),
    ("source-settling", "", Hurried, 1),
    ("charge-injection", "", Hurried, 1),
    ("thermal-emf", "", Day, 2),
    ("channel-noise", "channels = [1003, 1017]", Day, 1),
    ("leakage", "", Day, 1),
    ("mains-pickup", "", Day, 1),
    ("common-mode", "", Day, 1),
    ("input-resistance", "", Day, 1),
    ("bias-current", "", Day, 1),
    ("voltmeter-gain", "", Day, 1),
    ("autozero-off", "", Day, 12),
    ("voltmeter-noise", "", Day, 1),
    ("quantisation", "", Day, 1),
];

fn scan(taken: Taken) -> Scan {
    let usual = Scan::usual(26).unwrap();
    match taken {
        Day | Pressed => Scan {
            frames: 12,
            every: Duration::from_secs(2 * 3600),
            ..usual
        },
        Hurried => Scan {
            nplc: 0.001,
            resolution: 1e-4,
            settle: Duration::from_nanos(100),
            switching: Duration::ZERO,
            ..usual
        },
    }
}

fn scene(seed: u64, taken: Taken, effect: Option<(&str, &str)>) -> Scene {
    let effect = effect.map_or(String::new(), |(name, parameters)| {
        format!("[effects.{name}]\n{parameters}\n")
    });
    let load = if matches!(taken, Pressed) { LOAD } else { "" };
    let text = format!("seed = {seed}\n[mesh]\nfineness = 0.3\n{load}{effect}");
    Scene::parse("test.toml", &text).unwrap_or_else(|fault| panic!("{text}: {fault}"))
}

fn frames(scene: Scene, scan: &Scan) -> Vec<Volts> {
    let mut phantom = Phantom::new(scene).unwrap();
    (0..scan.frames)
        .flat_map(|frame| scan.frame(&mut phantom, scan.begin(frame)).unwrap())
        .collect()
}

fn predicted(scene: &Scene, scan: &Scan, name: &str) -> Prediction {
    let all = Preview::new(scene, scan.clone()).unwrap().predictions();
    all.into_iter().find(|one| one.name == name).unwrap()
}

#[test]
fn every_effect_is_as_large_as_predicted_within_a_factor_of_two() {
    let listed: BTreeSet<&str> = EffectSettings::ALL.iter().map(|(name, _)| *name).collect();
    let tested: BTreeSet<&str> = EFFECTS.iter().map(|(name, ..)| *name).collect();
    assert_eq!(listed, tested);
    let bare = [Day, Pressed, Hurried].map(|taken| frames(scene(0, taken, None), &scan(taken)));
    let mut wrong = Vec::new();
    for (name, parameters, taken, seeds) in EFFECTS {
        let scan = scan(taken);
        let bare = &bare[taken as usize];
        let mut sum = 0.0;
        for seed in 0..seeds {
            let seen = frames(scene(seed, taken, Some((name, parameters))), &scan);
            let apart = seen.iter().zip(bare).map(|(one, other)| one.0 - other.0);
            sum += apart.map(|volts| volts * volts).sum::<f64>();
        }
        let seen = (sum / (seeds as f64 * bare.len() as f64)).sqrt();
        let reported = predicted(&scene(0, taken, Some((name, parameters))), &scan, name);
        assert!(reported.named);
        if IN_WIRES.contains(&name) {
            assert_eq!(seen, 0.0, "{name}: no wires between sheet and frame here");
            continue;
        }
        let ratio = reported.volts / seen;
        println!(
            "{name:20} {seen:.2e} V seen, {:.2e} V predicted: {ratio:.2}",
            reported.volts
        );
        if !(0.5..=2.0).contains(&ratio) {
            wrong.push(format!("{name}: {ratio:.3}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn unnamed_effects_are_predicted_and_faults_state_assumptions() {
    let preview = Preview::new(&scene(0, Day, None), scan(Day)).unwrap();
    let all = preview.predictions();
    assert_eq!(all.len(), EffectSettings::ALL.len());
    for reported in &all {
        assert!(
            !reported.named && reported.volts.is_finite() && reported.volts >= 0.0,
            "{reported:?}"
        );
    }
    let off = all
        .iter()
        .find(|reported| reported.name == "detachment")
        .unwrap();
    assert_eq!(off.assumes.as_deref(), Some("electrode 1 comes off at 0 s"));
    // 3e-6 of the range of 1 V at 1 PLC
    assert!((preview.noise() - 3e-6).abs() < 1e-12);
    assert_eq!(preview.signal(), None);
}
