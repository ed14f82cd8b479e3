//! Hard cases 35 and 38: results on any number of threads, and degenerate polygons.

use eit::{Model, TrainingSettings};

use crate::failure::{Attempt, Failure};
use crate::stability::outcome::{Check, Naive, Outcome};
use crate::stability::solvers::tank::{Tank, few_neurons, refused};

/// 35: one, two and eight threads.
pub(crate) fn threads() -> Result<Outcome, Failure> {
    let tank = Tank::small()?;
    let on = |threads: usize| -> Result<(String, Vec<u64>, u32), Failure> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .attempt("the threads")?;
        let hash = |(_, model): (_, Model)| model.hash().to_owned();
        let model = pool.install(|| tank.trained(60).map(hash))?;
        let forward = tank.forward(&tank.contact)?;
        let jacobian = pool
            .install(|| forward.jacobian(&tank.sigma, &tank.protocol))
            .map_err(refused)?;
        let bits = jacobian.iter().map(|value| value.to_bits()).collect();
        Ok((model, bits, summed(threads)))
    };
    let (model, jacobian, sum) = on(1)?;
    let (mut files, mut entries, mut sums) = (0, 0, 0);
    for threads in [2, 8] {
        let (other, also, by_thread) = on(threads)?;
        files += u32::from(other != model);
        entries += jacobian.iter().zip(&also).filter(|(a, b)| a != b).count();
        sums += u32::from(by_thread != sum);
    }
    Ok(Outcome::of([
        Check::at_most(
            "model files that differ, 2 and 8 threads against 1",
            Naive::Error(f64::from(sums)),
            f64::from(files),
            0.0,
        ),
        Check::at_most(
            "entries of the sensitivity that differ",
            Naive::Error(f64::from(sums)),
            entries as f64,
            0.0,
        ),
    ])
    .noted("naive: a sum in f32 with as many parts as there are threads"))
}

/// The bits of a sum that is divided into as many parts as there are threads.
fn summed(threads: usize) -> u32 {
    let values: Vec<f32> = (0..100_000)
        .map(|i| (i as f32 * 0.37).sin() + 1.0)
        .collect();
    let parts = values.chunks(values.len() / threads);
    let sum: f32 = parts.map(|part| part.iter().sum::<f32>()).sum();
    sum.to_bits()
}

/// 38: polygons with fewer than three corners, of zero size, or with crossing sides.
pub(crate) fn polygons() -> Result<Outcome, Failure> {
    const DRAWS: usize = 10_000;
    let tank = Tank::small()?;
    let region = tank.mesh.region().len();
    let drawn = |radius_m: f64| -> Result<[usize; 2], Failure> {
        let settings = TrainingSettings {
            radius_m,
            ..few_neurons(DRAWS)
        };
        let simulation = tank.simulation(&settings).attempt("the polygons")?;
        let mut counts = [0; 2];
        for case in 0..DRAWS {
            let target = simulation.target(case);
            counts[0] += usize::from(target.is_empty());
            let wrong = |change: f32| !(-1.0..0.0).contains(&change);
            let everywhere = target.len() == region && region > 0;
            counts[1] += usize::from(everywhere || target.iter().any(|(_, change)| wrong(*change)));
        }
        Ok(counts)
    };
    let [empty, wrong] = drawn(0.07)?;
    let [none, _] = drawn(1e-12)?;
    // naive rule: a point is inside if it is not to the right of any side, so without sides every point is inside
    let corners = |count: usize| -> Vec<[f64; 2]> {
        let turn = |k: usize| std::f64::consts::TAU * k as f64 / count as f64;
        (0..count).map(|k| [turn(k).cos(), turn(k).sin()]).collect()
    };
    let convex = |polygon: &[[f64; 2]], p: [f64; 2]| {
        let next = polygon.iter().cycle().skip(1);
        polygon
            .iter()
            .zip(next)
            .all(|(a, b)| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) >= 0.0)
    };
    let swallowed = (0..3)
        .filter(|&count| convex(&corners(count), [50.0, 50.0]))
        .count();
    Ok(Outcome::of([
        Check::at_most(
            "draws of 10,000 that cover everything or lose none or more than all",
            Naive::Error(swallowed as f64),
            wrong as f64,
            0.0,
        ),
        Check::at_least(
                        "share of empty samples where the radius is nothing",
            Naive::Absent("a count of draws".into()),
            none as f64 / DRAWS as f64,
            1.0,
        ),
    ])
    .noted(format!(
        "{:.1} % of the draws are empty samples, which are kept; even-odd rule where sides cross. Naive: left of every side; \
         counted are polygons of 0, 1 and 2 corners that then contain a point far outside",
        100.0 * empty as f64 / DRAWS as f64
    )))
}
