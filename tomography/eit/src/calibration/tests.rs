//! Known presses are recovered; unusable ones are refused.

use super::fit::frame;
use super::*;
use crate::DiscTank;

/// Presses on a tank; their maps are smooth bumps whose heights depend on pressure and position.
fn presses(mesh: &Mesh, wrong: f64) -> Vec<KnownPress> {
    let frame = frame(mesh);
    let centroids = mesh.region_centroids();
    let mut presses = Vec::new();
    for (k, (kpa, x, y)) in [
        (5.0, 0.0, 0.0),
        (5.0, 0.5, 0.0),
        (10.0, 0.0, 0.4),
        (10.0, -0.5, 0.1),
        (20.0, 0.0, 0.0),
        (20.0, 0.4, 0.4),
        (40.0, -0.3, -0.4),
        (40.0, 0.1, 0.5),
        (40.0, 0.0, 0.0),
        (30.0, 0.45, -0.2),
        (15.0, -0.45, -0.1),
        (25.0, 0.2, 0.2),
    ]
    .into_iter()
    .enumerate()
    {
        let centre = [frame[0] + x * frame[2], frame[1] + y * frame[3]];
        let area = 4e-3;
        let radius = (area / std::f64::consts::PI).sqrt();
        let seen = 1.0 + 0.6 * (x * x + y * y);
        let top = kpa / (kpa + 25.0) * seen;
        let values = centroids
            .iter()
            .map(|p| {
                let d = (p[0] - centre[0]).hypot(p[1] - centre[1]) / radius;
                if d <= 1.0 {
                    -top
                } else {
                    -top * (-4.0 * (d - 1.0)).exp()
                }
            })
            .collect();
        presses.push(KnownPress {
            name: format!("press {}", k + 1),
            map: Map::relative(mesh.hash().to_owned(), values, "bump"),
            centre,
            area,
            newtons: 1e3 * kpa * area * if k % 3 == 0 { wrong } else { 1.0 },
        });
    }
    presses
}

fn tank() -> Mesh {
    DiscTank::default().mesh().unwrap()
}

#[test]
fn known_presses_come_back_within_a_tenth() {
    let mesh = tank();
    let presses = presses(&mesh, 1.0);
    let calibration = Calibration::fit(&mesh, &presses).unwrap();
    calibration.check().unwrap();
    assert!(calibration.rms < 0.1, "{calibration:?}");
    assert!(calibration.kpa.windows(2).all(|pair| pair[0] <= pair[1]));
    for press in &presses {
        let found = calibration.pressure(&mesh, &press.map).unwrap();
        let off = found.newtons / press.newtons - 1.0;
        assert!(off.abs() < 0.2, "{}: {off}", press.name);
    }
    // without a gain over the position, the force of the outer presses is overestimated
    let flat = Calibration {
        gain: [0.0; TERMS],
        ..calibration.clone()
    };
    let outer = presses[1].clone();
    let (with, without) = (
        calibration.pressure(&mesh, &outer.map).unwrap().newtons,
        flat.pressure(&mesh, &outer.map).unwrap().newtons,
    );
    assert!((without - outer.newtons).abs() > (with - outer.newtons).abs());
}

#[test]
fn too_few_alike_contradictory_and_unseen_presses_are_refused() {
    let mesh = tank();
    let good = presses(&mesh, 1.0);
    let refused = |presses: &[KnownPress], wanted: &str| {
        let refused = Calibration::fit(&mesh, presses).unwrap_err().to_string();
        assert!(refused.contains(wanted), "{refused}");
    };
    refused(&good[..5], "5 presses are too few for a calibration; 6");
    let alike: Vec<KnownPress> = good
        .iter()
        .map(|press| KnownPress {
            newtons: good[0].newtons,
            ..press.clone()
        })
        .collect();
    refused(
        &alike,
        "the presses have 1 different pressures; a curve needs 3",
    );
    refused(
        &presses(&mesh, 8.0),
        "the presses contradict each other: no single curve",
    );
    let mut unseen = good.clone();
    unseen[2].map.values.fill(0.0);
    refused(&unseen, "press 3");
    let mut weightless = good.clone();
    weightless[4].newtons = 0.0;
    refused(&weightless, "force is 0, it must be a positive number");
}

#[test]
fn presses_with_maps_of_two_methods_are_refused() {
    let mesh = tank();
    let mut mixed = presses(&mesh, 1.0);
    mixed[3].map.method = "disc".to_owned();
    let refused = Calibration::fit(&mesh, &mixed).unwrap_err();
    let message = refused.to_string();
    for word in ["'bump'", "'disc'", "press 4"] {
        assert!(message.contains(word), "{message}");
    }
}

#[test]
fn another_method_mesh_or_file_is_refused() {
    let mesh = tank();
    let good = presses(&mesh, 1.0);
    let calibration = Calibration::fit(&mesh, &good).unwrap();
    let mut other = good[0].map.clone();
    other.method = "another".to_owned();
    assert!(calibration.pressure(&mesh, &other).is_err());
    let falling = Calibration {
        kpa: calibration.kpa.iter().rev().copied().collect(),
        ..calibration.clone()
    };
    assert!(falling.check().is_err());
    let lifted = Calibration {
        kpa: calibration.kpa.iter().map(|kpa| kpa + 1.0).collect(),
        ..calibration.clone()
    };
    let refused = lifted.check().unwrap_err().to_string();
    assert!(refused.contains("kpa must begin with 0"), "{refused}");
    let foreign = Calibration {
        kind: "something".to_owned(),
        ..calibration
    };
    assert!(foreign.check().is_err());
}
