//! Exact and near-exact references of the fact sheet, section 5, one test each.
//!
//! The last ones, the play operator and the standard linear solid, are tested with the phantom's effects.

#[allow(dead_code)] // also holds functions for other tests
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use crate::parts::{eight, grid, spread};
use eit::{
    Forward, Mesh, OneStep, OneStepOptions, PaperSheet, Reconstructor, Scale, SheetElectrode,
};
use nalgebra::{DMatrix, DVector, Matrix2};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use survey::{
    Amps, Baseline, Dipole, Electrode, Frame, Measurement, Precautions, Protocol, Reading,
    Settings, Volts,
};

const ENDS: Dipole = Dipole {
    plus: Electrode(0),
    minus: Electrode(1),
};

/// The voltage of one pair for 1 A through another.
fn volts(forward: &Forward, sigma: &[f64], drive: Dipole, sense: Dipole) -> f64 {
    let protocol = Protocol::new(
        forward.mesh().electrodes(),
        vec![Measurement { drive, sense }],
    )
    .unwrap();
    forward.readings(sigma, &protocol).unwrap()[0]
}

#[test]
fn reference_01_a_bar_on_any_mesh() {
    let (length, width) = (0.3, 0.2);
    for (push, z) in [(0.0, 0.02), (0.5, 0.02), (0.7, 1e-6), (0.5, 1e4)] {
        let mesh = grid([length, width], [23, 17], push, &[(3, 0, 17), (1, 0, 17)]);
        let sigma = vec![1e-3; mesh.triangles().len()];
        let forward = Forward::new(Arc::new(mesh), &[z, z]).unwrap();
        let exact = 1e3 * length / width + 2.0 * z / width;
        let error = (volts(&forward, &sigma, ENDS, ENDS) / exact - 1.0).abs();
        println!("push {push}, z {z:e}: {error:.1e}");
        assert!(error <= 1e-12, "{error:e}");
    }
}

/// One electrode in the middle of each side of the sheet, on its edge.
fn four(width_mm: f64, edge_mm: f64) -> (Forward, Vec<f64>) {
    let sheet = PaperSheet {
        electrode: SheetElectrode::Edge,
        electrodes_per_width: 1,
        electrodes_per_height: 1,
        void_mm: width_mm,
        edge_mm,
        growth: 0.1,
        ..PaperSheet::default()
    };
    let mesh = sheet.mesh().unwrap();
    let sigma = vec![sheet.conductance(); mesh.triangles().len()];
    let contact = 100.0 * 1e-3 * width_mm;
    (Forward::new(Arc::new(mesh), &[contact; 4]).unwrap(), sigma)
}

fn pair(plus: usize, minus: usize) -> Dipole {
    Dipole {
        plus: Electrode(plus),
        minus: Electrode(minus),
    }
}

#[test]
fn reference_02_van_der_pauw() {
    let residual = |width_mm: f64| {
        let (forward, sigma) = four(width_mm, 1.0_f64.min(width_mm / 4.0));
        let one = volts(&forward, &sigma, pair(0, 1), pair(3, 2));
        let other = volts(&forward, &sigma, pair(1, 2), pair(0, 3));
        ((-PI * one / 1e3).exp() + (-PI * other / 1e3).exp() - 1.0).abs()
    };
    let residuals = [10.0, 5.0, 2.5].map(residual);
    println!("van der Pauw: {residuals:?}");
    for (residual, bound) in residuals.into_iter().zip([2e-3, 6e-4, 3e-4]) {
        assert!(residual <= bound, "{residual:e} > {bound:e}");
    }
    assert!(residuals[0] > 2.0 * residuals[1] && residuals[1] > 2.0 * residuals[2]);
}

/// Number of electrodes of the disc.
const RING: usize = 8;
/// Radius of the inclusion in the plane in which it is concentric, in units of the disc's radius.
const INNER: f64 = 0.5;

