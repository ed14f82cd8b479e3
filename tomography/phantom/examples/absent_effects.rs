//! Computing time of effects that a scene does not name: `cargo run --release -p tactus-phantom --example
//! absent_effects`.
//!
//! Times frames of a scene without effects and, in alternation, the same readings taken directly from the forward
//! solution. Prints median and interquartile range of both, in ns per reading.

use std::hint::black_box;
use std::time::{Duration, Instant};

use phantom::{Phantom, Scan, Scene};

const TURNS: usize = 41;
const FRAMES: usize = 100;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scan = Scan::usual(26)?;
    let coarse = "[mesh]\nfineness = 0.3\n";
    let named = format!("{coarse}[effects.voltmeter-noise]\n");
    let mut bare = Phantom::new(Scene::parse("bare.toml", coarse)?)?;
    let mut noisy = Phantom::new(Scene::parse("noisy.toml", &named)?)?;
    let requested = scan.protocol.measurements().to_vec();
    let mut times: [Vec<f64>; 3] = Default::default();
    let per_reading = 1e9 / (FRAMES * requested.len()) as f64;
    for _ in 0..TURNS {
        let start = Instant::now();
        for _ in 0..FRAMES {
            let frame: Result<Vec<f64>, phantom::PhantomError> = requested
                .iter()
                .map(|requested| {
                    let z = bare.transfer_impedance(Duration::ZERO)?;
                    let seen =
                        |k: usize| z[(requested.sense.plus.0, k)] - z[(requested.sense.minus.0, k)];
                    Ok(scan.current.0
                        * (seen(requested.drive.plus.0) - seen(requested.drive.minus.0)))
                })
                .collect();
            black_box(frame?);
        }
        times[0].push(start.elapsed().as_secs_f64() * per_reading);
        for (phantom, times) in [&mut bare, &mut noisy].into_iter().zip(&mut times[1..]) {
            let start = Instant::now();
            for _ in 0..FRAMES {
                black_box(scan.frame(phantom, Duration::ZERO)?);
            }
            times.push(start.elapsed().as_secs_f64() * per_reading);
        }
    }
    let names = [
        "forward solution alone",
        "a scene without effects",
        "with voltmeter noise",
    ];
    for (name, times) in names.iter().zip(&mut times) {
        times.sort_by(f64::total_cmp);
        let [low, middle, high] = [TURNS / 4, TURNS / 2, 3 * TURNS / 4].map(|k| times[k]);
        println!("{name:26} {middle:7.1} ns a reading ({low:.1} to {high:.1})");
    }
    Ok(())
}
