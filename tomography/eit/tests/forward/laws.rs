//! Physical laws for the forward model and its derivatives, on any mesh.

use std::sync::Arc;

use crate::parts::{eight, grid, spread};
use eit::{Forward, Mesh};
use nalgebra::DVector;
use survey::{Dipole, Electrode, Protocol, skip};

/// Contacts on both sides of the change of electrode form, on eight electrodes at 1 kohm per square.
const MIXED: [f64; 8] = [0.0, 1e-12, 1e-6, 0.1, 5.0, 20.0, 1e3, 1e9];

fn model(mesh: Mesh, contacts: &[f64]) -> (Forward, Vec<f64>) {
    let sigma = spread(mesh.triangles().len(), 1e-3, 10.0);
    (Forward::new(Arc::new(mesh), contacts).unwrap(), sigma)
}

/// Adjacent and other pairs, including some that share an electrode: every electrode form is driven and sensed.
fn all_pairs() -> Protocol {
    let pairs: Vec<Dipole> = (0..8)
        .flat_map(|k| [Dipole::skip(k, 0, 8), Dipole::skip(k, 2, 8)])
        .collect();
    let questions = pairs
        .iter()
        .flat_map(|&drive| {
            pairs
                .iter()
                .map(move |&sense| survey::Measurement { drive, sense })
        })
        .collect();
    Protocol::new(8, questions).unwrap()
}

fn largest_difference(a: &DVector<f64>, b: &DVector<f64>) -> f64 {
    (a - b).amax() / b.amax()
}

#[test]
fn source_and_voltmeter_may_change_places() {
    for contacts in [MIXED, [2.4; 8], [0.0; 8], [1e6; 8]] {
        let (forward, sigma) = model(eight(0.5), &contacts);
        let protocol = Protocol::new(8, skip(8, 0).chain(skip(8, 2)).collect()).unwrap();
        let readings = forward.readings(&sigma, &protocol).unwrap();
        for (reading, twin) in protocol.reciprocal_twins().into_iter().enumerate() {
            let twin = twin.unwrap();
            assert!((readings[reading] - readings[twin]).abs() < 1e-12 * readings.amax());
        }
    }
}

#[test]
fn units_scale_together() {
    let (forward, sigma) = model(eight(0.5), &MIXED[..6].repeat(2)[..8]);
    let protocol = all_pairs();
    let before = forward.readings(&sigma, &protocol).unwrap();
    for c in [1e-9, 1e-3, 1e3, 1e9] {
        let contacts: Vec<f64> = forward.contact_ohm_m().iter().map(|z| z / c).collect();
        let scaled: Vec<f64> = sigma.iter().map(|s| s * c).collect();
        let after = Forward::new(forward.mesh().clone(), &contacts)
            .unwrap()
            .readings(&scaled, &protocol)
            .unwrap();
        let error = largest_difference(&(after * c), &before);
        assert!(error < 1e-12, "c = {c:e}: {error:e}");
    }
}

#[test]
fn scaled_sheet_with_scaled_contacts_reads_the_same() {
    let contacts = [0.5, 1e-3, 7.0, 40.0, 0.0, 1.0, 2.0, 3.0];
    let (forward, sigma) = model(eight(0.5), &contacts);
    let mesh = forward.mesh();
    let larger = Mesh::new(
        mesh.nodes().iter().map(|p| p.map(|x| 2.0 * x)).collect(),
        mesh.triangles().to_vec(),
        mesh.electrode_edges().to_vec(),
        None,
    )
    .unwrap();
    let doubled = contacts.map(|z| 2.0 * z);
    let protocol = all_pairs();
    let before = forward.readings(&sigma, &protocol).unwrap();
    let after = Forward::new(Arc::new(larger), &doubled)
        .unwrap()
        .readings(&sigma, &protocol)
        .unwrap();
    assert!(largest_difference(&after, &before) < 1e-13);
}

#[test]
fn euler_sums_the_derivatives_to_the_voltage() {
    // Σ σ ∂V/∂σ - Σ z ∂V/∂z = -V
    let contacts = [0.5, 1e-6, 7.0, 40.0, 0.0, 1e-12, 200.0, 3.0];
    let (forward, sigma) = model(eight(0.5), &contacts);
    let protocol = all_pairs();
    let readings = forward.readings(&sigma, &protocol).unwrap();
    let by_sigma =
        forward.jacobian(&sigma, &protocol).unwrap() * DVector::from_column_slice(&sigma);
    let by_contact = forward.contact_jacobian(&sigma, &protocol).unwrap()
        * DVector::from_column_slice(&contacts);
    let error = largest_difference(&(by_contact - by_sigma), &readings);
    println!("Euler: {error:.1e}");
    assert!(error < 1e-12, "{error:e}");
}

