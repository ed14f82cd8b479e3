//! Tanks with a depth: limits, reciprocity, sensitivities, number of modes, an analytical solution.

use std::sync::Arc;

use crate::parts::spread;
use eit::{Depth, DiscTank, Forward, Mesh, Parameters};
use nalgebra::{DMatrix, DVector};
use survey::{Dipole, Protocol, skip};

fn tank(fineness: f64) -> DiscTank {
    DiscTank {
        electrodes: 8,
        arc_deg: 10.0,
        fineness,
        ..DiscTank::default()
    }
}

fn forward(mesh: &Mesh, tank: &DiscTank, depth: Option<Depth>) -> Forward {
    Forward::new(Arc::new(mesh.with_depth(depth)), &tank.contact_ohm_m()).unwrap()
}

/// 260 mm of liquid, electrodes 10 mm high in a plane at this height.
fn at_height(centre_m: f64, modes: usize) -> Option<Depth> {
    Some(Depth::new(0.26, 0.01, centre_m, modes).unwrap())
}

fn sheffield() -> Protocol {
    Protocol::sheffield(8).unwrap()
}

#[test]
fn electrodes_as_high_as_the_liquid_are_the_flat_model() {
    let tank = tank(0.5);
    let mesh = tank.mesh().unwrap();
    let sigma = spread(mesh.triangles().len(), 1e-3, 4.0);
    let flat = forward(&mesh, &tank, None);
    let full = Depth::new(0.02, 0.02, 0.01, 60).unwrap();
    let full = forward(&mesh, &tank, Some(full));
    assert_eq!(
        flat.readings(&sigma, &sheffield()).unwrap(),
        full.readings(&sigma, &sheffield()).unwrap()
    );
    assert_eq!(
        flat.jacobian(&sigma, &sheffield()).unwrap(),
        full.jacobian(&sigma, &sheffield()).unwrap()
    );
    assert_ne!(flat.mesh().hash(), full.mesh().hash());
}

#[test]
fn shallow_liquid_approaches_the_flat_model() {
    let tank = tank(0.5);
    let mesh = tank.mesh().unwrap();
    let sigma = spread(mesh.triangles().len(), 1e-3, 4.0);
    let flat = forward(&mesh, &tank, None)
        .readings(&sigma, &sheffield())
        .unwrap();
    let mut last = f64::INFINITY;
    for depth_m in [0.2, 0.1, 0.05] {
        // the electrodes are a tenth of the depth high
        let depth = Depth::new(depth_m, 0.1 * depth_m, 0.5 * depth_m, 60).unwrap();
        let deep = forward(&mesh, &tank, Some(depth))
            .readings(&sigma, &sheffield())
            .unwrap();
        let difference = (&deep - &flat).amax() / flat.amax();
        println!("{depth_m} m: {difference:.2e}");
        assert!(difference < 0.5 * last, "{depth_m} m: {difference}");
        last = difference;
    }
    assert!(last < 0.02, "{last}");
}

#[test]
fn reciprocal_readings_are_equal_with_a_depth() {
    let tank = tank(0.5);
    let mesh = tank.mesh().unwrap();
    let sigma = spread(mesh.triangles().len(), 1e-3, 4.0);
    let protocol = Protocol::new(8, skip(8, 1).collect()).unwrap();
    let deep = forward(&mesh, &tank, at_height(0.07, 60));
    let readings = deep.readings(&sigma, &protocol).unwrap();
    let questions = protocol.measurements();
    for (question, volts) in questions.iter().zip(readings.iter()) {
        let twin = questions
            .iter()
            .position(|other| other.drive == question.sense && other.sense == question.drive)
            .unwrap();
        assert!((volts - readings[twin]).abs() < 1e-12 * readings.amax());
    }
}

#[test]
fn all_ways_to_the_readings_agree_with_a_depth() {
    let tank = tank(0.5);
    let mesh = tank.mesh().unwrap();
    let sigma = spread(mesh.triangles().len(), 1e-3, 4.0);
    let protocol = sheffield();
    let deep = forward(&mesh, &tank, at_height(0.07, 30));
    let readings = deep.readings(&sigma, &protocol).unwrap();
    let uniform = vec![1e-3; sigma.len()];
    let mut plain = deep
        .workspace(&protocol)
        .unwrap()
        .plain()
        .about(&uniform)
        .unwrap();
    let impedance = deep.transfer_impedance(&sigma).unwrap();
    let drives = protocol.drives();
    let fields = deep.solve(&sigma, &drives).unwrap();
    let close = |other: &DVector<f64>| (other - &readings).amax() < 1e-11 * readings.amax();
    assert!(close(&plain.readings(&sigma).unwrap()));
    let by = |voltage: &dyn Fn(usize, Dipole) -> f64| {
        DVector::from_iterator(
            protocol.len(),
            protocol
                .measurements()
                .iter()
                .map(|q| voltage(q.sense.plus.0, q.drive) - voltage(q.sense.minus.0, q.drive)),
        )
    };
    assert!(close(&by(&|electrode, drive| {
        impedance[(electrode, drive.plus.0)] - impedance[(electrode, drive.minus.0)]
    })));
    assert!(close(&by(&|electrode, drive| {
        let column = drives.iter().position(|one| *one == drive).unwrap();
        fields.electrodes[(electrode, column)]
    })));
}

