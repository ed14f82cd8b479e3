//! The simulated night on the live page: its numbers equal those of the bus, of the command line and of the exported
//! file.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

use super::driver::Browser;
use super::live_page::Page;
use crate::test_rig::{self, Needs, ask, runtime};

/// Nine hours with a frame every ten minutes, played 300 times faster: slow enough for enough frames on a busy
/// machine.
const PLAYED: &str = "kind = \"recording\"\n[recording]\nsession = \"NIGHT\"\nspeed = 300.0\n";
const REGION: &str = "\n[[region]]\nname = \"hip\"\nrectangle_mm = [60.0, 80.0, 130.0, 150.0]\n";

/// The last quantities of the running session.
fn of_bus(path: &Path, id: &str) -> Option<(u64, Value)> {
    runtime().block_on(async {
        let (_connection, session) = test_rig::session(path, id).await;
        let latest = session.quantities().await.ok()?;
        let values = serde_json::from_str(&latest.json).expect("JSON");
        Some((latest.sequence, values))
    })
}

/// Values with the names of their region and quantity, in the order of these names.
type Values = Vec<(String, String, f64)>;

/// The mean values of each exported minute, by its begin, s since 1970.
fn exported(path: &Path) -> BTreeMap<i64, Values> {
    let mut file = netcdf3::FileReader::open(path).expect("a netCDF file");
    let names = file.data_set().get_var_attr_as_string("region", "names");
    let names = names.expect("names of regions");
    let regions: Vec<&str> = names.split(' ').collect();
    let variables = file.data_set().get_var_names();
    let mut read = |variable: &str| {
        let values = file.read_var(variable).expect("it is there");
        values.get_f64().expect("f64").to_vec()
    };
    let mut minutes: BTreeMap<i64, Values> = BTreeMap::new();
    let begins = read("minute");
    for variable in &variables {
        let Some(quantity) = variable.strip_suffix("_mean") else {
            continue;
        };
        let rows = read(variable);
        for (begin, row) in begins.iter().zip(rows.chunks(regions.len())) {
            let values = minutes.entry(*begin as i64).or_default();
            let there = regions.iter().zip(row).filter(|(_, value)| !value.is_nan());
            let quantity = quantity.replace('_', "-");
            values.extend(
                there.map(|(region, value)| ((*region).to_owned(), quantity.clone(), *value)),
            );
        }
    }
    minutes.values_mut().for_each(sort);
    minutes
}

fn sort(values: &mut Values) {
    values.sort_by(|a, b| (&a.0, &a.1).cmp(&(&b.0, &b.1)));
}

