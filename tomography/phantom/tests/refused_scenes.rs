//! Invalid scenes: the error names the position and what is allowed.

use phantom::Scene;

fn refuse(text: &str) -> String {
    match Scene::parse("s.toml", text) {
        Ok(_) => panic!("taken: {text}"),
        Err(fault) => fault.to_string(),
    }
}

#[track_caller]
fn says(text: &str, wanted: &str) {
    let message = refuse(text);
    assert!(message.starts_with(wanted), "{message}\nnot\n{wanted}");
}

const DISC: &str = "[[load]]\nshape = \"disc\"\ndiameter_mm = 10\ny_mm = 50\n";

#[test]
fn unknown_effect_is_refused_with_the_known_ones() {
    let message = refuse("[effects.creeep]\n");
    let start = "s.toml:1:10: there is no effect `creeep`, perhaps `creep`? There are ";
    assert!(message.starts_with(start), "{message}");
    assert!(message.contains("creep, ") && message.contains("relay-bounce, "));
}

#[test]
fn key_without_unit_is_refused_with_the_full_key() {
    let message = refuse("[effects.relay-bounce]\noperate = 3\n");
    assert!(
        message.starts_with("s.toml:2:1: unknown field `operate`"),
        "{message}"
    );
    assert!(
        message.ends_with("; a key ends in its unit: `operate_ms`"),
        "{message}"
    );
    let message = refuse(&format!("{DISC}x_mm = 3\nmass_kg = 3\n"));
    assert!(
        message.ends_with("; a key ends in its unit: `mass_g`"),
        "{message}"
    );
    let message = refuse(&format!("{DISC}x = 3\nmass_g = 3\n"));
    assert!(
        message.ends_with("; a key ends in its unit: `x_mm`"),
        "{message}"
    );
    let path = "x_mm = 3\nmass_g = 3\npath = [{ at = 3 }]\n";
    let message = refuse(&format!("{DISC}{path}"));
    assert!(message.starts_with("s.toml:7:11:"), "{message}");
    assert!(
        message.ends_with("; a key ends in its unit: `at_s`"),
        "{message}"
    );
    // no suggestion without a similar key
    assert!(!refuse("[effects.relay-bounce]\nfrobs = 3\n").contains("unit"));
}

#[test]
fn every_parameter_has_its_range() {
    for (text, wanted) in [
        (
            "[effects.relay-bounce]\noperate_ms = -1",
            "2:14: effects.relay-bounce.operate_ms is -1 ms, it must be 0 to 100 ms",
        ),
        (
            "[effects.crosstalk]\nwire_pf = 0",
            "2:11: effects.crosstalk.wire_pf is 0 pF, it must be 1 to 1000000 pF",
        ),
        (
            "[effects.self-heating]\ntau_s = 0",
            "2:9: effects.self-heating.tau_s is 0 s, it must be 0.1 to 100000 s",
        ),
        (
            "[effects.wear]\nshape = 0",
            "2:9: effects.wear.shape is 0, it must be 0.2 to 20",
        ),
        (
            "[effects.channel-resistance]\ndirty_percent = 101",
            "2:17: effects.channel-resistance.dirty_percent is 101 %, it must be 0 to 100 %",
        ),
        (
            "[effects.lead-resistance]\nohm = nan",
            "2:7: effects.lead-resistance.ohm is NaN ohm, it must be 0 to 1000000 ohm",
        ),
        (
            "[effects.electrode-placement]\noff_mm = 5",
            "2:10: effects.electrode-placement.off_mm is 5 mm, it must be 0 to 1 mm",
        ),
        (
            "[effects.foam]\nkpa = [1, 1]\nstrain_percent = [1, 2]",
            "2:7: effects.foam.kpa has 1 after 1, it must rise",
        ),
        (
            "[effects.foam]\nkpa = [1]",
            "1:2: effects.foam.strain_percent has 5 numbers, it must have one for each of the 1 of kpa",
        ),
        (
            "[effects.gauge-law]\nfactor = -1",
            "2:10: effects.gauge-law.factor is -1, it must be 0 to 1000",
        ),
        (
            "[effects.exponential-law]\nper_strain = 19",
            "2:14: effects.exponential-law.per_strain is 19, it must be 0 to 18",
        ),
        (
            "[effects.log-law]\nfrom_kpa = 0",
            "2:12: effects.log-law.from_kpa is 0 kPa, it must be 0.000001 to 1000000 kPa",
        ),
        (
            "[effects.hysteresis]\npercent = 41",
            "2:11: effects.hysteresis.percent is 41 %, it must be 0 to 40 %",
        ),
        (
            "[effects.creep]\ntau_s = [1]",
            "2:9: effects.creep.tau_s has 1 numbers, it must have one for each of the 3 of percent",
        ),
        (
            "[effects.set]\nbehind_cycles = -1",
            "2:17: effects.set.behind_cycles is -1 cycles, it must be 0 to 1000000000000 cycles",
        ),
        (
            "[effects.stretch]\nratio = 0.6",
            "2:9: effects.stretch.ratio is 0.6, it must be 0 to 0.5",
        ),
        (
            "[pressure]\nmodulus_kpa = 0",
            "2:15: pressure.modulus_kpa is 0, it must be a positive number",
        ),
        (
            "[pressure]\nhalf_kpa = -5",
            "2:12: pressure.half_kpa is -5, it must be a positive number",
        ),
    ] {
        says(text, &format!("s.toml:{wanted}"));
    }
}

