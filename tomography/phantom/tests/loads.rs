//! Loads that move, change their force, and act on effects with a history.

use std::time::Duration;

use nalgebra::DMatrix;
use phantom::{Load, Phantom, Scene};

fn phantom(text: &str) -> Phantom {
    let text = format!("[mesh]\nfineness = 0.6\n{text}");
    let scene = Scene::parse("test.toml", &text).unwrap_or_else(|fault| panic!("{fault}"));
    Phantom::new(scene).unwrap()
}

fn seconds(seconds: f64) -> Duration {
    survey::duration(seconds)
}

fn apart(one: &DMatrix<f64>, other: &DMatrix<f64>) -> f64 {
    (one - other).norm()
}

#[test]
fn each_reading_has_the_moving_load_at_its_time() {
    // 20 mm in 20 s, as in a frame of the armature module
    let mut moving = phantom(
        "[[load]]\nshape = \"disc\"\ndiameter_mm = 10\nx_mm = 60\ny_mm = 70\nloss_percent = 50\n\
         path = [{ at_s = 20, x_mm = 80 }]\n",
    );
    let mut still = phantom("");
    let untouched = still.transfer_impedance(seconds(0.0)).unwrap().clone();
    let mut seen = Vec::new();
    let mut worst = 0.0_f64;
    for tenths in 0..200 {
        let at = seconds(f64::from(tenths) / 10.0);
        let z = moving.transfer_impedance(at).unwrap().clone();
        if tenths % 17 == 0 {
            still.release();
            let exact = [60.0 + at.as_secs_f64(), 70.0];
            still.press(Load::disc(exact, 10.0, 0.5)).unwrap();
            let exact = still.transfer_impedance(at).unwrap();
            worst = worst.max(apart(&z, exact) / apart(exact, &untouched));
            let place = moving.loads(at).next().unwrap().centre_mm[0];
            assert!((place - 60.0 - at.as_secs_f64()).abs() <= 0.125 + 1e-9);
        }
        if seen.last() != Some(&z) {
            seen.push(z);
        }
    }
    println!("in steps of 0.25 mm: {worst:.4} of the load's signal beside the exact place");
    // the error of 0.125 mm is small against the 10 mm over which the signal falls off
    assert!(worst < 0.006, "{worst}");
    assert!(worst > 0.0);
    // one solution per step; nothing is recomputed between two steps
    assert_eq!(seen.len(), 80);
}

#[test]
fn a_force_over_time_is_its_pressure_at_each_moment() {
    let mut phantom = phantom(
        "[pressure]\nhalf_kpa = 25\n[[load]]\nshape = \"rectangle\"\nwidth_mm = 30\nheight_mm = 40\nx_mm = 100\n\
         y_mm = 100\nmass_g = 1000\npath = [{ at_s = 10, mass_g = 0 }, { at_s = 20, mass_g = 3000 }]\n",
    );
    let loss = |phantom: &Phantom, at| phantom.loads(seconds(at)).next().unwrap().loss;
    let exact = |grams: f64| {
        let kpa = grams * 9.80665e-3 / 1.2;
        kpa / (kpa + 25.0)
    };
    // within half of 2 % of the larger force
    for (at, grams, step) in [
        (0.0, 1000.0, 20.0),
        (4.0, 600.0, 20.0),
        (15.0, 1500.0, 60.0),
    ] {
        let [low, high] = [grams - 0.51 * step, grams + 0.51 * step].map(exact);
        let seen = loss(&phantom, at);
        assert!((low..=high).contains(&seen), "{at}: {seen}");
    }
    assert!((loss(&phantom, 20.0) - exact(3000.0)).abs() < 1e-15);
    let whole = phantom.scene().sheet.conductance();
    let least = |phantom: &mut Phantom, at| {
        let sigma = phantom.conductance(seconds(at));
        sigma.into_iter().fold(f64::INFINITY, f64::min) / whole
    };
    assert!((least(&mut phantom, 20.0) - (1.0 - exact(3000.0))).abs() < 1e-12);
}

const PRESS: &str = "[[load]]\nshape = \"disc\"\ndiameter_mm = 30\nx_mm = 100\ny_mm = 110\n";

/// The smallest remaining share of conductance.
fn left(phantom: &mut Phantom, at: f64) -> f64 {
    let whole = phantom.scene().sheet.conductance();
    let sigma = phantom.conductance(seconds(at));
    sigma.into_iter().fold(f64::INFINITY, f64::min) / whole
}