/// A disc of radius 1 with an inclusion, on a mesh of rings and spokes mapped by z = (w + a) / (1 + a w).
struct Disc {
    mesh: Mesh,
    /// Triangles of the inclusion.
    inside: Vec<bool>,
    /// Ends of each electrode, as angles in the plane in which the inclusion is concentric.
    arcs: Vec<[f64; 2]>,
    /// a, which determines the eccentricity of the inclusion.
    off: f64,
}

impl Disc {
    /// `spokes`: a multiple of 4 RING; every second run of spokes ends on an electrode.
    fn new(spokes: usize, off: f64) -> Self {
        let rings = spokes / 8;
        let place = |radius: f64, angle: f64| {
            let (x, y) = (radius * angle.cos(), radius * angle.sin());
            let (p, q) = (1.0 + off * x, off * y);
            let square = p * p + q * q;
            [
                ((x + off) * p + y * q) / square,
                (y * p - (x + off) * q) / square,
            ]
        };
        let angle = |k: usize| TAU * (k % spokes) as f64 / spokes as f64;
        let mut nodes = vec![place(0.0, 0.0)];
        let radii: Vec<f64> = (1..=2 * rings)
            .map(|i| i as f64 / (2 * rings) as f64)
            .collect();
        for radius in &radii {
            nodes.extend((0..spokes).map(|k| place(*radius, angle(k))));
        }
        let node = |ring: usize, k: usize| 1 + ring * spokes + k % spokes;
        let mut triangles = Vec::new();
        let mut inside = Vec::new();
        for k in 0..spokes {
            triangles.push([0, node(0, k), node(0, k + 1)]);
            inside.push(true);
            for ring in 0..radii.len() - 1 {
                let [a, b] = [node(ring, k), node(ring, k + 1)];
                let [c, d] = [node(ring + 1, k), node(ring + 1, k + 1)];
                if (k + ring) % 2 == 0 {
                    triangles.extend([[a, c, d], [a, d, b]]);
                } else {
                    triangles.extend([[a, c, b], [b, c, d]]);
                }
                inside.extend([radii[ring + 1] <= INNER; 2]);
            }
        }
        let run = spokes / (2 * RING);
        let last = radii.len() - 1;
        let edges = (0..RING)
            .map(|e| {
                let first = 2 * e * run;
                (first..first + run)
                    .map(|k| [node(last, k), node(last, k + 1)])
                    .collect()
            })
            .collect();
        let arcs = (0..RING)
            .map(|e| [2 * e * run, (2 * e + 1) * run].map(|k| TAU * k as f64 / spokes as f64))
            .collect();
        Self {
            mesh: Mesh::new(nodes, triangles, edges, None).unwrap(),
            inside,
            arcs,
            off,
        }
    }

    /// Readings with contacts so large that the current is uniform over each electrode.
    fn solved(&self, ratio: f64) -> DVector<f64> {
        let sigma: Vec<f64> = self
            .inside
            .iter()
            .map(|&inside| if inside { 1e-3 * ratio } else { 1e-3 })
            .collect();
        Forward::new(Arc::new(self.mesh.clone()), &[1e9; RING])
            .unwrap()
            .readings(&sigma, &Protocol::sheffield(RING).unwrap())
            .unwrap()
    }

