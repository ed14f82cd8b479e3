//! Hard cases by name: a finite result or a typed error, never a silent wrong one.

use std::sync::Arc;

use crate::parts::{eight, spread};
use eit::{DiscTank, FLOOR, Forward, ForwardError, Mesh};
use nalgebra::DVector;
use survey::{Dipole, Electrode, Protocol};

fn readings(mesh: &Arc<Mesh>, contacts: &[f64], sigma: &[f64]) -> DVector<f64> {
    let protocol = Protocol::sheffield(mesh.electrodes()).unwrap();
    Forward::new(mesh.clone(), contacts)
        .unwrap()
        .readings(sigma, &protocol)
        .unwrap()
}

fn uniform(mesh: &Mesh) -> Vec<f64> {
    vec![1e-3; mesh.triangles().len()]
}

fn largest_difference(a: &DVector<f64>, b: &DVector<f64>) -> f64 {
    (a - b).amax() / b.amax()
}

/// Triangles within a square in the middle of [`eight`]'s sheet.
fn middle(mesh: &Mesh) -> Vec<usize> {
    (0..mesh.triangles().len())
        .filter(|&t| {
            let [x, y] = mesh.centroid(t);
            (x - 0.1).abs() < 0.03 && (y - 0.115).abs() < 0.03
        })
        .collect()
}

fn with(mesh: &Mesh, triangles: &[usize], value: f64) -> Vec<f64> {
    let mut sigma = uniform(mesh);
    triangles.iter().for_each(|&t| sigma[t] = value);
    sigma
}

#[test]
fn contacts_of_any_size_on_either_side_of_the_change_of_form() {
    let mesh = Arc::new(eight(0.5));
    let sigma = spread(mesh.triangles().len(), 1e-3, 10.0);
    // the readings are continuous where the electrode form changes: at z/|e| of about 1 kohm a square, |e| = 0.02 m
    for z in [
        1e-15, 1e-9, 1e-3, 1.0, 15.0, 19.0, 20.0, 21.0, 25.0, 1e3, 1e9, 1e15,
    ] {
        let (below, above) = (
            readings(&mesh, &[z; 8], &sigma),
            readings(&mesh, &[z * (1.0 + 1e-9); 8], &sigma),
        );
        let jump = largest_difference(&above, &below);
        assert!(jump < 2e-9, "z = {z:e}: {jump:e}");
    }
}

#[test]
fn a_contact_that_vanishes_tends_to_the_shunt() {
    let mesh = Arc::new(eight(0.5));
    let sigma = uniform(&mesh);
    let shunt = readings(&mesh, &[0.0; 8], &sigma);
    let mut last = f64::INFINITY;
    for z in [1e-2, 1e-3, 1e-4, 1e-6, 1e-9, 1e-12, 1e-14] {
        let difference = largest_difference(&readings(&mesh, &[z; 8], &sigma), &shunt);
        assert!(
            difference < 0.3 * last || difference < 1e-13,
            "z = {z:e}: {difference:e}"
        );
        last = difference;
    }
    assert!(last < 1e-13);
}

#[test]
fn a_contact_that_opens_has_a_limit() {
    let mesh = Arc::new(eight(0.5));
    let sigma = uniform(&mesh);
    let length = 0.02;
    let limit = readings(&mesh, &[1e14 * length; 8], &sigma);
    for ohm in [1e6, 1e9, 1e12, 1e15] {
        let got = readings(&mesh, &[ohm * length; 8], &sigma);
        let difference = largest_difference(&got, &limit);
        assert!(
            difference <= 0.02 * 1e3 / ohm + 1e-12,
            "{ohm:e} ohm: {difference:e}"
        );
    }
    // one electrode with an extreme contact: the others do not depend on its value
    let mut contacts = [2.0; 8];
    contacts[4] = 1e9;
    let far = readings(&mesh, &contacts, &sigma);
    contacts[4] = 1e12;
    let farther = readings(&mesh, &contacts, &sigma);
    let protocol = Protocol::sheffield(8).unwrap();
    for (k, question) in protocol.measurements().iter().enumerate() {
        if !(question.drive.contains(Electrode(4)) || question.sense.contains(Electrode(4))) {
            assert!((far[k] - farther[k]).abs() < 1e-8 * farther.amax());
        }
    }
}