/// The slope of the remainder's logarithm over that of the step.
fn slopes(remainder: impl Fn(f64) -> f64) -> Vec<f64> {
    let errors: Vec<f64> = (0..5).map(|k| remainder(0.1 / f64::from(1 << k))).collect();
    errors
        .windows(2)
        .map(|pair| (pair[0] / pair[1]).log2())
        .collect()
}

#[test]
fn first_order_remainder_falls_with_the_square_of_the_step() {
    let contacts = [0.5, 1e-3, 7.0, 40.0, 0.2, 1.0, 2.0, 300.0];
    let (forward, sigma) = model(eight(0.5), &contacts);
    let protocol = all_pairs();
    let v = forward.readings(&sigma, &protocol).unwrap();
    let along = DVector::from_fn(sigma.len(), |t, _| sigma[t] * crate::parts::wobble(t + 99));
    let first = forward.jacobian(&sigma, &protocol).unwrap() * &along;
    for slope in slopes(|h| {
        let moved: Vec<f64> = sigma
            .iter()
            .zip(along.iter())
            .map(|(s, d)| s + h * d)
            .collect();
        (forward.readings(&moved, &protocol).unwrap() - &v - h * &first).norm()
    }) {
        assert!((slope - 2.0).abs() < 0.05, "by sigma: {slope}");
    }
    let along = DVector::from_fn(8, |l, _| contacts[l] * crate::parts::wobble(l));
    let first = forward.contact_jacobian(&sigma, &protocol).unwrap() * &along;
    for slope in slopes(|h| {
        let moved: Vec<f64> = contacts
            .iter()
            .zip(along.iter())
            .map(|(z, d)| z + h * d)
            .collect();
        let moved = Forward::new(forward.mesh().clone(), &moved).unwrap();
        (moved.readings(&sigma, &protocol).unwrap() - &v - h * &first).norm()
    }) {
        assert!((slope - 2.0).abs() < 0.05, "by contact: {slope}");
    }
}

#[test]
fn a_uniform_field_is_exact_on_any_mesh() {
    // the patch test: u = 1/2 - x/L between electrodes that cover two sides, on a mesh with displaced nodes
    for (push, z) in [(0.0, 3.0), (0.5, 3.0), (0.5, 1e-9), (0.5, 1e5)] {
        let mesh = grid([0.3, 0.2], [23, 17], push, &[(3, 0, 17), (1, 0, 17)]);
        let sigma = vec![1e-3; mesh.triangles().len()];
        let forward = Forward::new(Arc::new(mesh), &[z, z]).unwrap();
        let pair = Dipole {
            plus: Electrode(0),
            minus: Electrode(1),
        };
        let fields = forward.solve(&sigma, &[pair]).unwrap();
        let field = 1.0 / (1e-3 * 0.2);
        for (node, p) in forward.mesh().nodes().iter().enumerate() {
            let exact = field * (0.15 - p[0]);
            let error = (fields.potentials[(node, 0)] - exact).abs();
            assert!(
                error < 1e-12 * field * 0.3,
                "z {z:e}, node {node}: {error:e}"
            );
        }
    }
}

/// Largest error at the nodes for u = x + sin(2 pi x)/8 on the unit square between two shunts: with sigma = g(y) /
/// u'(x) the flux sigma u' = g(y) has no divergence, and is zero through bottom and top.
fn manufactured(cells: usize) -> f64 {
    let pi = std::f64::consts::PI;
    let u = |x: f64| x + (2.0 * pi * x).sin() / 8.0;
    let slope = |x: f64| 1.0 + pi / 4.0 * (2.0 * pi * x).cos();
    let g = |y: f64| 1.0 + 0.5 * (pi * y).cos();
    let mesh = grid(
        [1.0, 1.0],
        [cells, cells],
        0.3,
        &[(3, 0, cells), (1, 0, cells)],
    );
    let sigma: Vec<f64> = (0..mesh.triangles().len())
        .map(|t| mesh.centroid(t))
        .map(|[x, y]| g(y) / slope(x))
        .collect();
    let forward = Forward::new(Arc::new(mesh), &[0.0, 0.0]).unwrap();
    // the total current is that of g, 1 A, entering at x = 1; the gauge sets u = 1/2 to zero
    let pair = Dipole {
        plus: Electrode(1),
        minus: Electrode(0),
    };
    let fields = forward.solve(&sigma, &[pair]).unwrap();
    forward
        .mesh()
        .nodes()
        .iter()
        .enumerate()
        .map(|(node, p)| (fields.potentials[(node, 0)] - (u(p[0]) - 0.5)).abs())
        .fold(0.0, f64::max)
}

