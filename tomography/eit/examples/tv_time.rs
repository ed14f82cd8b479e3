//! Time of total variation at the paper's size, and its distance from the true minimum:
//! `cargo run --release -p tactus-eit --example tv_time [-- FRAMES [--times-only]]`. One core. The reference minimum is
//! computed offline by this crate's interior-point method over all triangles, to 2e-9.

use std::sync::Arc;
use std::time::Instant;

use eit::{Forward, Mesh, PaperSheet, Tv, TvOptions};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use survey::{Protocol, Reading, Volts};

const CURRENT: f64 = 1e-3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let frames: usize = std::env::args().nth(1).map_or(Ok(4), |text| text.parse())?;
    let times_only = std::env::args().any(|word| word == "--times-only");
    let sheet = PaperSheet::default();
    let mesh = Arc::new(sheet.mesh()?);
    let protocol = Protocol::sheffield(26)?;
    let sigma0 = vec![sheet.conductance(); mesh.triangles().len()];
    // data of another, finer mesh
    let other = PaperSheet {
        fineness: 1.4,
        seeding: 7,
        ..sheet.clone()
    };
    let finer = Arc::new(other.mesh()?);
    let forward = Forward::new(Arc::clone(&finer), &other.contact_ohm_m())?;
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let noise = Normal::new(0.0, 2e-6)?;
    let mut readings = |pressed: &[([f64; 2], f64)]| -> Result<Vec<Reading>, eit::ForwardError> {
        let sigma: Vec<f64> = (0..finer.triangles().len())
            .map(|t| conductance(&finer, t, pressed))
            .collect();
        let volts = forward.readings(&sigma, &protocol)?;
        Ok(volts
            .iter()
            .map(|v| Reading::Ok(Volts(CURRENT * v + noise.sample(&mut random))))
            .collect())
    };
    let baseline = readings(&[])?;
    let place = |k: usize| {
        let (a, b) = (0.7 * k as f64, 1.1 * k as f64 + 0.3);
        [0.107 + 0.07 * a.sin(), 0.115 + 0.075 * b.cos()]
    };
    for (name, diameter) in [("10 mm", 0.010), ("30 mm", 0.030), ("80 mm", 0.080)] {
        let pressed = (0..frames)
            .map(|k| {
                let at = place(k);
                readings(&[(at, diameter)])
            })
            .collect::<Result<Vec<_>, eit::ForwardError>>()?;
        for loss_only in [true, false] {
            let prepare = |gap| {
                Tv::new(
                    Arc::clone(&mesh),
                    &sheet.contact_ohm_m(),
                    &sigma0,
                    &protocol,
                    TvOptions {
                        loss_only,
                        gap,
                        ..TvOptions::default()
                    },
                )
            };
            let exact = prepare(1e-9)?;
            let least = pressed
                .iter()
                .map(|frame| {
                    if times_only {
                        return Ok(f64::NAN);
                    }
                    exact.minimum_offline(&baseline, frame)
                })
                .collect::<Result<Vec<_>, _>>()?;
            for gap in [1e-3, 1e-6] {
                let tv = prepare(gap)?;
                let mut times = vec![];
                let (mut excess, mut stated, mut rounds) = (0.0_f64, 0.0_f64, vec![]);
                for (frame, least) in pressed.iter().zip(&least) {
                    let start = Instant::now();
                    let (solution, _) = tv.solve(&baseline, frame)?;
                    times.push(1e3 * start.elapsed().as_secs_f64());
                    let full = tv.objective(&baseline, frame, &solution.values)?;
                    excess = excess.max(full / least - 1.0);
                    stated = stated.max(solution.gap / full);
                    rounds.push(solution.rounds as f64);
                }
                let (fastest, middle) = spread(&mut times);
                let (_, rounds) = spread(&mut rounds);
                println!(
                    "{name}, {}: gap {gap:e}: {middle:.0} ms (least {fastest:.0}), {rounds} rounds, stated {stated:.1e}, \
                     true excess {excess:.1e}",
                    if loss_only { "loss only" } else { "free" },
                );
            }
        }
    }
    Ok(())
}

/// Half of the conductance is lost under a disc; a triangle counts by its centroid.
fn conductance(mesh: &Mesh, triangle: usize, pressed: &[([f64; 2], f64)]) -> f64 {
    let [x, y] = mesh.centroid(triangle);
    let under = pressed
        .iter()
        .any(|([cx, cy], diameter)| (x - cx).hypot(y - cy) <= 0.5 * diameter);
    if under { 0.5e-3 } else { 1e-3 }
}

/// Minimum and median.
fn spread(values: &mut [f64]) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    (values[0], values[values.len() / 2])
}