#[test]
fn a_hole_may_be_meshed_out_or_left_without_conductance() {
    let mesh = Arc::new(eight(0.5));
    let hole = middle(&mesh);
    let floored = with(&mesh, &hole, 0.0);
    let forward = Forward::new(mesh.clone(), &[2.0; 8]).unwrap();
    assert_eq!(forward.admit(&floored).unwrap().floored, hole.len());
    let fields = forward.solve(&floored, &[Dipole::adjacent(0, 8)]).unwrap();
    assert_eq!(fields.floored, hole.len());
    assert!(fields.potentials.iter().all(|u| u.is_finite()));
    let left = readings(&mesh, &[2.0; 8], &floored);
    let kept: Vec<[usize; 3]> = (0..mesh.triangles().len())
        .filter(|t| !hole.contains(t))
        .map(|t| mesh.triangles()[t])
        .collect();
    let mut new = vec![usize::MAX; mesh.nodes().len()];
    let mut nodes = Vec::new();
    for &node in kept.iter().flatten() {
        if new[node] == usize::MAX {
            new[node] = nodes.len();
            nodes.push(mesh.nodes()[node]);
        }
    }
    let cut = Mesh::new(
        nodes,
        kept.iter().map(|t| t.map(|node| new[node])).collect(),
        mesh.electrode_edges()
            .iter()
            .map(|edges| edges.iter().map(|e| e.map(|node| new[node])).collect())
            .collect(),
        None,
    )
    .unwrap();
    let cut = Arc::new(cut);
    let out = readings(&cut, &[2.0; 8], &uniform(&cut));
    assert!(largest_difference(&left, &out) < 1e-7);
    const { assert!(FLOOR == 1e-8) };
}

#[test]
fn an_insulating_patch_of_any_contrast() {
    let mesh = Arc::new(eight(0.5));
    let patch = middle(&mesh);
    let limit = readings(&mesh, &[2.0; 8], &with(&mesh, &patch, 1e-3 * 1e-16));
    for contrast in [1e-4, 1e-6, 1e-9, 1e-12] {
        let got = readings(&mesh, &[2.0; 8], &with(&mesh, &patch, 1e-3 * contrast));
        let difference = largest_difference(&got, &limit);
        assert!(
            difference <= 2.0 * contrast + 1e-13,
            "{contrast:e}: {difference:e}"
        );
    }
}

#[test]
fn a_patch_of_metal_of_any_contrast() {
    let mesh = Arc::new(eight(0.5));
    let patch = middle(&mesh);
    let limit = readings(&mesh, &[2.0; 8], &with(&mesh, &patch, 1e-3 * 1e12));
    for contrast in [1e2, 1e4, 1e6, 1e8] {
        let got = readings(&mesh, &[2.0; 8], &with(&mesh, &patch, 1e-3 * contrast));
        let difference = largest_difference(&got, &limit);
        assert!(
            difference <= 2.0 / contrast + 1e-9,
            "{contrast:e}: {difference:e}"
        );
    }
}

#[test]
fn a_patch_without_conductance_where_the_ground_would_be() {
    // nearly everything far from an electrode is insulating
    let mesh = Arc::new(eight(0.0));
    let most: Vec<usize> = (0..mesh.triangles().len())
        .filter(|&t| {
            let [x, y] = mesh.centroid(t);
            (x - 0.1).abs() < 0.07 && (y - 0.115).abs() < 0.08
        })
        .collect();
    let thin = readings(&mesh, &[2.0; 8], &with(&mesh, &most, 1e-3 * 1e-15));
    let thinner = readings(&mesh, &[2.0; 8], &with(&mesh, &most, 1e-3 * 1e-16));
    assert!(largest_difference(&thin, &thinner) < 1e-12);
}

#[test]
fn a_sliver_hardly_matters() {
    let plain = eight(0.0);
    let before = readings(&Arc::new(plain.clone()), &[2.0; 8], &uniform(&plain));
    // split the first inner triangle at a point just above the middle of its longest side
    let t = middle(&plain)[0];
    let [a, b, c] = plain.triangles()[t];
    let [p, q, r] = plain.corners(t);
    let half = 0.5 * plain.edge_length([a, b]);
    let up = half * 0.01_f64.to_radians().tan();
    let side = [q[0] - p[0], q[1] - p[1]];
    let unit = plain.edge_length([a, b]);
    let normal = [-side[1] / unit, side[0] / unit];
    assert!(plain.area(t) > 0.0 && r != p);
    let mut nodes = plain.nodes().to_vec();
    nodes.push([0, 1].map(|i| 0.5 * (p[i] + q[i]) + up * normal[i]));
    let n = nodes.len() - 1;
    let mut triangles = plain.triangles().to_vec();
    triangles[t] = [a, b, n];
    triangles.extend([[b, c, n], [c, a, n]]);
    let sliver = Mesh::new(nodes, triangles, plain.electrode_edges().to_vec(), None).unwrap();
    assert!(sliver.quality().smallest_angle < 0.011);
    let after = readings(&Arc::new(sliver.clone()), &[2.0; 8], &uniform(&sliver));
    assert!(largest_difference(&after, &before) < 1e-5);
}