    /// The same from the series: flux cos n phi gives the voltage (1 - mu q) / (1 + mu q) cos n phi / (n sigma) in the
    /// plane in which the inclusion is concentric, with q = r^2n; arcs, flux and means are mapped there.
    fn exact(&self, ratio: f64) -> DVector<f64> {
        const TERMS: usize = 1500;
        const POINTS: usize = 1500;
        let mu = if ratio == f64::INFINITY {
            1.0
        } else {
            (ratio - 1.0) / (ratio + 1.0)
        };
        // angle in the disc of a point on the rim
        let carried = |phi: f64| {
            let (x, y) = (phi.cos(), phi.sin());
            let (p, q) = (1.0 + self.off * x, self.off * y);
            (y * p - (x + self.off) * q).atan2((x + self.off) * p + y * q)
        };
        let back = |theta: f64| {
            let (x, y) = (theta.cos(), theta.sin());
            let (p, q) = (1.0 - self.off * x, -self.off * y);
            (y * p - (x - self.off) * q).atan2((x - self.off) * p + y * q)
        };
        // mean of e^(i n phi) over each electrode, weighted by arc length on the disc's rim
        let means: Vec<Vec<[f64; 2]>> = self
            .arcs
            .iter()
            .map(|&[from, to]| {
                let from = carried(from);
                let to = from + (carried(to) - from).rem_euclid(TAU);
                let mut sums = vec![[0.0; 2]; TERMS + 1];
                for k in 0..POINTS {
                    let theta = from + (to - from) * (k as f64 + 0.5) / POINTS as f64;
                    let phi = back(theta);
                    let (c, s) = (phi.cos(), phi.sin());
                    let mut power = [1.0, 0.0];
                    for sum in &mut sums {
                        sum[0] += power[0] / POINTS as f64;
                        sum[1] += power[1] / POINTS as f64;
                        power = [power[0] * c - power[1] * s, power[0] * s + power[1] * c];
                    }
                }
                sums
            })
            .collect();
        let transfer = DMatrix::from_fn(RING, RING, |i, j| {
            (1..=TERMS)
                .map(|n| {
                    let q = INNER.powi(2 * n as i32);
                    let along = means[i][n][0] * means[j][n][0] + means[i][n][1] * means[j][n][1];
                    along * (1.0 - mu * q) / ((1.0 + mu * q) * PI * n as f64 * 1e-3)
                })
                .sum::<f64>()
        });
        let protocol = Protocol::sheffield(RING).unwrap();
        let readings = protocol.measurements().iter().map(|question| {
            let at = |sense: Electrode, drive: Electrode| transfer[(sense.0, drive.0)];
            let (s, d) = (question.sense, question.drive);
            at(s.plus, d.plus) - at(s.plus, d.minus) - at(s.minus, d.plus) + at(s.minus, d.minus)
        });
        DVector::from_iterator(protocol.len(), readings)
    }

    fn error(spokes: usize, off: f64, ratio: f64) -> f64 {
        let disc = Self::new(spokes, off);
        let exact = disc.exact(ratio);
        // a perfect conductor or insulator, limited as in the forward model
        let ratio = ratio.min(1e9);
        (disc.solved(ratio) - &exact).amax() / exact.amax()
    }
}

#[test]
fn reference_03_a_concentric_disc() {
    for ratio in [0.0, 0.2, 5.0, f64::INFINITY] {
        let errors = [64, 128, 256].map(|spokes| Disc::error(spokes, 0.0, ratio));
        println!("k = {ratio}: {errors:?}");
        for two in errors.windows(2) {
            let order = (two[0] / two[1]).log2();
            assert!((order - 2.0).abs() < 0.2, "k = {ratio}: {errors:?}");
        }
    }
}

#[test]
fn reference_04_an_eccentric_disc() {
    for ratio in [0.0, 0.2, 5.0, f64::INFINITY] {
        let errors = [96, 192, 384].map(|spokes| Disc::error(spokes, 0.3, ratio));
        println!("k = {ratio}: {errors:?}");
        // 384 spokes: edges of R/60 on the rim where they are even, up to R/33 where they are longest
        assert!(errors[2] <= 1e-3, "k = {ratio}: {errors:?}");
        let order = 0.5 * (errors[0] / errors[2]).log2();
        assert!((order - 2.0).abs() < 0.3, "k = {ratio}: {errors:?}");
    }
}

