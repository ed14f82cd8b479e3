//! Time per frame of the trained networks, next to the memory bandwidth measured in the same run.
//!
//! `cargo run --release -p tactus-eit --example deep_time [THREADS]`, 2 by default. The deep network has the paper's
//! size and untrained weights; its time does not depend on them. Every figure is the minimum of many interleaved
//! rounds.

use std::hint::black_box;
use std::time::Instant;

use eit::inverse::learned::network::{Layer, Weights};
use eit::{DeepNetwork, DeepSettings, Network, Precision, model};
use rayon::prelude::*;

const ROUNDS: usize = 300;
const FRAMES: usize = 5000;

fn main() {
    let threads = std::env::args()
        .nth(1)
        .and_then(|text| text.parse().ok())
        .unwrap_or(2);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("threads can be started");
    pool.install(run);
}

fn run() {
    let widths = DeepSettings::default().widths(598, 3690);
    let wave = |count: usize, size: f32| -> Vec<f32> {
        (0..count).map(|i| (i as f32 * 0.37).sin() * size).collect()
    };
    let layers = widths
        .windows(2)
        .map(|pair| Layer {
            weights: Weights::F32(wave(pair[0] * pair[1], (3.0 / pair[0] as f32).sqrt())),
            bias: wave(pair[1], 0.1),
        })
        .collect();
    let exact = DeepNetwork::new(
        vec![0.0; widths[0]],
        vec![1.0; widths[0]],
        vec![0.0; widths[0]],
        layers,
    )
    .expect("the layers fit");
    let networks = [Precision::F32, Precision::F16, Precision::Int8]
        .map(|precision| exact.with_precision(precision));
    let rbf = std::env::args().nth(2).map(|path| {
        let model = model::load(path.as_ref()).expect("a model file is given");
        match model.network() {
            Network::Rbf(network) => network.clone(),
            Network::Deep(..) => panic!("an RBF model file is wanted"),
        }
    });
    let input = wave(widths[0], 1.0);
    let wide: Vec<f64> = input.iter().map(|value| f64::from(*value) * 1e-3).collect();
    let memory = vec![1.0_f32; exact.weight_bytes() / 4];
    let mut least = [f64::INFINITY; 5];
    for _ in 0..ROUNDS {
        let mut time = |slot: usize, work: &dyn Fn()| {
            let start = Instant::now();
            work();
            least[slot] = least[slot].min(start.elapsed().as_secs_f64() * 1e3);
        };
        time(0, &|| {
            let sum: f32 = memory
                .par_chunks(1 << 17)
                .map(|part| {
                    let mut lanes = [0.0_f32; 64];
                    for part in part.chunks_exact(64) {
                        for (lane, value) in lanes.iter_mut().zip(part) {
                            *lane += value;
                        }
                    }
                    lanes.iter().sum::<f32>()
                })
                .sum();
            black_box(sum);
        });
        for (slot, network) in networks.iter().enumerate() {
            time(slot + 1, &|| {
                black_box(network.predict(&input));
            });
        }
    }
    if let Some(rbf) = &rbf {
        for _ in 0..FRAMES {
            let start = Instant::now();
            black_box(rbf.predict(&wide));
            least[4] = least[4].min(start.elapsed().as_secs_f64() * 1e3);
        }
    }
    let megabytes = |bytes: usize| bytes as f64 * 1e-6;
    println!(
        "reading {:.1} MB: {:.2} ms, {:.1} GB/s on {} threads",
        megabytes(exact.weight_bytes()),
        least[0],
        megabytes(exact.weight_bytes()) / least[0],
        rayon::current_num_threads()
    );
    for (network, time) in networks.iter().zip(&least[1..]) {
        println!(
            "deep frame {}: {:.1} MB, {time:.2} ms, {:.0} % of that bandwidth",
            network.precision().name(),
            megabytes(network.weight_bytes()),
            100.0 * megabytes(network.weight_bytes())
                / time
                / (megabytes(exact.weight_bytes()) / least[0])
        );
    }
    if rbf.is_some() {
        println!("RBF frame: {:.3} ms", least[4]);
    }
}