#[test]
fn a_night_has_the_same_numbers_on_page_bus_cli_and_in_files() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::QUIET) else {
        return;
    };
    let profile = stage.path().join("browser");
    let Some(browser) = Browser::start(&profile, 1500, 1000) else {
        return;
    };
    let night = stage.path().join("night");
    let mut run = stage.command("tactus-lab");
    run.args([
        "scene",
        "run",
        "bedside-night",
        "--nplc",
        "1",
        "--range-v",
        "0.1",
    ]);
    run.args(["--every", "600", "--frames", "54", "--logbook"])
        .arg(&night);
    let ran = stage.run_command(run).and_then(|ran| ran.succeeded());
    ran.unwrap_or_else(|fault| panic!("{fault}"));
    let files = std::fs::read_dir(&night).expect("it was written");
    let recorded = files
        .filter_map(|file| Some(file.ok()?.path()))
        .find(|path| {
            path.extension()
                .is_some_and(|extension| extension == "tactus")
        });
    let recorded = recorded.expect("a session").display().to_string();
    let simulated =
        "kind = \"simulated\"\nprofile = \"STAGE/profile.toml\"\nscene = \"STAGE/scene.toml\"\n";
    let config = tactus_tests::SIMULATED.replace(simulated, &PLAYED.replace("NIGHT", &recorded));
    assert_ne!(config, tactus_tests::SIMULATED);
    stage
        .configure(&format!("{config}{REGION}"))
        .expect("it is written");
    let daemon = test_rig::start(&stage);
    let page = Page::serve(&stage, &[]);
    browser.open(&page.url);
    browser.value("location.reload()");
    browser.until("typeof map !== 'undefined' && latest !== null");
    browser.value("window.seen = {}, window.showWhole = show, show = state => { showWhole(state); \
        if (state.frame && state.frame.quantities) seen[state.frame.sequence] = state.frame.quantities.regions; }, 0");
    let begun = ask(&stage, &["start"]);
    let id = begun[0]["session"].as_str().expect("a session").to_owned();
    browser
        .until("latest.frame && latest.frame.sequence > 2 && byId('quantities').rows.length > 3");
    let mut of_bus_found = Vec::new();
    while browser.value("latest.session === null") != true {
        of_bus_found.extend(of_bus(&stage.peer_path(), &id));
        browser.value("new Promise(resume => setTimeout(resume, 500))");
    }
    browser.screenshot(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("night-live.png"));
    // frames keep the times of the night, which must not be reported as a set clock
    let moved = "latest.events.filter(event => event.kind === 'clock-moved').length";
    assert_eq!(browser.value(moved), 0);
    let seen = browser.value("seen");
    let seen = seen.as_object().expect("frames");
    // the night has 54 frames; a slow browser skips some
    assert!(seen.len() > 15, "the page showed {} frames", seen.len());
    let frames = ask(&stage, &["quantities", &id, "--each-frame", "--recompute"]);
    let values = |regions: &Value| -> Values {
        let regions = regions.as_array().expect("regions").iter();
        let each = regions.flat_map(|region| {
            let name = region["name"].as_str().expect("a name");
            let values = region["values"].as_object().expect("values").iter();
            values.map(move |(quantity, value)| {
                (
                    name.to_owned(),
                    quantity.clone(),
                    value.as_f64().expect("a number"),
                )
            })
        });
        // the browser sorts values by their names
        let mut all: Vec<_> = each.collect();
        sort(&mut all);
        all
    };
    let recomputed = |sequence: &str| {
        let frame = frames.iter().find(|frame| {
            frame["frame"]
                .as_u64()
                .map(|number| number.to_string())
                .as_deref()
                == Some(sequence)
        });
        values(&frame.expect("it is recorded")["regions"])
    };
    let mut loaded = 0;
    for (sequence, regions) in seen {
        let shown = values(regions);
        assert_eq!(shown, recomputed(sequence), "frame {sequence}");
        let of_hip = shown
            .iter()
            .filter(|(region, quantity, _)| region == "hip" && quantity == "contact");
        loaded += usize::from(of_hip.map(|(_, _, area)| *area).sum::<f64>() > 1000.0);
    }
    // the simulated person lies there from the tenth minute on
    assert!(
        loaded > seen.len() / 2,
        "the hip lies on its region in {loaded} of {} frames",
        seen.len()
    );
    of_bus_found.dedup_by_key(|(sequence, _)| *sequence);
    assert!(
        of_bus_found.len() > 5,
        "{} frames read from the bus",
        of_bus_found.len()
    );
    for (sequence, quantities) in &of_bus_found {
        let bus = values(&quantities["regions"]);
        assert_eq!(bus, recomputed(&sequence.to_string()), "frame {sequence}");
    }
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
    let file = stage.path().join("night.nc");
    let out = file.display().to_string();
    let export = ["export", &id, "--format", "nc", "--out", &out];
    let written = stage.tactus(&export).and_then(|ran| ran.succeeded());
    written.unwrap_or_else(|fault| panic!("{fault}"));
    // a minute has one frame, or none; its numbers are stored as f32
    let of_frame = |frame: &Value| {
        let wall = frame["wall"].as_str().expect("a time");
        let wall = chrono::DateTime::parse_from_rfc3339(wall).expect("RFC 3339");
        let mut stored = values(&frame["regions"]);
        for (.., value) in &mut stored {
            *value = f64::from(*value as f32);
        }
        (wall.timestamp().div_euclid(60) * 60, stored)
    };
    let of_frames: BTreeMap<i64, Values> = frames.iter().map(of_frame).collect();
    assert_eq!(exported(&file), of_frames);
}