#[test]
fn reference_05_two_point_resistance_grows_logarithmically() {
    let resistance = |width_mm: f64| {
        let (forward, sigma) = four(width_mm, width_mm / 16.0);
        volts(&forward, &sigma, pair(0, 2), pair(0, 2))
    };
    let exact = 2e3 / PI;
    for width in [20.0, 10.0, 5.0, 2.5] {
        let slope = (resistance(0.5 * width) - resistance(width)) / 2.0_f64.ln();
        println!("from {width} mm: {slope:.1} against {exact:.1} ohm an e-fold");
        assert!((slope / exact - 1.0).abs() <= 0.01, "{slope}");
    }
}

/// u = x + sin(2 pi x) / 8 on the unit square between two shunts, with sigma = g(y) / u'(x): the flux has no divergence.
fn manufactured(cells: usize) -> [f64; 2] {
    let u = |x: f64| x + (TAU * x).sin() / 8.0 - 0.5;
    let slope = |x: f64| 1.0 + PI / 4.0 * (TAU * x).cos();
    let g = |y: f64| 1.0 + 0.5 * (PI * y).cos();
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
    let fields = forward.solve(&sigma, &[pair(1, 0)]).unwrap();
    let mesh = forward.mesh();
    let (mut square, mut energy) = (0.0, 0.0);
    for t in 0..sigma.len() {
        let corners = mesh.corners(t);
        let at = mesh.triangles()[t].map(|node| fields.potentials[(node, 0)]);
        let area = mesh.area(t);
        // gradient of the linear function
        let mut gradient = [0.0; 2];
        for i in 0..3 {
            let (q, r) = (corners[(i + 1) % 3], corners[(i + 2) % 3]);
            gradient[0] += at[i] * (q[1] - r[1]) / (2.0 * area);
            gradient[1] += at[i] * (r[0] - q[0]) / (2.0 * area);
        }
        for i in 0..3 {
            // midpoint rule of the sides, exact to the second order
            let (q, r) = (corners[(i + 1) % 3], corners[(i + 2) % 3]);
            let x = 0.5 * (q[0] + r[0]);
            let found = 0.5 * (at[(i + 1) % 3] + at[(i + 2) % 3]);
            square += area / 3.0 * (found - u(x)).powi(2);
            energy += area / 3.0 * ((gradient[0] - slope(x)).powi(2) + gradient[1].powi(2));
        }
    }
    [square.sqrt(), energy.sqrt()]
}

/// Currents enter through electrodes only, so the manufactured solution must be driven by two shunts, unlike e^x cos y.
#[test]
fn reference_06_a_manufactured_solution_and_the_patch_test() {
    let errors = [16, 32, 64].map(manufactured);
    println!("L2 and H1: {errors:?}");
    for two in errors.windows(2) {
        let [l2, h1] = [0, 1].map(|norm: usize| (two[0][norm] / two[1][norm]).log2());
        assert!((l2 - 2.0).abs() < 0.2, "{errors:?}");
        assert!((h1 - 1.0).abs() < 0.1, "{errors:?}");
    }
    // two conductances in series, with their border on edges
    let mesh = grid([0.3, 0.2], [24, 17], 0.0, &[(3, 0, 17), (1, 0, 17)]);
    let sigma: Vec<f64> = (0..mesh.triangles().len())
        .map(|t| {
            if mesh.centroid(t)[0] < 0.15 {
                1e-3
            } else {
                1.0
            }
        })
        .collect();
    let forward = Forward::new(Arc::new(mesh), &[0.02; 2]).unwrap();
    let exact = 0.15 / 0.2 * (1e3 + 1.0) + 2.0 * 0.02 / 0.2;
    let error = (volts(&forward, &sigma, ENDS, ENDS) / exact - 1.0).abs();
    assert!(error <= 1e-12, "{error:e}");
}