#[test]
fn a_load_outside_the_sheet_is_refused_at_the_line_of_its_place() {
    says(
        &format!("{DISC}x_mm = 220\nmass_g = 3\n"),
        "s.toml:5:8: load 'load 1' at 220, 50 mm covers no part of the sheet",
    );
    let path =
        "x_mm = 200\nmass_g = 3\npath = [{ at_s = 3, x_mm = 210 }, { at_s = 5, x_mm = 219.1 }]\n";
    says(
        &format!("{DISC}{path}"),
        "s.toml:7:35: load 'load 1' at 219.1, 50 mm covers no part",
    );
    for nowhere in ["nan", "inf"] {
        let path = format!("x_mm = 20\nmass_g = 3\npath = [{{ at_s = 3, x_mm = {nowhere} }}]\n");
        says(
            &format!("{DISC}{path}"),
            "s.toml:7:9: load 'load 1': x_mm is not a finite number",
        );
    }
    let tank = format!("[disc-tank]\n{DISC}x_mm = 144\nmass_g = 3\n");
    assert!(Scene::parse("s.toml", &tank).is_ok());
    let tank = format!("[disc-tank]\n{DISC}x_mm = 147\nmass_g = 3\n");
    says(
        &tank,
        "s.toml:6:8: load 'load 1' at 147, 50 mm covers no part",
    );
    // one plate covers the whole tank
    let plate = "[disc-tank]\n[[load]]\nshape = \"disc\"\ndiameter_mm = 400\ny_mm = 0\nx_mm = 9\nmass_g = 3\n";
    assert!(Scene::parse("s.toml", plate).is_ok());
}

#[test]
fn two_that_contradict_are_both_named() {
    for (text, wanted) in [
        (
            "[effects.gauge-law]\n[effects.exponential-law]\n",
            "2:1: effects.exponential-law contradicts effects.gauge-law: both define the effect of a strain",
        ),
        (
            "[effects.log-law]\n[effects.gauge-law]\n",
            "1:1: effects.log-law contradicts effects.gauge-law: both define the effect of a load",
        ),
        (
            "[effects.exponential-law]\n[effects.log-law]\n",
            "2:1: effects.log-law contradicts effects.exponential-law: both define the effect of a load",
        ),
        (
            "[effects.foam]\n[effects.log-law]\n",
            "2:1: effects.log-law contradicts effects.foam: the film uses the pressure itself",
        ),
        (
            "[pressure]\nhalf_kpa = 20\n[effects.gauge-law]\n",
            "2:12: pressure.half_kpa contradicts effects.gauge-law: both define the effect of a load",
        ),
    ] {
        says(text, &format!("s.toml:{wanted}"));
    }
}

