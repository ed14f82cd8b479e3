//! Two rods, 45 degrees apart, in a round tank of 16 electrodes: `best` shows two losses, linear maps show one. Frames
//! are simulated on a finer mesh than the model's. Rods 46 mm apart, with 16 mm of liquid between them, merge.

use std::sync::Arc;

use eit::{DiscTank, Forward, Preset};
use imaging::{Conditions, Geometry, Method, ReconstructionSettings, build};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use studies::{add_noise, measured};
use survey::{Amps, Protocol, Reading};

const CURRENT: f64 = 1e-3;
/// Standard deviation of a reading, as a share of the root mean square of the readings.
const NOISE_SHARE: f64 = 1e-4;
/// Radius of the tank, radius of the rods, and distances of the rods from the middle, m.
const TANK: f64 = 0.15;
const ROD: f64 = 0.015;
const AWAY: [f64; 2] = [0.075, 0.1];
/// Relative loss in a rod.
const LOSS: f64 = 0.9;

fn tank(fineness: f64, seeding: u32) -> DiscTank {
    DiscTank {
        radius_mm: 1e3 * TANK,
        fineness,
        seeding,
        ..DiscTank::default()
    }
}

/// Centres of the rods, m.
fn rods(away: f64) -> [[f64; 2]; 2] {
    [20.0_f64, 65.0].map(|degrees| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        [away * cos, away * sin]
    })
}

struct Fine {
    forward: Forward,
    conductance: f64,
}

impl Fine {
    fn new() -> Self {
        let tank = tank(4.1, 5);
        let mesh = Arc::new(tank.mesh().unwrap());
        Self {
            conductance: tank.conductance(),
            forward: Forward::new(mesh, &tank.contact_ohm_m()).unwrap(),
        }
    }

    fn frame(
        &self,
        protocol: &Protocol,
        rods: &[[f64; 2]],
        random: &mut ChaCha8Rng,
    ) -> (Vec<Reading>, f64) {
        let under = |at: [f64; 2]| {
            let mut rods = rods.iter();
            rods.any(|rod| (at[0] - rod[0]).hypot(at[1] - rod[1]) < ROD)
        };
        let mesh = self.forward.mesh();
        // a triangle crossed by the border of a rod has the geometric mean of both conductances
        let share = |triangle: usize| {
            let [a, b, c] = mesh.corners(triangle);
            let places = (0..64).filter(|k| {
                let (mut u, mut v) = (f64::from(k % 8) + 0.5, f64::from(k / 8) + 0.5);
                if u + v > 8.0 {
                    (u, v) = (8.0 - u, 8.0 - v);
                }
                under([0, 1].map(|i| a[i] + (u * (b[i] - a[i]) + v * (c[i] - a[i])) / 8.0))
            });
            places.count() as f64 / 64.0
        };
        let sigma: Vec<f64> = (0..mesh.triangles().len())
            .map(|triangle| self.conductance * (1.0 - LOSS).powf(share(triangle)))
            .collect();
        let ohms = self.forward.readings(&sigma, protocol).unwrap();
        let mut volts: Vec<f64> = ohms.iter().map(|ohms| CURRENT * ohms).collect();
        let squares: f64 = volts.iter().map(|volts| volts * volts).sum();
        let noise = NOISE_SHARE * (squares / volts.len() as f64).sqrt();
        add_noise(&mut volts, noise, random);
        (measured(&volts), noise)
    }
}

/// The largest loss within a rod's radius of each rod, and the largest one at the middle between them.
fn profile(geometry: &Geometry, map: &[f64], rods: [[f64; 2]; 2]) -> [f64; 3] {
    let middle = [0, 1].map(|axis| 0.5 * (rods[0][axis] + rods[1][axis]));
    let centroids = geometry.mesh.region_centroids();
    let loss = |place: [f64; 2], radius: f64| {
        let near = centroids
            .iter()
            .zip(map)
            .filter(|(at, _)| (at[0] - place[0]).hypot(at[1] - place[1]) < radius);
        near.fold(0.0_f64, |most, (_, value)| most.max(-value))
    };
    [
        loss(rods[0], ROD),
        loss(middle, 0.4 * ROD),
        loss(rods[1], ROD),
    ]
}

#[test]
fn two_rods_45_degrees_apart_are_two_losses() {
    let geometry = Geometry::from_preset(&Preset::DiscTank(tank(1.7, 0))).unwrap();
    let protocol = Protocol::sheffield(16).unwrap();
    let (fine, mut random) = (Fine::new(), ChaCha8Rng::seed_from_u64(45));
    let (unloaded, noise) = fine.frame(&protocol, &[], &mut random);
    let mut conditions = Conditions::live(&geometry, &protocol, Amps(CURRENT));
    conditions.noise_v = Some(noise);
    for method in [Method::Best, Method::OneStep] {
        let settings = ReconstructionSettings {
            method: Some(method),
            ..ReconstructionSettings::default()
        };
        let model = build(&settings, &conditions).unwrap();
        for away in AWAY {
            let rods = rods(away);
            let (loaded, _) = fine.frame(&protocol, &rods, &mut random);
            let map = model.reconstruct(&unloaded, &loaded).unwrap();
            let [first, middle, second] = profile(&geometry, &map.values, rods);
            println!(
                "{}: rods {:.0} mm from the middle, {:.0} mm apart: losses {first:.2} {middle:.2} {second:.2}",
                map.method,
                1e3 * away,
                1e3 * (rods[0][0] - rods[1][0]).hypot(rods[0][1] - rods[1][1])
            );
            let apart = middle < 0.3 * first.min(second);
            match method {
                Method::Best => {
                    assert!(
                        apart && first.min(second) > 0.5,
                        "{first} {middle} {second}"
                    );
                }
                // linear maps merge at least the closer rods, which shows that the bound can fail
                _ => assert!(!apart || away > 0.09, "{first} {middle} {second}"),
            }
        }
    }
}
