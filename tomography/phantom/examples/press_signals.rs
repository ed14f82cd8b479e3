//! Changes of the readings by the paper's presses, and the computing time of the phantom:
//! `cargo run -p tactus-phantom --example press_signals`.

use std::time::{Duration, Instant};

use phantom::{Phantom, Scene, paper};
use survey::Protocol;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let start = Instant::now();
    let mut phantom = Phantom::new(Scene::quiet())?;
    println!(
        "{} triangles, smallest angle {:.1} degrees, made in {:.0} ms",
        phantom.mesh().triangles().len(),
        phantom.mesh().quality().smallest_angle,
        start.elapsed().as_secs_f64() * 1e3
    );
    let protocol = Protocol::sheffield(phantom.electrodes())?;
    let readings = |phantom: &mut Phantom| -> Result<Vec<f64>, phantom::PhantomError> {
        let z = phantom.transfer_impedance(Duration::ZERO)?;
        let between = |s: survey::Dipole, electrode: usize| {
            z[(s.plus.0, electrode)] - z[(s.minus.0, electrode)]
        };
        Ok(protocol
            .measurements()
            .iter()
            .map(|q| between(q.sense, q.drive.plus.0) - between(q.sense, q.drive.minus.0))
            .collect())
    };
    let untouched = readings(&mut phantom)?;
    let largest = untouched.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    let smallest = untouched
        .iter()
        .fold(f64::INFINITY, |least, v| least.min(v.abs()));
    println!(
        "at 1 mA the largest reading is {largest:.1} mV, {:.0} times the smallest",
        largest / smallest
    );
    for centre in paper::test1_positions() {
        phantom.press(paper::s1(centre))?;
        let start = Instant::now();
        let pressed = readings(&mut phantom)?;
        let took = start.elapsed().as_secs_f64() * 1e3;
        let sum: f64 = pressed
            .iter()
            .zip(&untouched)
            .map(|(a, b)| (a - b) * (a - b))
            .sum();
        let rms = (sum / pressed.len() as f64).sqrt() * 1e3;
        println!("S1 at {centre:?} mm: {rms:.1} uV rms ({took:.0} ms)");
        phantom.release();
    }
    Ok(())
}