#[test]
fn path_points_ascend_in_time_and_keep_the_kind_of_load() {
    let way = |path: &str| {
        format!("{DISC}x_mm = 100\nmass_g = 300\nfrom_s = 5\nto_s = 50\npath = [{path}]\n")
    };
    for (path, wanted) in [
        (
            "{ at_s = 5 }",
            "9:18: at_s is 5, it must be later than 5 s, and no later than 50 s",
        ),
        (
            "{ at_s = 9 }, { at_s = 8 }",
            "9:32: at_s is 8, it must be later than 9 s",
        ),
        (
            "{ at_s = 51 }",
            "9:18: at_s is 51, it must be later than 5 s, and no later than 50 s",
        ),
        (
            "{ at_s = -1 }",
            "9:18: at_s is -1, it must be zero or more seconds",
        ),
        (
            "{ at_s = 9, loss_percent = 3 }",
            "9:36: loss_percent on the path of a load with mass_g",
        ),
        (
            "{ at_s = 9, mass_g = -3 }",
            "9:30: mass_g is -3, it must be zero or more",
        ),
    ] {
        says(&way(path), &format!("s.toml:{wanted}"));
    }
    let lost = format!(
        "{DISC}x_mm = 100\nloss_percent = 30\npath = [{{ at_s = 5, loss_percent = 101 }}]\n"
    );
    says(
        &lost,
        "s.toml:7:36: loss_percent is 101, it must be 0 to 100",
    );
}

#[test]
fn a_repeat_has_sound_numbers_and_waits_for_the_end() {
    let load = |rest: &str| format!("{DISC}x_mm = 100\nmass_g = 300\n{rest}\n");
    let fault = |rest: &str| format!("[[fault]]\nat_s = 5\nwhat = \"drop 6221\"\n{rest}\n");
    for (text, wanted) in [
        (
            load("repeat = { every_s = 10, times = 3 }"),
            "7:10: a repeated load needs to_s",
        ),
        (
            load("to_s = 10\nrepeat = { every_s = 10, times = 3 }"),
            "8:22: repeat.every_s is 10, it must be longer than the load lies there (10 s)",
        ),
        (
            load("to_s = 10\nrepeat = { every_s = 20, times = 0 }"),
            "8:34: repeat.times is 0, it must be 2 to 100000, the first time included",
        ),
        (
            load("to_s = 10\nrepeat = { every_s = 20 }"),
            "8:10: missing field `times`",
        ),
        (
            load("to_s = 10\nrepeat = { every = 20, times = 3 }"),
            "8:12: unknown field `every`, expected `every_s` or `times`; a key ends in its unit",
        ),
        (
            fault("repeat = { every_s = -1, times = 3 }"),
            "4:22: repeat.every_s is -1, it must be 0.001 to",
        ),
        (
            fault("repeat = { every_s = 1e9, times = 100000 }"),
            "4:22: repeat.every_s is 1000000000, it must be 0.001 to 31558 s",
        ),
        (
            fault("repeat = { every_s = 5, times = -3 }"),
            "4:33: repeat.times is -3, it must be 2 to 100000",
        ),
        (
            fault("for_s = 7\nrepeat = { every_s = 5, times = 3 }"),
            "5:22: repeat.every_s is 5, it must be longer than the fault lasts (7 s)",
        ),
    ] {
        says(&text, &format!("s.toml:{wanted}"));
    }
}

#[test]
fn a_contact_belongs_to_its_shape() {
    let load = |rest: &str| format!("[[load]]\nx_mm = 100\ny_mm = 50\n{rest}\n");
    for (rest, wanted) in [
        (
            "shape = \"disc\"\ndiameter_mm = 10\nloss_percent = 30\ncontact = \"punch\"",
            "7:11: contact \"punch\" is only for a disc with mass_g",
        ),
        (
            "shape = \"triangle\"\nside_mm = 10\nmass_g = 30\ncontact = \"punch\"",
            "7:11: contact \"punch\" is only for a disc with mass_g",
        ),
        (
            "shape = \"sphere\"\ndiameter_mm = 10\nmass_g = 30\ncontact = \"even\"",
            "7:11: a sphere has its own contact",
        ),
        (
            "shape = \"sphere\"\ndiameter_mm = 10\nloss_percent = 30",
            "1:1: the contact of a sphere is computed from its force: give mass_g",
        ),
        (
            "shape = \"sphere\"\ndiameter_mm = 10\nmass_g = 3000",
            "1:1: 3000 g press a sphere of 5 mm radius into foam of 100 kPa beyond its middle",
        ),
        (
            "shape = \"disc\"\ndiameter_mm = 10\nmass_g = 3\ncontact = \"soft\"",
            "7:11: unknown variant `soft`, expected `even` or `punch`",
        ),
    ] {
        says(&load(rest), &format!("s.toml:{wanted}"));
    }
}
