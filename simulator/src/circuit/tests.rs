use super::*;

const SOURCE_HI: Point = Point::Source(true);
const SOURCE_LO: Point = Point::Source(false);

fn resistor(from: Point, to: Point, ohms: f64) -> Resistor {
    Resistor { from, to, ohms }
}

fn joins(electrode: usize, to: Point, ohms: f64) -> Resistor {
    resistor(Point::Electrode(electrode), to, ohms)
}

/// A ring of equal resistors as a sheet: Z is the pseudo-inverse of its Laplacian.
fn ring(electrodes: usize, ohms: f64) -> DMatrix<f64> {
    let mut laplacian = DMatrix::zeros(electrodes, electrodes);
    for k in 0..electrodes {
        let next = (k + 1) % electrodes;
        laplacian[(k, k)] += 1.0 / ohms;
        laplacian[(next, next)] += 1.0 / ohms;
        laplacian[(k, next)] -= 1.0 / ohms;
        laplacian[(next, k)] -= 1.0 / ohms;
    }
    laplacian.pseudo_inverse(1e-12).unwrap()
}

fn pair(k: usize, hi: Point, lo: Point, ohms: f64, electrodes: usize) -> [Resistor; 2] {
    [joins(k, hi, ohms), joins((k + 1) % electrodes, lo, ohms)]
}

#[test]
fn pair_circuit_reads_four_entries_of_z_to_the_bit() {
    let z = ring(6, 1000.0);
    let inject = pair(0, SOURCE_HI, SOURCE_LO, 100.1, 6);
    let measure = pair(3, METER_HI, METER_LO, 100.1, 6);
    let flow = Flow::solve([inject, measure].concat(), &z);
    let expected = (z[(3, 0)] - z[(3, 1)]) - (z[(4, 0)] - z[(4, 1)]);
    assert!((flow.across(&z, METER_HI, METER_LO) - expected).abs() <= 1e-13 * expected.abs());
    // 1 kohm in parallel with five in series, and two poles of 100.1 ohm
    let seen = 5.0 / 6.0 * 1000.0 + 200.2;
    assert!((flow.resistance(&z) - seen).abs() < 1e-9);
}

#[test]
fn nothing_closed_is_an_open_source_and_a_meter_at_zero() {
    let z = ring(6, 1000.0);
    let flow = Flow::solve(Vec::new(), &z);
    assert_eq!(flow.resistance(&z), f64::INFINITY);
    assert_eq!(flow.across(&z, METER_HI, METER_LO), 0.0);
    let half = Flow::solve(vec![joins(0, SOURCE_HI, 0.1)], &z);
    assert_eq!(half.resistance(&z), f64::INFINITY);
}

#[test]
fn a_meter_on_one_wire_floats_at_zero() {
    let z = ring(6, 1000.0);
    let mut resistors = pair(0, SOURCE_HI, SOURCE_LO, 0.1, 6).to_vec();
    resistors.push(joins(3, METER_HI, 0.1));
    let flow = Flow::solve(resistors, &z);
    assert_eq!(flow.across(&z, METER_HI, METER_LO), 0.0);
}

#[test]
fn neighbouring_pairs_short_the_source_at_shared_electrode() {
    // HI on electrodes 0 and 1, LO on 1 and 2: 0.1 + 0.1 ohm at electrode 1 carry nearly all
    let z = ring(6, 1000.0);
    let both = [
        pair(0, SOURCE_HI, SOURCE_LO, 0.1, 6),
        pair(1, SOURCE_HI, SOURCE_LO, 0.1, 6),
    ]
    .concat();
    let seen = Flow::solve(both, &z).resistance(&z);
    assert!((0.19..0.2).contains(&seen), "{seen}");
}

#[test]
fn any_network_agrees_with_its_nodal_equations() {
    // Deterministic pseudo-random networks; the sheet enters the reference as its admittance.
    let electrodes = 5;
    let z = ring(electrodes, 700.0);
    let y = z.clone().pseudo_inverse(1e-9).unwrap();
    let points = [
        SOURCE_HI,
        SOURCE_LO,
        METER_HI,
        METER_LO,
        Point::Bus(2, true),
    ];
    let mut state = 12345_u64;
    let mut draw = |most: usize| {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 33) as usize % most
    };
    let mut compared = 0;
    for _ in 0..400 {
        let resistors: Vec<Resistor> = (0..2 + draw(9))
            .map(|_| {
                joins(
                    draw(electrodes),
                    points[draw(5)],
                    [0.1, 70.0, 100.1][draw(3)],
                )
            })
            .collect();
        let flow = Flow::solve(resistors.clone(), &z);
        // reference: nodal analysis with electrode potentials and points as unknowns, 1 pS to ground everywhere
        let size = electrodes + points.len();
        let at = |point: Point| match point {
            Point::Electrode(k) => k,
            other => electrodes + points.iter().position(|known| *known == other).unwrap(),
        };
        let mut nodal = DMatrix::zeros(size, size);
        nodal
            .view_mut((0, 0), (electrodes, electrodes))
            .copy_from(&y);
        for resistor in &resistors {
            let (a, b) = (at(resistor.from), at(resistor.to));
            let g = 1.0 / resistor.ohms;
            nodal[(a, a)] += g;
            nodal[(b, b)] += g;
            nodal[(a, b)] -= g;
            nodal[(b, a)] -= g;
        }
        for k in 0..size {
            nodal[(k, k)] += 1e-12;
        }
        if !flow.joined {
            continue;
        }
        let mut driven = DVector::zeros(size);
        driven[at(SOURCE_HI)] = 1.0;
        driven[at(SOURCE_LO)] = -1.0;
        let potentials = nodal.lu().solve(&driven).unwrap();
        let seen = potentials[at(SOURCE_HI)] - potentials[at(SOURCE_LO)];
        assert!(
            (seen - flow.resistance(&z)).abs() < 1e-5 * seen.max(1.0),
            "{seen}"
        );
        let read = flow.across(&z, METER_HI, METER_LO);
        let connected = |point| flow.tree.component[flow.tree.node(point)];
        if connected(METER_HI) == connected(METER_LO) && connected(METER_HI) == connected(SOURCE_HI)
        {
            let expected = potentials[at(METER_HI)] - potentials[at(METER_LO)];
            assert!(
                (read - expected).abs() < 1e-5 * seen.max(1.0),
                "{read} {expected}"
            );
            compared += 1;
        }
    }
    assert!(compared > 50, "{compared}");
}
