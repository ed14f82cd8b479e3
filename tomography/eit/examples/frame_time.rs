//! Time per frame of the one-step method at the paper's size, with the full matrix and with the low-rank factor, and
//! the difference between the two maps: `cargo run --release -p tactus-eit --example frame_time`. One thread; minimum
//! and median of many, first back to back, then with 64 MB of other data read between the frames, as on a busy machine.

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use eit::{Forward, OneStep, OneStepOptions, PaperSheet, Reconstructor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use survey::{Protocol, Reading, Volts};

const CURRENT: f64 = 1e-3;
const FRAMES: usize = 16;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sheet = PaperSheet::default();
    let mesh = Arc::new(sheet.mesh()?);
    let protocol = Protocol::sheffield(26)?;
    let contact = sheet.contact_ohm_m();
    let sigma0 = vec![sheet.conductance(); mesh.triangles().len()];
    let forward = Forward::new(Arc::clone(&mesh), &contact)?;
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let noise = Normal::new(0.0, 2e-6)?;
    let mut taken = |sigma: &[f64]| -> Result<Vec<Reading>, eit::ForwardError> {
        let volts = forward.readings(sigma, &protocol)?;
        let noisy = volts
            .iter()
            .map(|v| Reading::Ok(Volts(CURRENT * v + noise.sample(&mut random))));
        Ok(noisy.collect())
    };
    let baseline = taken(&sigma0)?;
    let other: Vec<u64> = vec![1; 8 << 20];
    for (name, radius) in [("10 mm", 0.005), ("30 mm", 0.015), ("80 mm", 0.04)] {
        let frames = (0..FRAMES)
            .map(|k| {
                let (a, b) = (0.7 * k as f64, 1.1 * k as f64 + 0.3);
                let at = [0.107 + 0.07 * a.sin(), 0.115 + 0.075 * b.cos()];
                let mut sigma = sigma0.clone();
                for &t in mesh.region() {
                    let [x, y] = mesh.centroid(t);
                    if (x - at[0]).hypot(y - at[1]) <= radius {
                        sigma[t] *= 0.5;
                    }
                }
                taken(&sigma)
            })
            .collect::<Result<Vec<_>, _>>()?;
        let prepare = |map_error| {
            OneStep::new(
                Arc::clone(&mesh),
                &contact,
                &sigma0,
                &protocol,
                OneStepOptions {
                    map_error,
                    ..OneStepOptions::default()
                },
            )
        };
        let exact = prepare(None)?;
        for map_error in [None, Some(1e-3)] {
            let start = Instant::now();
            let step = prepare(map_error)?;
            let set_up = 1e3 * start.elapsed().as_secs_f64();
            let mut largest = 0.0_f64;
            for frame in &frames {
                let (a, b) = (
                    exact.reconstruct(&baseline, frame)?,
                    step.reconstruct(&baseline, frame)?,
                );
                let top = a.values.iter().fold(0.0_f64, |top, x| top.max(x.abs()));
                let apart = (a.values.iter().zip(&b.values))
                    .fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
                largest = largest.max(apart / top);
            }
            let time = |between: bool| -> Result<[f64; 2], eit::ReconstructError> {
                let mut times = Vec::new();
                for k in 0..20 * FRAMES {
                    if between {
                        black_box(other.iter().sum::<u64>());
                    }
                    let start = Instant::now();
                    black_box(step.reconstruct(&baseline, &frames[k % FRAMES])?);
                    times.push(1e3 * start.elapsed().as_secs_f64());
                }
                times.sort_by(f64::total_cmp);
                Ok([times[0], times[times.len() / 2]])
            };
            let ([least, middle], [cold_least, cold]) = (time(false)?, time(true)?);
            println!(
                "{name}, {}: frame {least:.3} ms at least, {middle:.3} median; other data read between: {cold_least:.3}, \
                 {cold:.3}; map error {largest:.1e}; set-up {set_up:.0} ms",
                map_error.map_or("whole matrix".to_owned(), |error| format!(
                    "map error {error:e} allowed"
                )),
            );
            if map_error.is_some() {
                println!("  {}", step.assumptions().pop().unwrap_or_default());
            }
        }
    }
    Ok(())
}
