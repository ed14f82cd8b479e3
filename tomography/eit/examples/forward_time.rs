//! How long the forward model and what stands on it take at the paper's size:
//! `cargo run --release -p eit --example forward_time`.
//!
//! Shortest and median wall time of each; on a machine with other work the shortest is the honest one.

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use eit::{Forward, PaperSheet};
use survey::{Dipole, Protocol};

fn show(what: &str, rounds: usize, mut work: impl FnMut(usize)) {
    let mut times: Vec<f64> = (0..rounds)
        .map(|round| {
            let start = Instant::now();
            work(round);
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    println!("{what:44} {:9.3} {:9.3}", times[0], times[rounds / 2]);
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sheet = PaperSheet::default();
    let mesh = Arc::new(sheet.mesh()?);
    let quality = mesh.quality();
    println!(
        "{} nodes, {} triangles, {} in the region, smallest angle {:.1} degrees",
        quality.nodes, quality.triangles, quality.region, quality.smallest_angle
    );
    println!("{:44} {:>9} {:>9}", "ms", "shortest", "median");
    show("mesh", 3, |_| {
        black_box(sheet.mesh().expect("the default sheet"));
    });
    let contacts = sheet.contact_ohm_m();
    show("analysis, once", 5, |_| {
        black_box(Forward::new(Arc::clone(&mesh), &contacts).expect("the default sheet"));
    });
    let forward = Forward::new(Arc::clone(&mesh), &contacts)?;
    let protocol = Protocol::sheffield(sheet.electrodes())?;
    let drives: Vec<Dipole> = protocol.drives();
    // another conductance each time, so that nothing can be reused
    let everywhere: Vec<Vec<f64>> = (0..64)
        .map(|round| {
            (0..mesh.triangles().len())
                .map(|t| 1e-3 * (1.0 - 0.5 * ((t * (round + 3)) as f64 * 0.618).fract()))
                .collect()
        })
        .collect();
    let sigma0 = vec![1e-3; mesh.triangles().len()];
    // a disc of 30 mm somewhere
    let pressed: Vec<Vec<f64>> = (0..64)
        .map(|round| {
            let centre = [0.04 + 0.0021 * round as f64, 0.05 + 0.0013 * round as f64];
            let mut sigma = sigma0.clone();
            for &t in mesh.region() {
                let p = mesh.centroid(t);
                if (p[0] - centre[0]).hypot(p[1] - centre[1]) < 0.03 {
                    sigma[t] *= 0.4;
                }
            }
            sigma
        })
        .collect();
    let expect = "the conductances are positive";
    show("all fields, refined", 200, |round| {
        black_box(
            forward
                .solve(&everywhere[round % 64], &drives)
                .expect(expect),
        );
    });
    let mut plain = forward.workspace(&protocol)?.plain();
    show("all fields, plain", 200, |round| {
        black_box(plain.fields(&everywhere[round % 64]).expect(expect));
    });
    let mut refined = forward.workspace(&protocol)?;
    show("598 readings, refined", 200, |round| {
        black_box(refined.readings(&everywhere[round % 64]).expect(expect));
    });
    show("598 readings, plain", 200, |round| {
        black_box(plain.readings(&everywhere[round % 64]).expect(expect));
    });
    let mut about = forward.workspace(&protocol)?.plain().about(&sigma0)?;
    show("the same, a disc of 30 mm about a known", 200, |round| {
        black_box(about.readings(&pressed[round % 64]).expect(expect));
    });
    show("Jacobian, 598 x all", 10, |round| {
        black_box(
            forward
                .jacobian(&everywhere[round % 64], &protocol)
                .expect(expect),
        );
    });
    Ok(())
}