#[test]
fn reference_07_a_symmetric_sheet() {
    let sheet = PaperSheet {
        fineness: 0.6,
        ..PaperSheet::default()
    };
    let mesh = Arc::new(sheet.mesh().unwrap());
    let sigma = vec![sheet.conductance(); mesh.triangles().len()];
    let forward = Forward::new(mesh.clone(), &sheet.contact_ohm_m()).unwrap();
    let z = forward.transfer_impedance(&sigma).unwrap();
    let centres = mesh.electrode_centres();
    let size = [1e-3 * sheet.width_mm, 1e-3 * sheet.height_mm];
    for mirrored in [[true, false], [false, true], [true, true]] {
        let image: Vec<usize> = centres
            .iter()
            .map(|c| {
                let at = [0, 1].map(|i| if mirrored[i] { size[i] - c[i] } else { c[i] });
                let apart = |e: usize| (centres[e][0] - at[0]).hypot(centres[e][1] - at[1]);
                let nearest = (0..26)
                    .min_by(|&a, &b| apart(a).total_cmp(&apart(b)))
                    .unwrap();
                assert!(apart(nearest) < 1e-9);
                nearest
            })
            .collect();
        let turned = DMatrix::from_fn(26, 26, |i, j| z[(image[i], image[j])]);
        let error = (&turned - &z).amax() / z.amax();
        println!("{mirrored:?}: {error:.1e}");
        assert!(error <= 1e-12, "{mirrored:?}: {error:e}");
    }
}

#[test]
fn reference_08_less_conductance_is_more_resistance() {
    let mesh = Arc::new(eight(0.5));
    let forward = Forward::new(mesh.clone(), &[2.0; 8]).unwrap();
    let before = spread(mesh.triangles().len(), 1e-3, 10.0);
    let resistances = |sigma: &[f64]| {
        let z = forward.transfer_impedance(sigma).unwrap();
        DMatrix::from_fn(8, 8, |i, j| z[(i, i)] + z[(j, j)] - 2.0 * z[(i, j)])
    };
    let unloaded = resistances(&before);
    for (place, kept) in [
        (0, 0.5),
        (700, 0.999),
        (1500, 0.0),
        (2400, 0.1),
        (3100, 1e-6),
    ] {
        let mut after = before.clone();
        after[place..place + 60].iter_mut().for_each(|s| *s *= kept);
        let loaded = resistances(&after);
        for i in 0..8 {
            for j in 0..i {
                let lost = unloaded[(i, j)] - loaded[(i, j)];
                assert!(lost <= 1e-13 * unloaded[(i, j)], "{i}, {j}: {lost:e}");
            }
        }
        assert!(
            (&loaded - &unloaded).amax() > 1e-9 * unloaded.amax(),
            "{place}"
        );
    }
}

fn frame(protocol: &Protocol, volts: impl IntoIterator<Item = f64>) -> Frame {
    Frame {
        sequence: 1,
        readings: volts.into_iter().map(|v| Reading::Ok(Volts(v))).collect(),
        extra: Vec::new(),
        monotonic: Default::default(),
        wall: Default::default(),
        duration: Default::default(),
        settings: Settings {
            protocol_hash: protocol.hash(),
            current: Amps(1e-3),
            range: Volts(1.0),
            nplc: 1.0,
            settle: Default::default(),
            wiring: "none".to_owned(),
            precautions: Precautions::default(),
        },
        compliance: Vec::new(),
        simulated: true,
    }
}

