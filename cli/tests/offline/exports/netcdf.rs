//! netCDF files, read by xarray and scipy.

use imaging::quantities::{LoadUnit, Quantity, QuantityRow, store};

use super::{BEFORE_VOLTAGES, Cells, bits, python, read, tables};
use crate::scene::{done, session, session_at_thirds_of_a_second, session_in_parts, tactus};

#[test]
fn netcdf_has_the_bits_of_the_tables() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    session_at_thirds_of_a_second(folder.path());
    let (frames, baseline) = tables(folder.path(), "last");
    done(
        folder.path(),
        &["export", "last", "--format", "nc", "--out", "out.nc"],
    );
    let read = read(&python, "read_nc.py", &folder.path().join("out.nc"));
    assert_eq!(read["version"].values, ["2"], "64-bit offset");
    assert_eq!(read["records"].values, ["3"]);
    assert_eq!(read["voltage"].shape, [3, 208]);
    assert_eq!(
        read["voltage"].bits(),
        bits(frames.block(BEFORE_VOLTAGES)),
        "voltages to the bit, NaN where missing"
    );
    assert!(read["voltage"].numbers()[208 + 7].is_nan());
    assert_eq!(read["quality"].shape, [3, 208]);
    let missing: Vec<usize> = (0..3 * 208)
        .filter(|&at| read["quality"].values[at] != "0")
        .collect();
    assert_eq!(missing, [208 + 7]);
    assert_eq!(read["quality"].values[208 + 7], "1");
    let meanings = &read["quality:flag_meanings"].values[0];
    assert_eq!(meanings, "ok overload not_measured");
    assert_eq!(read["quality:flag_values"].values[0], "0 1 3");
    assert_eq!(read["sequence"].numbers(), frames.numbers("sequence"));
    let seconds = [
        1_800_000_001.0,
        1_800_000_002.333_333,
        1_800_000_003.666_666,
    ];
    assert_eq!(read["time"].numbers(), seconds);
    for (decoded, seconds) in read["decoded"].values.iter().zip(seconds) {
        let microseconds = (decoded.parse::<i64>().unwrap() + 500).div_euclid(1000);
        assert_eq!(microseconds, (seconds * 1e6).round() as i64);
    }
    assert_eq!(read["baseline"].bits(), bits(baseline.numbers("mean_V")));
    for (name, column) in [
        ("inject_plus", "source"),
        ("inject_minus", "sink"),
        ("measure_plus", "v_plus"),
        ("measure_minus", "v_minus"),
    ] {
        assert_eq!(read[name].numbers(), baseline.numbers(column), "{name}");
    }
    assert_eq!(read["electrode"].values.len(), 16);
    for (attribute, value) in [
        (":Conventions", "'CF-1.11'"),
        (":session", "'m20270115_1'"),
        (":note", "'three frames'"),
        (":current_a", "0.001"),
        (":nplc", "1.0"),
        (":settle_s", "0.001"),
        (":baseline_session", "'b20270115_1'"),
    ] {
        let found = &read[attribute].values[0];
        assert!(found.contains(value), "{attribute}: {found}");
    }
    assert!(read[":source"].values[0].contains("SIMULATED"));
    let time = &read["time:units"].values[0];
    assert_eq!(time, "seconds since 1970-01-01 00:00:00");
    assert_eq!(read["voltage:units"].values[0], "V");
    assert_eq!(read["voltage:dimensions"].values[0], "time reading");
    assert!(!read.contains_key("map"));
}

#[test]
fn netcdf_maps_are_those_of_replay() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let method = ["--preset", "disc-tank", "--noise-v", "2e-6"];
    let replay = ["replay", "last", "--no-map", "--out", "maps.csv", "--sd"];
    done(folder.path(), &[&replay[..], &method].concat());
    let export = [
        "export", "last", "--format", "nc", "--maps", "--sd", "-o", "out.nc",
    ];
    done(folder.path(), &[&export[..], &method].concat());
    let read = read(&python, "read_nc.py", &folder.path().join("out.nc"));
    let maps = Cells::read(&folder.path().join("maps.csv"));
    let triangles = Cells::read(&folder.path().join("maps.triangles.csv"));
    let count = triangles.rows.len();
    assert_eq!(read["map"].shape, [3, count]);
    assert_eq!(read["map"].bits(), bits(maps.block(1)));
    let deviations = Cells::read(&folder.path().join("maps.sd.csv")).block(1);
    assert_eq!(read["map_sd"].bits(), bits(deviations.clone()));
    // the first frame equals the baseline, so that its deviations are unknown; the second frame lacks a reading
    let known = |row: usize| {
        !deviations[row * count..][..count]
            .iter()
            .all(|sd| sd.is_nan())
    };
    assert_eq!([known(0), known(1), known(2)], [false, true, true]);
    assert_eq!(read["element"].numbers(), triangles.numbers("element"));
    assert_eq!(read["triangle_nodes"].shape, [count, 3]);
    let nodes = read["triangle_nodes"].numbers();
    let (x, y) = (read["node_x"].numbers(), read["node_y"].numbers());
    let (centre_x, centre_y) = (triangles.numbers("x_m"), triangles.numbers("y_m"));
    for (at, corners) in nodes.chunks(3).enumerate() {
        let mean = |axis: &[f64]| corners.iter().map(|&n| axis[n as usize]).sum::<f64>() / 3.0;
        assert!((mean(&x) - centre_x[at]).abs() < 1e-9);
        assert!((mean(&y) - centre_y[at]).abs() < 1e-9);
    }
    for (attribute, value) in [
        ("mesh:cf_role", "mesh_topology"),
        ("mesh:topology_dimension", "2"),
        ("mesh:node_coordinates", "node_x node_y"),
        ("mesh:face_node_connectivity", "triangle_nodes"),
        ("triangle_nodes:start_index", "0"),
        ("map:mesh", "mesh"),
        ("map:location", "face"),
        ("map:units", "1"),
    ] {
        assert_eq!(read[attribute].values[0], value, "{attribute}");
    }
    assert!(read[":Conventions"].values[0].contains("CF-1.11 UGRID-1.0"));
}