#[test]
fn halving_the_edges_quarters_the_error() {
    let errors: Vec<f64> = [16, 32, 64].map(manufactured).to_vec();
    println!("errors {errors:?}");
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!(
            (order - 2.0).abs() < 0.2,
            "order {order}, errors {errors:?}"
        );
    }
}

#[test]
fn the_transfer_impedance_holds_every_reading() {
    let (forward, sigma) = model(eight(0.5), &[0.5, 1e-6, 7.0, 40.0, 0.0, 1e-12, 200.0, 3.0]);
    let z = forward.transfer_impedance(&sigma).unwrap();
    assert_eq!(z, z.transpose());
    assert!(z.row_sum().amax() < 1e-12 * z.amax());
    let protocol = all_pairs();
    let readings = forward.readings(&sigma, &protocol).unwrap();
    for (question, reading) in protocol.measurements().iter().zip(readings.iter()) {
        let (d, s) = (question.drive, question.sense);
        let from_z = z[(s.plus.0, d.plus.0)] - z[(s.plus.0, d.minus.0)] - z[(s.minus.0, d.plus.0)]
            + z[(s.minus.0, d.minus.0)];
        assert!((from_z - reading).abs() < 1e-13 * readings.amax());
    }
}

/// Eq. 2 of the paper: i = Y v, v = Z i, both symmetric with zero row sums; with two shunts, a single resistor.
#[test]
fn admittance_and_impedance_are_inverse_to_one_another() {
    for contacts in [
        [0.5, 1e-3, 7.0, 40.0, 0.2, 1.0, 2.0, 300.0],
        [0.0, 1e-9, 1e-4, 1.0, 0.0, 10.0, 1e-4, 10.0],
    ] {
        let (forward, sigma) = model(eight(0.5), &contacts);
        let z = forward.transfer_impedance(&sigma).unwrap();
        let y = forward.transfer_admittance(&sigma).unwrap();
        assert_eq!((z.transpose(), y.transpose()), (z.clone(), y.clone()));
        let identity = &y * &z;
        for row in 0..8 {
            assert!(z.row(row).sum().abs() < 1e-12 * z.amax());
            assert!(y.row(row).sum().abs() < 1e-15 * y.amax());
            for column in 0..8 {
                let wanted = f64::from(u8::from(row == column)) - 1.0 / 8.0;
                let error = (identity[(row, column)] - wanted).abs();
                assert!(error < 1e-11, "{row}, {column}: {error:e}");
            }
        }
    }
    let mesh = grid([0.3, 0.2], [23, 17], 0.5, &[(3, 0, 17), (1, 0, 17)]);
    let (forward, _) = model(mesh, &[0.0, 0.0]);
    let sigma = vec![1e-3; forward.mesh().triangles().len()];
    let y = forward.transfer_admittance(&sigma).unwrap();
    assert!((y[(0, 0)] / (1e-3 * 0.2 / 0.3) - 1.0).abs() < 1e-12);
    assert_eq!(y[(0, 1)], -y[(0, 0)]);
}

#[test]
fn the_energy_is_the_voltage() {
    // V = ∫ σ ∇u·∇u + Σ ∫ (u - U)²/z
    let contacts = [0.5, 0.1, 7.0, 40.0, 3.0, 2.0, 200.0, 3.0];
    let (forward, sigma) = model(eight(0.5), &contacts);
    let drive = Dipole::adjacent(3, 8);
    let question = survey::Measurement {
        drive,
        sense: drive,
    };
    let protocol = Protocol::new(8, vec![question]).unwrap();
    let volts = forward.readings(&sigma, &protocol).unwrap()[0];
    let mut energy = 0.0;
    let by_sigma = forward.jacobian(&sigma, &protocol).unwrap();
    for (t, s) in sigma.iter().enumerate() {
        energy -= by_sigma[(0, t)] * s;
    }
    let fields = forward.solve(&sigma, &[drive]).unwrap();
    for (l, z) in contacts.iter().enumerate() {
        for &[a, b] in &forward.mesh().electrode_edges()[l] {
            let h = forward.mesh().edge_length([a, b]);
            let drop = |n: usize| fields.potentials[(n, 0)] - fields.electrodes[(l, 0)];
            let (p, q) = (drop(a), drop(b));
            energy += h / (3.0 * z) * (p * p + p * q + q * q);
        }
    }
    assert!(
        (energy / volts - 1.0).abs() < 1e-11,
        "{energy} against {volts}"
    );
}