#[test]
fn creep_equals_closed_form_however_often_it_is_computed() {
    let text = format!(
        "{PRESS}loss_percent = 40\nfrom_s = 100\nto_s = 5000\n\
         [effects.creep]\npercent = [10, 20]\ntau_s = [30, 1000]\nevery_s = 10\n"
    );
    let exact = |at: f64| {
        let grown =
            |since: f64| 1.0 - 0.1 * (-since / 30.0).exp_m1() - 0.2 * (-since / 1000.0).exp_m1();
        let creep = if at < 5000.0 {
            grown(at - 100.0)
        } else {
            grown(at - 100.0) - grown(at - 5000.0)
        };
        0.6_f64.powf(creep)
    };
    let mut seldom = phantom(&text);
    let mut often = phantom(&text);
    let mut tenth = 0;
    for at in [100.0, 110.0, 500.0, 4990.0, 5010.0, 6000.0] {
        let seen = left(&mut seldom, at);
        assert!(
            (seen - exact(at)).abs() < 1e-9,
            "{at}: {seen} {}",
            exact(at)
        );
        while f64::from(tenth) < at {
            left(&mut often, f64::from(tenth));
            tenth += 10;
        }
        assert!((left(&mut often, at) - seen).abs() < 1e-12);
    }
    assert_eq!(left(&mut seldom, 1e6), 1.0, "what is left fades");
    // between two updates the solution is reused
    let z = often.transfer_impedance(seconds(6011.0)).unwrap().clone();
    assert!(often.transfer_impedance(seconds(6019.0)).unwrap() == &z);
    assert!(often.transfer_impedance(seconds(6021.0)).unwrap() != &z);
}

#[test]
fn hysteresis_shows_on_release_and_moving_load_leaves_trail() {
    let mut phantom1 = phantom(&format!(
        "{PRESS}mass_g = 100\npath = [{{ at_s = 10, mass_g = 2000 }}, {{ at_s = 20, mass_g = 100 }}]\n[effects.hysteresis]\n"
    ));
    let [there, top, back] = [5.1, 10.0, 14.9].map(|at| left(&mut phantom1, at));
    assert!(top < back && back < there - 0.02, "{there} {top} {back}");

    let text = format!(
        "{PRESS}loss_percent = 50\npath = [{{ at_s = 60, x_mm = 100 }}, {{ at_s = 61, x_mm = 160 }}]\n"
    );
    let mut bare = phantom(&text);
    let mut creeping = phantom(&format!("{text}[effects.creep]\n"));
    let behind = |phantom: &mut Phantom| {
        let sigma = phantom.conductance(seconds(80.0));
        let mesh = phantom.mesh();
        let near = (0..sigma.len()).filter(|t| {
            let [x, y] = mesh.centroid(*t);
            (x - 0.1).hypot(y - 0.11) < 0.01
        });
        near.map(|t| sigma[t]).fold(f64::INFINITY, f64::min) / phantom.scene().sheet.conductance()
    };
    assert_eq!(behind(&mut bare), 1.0);
    let trail = behind(&mut creeping);
    assert!((0.9..0.99).contains(&trail), "{trail}");
}

#[test]
fn a_press_by_hand_has_hysteresis_too() {
    let mut phantom = phantom("[effects.creep]\npercent = [50]\ntau_s = [100]\n");
    assert_eq!(left(&mut phantom, 5.0), 1.0);
    phantom
        .press(Load::disc([100.0, 110.0], 30.0, 0.5))
        .unwrap();
    left(&mut phantom, 10.0);
    let later = left(&mut phantom, 1000.0);
    assert!((later - 0.5_f64.powf(1.5)).abs() < 1e-3, "{later}");
    phantom.release();
    let after = left(&mut phantom, 1000.0);
    assert!((after - 0.5_f64.powf(0.5)).abs() < 1e-3, "{after}");
}

#[test]
fn contacts_of_the_scene_stay_under_effects_on_contacts() {
    let text = "[[contact]]\nelectrode = 3\nohm = 5000\n";
    let plain = phantom(text)
        .transfer_impedance(seconds(0.0))
        .unwrap()
        .clone();
    let nothing = format!("{text}[effects.contact-spread]\nstd = 0.0\n");
    let mut under = phantom(&nothing);
    assert!(under.transfer_impedance(seconds(0.0)).unwrap() == &plain);
}

#[test]
fn a_repeated_load_is_its_written_out_copies_to_the_bit() {
    let load = |from: u32, repeat: &str| {
        format!(
            "[[load]]\nname = \"night\"\nshape = \"disc\"\ndiameter_mm = 20\nx_mm = 60\ny_mm = 70\nloss_percent = 50\n\
             from_s = {from}\nto_s = {}\npath = [{{ at_s = {}, x_mm = 62 }}]\n{repeat}\n",
            from + 10,
            from + 4
        )
    };
    let effects = "[effects.creep]\n[effects.set]\n[effects.hysteresis]\n";
    let mut repeated = phantom(&format!(
        "{effects}{}",
        load(5, "repeat = { every_s = 30, times = 3 }")
    ));
    let copies = [5, 35, 65].map(|from| load(from, "")).concat();
    let mut copied = phantom(&format!("{effects}{copies}"));
    for at in [0.0, 6.5, 14.0, 20.0, 36.5, 46.0, 67.0, 74.9, 75.0, 100.0] {
        let at = seconds(at);
        let one = repeated.transfer_impedance(at).unwrap();
        assert_eq!(one, copied.transfer_impedance(at).unwrap(), "{at:?}");
    }
    let names = |at: f64| -> Vec<String> {
        let loads = repeated.loads(seconds(at));
        loads.map(|load| load.name).collect()
    };
    assert_eq!(names(6.0), ["night 1"]);
    assert_eq!(names(66.0), ["night 3"]);
    assert_eq!(names(96.0), [""; 0]);
}