#[test]
fn sensitivities_with_a_depth_are_central_differences() {
    let tank = tank(0.5);
    let mesh = tank.mesh().unwrap();
    let sigma = spread(mesh.triangles().len(), 1e-3, 4.0);
    let protocol = sheffield();
    let deep = forward(&mesh, &tank, at_height(0.07, 20));
    let jacobian = deep.jacobian(&sigma, &protocol).unwrap();
    let logarithmic = deep
        .sensitivity(&sigma, &protocol, &Parameters::elements().logarithmic())
        .unwrap();
    let at = |t: usize, h: f64| {
        let mut sigma = sigma.clone();
        sigma[t] *= 1.0 + h;
        deep.readings(&sigma, &protocol).unwrap()
    };
    let all = sigma.len();
    for t in [0, all / 3, all / 2, all - 1] {
        let difference = (at(t, 1e-3) - at(t, -1e-3)) / (2e-3 * sigma[t]);
        let column: DMatrix<f64> = jacobian.columns(t, 1).into_owned();
        let error = (&difference - column.column(0)).amax() / difference.amax();
        assert!(error < 1e-5, "triangle {t}: {error:e}");
        let scaled = column.column(0) * sigma[t];
        assert!((scaled - logarithmic.column(t)).amax() < 1e-12 * logarithmic.column(t).amax());
    }
}

#[test]
fn a_layer_as_high_as_the_liquid_is_the_whole_depth() {
    let tank = tank(0.5);
    let mesh = tank.mesh().unwrap();
    let sigma = spread(mesh.triangles().len(), 1e-3, 4.0);
    let depth = Depth::new(0.26, 0.01, 0.13, 20).unwrap();
    let of = |height: f64| {
        let depth = depth.with_target_height(height).unwrap();
        forward(&mesh, &tank, Some(depth))
            .jacobian(&sigma, &sheffield())
            .unwrap()
    };
    let whole = of(0.26);
    // products of different modes integrate to zero over the whole depth only
    let almost = of(0.26 * (1.0 - 1e-9));
    assert!((&almost - &whole).amax() < 1e-7 * whole.amax());
    let thin = of(0.04);
    assert!((&thin - &whole * (0.04 / 0.26)).amax() > 0.1 * thin.amax());
    let layer = depth.with_target_height(0.04).unwrap();
    let refused = forward(&mesh, &tank, Some(layer)).check_changes();
    assert!(refused.unwrap_err().to_string().contains("40 mm high"));
}

#[test]
fn sixty_modes_are_enough() {
    let tank = tank(0.5);
    let mesh = tank.mesh().unwrap();
    let sigma = vec![1e-3; mesh.triangles().len()];
    let of = |modes| {
        forward(&mesh, &tank, at_height(0.13, modes))
            .readings(&sigma, &sheffield())
            .unwrap()
    };
    let many = of(240);
    let mut last = f64::INFINITY;
    for modes in [4, 8, 16, 60] {
        let error = (of(modes) - &many).amax() / many.amax();
        println!("{modes} modes: {error:.1e}");
        assert!(error < last);
        last = error;
    }
    assert!(last < 1e-6, "{last:e}");
}

/// A source and a sink on the wall of a cylinder: the potential of a mode is a sum of modified Bessel functions.
#[test]
fn modes_of_a_uniform_cylinder_are_bessel_functions() {
    let tank = tank(2.0);
    let mesh = tank.mesh().unwrap();
    let sigma = vec![1e-3; mesh.triangles().len()];
    let protocol = sheffield();
    let of = |depth| {
        forward(&mesh, &tank, depth)
            .readings(&sigma, &protocol)
            .unwrap()
    };
    let depth = Depth::new(0.26, 0.01, 0.13, 2).unwrap();
    let added = of(Some(depth)) - of(None);
    // mode 2 of electrodes at half depth: cos(pi) = -1, sinc(pi 0.01 / 0.26)
    let half = std::f64::consts::PI * 0.01 / 0.26;
    let share = 2.0 * (half.sin() / half).powi(2);
    let x = 2.0 * std::f64::consts::PI / 0.26 * 0.15;
    let arc = 10_f64.to_radians();
    // 1/(pi sigma) sum of I_n(x) / (x I_n'(x)) cos(n angle) sinc(n arc / 2)^2, half of it at n = 0
    let between = |a: usize, b: usize| {
        let angle = (a as f64 - b as f64) * std::f64::consts::TAU / 8.0;
        (0..200)
            .map(|n| {
                let spread = 0.5 * n as f64 * arc;
                let spread = if n == 0 { 1.0 } else { spread.sin() / spread };
                let half = if n == 0 { 0.5 } else { 1.0 };
                half * (n as f64 * angle).cos() * spread * spread / log_slope(n, x)
            })
            .sum::<f64>()
            / (std::f64::consts::PI * 1e-3)
    };
    for (question, added) in protocol.measurements().iter().zip(added.iter()) {
        let (d, s) = (question.drive, question.sense);
        let exact = share
            * (between(d.plus.0, s.plus.0)
                - between(d.minus.0, s.plus.0)
                - between(d.plus.0, s.minus.0)
                + between(d.minus.0, s.minus.0));
        assert!(
            (exact - added).abs() < 0.01 * exact.abs().max(1.0),
            "{d} {s}: {added} instead of {exact}"
        );
    }
}

/// x I_n'(x) / I_n(x), from the power series.
fn log_slope(n: usize, x: f64) -> f64 {
    let (mut term, mut sum, mut slope) = (1.0, 0.0, 0.0);
    for m in 0..200 {
        sum += term;
        slope += term * (2 * m + n) as f64;
        term *= 0.25 * x * x / ((m + 1) as f64 * (m + 1 + n) as f64);
    }
    slope / sum
}
