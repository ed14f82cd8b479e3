//! Comparison with published values and with hand calculations.

use std::sync::Arc;

use eit::{Case, Forward, Mesh, Table};
use survey::{Dipole, Electrode};

fn table(path: &std::path::Path) -> Vec<Vec<f64>> {
    let rows = Table::read(path).unwrap().rows;
    rows.into_iter()
        .map(|row| row.into_iter().map(Option::unwrap).collect())
        .collect()
}

#[test]
fn disc16_voltages() {
    let folder = needs::case("disc16");
    let case = Case::read(&folder).unwrap();
    assert_eq!(
        case.coarse_electrodes().len(),
        16,
        "two edges each: accepted, and said"
    );
    let forward = Forward::new(case.mesh.clone(), &case.contact_ohm_m).unwrap();
    for name in ["homog", "one", "random"] {
        let exact = table(&folder.join(format!("v_exact_{name}.csv")));
        let largest = exact
            .iter()
            .fold(0.0_f64, |most, row| most.max(row[0].abs()));
        let got = forward.readings(&case.sigma[name], &case.protocol).unwrap();
        let error = got
            .iter()
            .zip(&exact)
            .fold(0.0_f64, |most, (v, row)| most.max((v - row[0]).abs()));
        println!("disc16 v {name}: {:.1e}", error / largest);
        assert!(error <= 1e-13 * largest, "{name}: {:e}", error / largest);
    }
    for name in ["homog", "one"] {
        let exact = table(&folder.join(format!("U_exact_{name}.csv")));
        let drives: Vec<Dipole> = (0..16).map(|k| Dipole::adjacent(k, 16)).collect();
        let fields = forward.solve(&case.sigma[name], &drives).unwrap();
        let (mut error, mut largest) = (0.0_f64, 0.0_f64);
        for (drive, row) in exact.iter().enumerate() {
            for (electrode, value) in row.iter().enumerate() {
                error = error.max((fields.electrodes[(electrode, drive)] - value).abs());
                largest = largest.max(value.abs());
            }
        }
        println!("disc16 U {name}: {:.1e}", error / largest);
        assert!(error <= 1e-13 * largest, "{name}: {:e}", error / largest);
    }
}

#[test]
fn disc16_jacobian() {
    let folder = needs::case("disc16");
    let case = Case::read(&folder).unwrap();
    let forward = Forward::new(case.mesh.clone(), &case.contact_ohm_m).unwrap();
    // the first reading of each drive
    let exact = table(&folder.join("J_homog_every_13th.csv"));
    assert_eq!((exact.len(), exact[0].len()), (16, 780));
    let got = forward
        .jacobian(&case.sigma["homog"], &case.protocol)
        .unwrap();
    let (mut error, mut largest) = (0.0_f64, 0.0_f64);
    for (drive, row) in exact.iter().enumerate() {
        for (element, value) in row.iter().enumerate() {
            error = error.max((got[(13 * drive, element)] - value).abs());
            largest = largest.max(value.abs());
        }
    }
    println!("disc16 J: {:.1e}", error / largest);
    assert!(error <= 1e-11 * largest, "{:e}", error / largest);
}

/// A rectangle with any columns and rows, electrodes on its left and right sides, and displaced inner nodes.
fn strip(length: f64, width: f64, columns: &[f64], rows: usize, push: f64) -> Mesh {
    let mut nodes = Vec::new();
    for (i, share) in columns.iter().enumerate() {
        for j in 0..=rows {
            // an irregular but repeatable displacement; never along x, so that the border of the two conductances stays
            // straight
            let wobble = ((i * 7919 + j * 104_729) as f64 * 0.618).fract() - 0.5;
            let inner = f64::from(u8::from(j > 0 && j < rows));
            nodes.push([
                length * share,
                width * (j as f64 + push * wobble * inner) / rows as f64,
            ]);
        }
    }
    let node = |i: usize, j: usize| i * (rows + 1) + j;
    let mut triangles = Vec::new();
    for i in 0..columns.len() - 1 {
        for j in 0..rows {
            let [a, b, c, d] = [
                node(i, j),
                node(i + 1, j),
                node(i + 1, j + 1),
                node(i, j + 1),
            ];
            if (i + j) % 2 == 0 {
                triangles.extend([[a, b, c], [a, c, d]]);
            } else {
                triangles.extend([[a, b, d], [b, c, d]]);
            }
        }
    }
    let side = |i: usize| (0..rows).map(|j| [node(i, j), node(i, j + 1)]).collect();
    Mesh::new(
        nodes,
        triangles,
        vec![side(0), side(columns.len() - 1)],
        None,
    )
    .unwrap()
}

#[test]
fn strips_have_the_resistance_a_pencil_gives() {
    let path = needs::case("strip.csv");
    let pair = Dipole {
        plus: Electrode(0),
        minus: Electrode(1),
    };
    for (row, case) in table(&path).iter().enumerate() {
        let [
            _,
            length,
            width,
            split,
            left,
            right,
            z_left,
            z_right,
            current,
            voltage,
        ] = case[..]
        else {
            panic!("ten columns")
        };
        let share = split / length;
        for (cut, rows, push) in [(1, 1, 0.0), (5, 7, 0.0), (20, 19, 0.7)] {
            let mut columns: Vec<f64> = (0..=cut).map(|k| share * k as f64 / cut as f64).collect();
            if share < 1.0 {
                columns.extend((1..=cut).map(|k| share + (1.0 - share) * k as f64 / cut as f64));
            }
            *columns.last_mut().unwrap() = 1.0;
            let mesh = Arc::new(strip(length, width, &columns, rows, push));
            let sigma: Vec<f64> = (0..mesh.triangles().len())
                .map(|t| {
                    if mesh.centroid(t)[0] < split {
                        left
                    } else {
                        right
                    }
                })
                .collect();
            let forward = Forward::new(mesh, &[z_left, z_right]).unwrap();
            let fields = forward.solve(&sigma, &[pair]).unwrap();
            let got = current * (fields.electrodes[(0, 0)] - fields.electrodes[(1, 0)]);
            let error = (got / voltage - 1.0).abs();
            println!("strip {row}, {} triangles: {error:.1e}", sigma.len());
            assert!(error <= 1e-12, "strip {row}: {got} against {voltage}");
        }
    }
}