#[test]
fn reference_09_the_law_of_noise() {
    const NOISE: f64 = 2e-6;
    const FRAMES: usize = 40;
    const AVERAGED: usize = 16;
    let mesh = Arc::new(eight(0.3));
    let sigma = vec![1e-3; mesh.triangles().len()];
    let protocol = Protocol::sheffield(8).unwrap();
    let forward = Forward::new(mesh.clone(), &[2.0; 8]).unwrap();
    let exact = forward.readings(&sigma, &protocol).unwrap() * 1e-3;
    let random = &mut ChaCha8Rng::seed_from_u64(5);
    let normal = Normal::new(0.0, NOISE).unwrap();
    let mut noisy = || -> Vec<f64> { exact.iter().map(|v| v + normal.sample(random)).collect() };
    // the mean of n readings has 1/sqrt(n) of the noise: chi-square of 40 draws of 40 readings
    let (mut square, mut count) = (0.0, 0.0_f64);
    let mut averages = Vec::new();
    for _ in 0..FRAMES {
        let frames: Vec<Frame> = (0..AVERAGED).map(|_| frame(&protocol, noisy())).collect();
        let mean = Baseline::from_frames("mean", &frames).unwrap().readings;
        for (reading, exact) in mean.iter().zip(exact.iter()) {
            square += (reading.volts().unwrap().0 - exact).powi(2);
            count += 1.0;
        }
        averages.push(mean);
    }
    let ratio = square / count * AVERAGED as f64 / (NOISE * NOISE);
    println!("averaged: {ratio:.3} of the variance over n");
    assert!((ratio - 1.0).abs() <= 4.0 * (2.0 / count).sqrt(), "{ratio}");
    // the part of a difference that no map explains, in units of its noise
    let options = OneStepOptions {
        scale: Scale::Currents(vec![1e-3; protocol.len()]),
        hyper: eit::Hyper::Noise {
            volts: NOISE,
            current: 1e-3,
        },
        ..OneStepOptions::default()
    };
    let step = OneStep::new(mesh, &[2.0; 8], &sigma, &protocol, options).unwrap();
    let mut residuals = Vec::new();
    for _ in 0..400 {
        let [before, after] = [noisy(), noisy()].map(|volts| frame(&protocol, volts).readings);
        let novelty = step.novelty(&before, &after).unwrap().unwrap();
        residuals.push(novelty.value.powi(2));
    }
    let mean = residuals.iter().sum::<f64>() / residuals.len() as f64;
    let variance =
        residuals.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / (residuals.len() - 1) as f64;
    let deviation = (variance / residuals.len() as f64).sqrt();
    println!("whitened residual: {mean:.3} +- {deviation:.3}");
    assert!(
        (mean - 1.0).abs() <= 4.0 * deviation,
        "{mean} +- {deviation}"
    );
}

/// Share of each triangle under a disc, by 28 points.
fn under(mesh: &Mesh, centre: [f64; 2], radius: f64) -> Vec<f64> {
    const CUT: usize = 7;
    (0..mesh.triangles().len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            let middle = mesh.centroid(t);
            if (middle[0] - centre[0]).hypot(middle[1] - centre[1]) > 2.0 * radius {
                return 0.0;
            }
            let (mut inside, mut all) = (0.0, 0.0);
            for i in 0..CUT {
                for j in 0..CUT - i {
                    let (p, q) = (
                        (i as f64 + 1.0 / 3.0) / CUT as f64,
                        (j as f64 + 1.0 / 3.0) / CUT as f64,
                    );
                    let at = [0, 1].map(|k| a[k] + p * (b[k] - a[k]) + q * (c[k] - a[k]));
                    all += 1.0;
                    if (at[0] - centre[0]).hypot(at[1] - centre[1]) <= radius {
                        inside += 1.0;
                    }
                }
            }
            inside / all
        })
        .collect()
}

