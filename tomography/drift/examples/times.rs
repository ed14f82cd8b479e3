//! Computing times of the sheet's fit, the model and the frames of a tracker, on one core:
//! `cargo run --release -p tactus-drift --example times`. Linux counts the time on the processor; elsewhere it is elapsed time.

use std::sync::Arc;
use std::time::{Duration, Instant};

use drift::{DriftModel, FitOptions, Noise, Pairs, SheetFit, Tracker};
use eit::{Forward, PaperSheet};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use survey::{Protocol, Reading, Volts};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build_global()?;
    let start = Instant::now();
    let clock = || processor_time().unwrap_or_else(|| start.elapsed());
    let protocol = Protocol::sheffield(26)?;
    let fine = PaperSheet {
        fineness: 1.5,
        ..PaperSheet::default()
    };
    let mesh = Arc::new(fine.mesh()?);
    let sigma = vec![fine.conductance(); mesh.triangles().len()];
    let forward = Forward::new(Arc::clone(&mesh), &fine.contact_ohm_m())?;
    let volts = forward.readings(&sigma, &protocol)? * 1e-3;
    let baseline: Vec<Reading> = volts.iter().map(|v| Reading::Ok(Volts(*v))).collect();

    let sheet = PaperSheet::default();
    let mesh = Arc::new(sheet.mesh()?);
    let sigma0 = vec![sheet.conductance(); mesh.triangles().len()];
    let contact = sheet.contact_ohm_m();
    let (options, pairs) = (FitOptions::default(), Pairs::new(&protocol));
    let begun = clock();
    let fit = SheetFit::new(&mesh, &contact, &sigma0, &pairs, volts.as_slice(), &options)?;
    let seconds = (clock() - begun).as_secs_f64();
    println!(
        "fit of the sheet  {seconds:.2} s, misfit {:.2} %",
        100.0 * fit.misfit
    );
    let noise = Noise {
        reading_v: 2e-6,
        emf_v: 0.9e-6,
    };
    let begun = clock();
    let model = DriftModel::new(
        &mesh, &contact, &sigma0, &protocol, &baseline, noise, &options,
    )?;
    println!("model with fit    {:.2} s", (clock() - begun).as_secs_f64());
    let model = Arc::new(model);
    let disc = model.disc([0.06, 0.15], 0.03) * -0.5;
    let relative = model.relative(&baseline)?;
    let begun = clock();
    let assessed = model.assess(&disc, &relative.rows)?;
    let steps = assessed.evaluations;
    println!(
        "evidence          {:.0} ms, {steps} likelihoods",
        ms(clock() - begun)
    );
    let begun = clock();
    assessed.whitened.fit_disc(&model)?;
    println!("one disc          {:.0} ms", ms(clock() - begun));
    // a load that is not a disc: two discs
    let two = &disc + model.disc([0.14, 0.08], 0.04) * -0.5;
    let begun = clock();
    let drift = model.frame_drift(&two, &relative.rows)?;
    println!(
        "drift of a frame  {:.0} ms, {}",
        ms(clock() - begun),
        if drift.is_disc { "one disc" } else { "no disc" }
    );
    let mut tracker = Tracker::new(Arc::clone(&model), 0.0)?;
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut frame = || -> Vec<Reading> {
        let readings = volts.iter().map(|volts| {
            let normal: f64 = StandardNormal.sample(&mut random);
            Reading::Ok(Volts(volts + noise.reading_v * normal))
        });
        readings.collect()
    };
    for k in 1..=14 {
        tracker.follow(&frame(), 600.0 * f64::from(k))?;
    }
    // five days: the covariance is renewed every 24th frame, a baseline of the past is compared every sixth
    let mut each = Vec::new();
    for k in 15..735 {
        let frame = frame();
        // processor time is counted in steps longer than a frame, so elapsed time is measured
        let begun = Instant::now();
        tracker.follow(&frame, 600.0 * f64::from(k))?;
        each.push(ms(begun.elapsed()));
    }
    let mean = each.iter().sum::<f64>() / each.len() as f64;
    each.sort_by(f64::total_cmp);
    let median = each[each.len() / 2];
    println!("empty frame       {median:.2} ms in the median, {mean:.2} in the mean");
    let mut pressed = volts.as_slice().to_vec();
    for (row, change) in disc.iter().enumerate() {
        for reading in model.pairs().readings(row) {
            pressed[reading] += change;
        }
    }
    let pressed: Vec<Reading> = pressed.iter().map(|v| Reading::Ok(Volts(*v))).collect();
    let begun = clock();
    let answer = tracker.follow(&pressed, 600.0 * 735.0)?;
    let loads = answer.loads;
    println!(
        "event             {:.0} ms, {loads} load",
        ms(clock() - begun)
    );
    Ok(())
}

fn ms(time: Duration) -> f64 {
    1e3 * time.as_secs_f64()
}

/// Time of this thread on a processor.
fn processor_time() -> Option<Duration> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds = text.split_whitespace().next()?.parse().ok()?;
    Some(Duration::from_nanos(nanoseconds))
}