#[test]
fn netcdf_of_parts_is_that_of_the_whole() {
    let folders = [(); 2].map(|()| tempfile::tempdir().unwrap());
    session(folders[0].path());
    session_in_parts(folders[1].path());
    let Some(python) = python() else { return };
    let [whole, parts] = folders.map(|folder| {
        done(
            folder.path(),
            &["export", "last", "--format", "nc", "--out", "out.nc"],
        );
        read(&python, "read_nc.py", &folder.path().join("out.nc"))
    });
    for name in ["voltage", "sequence", "time", "quality"] {
        assert_eq!(whole[name].bits(), parts[name].bits(), "{name}");
    }
}

#[test]
fn stored_quantities_are_those_of_the_command() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let row = |minute: i64, region: &str, quantity, mean: f64| QuantityRow {
        begin_s: 1_800_000_000 + 60 * minute,
        region: region.into(),
        quantity,
        of: LoadUnit::Pressure,
        min: mean / 3.0,
        mean,
        max: mean * 1.7,
        frames: 60,
        known: 59,
    };
    for (minute, mean) in [(0, 0.1), (1, 12.3), (7, 1e-7)] {
        let mut rows = vec![
            row(minute, "sheet", Quantity::Load, mean),
            row(minute, "sheet", Quantity::CentreX, 2.0 * mean),
        ];
        // a quantity without a value has no row
        if minute != 1 {
            rows.push(row(minute, "heel", Quantity::Load, 0.3 * mean));
        }
        store(folder.path(), "m20270115_1", &rows).unwrap();
    }
    let table = done(folder.path(), &["quantities", "last", "--csv"]);
    std::fs::write(folder.path().join("table.csv"), table).unwrap();
    let table = Cells::read(&folder.path().join("table.csv"));
    let export = ["export", "last", "--format", "nc", "--out", "out.nc"];
    done(folder.path(), &export);
    let read = read(&python, "read_nc.py", &folder.path().join("out.nc"));
    let minutes = [1_800_000_000.0, 1_800_000_060.0, 1_800_000_420.0];
    assert_eq!(read["minute"].numbers(), minutes);
    assert_eq!(read["region:names"].values[0], "sheet heel");
    assert_eq!(read["load_mean:units"].values[0], "N");
    assert_eq!(read["load_mean"].shape, [3, 2]);
    assert!(!read.contains_key("peak_mean"));
    for ending in ["min", "mean", "max"] {
        let of = |region: &str, quantity: &str| -> Vec<f64> {
            let rows = std::iter::zip(table.column("region"), table.column("quantity"));
            let chosen = rows.zip(table.numbers(ending));
            let chosen = chosen.filter(|(row, _)| *row == (region, quantity));
            chosen.map(|(_, value)| value).collect()
        };
        let (sheet, heel) = (of("sheet", "load"), of("heel", "load"));
        let load = [sheet[0], heel[0], sheet[1], f64::NAN, sheet[2], heel[1]];
        assert_eq!(
            read[&format!("load_{ending}")].bits(),
            bits(load),
            "{ending}"
        );
        let nan = f64::NAN;
        let centre = of("sheet", "centre-x");
        let centre = [centre[0], nan, centre[1], nan, centre[2], nan];
        let name = format!("centre_x_{ending}");
        assert_eq!(read[&name].bits(), bits(centre), "{ending}");
    }
    // quantities do not change the frames
    assert_eq!(read["voltage"].shape, [3, 208]);
    assert_eq!(read["sequence"].numbers(), [1.0, 2.0, 3.0]);
}

#[test]
fn stored_quantities_survive_a_clock_that_is_set_back() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let row = |minute: i64, of, load: f64| QuantityRow {
        begin_s: 1_800_000_000 + 60 * minute,
        region: "sheet".into(),
        quantity: Quantity::Load,
        of,
        min: load,
        mean: load,
        max: load,
        frames: 60,
        known: 60,
    };
    // the clock is set back by two minutes after the third row; calibrated from the second row on
    for (minute, of, load) in [
        (0, LoadUnit::RelativeLoss, 0.5),
        (5, LoadUnit::Pressure, 1.0),
        (6, LoadUnit::Pressure, 2.0),
        (4, LoadUnit::Pressure, 3.0),
        (5, LoadUnit::Pressure, 5.0),
    ] {
        store(folder.path(), "m20270115_1", &[row(minute, of, load)]).unwrap();
    }
    let export = ["export", "last", "--format", "nc", "--out", "out.nc"];
    let output = tactus(folder.path(), &export);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{message}");
    assert!(message.contains("in another unit"), "{message}");
    let read = read(&python, "read_nc.py", &folder.path().join("out.nc"));
    let minutes = [1_800_000_240.0, 1_800_000_300.0, 1_800_000_360.0];
    assert_eq!(read["minute"].numbers(), minutes);
    assert_eq!(read["load_mean:units"].values[0], "N");
    assert_eq!(read["load_mean"].numbers(), [3.0, 3.0, 2.0]);
    assert_eq!(read["load_max"].numbers(), [3.0, 5.0, 2.0]);
}
