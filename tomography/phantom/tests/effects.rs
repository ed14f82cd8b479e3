//! All effects: absent ones change no bit, present ones change the results, and none changes the random numbers of
//! another.

use std::time::Duration;

use phantom::{Phantom, ReadingContext, Scene};
use survey::{Amps, Ohms, Relay, Volts};

/// Each effect with two settings: one with a visible size, and one of size zero, with which it is present and draws
/// numbers but changes nothing.
const EFFECTS: [(&str, &str, &str); 43] = [
    (
        "electrode-placement",
        "",
        "off_mm = 0.0\nwidth_percent = 0.0",
    ),
    ("foam", "", ""),
    ("gauge-law", "", ""),
    ("exponential-law", "", ""),
    ("log-law", "", ""),
    ("hysteresis", "", "percent = 0.0"),
    ("creep", "", "percent = [0.0]\ntau_s = [100.0]"),
    ("power-law-creep", "", "exponent = 0.0"),
    ("set", "", "percent_per_decade = 0.0"),
    ("stretch", "", "ratio = 0.0"),
    ("body-contact", "", "c = 0.0"),
    ("spray", "std = 0.2", "std = 0.0"),
    ("temperature", "", "percent_per_c = 0.0"),
    ("humidity", "", "percent_per_10_rh = 0.0"),
    (
        "long-drift",
        "",
        "wander_percent = 0.0\nwalk_percent = 0.0\nrunning_in_percent = 0.0",
    ),
    (
        "crack",
        "from_mm = [60, 60]\nto_mm = [150, 160]\nwidth_mm = 12.0",
        "from_mm = [60, 60]\nto_mm = [150, 160]\nloss_percent = 0.0",
    ),
    ("contact-spread", "", "std = 0.0"),
    ("contact-drift", "", "percent = 0.0"),
    ("detachment", "electrode = 3", "electrode = 3\ntimes = 1.0"),
    (
        "short",
        "electrodes = [4, 5]",
        "electrodes = [4, 5]\nfrom_s = 1e9",
    ),
    ("isolation", "", ""),
    ("channel-resistance", "", "ohm = 0.0\ndirty_percent = 0.0"),
    ("lead-resistance", "", "ohm = 0.0"),
    ("wear", "behind_closures = 3e7", "life_closures = 1e12"),
    ("self-heating", "", "percent_per_c = 0.0"),
    (
        "current-error",
        "",
        "gain_percent = 0.0\noffset_percent = 0.0",
    ),
    ("current-noise", "", "range_ppm = 0.0"),
    ("output-resistance", "", ""),
    ("source-settling", "", ""),
    ("charge-injection", "", "pc = 0.0"),
    ("crosstalk", "", "between_pf = 0.0"),
    ("thermal-emf", "", "uv = 0.0"),
    (
        "channel-noise",
        "channels = [1003]",
        "channels = [1003]\nuv = 0.0",
    ),
    ("leakage", "", "na = 0.0"),
    ("relay-bounce", "", "operate_ms = 0.0\nbounce_ms = 0.0"),
    ("mains-pickup", "", "mv = 0.0"),
    ("common-mode", "", ""),
    ("input-resistance", "", ""),
    ("bias-current", "", "pa = 0.0"),
    ("voltmeter-gain", "", "gain_ppm = 0.0\noffset_ppm = 0.0"),
    ("autozero-off", "", "range_ppm = 0.0\nuv = 0.0"),
    ("voltmeter-noise", "", "uv = 0.0"),
    ("quantisation", "", "step_uv = 0.0"),
];

/// A load that is placed, moves, presses harder and is removed, for effects on loads.
const LOAD: &str = "[[load]]
shape = \"disc\"
diameter_mm = 30
x_mm = 90
y_mm = 100
mass_g = 500
to_s = 80000
path = [{ at_s = 7200, x_mm = 110 }, { at_s = 14400, mass_g = 900 }, { at_s = 18000, mass_g = 400 }]
";

fn phantom(effects: &[(&str, &str)]) -> Phantom {
    let mut text = format!("seed = 5\n[mesh]\nfineness = 0.3\n{LOAD}");
    for (name, parameters) in effects {
        text += &format!("[effects.{name}]\n{parameters}\n");
    }
    let scene = Scene::parse("test.toml", &text).unwrap_or_else(|fault| panic!("{text}: {fault}"));
    Phantom::new(scene).unwrap()
}

/// Effects on the wires: the simulator applies them; the phantom's readings do not include them.
fn seen_in_wires(phantom: &mut Phantom, at: Duration, seen: &mut Vec<u64>) {
    seen.push(phantom.loop_resistance().0.to_bits());
    for channel in 1001..1009 {
        let contact = phantom.relay_contact(Relay(channel), 1_000_000, at);
        seen.push(contact.ohms.0.to_bits());
        seen.push(contact.stuck.map_or(2, u64::from));
    }
}

