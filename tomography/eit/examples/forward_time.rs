//! How long a forward solution takes at the paper's size on one core:
//! `cargo run --release -p eit --example forward_time`.

use std::sync::Arc;
use std::time::Instant;

use eit::{Forward, PaperSheet};
use survey::Protocol;

fn median(rounds: usize, mut work: impl FnMut(usize)) -> f64 {
    let mut times: Vec<f64> = (0..rounds)
        .map(|round| {
            let start = Instant::now();
            work(round);
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[rounds / 2]
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sheet = PaperSheet::default();
    let start = Instant::now();
    let mesh = Arc::new(sheet.mesh()?);
    println!(
        "mesh          {:8.2} ms",
        start.elapsed().as_secs_f64() * 1e3
    );
    let quality = mesh.quality();
    println!(
        "              {} nodes, {} triangles, {} in the region, smallest angle {:.1} degrees",
        quality.nodes, quality.triangles, quality.region, quality.smallest_angle
    );
    let start = Instant::now();
    let forward = Forward::new(Arc::clone(&mesh), &sheet.contact_ohm_m())?;
    println!(
        "analysis once {:8.2} ms",
        start.elapsed().as_secs_f64() * 1e3
    );
    let protocol = Protocol::sheffield(sheet.electrodes())?;
    // another conductance each time, so that nothing can be reused
    let sigma = |round: usize| -> Vec<f64> {
        (0..mesh.triangles().len())
            .map(|t| 1e-3 * (1.0 - 0.5 * ((t * (round + 3)) as f64 * 0.618).fract()))
            .collect()
    };
    let mut sum = 0.0;
    let readings = median(31, |round| {
        sum += forward
            .readings(&sigma(round), &protocol)
            .expect("the conductances are positive")[0];
    });
    println!("598 readings  {readings:8.2} ms (median of 31; factor, 26 drives, refinement)");
    let jacobian = median(5, |round| {
        sum += forward
            .jacobian(&sigma(round), &protocol)
            .expect("the conductances are positive")[(0, 0)];
    });
    println!(
        "Jacobian      {jacobian:8.2} ms (median of 5; 598 x {})",
        mesh.triangles().len()
    );
    // keeps the work from being optimised away
    eprintln!("checksum {sum:e}");
    Ok(())
}