#[test]
fn numbering_does_not_matter() {
    let mesh = eight(0.5);
    let sigma = spread(mesh.triangles().len(), 1e-3, 10.0);
    let contacts = [0.0, 1e-9, 1.0, 5.0, 19.0, 25.0, 1e3, 1e6];
    let before = readings(&Arc::new(mesh.clone()), &contacts, &sigma);
    // the nodes permuted, the triangles in reverse order
    let count = mesh.nodes().len();
    let place = |node: usize| (node * 1_000_003) % count;
    let mut nodes = vec![[0.0; 2]; count];
    (0..count).for_each(|node| nodes[place(node)] = mesh.nodes()[node]);
    let shuffled = Mesh::new(
        nodes,
        mesh.triangles()
            .iter()
            .rev()
            .map(|t| t.map(place))
            .collect(),
        mesh.electrode_edges()
            .iter()
            .map(|edges| edges.iter().map(|e| e.map(place)).collect())
            .collect(),
        None,
    )
    .unwrap();
    let backwards: Vec<f64> = sigma.iter().rev().copied().collect();
    let after = readings(&Arc::new(shuffled), &contacts, &backwards);
    let error = largest_difference(&after, &before);
    assert!(error < 1e-14, "{error:e}");
}

#[test]
fn the_same_question_has_the_same_bits() {
    let tank = DiscTank::default();
    let mesh = Arc::new(tank.mesh().unwrap());
    let sigma = spread(mesh.triangles().len(), 1e-3, 3.0);
    let once = readings(&mesh, &tank.contact_ohm_m(), &sigma);
    let again: Vec<DVector<f64>> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4)
            .map(|_| scope.spawn(|| readings(&mesh, &tank.contact_ohm_m(), &sigma)))
            .collect();
        threads
            .into_iter()
            .map(|thread| thread.join().unwrap())
            .collect()
    });
    for again in again {
        assert!(
            once.iter()
                .zip(again.iter())
                .all(|(a, b)| a.to_bits() == b.to_bits())
        );
    }
}

#[test]
fn every_node_on_an_electrode() {
    let mesh = Arc::new(crate::parts::grid(
        [1.0, 1.0],
        [1, 1],
        0.0,
        &[(3, 0, 1), (1, 0, 1)],
    ));
    let pair = Dipole::adjacent(0, 2);
    for z in [0.0, 1e-9, 0.3, 3.0, 1e9] {
        let forward = Forward::new(mesh.clone(), &[z, 2.0 * z]).unwrap();
        let fields = forward.solve(&[2.0, 2.0], &[pair]).unwrap();
        let got = fields.electrodes[(0, 0)] - fields.electrodes[(1, 0)];
        let exact = 0.5 + 3.0 * z;
        assert!((got / exact - 1.0).abs() < 1e-13, "z = {z}: {got}");
    }
}

#[test]
fn what_makes_no_sense_is_refused_by_name() {
    let mesh = Arc::new(eight(0.0));
    let sigma = uniform(&mesh);
    let forward = Forward::new(mesh.clone(), &[1.0; 8]).unwrap();
    let drive = [Dipole::adjacent(0, 8)];
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        let mut sigma = sigma.clone();
        sigma[17] = bad;
        match forward.solve(&sigma, &drive) {
            Err(ForwardError::Sigma { element: 17, .. }) => {}
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(
        forward.solve(&sigma[1..], &drive),
        Err(ForwardError::SigmaCount {
            has: sigma.len() - 1,
            wants: sigma.len()
        })
    );
    assert_eq!(
        forward.solve(&vec![0.0; sigma.len()], &drive),
        Err(ForwardError::NoConductance)
    );
    assert!(matches!(
        forward.solve(&sigma, &[Dipole::adjacent(8, 20)]),
        Err(ForwardError::Drive { electrodes: 8, .. })
    ));
    assert!(matches!(
        forward.readings(&sigma, &Protocol::sheffield(16).unwrap()),
        Err(ForwardError::Ring {
            protocol: 16,
            mesh: 8
        })
    ));
    let mut currents = nalgebra::DMatrix::zeros(8, 2);
    currents[(0, 1)] = 1e-3;
    currents[(5, 1)] = -0.9e-3;
    assert!(matches!(
        forward.solve_currents(&sigma, &currents),
        Err(ForwardError::CurrentSum { pattern: 1, .. })
    ));
    assert!(matches!(
        Forward::new(mesh.clone(), &[1.0; 7]),
        Err(ForwardError::ContactCount { has: 7, wants: 8 })
    ));
    let mut contacts = [1.0; 8];
    contacts[2] = -1.0;
    let refusal = Forward::new(mesh, &contacts).unwrap_err().to_string();
    assert!(refusal.starts_with("electrode 3:"), "{refusal}");
}