/// The bits of a scene's results: transfer impedances, wires and readings at three moments.
fn seen(effects: &[(&str, &str)]) -> Vec<u64> {
    let mut phantom = phantom(effects);
    let mut seen = Vec::new();
    for hours in [0, 5, 30] {
        let at = Duration::from_secs(hours * 3600 + 1);
        let z = phantom.transfer_impedance(at).unwrap().clone();
        seen.extend(z.iter().map(|ohm| ohm.to_bits()));
        seen_in_wires(&mut phantom, at, &mut seen);
        for channel in 0..8_usize {
            let context = ReadingContext {
                at: at + Duration::from_millis(30 * channel as u64),
                integration: Duration::from_millis(4),
                range: Volts(1.0),
                nplc: 0.2,
                resolution: 1e-5,
                relay: Some(Relay(1001 + channel as u32)),
                flowing: Amps(1e-3),
                source_range: Amps(2e-3),
                since_change: Duration::from_nanos(4_000_300),
                source_resistance: Ohms(1500.0),
                load_resistance: Ohms(1800.0),
            };
            let exact = 1e-3 * (z[(channel, 0)] - z[(channel + 1, 0)]);
            let reading = phantom.reading(Volts(exact), context);
            seen.push(reading.0.to_bits());
        }
    }
    seen
}

#[test]
fn every_effect_acts_and_size_zero_changes_no_bit() {
    let bare = seen(&[]);
    for (name, active, nothing) in EFFECTS {
        assert!(seen(&[(name, active)]) != bare, "{name} does nothing");
        // some effects are a resistance, which cannot have size zero
        if active != nothing {
            assert!(seen(&[(name, nothing)]) == bare, "{name} without size");
        }
    }
}

/// Effects that draw random numbers.
const DRAWING: [&str; 13] = [
    "electrode-placement",
    "channel-resistance",
    "wear",
    "relay-bounce",
    "spray",
    "long-drift",
    "contact-spread",
    "contact-drift",
    "current-noise",
    "thermal-emf",
    "channel-noise",
    "autozero-off",
    "voltmeter-noise",
];

#[test]
fn one_effect_more_shifts_no_number_of_another() {
    let drawing = || EFFECTS.iter().filter(|(name, ..)| DRAWING.contains(name));
    assert_eq!(drawing().count(), DRAWING.len());
    for (name, active, _) in drawing() {
        let alone = seen(&[(name, active)]);
        assert!(
            seen(&[(name, active)]) == alone,
            "{name}: same seed, same bits"
        );
        for (other, _, nothing) in drawing().filter(|(other, ..)| other != name) {
            let both = seen(&[(name, active), (other, nothing)]);
            assert!(both == alone, "{other} shifts the numbers of {name}");
        }
    }
}

#[test]
fn a_parameter_out_of_range_is_refused_at_its_line() {
    let refuse = |text: &str| Scene::parse("s.toml", text).unwrap_err().to_string();
    assert_eq!(
        refuse("[effects.thermal-emf]\ntau_s = 900\nuv = 201"),
        "s.toml:3:6: effects.thermal-emf.uv is 201 uV, it must be 0 to 200 uV"
    );
    assert_eq!(
        refuse("effects.detachment = { electrode = 27 }"),
        "s.toml:1:36: effects.detachment.electrode names electrode 27, the sheet has 26"
    );
    assert!(refuse("[effects.short]\nelectrodes = [3, 3]").contains("electrode 3 twice"));
    assert!(refuse("[effects.spray]\nstd = nan").contains("must be 0 to 1"));
    let unknown = refuse("[effects.thermal]\n");
    let wanted = "s.toml:1:10: there is no effect `thermal`, perhaps `thermal-emf`? There are ";
    assert!(unknown.starts_with(wanted), "{unknown}");
    assert!(
        unknown.contains("spray, ") && unknown.ends_with("quantisation"),
        "{unknown}"
    );
    assert!(refuse("[effects.crack]\nto_mm = [1, 2]").contains("missing field `from_mm`"));
}

#[test]
fn all_together_are_the_same_on_every_run() {
    // a scene can have only one conductance law and one kind of creep
    let all: Vec<(&str, &str)> = EFFECTS
        .iter()
        .filter(|(name, ..)| !["exponential-law", "log-law", "power-law-creep"].contains(name))
        .map(|(name, active, _)| (*name, *active))
        .collect();
    assert!(seen(&all) == seen(&all));
}
