//! Accuracy of the model-based methods on simulated presses, with any seeds:
//! `cargo run --release -p tactus-studies --example press_figures -- [FIRST_SEED [PRESSES [METHOD...]]]`.
//!
//! Discs of 10 and 30 mm halve the conductance at random positions of the region. The readings are solved on the
//! phantom's finer mesh, with 2 uV of white noise on baseline and frame. Prints mean and largest location error (mm),
//! mean correlation with the true map, mean Dice coefficient of the parts at or above half of the largest loss, and
//! median time per frame.

use std::sync::Arc;
use std::time::{Duration, Instant};

use eit::{
    Mesh, OneStep, OneStepOptions, PaperSheet, Prior, Reconstructor, Strength, Tv, TvOptions,
};
use phantom::{Load, Phantom, Scene};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use survey::{Protocol, Reading, Volts};

const CURRENT: f64 = 1e-3;
const NOISE: f64 = 2e-6;

struct Press {
    at: [f64; 2],
    truth: Vec<f64>,
    baseline: Vec<Reading>,
    frame: Vec<Reading>,
}

fn readings(
    phantom: &mut Phantom,
    protocol: &Protocol,
    random: &mut ChaCha8Rng,
) -> Result<Vec<Reading>, Box<dyn std::error::Error>> {
    let z = phantom.transfer_impedance(Duration::ZERO)?;
    let noise = Normal::new(0.0, NOISE)?;
    Ok(protocol
        .measurements()
        .iter()
        .map(|question| {
            let exact = phantom::across(z, question.sense, question.drive);
            Reading::Ok(Volts(CURRENT * exact + noise.sample(random)))
        })
        .collect())
}

fn presses(
    phantom: &mut Phantom,
    protocol: &Protocol,
    sheet: &PaperSheet,
    mesh: &Mesh,
    diameter_mm: f64,
    seeds: std::ops::Range<u64>,
) -> Result<Vec<Press>, Box<dyn std::error::Error>> {
    seeds
        .map(|seed| {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let within = |half: f64, random: &mut ChaCha8Rng| {
                (half - 0.5 * diameter_mm) * (2.0 * random.random::<f64>() - 1.0)
            };
            let at = [
                0.5 * sheet.width_mm + within(sheet.region_half_width_mm, &mut random),
                0.5 * sheet.height_mm + within(sheet.region_half_height_mm, &mut random),
            ];
            phantom.release();
            let baseline = readings(phantom, protocol, &mut random)?;
            let load = Load::disc(at, diameter_mm, 0.5);
            let mut whole = vec![0.0; mesh.triangles().len()];
            for (triangle, share) in load.coverage(mesh)? {
                whole[triangle] = -0.5 * share;
            }
            phantom.press(load)?;
            Ok(Press {
                at: at.map(|mm| mm * 1e-3),
                truth: mesh.region().iter().map(|&t| whole[t]).collect(),
                baseline,
                frame: readings(phantom, protocol, &mut random)?,
            })
        })
        .collect()
}

fn correlation(a: &[f64], b: &[f64], areas: &[f64]) -> f64 {
    let all: f64 = areas.iter().sum();
    let mean = |x: &[f64]| x.iter().zip(areas).map(|(x, w)| x * w).sum::<f64>() / all;
    let (ma, mb) = (mean(a), mean(b));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for ((x, y), w) in a.iter().zip(b).zip(areas) {
        ab += w * (x - ma) * (y - mb);
        aa += w * (x - ma) * (x - ma);
        bb += w * (y - mb) * (y - mb);
    }
    if aa * bb > 0.0 {
        ab / (aa * bb).sqrt()
    } else {
        0.0
    }
}

fn dice(map: &[f64], truth: &[f64], areas: &[f64]) -> f64 {
    let least = map.iter().copied().fold(0.0, f64::min);
    let (mut both, mut sum) = (0.0, 0.0);
    for ((x, t), w) in map.iter().zip(truth).zip(areas) {
        let (found, there) = (*x <= 0.5 * least && least < 0.0, *t <= -0.25);
        both += w * f64::from(u8::from(found && there));
        sum += w * (f64::from(u8::from(found)) + f64::from(u8::from(there)));
    }
    2.0 * both / sum
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let first: u64 = arguments.next().map_or(Ok(1000), |text| text.parse())?;
    let count: u64 = arguments.next().map_or(Ok(32), |text| text.parse())?;
    let wanted: Vec<String> = arguments.collect();
    let sheet = PaperSheet::default();
    let mesh = Arc::new(sheet.mesh()?);
    let sigma0 = vec![sheet.conductance(); mesh.triangles().len()];
    let protocol = Protocol::sheffield(26)?;
    let mut phantom = Phantom::new(Scene::quiet())?;
    let sets = [10.0, 30.0]
        .iter()
        .map(|&d| {
            presses(
                &mut phantom,
                &protocol,
                &sheet,
                &mesh,
                d,
                first..first + count,
            )
        })
        .collect::<Result<Vec<_>, _>>()?;
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    let contact = sheet.contact_ohm_m();
    for name in &wanted {
        let parts: Vec<&str> = name.split(':').collect();
        let number = |at: usize, or: f64| parts.get(at).map_or(Ok(or), |text| text.parse::<f64>());
        let loss_only = parts.contains(&"loss");
        let method: Box<dyn Reconstructor> = match parts[0] {
            "tv" => Box::new(Tv::new(
                Arc::clone(&mesh),
                &contact,
                &sigma0,
                &protocol,
                TvOptions {
                    strength: Strength::Relative(number(1, 1.0)?),
                    gap: number(2, 1e-3)?,
                    loss_only,
                    ..TvOptions::default()
                },
            )?),
            prior => Box::new(OneStep::new(
                Arc::clone(&mesh),
                &contact,
                &sigma0,
                &protocol,
                OneStepOptions {
                    prior: match prior {
                        "laplace" => Prior::Laplace,
                        "tikhonov" => Prior::Tikhonov,
                        _ => OneStepOptions::default().prior,
                    },
                    loss_only,
                    ..OneStepOptions::default()
                },
            )?),
        };
        for (set, diameter) in sets.iter().zip([10, 30]) {
            let (mut errors, mut correlations, mut dices) = (vec![], vec![], vec![]);
            let (mut times, mut newness) = (vec![], vec![]);
            for press in set {
                let start = Instant::now();
                let map = method.reconstruct(&press.baseline, &press.frame)?;
                times.push(1e3 * start.elapsed().as_secs_f64());
                let found = map.found(&centroids, &areas).unwrap_or([0.0; 2]);
                errors.push(1e3 * (found[0] - press.at[0]).hypot(found[1] - press.at[1]));
                correlations.push(correlation(&map.values, &press.truth, &areas));
                dices.push(dice(&map.values, &press.truth, &areas));
                newness.extend(
                    method
                        .novelty(&press.baseline, &press.frame)?
                        .map(|n| n.value),
                );
            }
            times.sort_by(f64::total_cmp);
            let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
            let worst = |x: &[f64]| x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            println!(
                "{name:<22} {diameter} mm: error {:.2} worst {:.2} mm, correlation {:.3}, Dice {:.3}, {:.1} ms (worst {:.1}), \
                 novelty {:.2} worst {:.2}",
                mean(&errors),
                worst(&errors),
                mean(&correlations),
                mean(&dices),
                times[times.len() / 2],
                worst(&times),
                mean(&newness),
                worst(&newness),
            );
        }
    }
    Ok(())
}
