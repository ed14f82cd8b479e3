//! Measures the time of calls of the Rust engine for `benchmarks/compare.py`, which measures the same calls through
//! Python. Call: `times ELECTRODES FINENESS`. Each line of standard input names a work (`forward`, `jacobian`,
//! `set-up`, `frame`); for each, a line with the shortest processor time of a call, s, is printed.

use std::error::Error;
use std::hint::black_box;
use std::io::{BufRead, Write};
use std::sync::Arc;

use cpu_time::ProcessTime;
use eit::{DiscTank, Forward, Mesh, Parameters, Preset};
use imaging::recorded::{Fitted, Unloaded};
use imaging::{Geometry, HyperChoice, Method, Model, ReconstructionSettings, Unknowns};
use survey::{Protocol, Reading, Volts};

/// Most calls for one line of input, and processor time after which no further call starts, s.
const CALLS: usize = 10;
const TURN_S: f64 = 0.1;

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().collect();
    let [_, electrodes, fineness] = &words[..] else {
        return Err("call: times ELECTRODES FINENESS".into());
    };
    let tank = DiscTank {
        electrodes: electrodes.parse()?,
        fineness: fineness.parse()?,
        ..DiscTank::default()
    };
    let geometry = Geometry::from_preset(&Preset::DiscTank(tank))?;
    let protocol = Protocol::sheffield(geometry.electrodes())?;
    let sigma = geometry.sigma0.clone();
    let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m)?;
    let ohms = forward.readings(&sigma, &protocol)?;
    let volts = |change: f64| -> Vec<Reading> {
        let each = ohms.iter().enumerate();
        each.map(|(reading, ohms)| {
            Reading::Ok(Volts(1e-3 * ohms * (1.0 + change * (reading as f64).sin())))
        })
        .collect()
    };
    let (baseline, frame) = (volts(0.0), volts(1e-3));
    let geometry = Geometry {
        from_case: true,
        sigma0_known: true,
        ..geometry
    };
    let mut made = None;
    for line in std::io::stdin().lock().lines() {
        let work = line?;
        let mut times: Vec<f64> = Vec::new();
        while times.len() < CALLS && times.iter().sum::<f64>() < TURN_S {
            let begin = ProcessTime::now();
            match work.as_str() {
                "forward" => {
                    black_box(forward.readings(&sigma, &protocol)?);
                }
                "jacobian" => {
                    let all = Parameters::elements();
                    black_box(forward.sensitivity(&sigma, &protocol, &all)?);
                }
                "set-up" => made = Some(set_up(geometry.clone(), &protocol, &baseline)?),
                "frame" => {
                    let model = made.as_ref().ok_or("no set-up yet")?;
                    black_box(model.reconstructor.reconstruct(&baseline, &frame)?);
                }
                other => return Err(format!("no work is called {other}").into()),
            }
            times.push(begin.elapsed().as_secs_f64());
        }
        println!("{}", times.into_iter().fold(f64::INFINITY, f64::min));
        std::io::stdout().flush()?;
    }
    Ok(())
}

fn set_up(
    geometry: Geometry,
    protocol: &Protocol,
    baseline: &[Reading],
) -> Result<Model, Box<dyn Error>> {
    // a mesh caches its analysis, a new mesh has none
    let mesh = &geometry.mesh;
    let fresh = Mesh::new(
        mesh.nodes().to_vec(),
        mesh.triangles().to_vec(),
        mesh.electrode_edges().to_vec(),
        None,
    )?;
    let geometry = Geometry {
        mesh: Arc::new(fresh),
        ..geometry
    };
    black_box(Forward::new(
        Arc::clone(&geometry.mesh),
        &geometry.contact_ohm_m,
    )?);
    let unloaded = Unloaded::mean(&[baseline]);
    let fitted = Fitted::new(geometry, protocol, &vec![1e-3; protocol.len()], &unloaded)?;
    let mut conditions = fitted.conditions(protocol);
    (conditions.noise_v, conditions.noise_assumed) = (Some(2e-6), false);
    let settings = ReconstructionSettings {
        method: Some(Method::OneStep),
        loss_only: Some(false),
        unknowns: Some(Unknowns::Sheet),
        choose: Some(HyperChoice::Noise),
        ..Default::default()
    };
    Ok(imaging::unjudged(&settings, &conditions)?)
}