#[test]
fn reference_10_no_locator_beats_the_bound_of_cramer_and_rao() {
    let sheet = PaperSheet {
        electrode: SheetElectrode::Edge,
        void_mm: 10.0,
        fineness: 2.0,
        ..PaperSheet::default()
    };
    let mesh = Arc::new(sheet.mesh().unwrap());
    let protocol = Protocol::sheffield(26).unwrap();
    let forward = Forward::new(mesh.clone(), &sheet.contact_ohm_m()).unwrap();
    let mut workspace = forward.workspace(&protocol).unwrap();
    let mut readings = |centre: [f64; 2], loss: f64| {
        let sigma: Vec<f64> = under(&mesh, centre, 5e-3)
            .iter()
            .map(|share| 1e-3 * (1.0 - loss * share))
            .collect();
        workspace.readings(&sigma).unwrap()
    };
    let middle = [0.107, 0.115];
    let top = readings(middle, 0.0).amax();
    let h = 3e-3;
    let slopes = [[h, 0.0], [0.0, h]].map(|[dx, dy]| {
        let ahead = readings([middle[0] + dx, middle[1] + dy], 0.5);
        let behind = readings([middle[0] - dx, middle[1] - dy], 0.5);
        (ahead - behind) / (2.0 * h)
    });
    let noise = 1e-5 * top;
    let information = Matrix2::from_fn(|i, j| slopes[i].dot(&slopes[j]) / (noise * noise));
    let bound = information.try_inverse().unwrap().trace().sqrt();
    println!("no better than {:.3} mm", 1e3 * bound);
    assert!((1e3 * bound / 0.48 - 1.0).abs() < 0.1, "{bound:e}");
    // independent check: least squares over readings tabulated by position and fitted by quadratic polynomials, without
    // the matrix above
    let steps: Vec<f64> = (-2..=2).map(|k| f64::from(k) * 1e-3).collect();
    let positions: Vec<[f64; 2]> = steps
        .iter()
        .flat_map(|x| steps.iter().map(|y| [*x, *y]))
        .collect();
    let terms = |[x, y]: [f64; 2]| [1.0, x, y, x * x, x * y, y * y];
    let scaled = |at: [f64; 2]| terms(at.map(|v| 1e3 * v));
    let table = DMatrix::from_rows(
        &positions
            .iter()
            .map(|at| readings([middle[0] + at[0], middle[1] + at[1]], 0.5).transpose())
            .collect::<Vec<_>>(),
    );
    let design = DMatrix::from_fn(positions.len(), 6, |i, j| scaled(positions[i])[j]);
    let fit = design.svd(true, true).solve(&table, 1e-12).unwrap();
    let model = |at: [f64; 2]| fit.tr_mul(&DVector::from_row_slice(&scaled(at)));
    let locate = |measured: &DVector<f64>| -> [f64; 2] {
        let mut at = [0.0, 0.0];
        for _ in 0..4 {
            let h = 1e-5;
            let ahead = [[at[0] + h, at[1]], [at[0], at[1] + h]].map(&model);
            let now = model(at);
            let slopes = DMatrix::from_columns(&ahead.map(|ahead| (ahead - &now) / h));
            let step = slopes
                .svd(true, true)
                .solve(&(measured - now), 0.0)
                .unwrap();
            at = [at[0] + step[0], at[1] + step[1]];
        }
        at
    };
    let (random, normal) = (
        &mut ChaCha8Rng::seed_from_u64(3),
        Normal::new(0.0, noise).unwrap(),
    );
    let truths = [
        [0.0, 0.0],
        [0.6e-3, -0.3e-3],
        [-0.4e-3, 0.7e-3],
        [0.5e-3, 0.5e-3],
    ];
    let draws = 300;
    let (mut square, mut pulled) = (0.0, 0.0);
    for truth in truths {
        let exact = readings([middle[0] + truth[0], middle[1] + truth[1]], 0.5);
        for _ in 0..draws {
            let noisy = exact.map(|v| v + normal.sample(random));
            let found = locate(&noisy);
            square += (found[0] - truth[0]).powi(2) + (found[1] - truth[1]).powi(2);
            // the estimate moved half way to the middle, as with prior knowledge of the position
            pulled += (0.5 * found[0] - truth[0]).powi(2) + (0.5 * found[1] - truth[1]).powi(2);
        }
    }
    let mean = |square: f64| (square / (truths.len() as f64 * f64::from(draws))).sqrt();
    let (reached, pulled) = (mean(square), mean(pulled));
    println!(
        "least squares reach {:.3} mm, pulled to the middle {:.3} mm",
        1e3 * reached,
        1e3 * pulled
    );
    let no_better = |rms: f64| rms > 0.95 * bound;
    assert!(
        no_better(reached) && reached < 1.1 * bound,
        "{reached:e} {bound:e}"
    );
    assert!(
        !no_better(0.5 * reached),
        "an error of half the bound would pass"
    );
}
