//! Hard cases 30 and 32 to 34: missing readings, tiny baseline readings, reversed signs, and one channel with a spike.

use eit::{MOST_MISSING, OneStep, OneStepOptions, ReconstructError, Reconstructor};
use nalgebra::{DMatrix, DVector};
use survey::{Amps, Checks, Frame, QualityFlag, Reading, Volts};

use crate::failure::{Attempt, Failure};
use crate::readings::{measured, plain_frame};
use crate::stability::outcome::{Check, Naive, Outcome, naive, worst};
use crate::stability::solvers::tank::Tank;

/// Drive current, A.
const CURRENT: f64 = 1e-3;

/// A tank, a load, and the default method.
struct Scene {
    tank: Tank,
    baseline: Vec<f64>,
    frame: Vec<f64>,
    step: OneStep,
    /// Rms of the noise of the default map.
    noise: f64,
}

impl Scene {
    /// A tank of sixteen electrodes.
    fn tank() -> Result<Self, Failure> {
        let tank = Tank::sixteen(0.4)?;
        let load = tank.patch([0.4, 0.1], 0.2);
        Self::of(tank, &load)
    }

    /// The paper's sheet.
    fn paper() -> Result<Self, Failure> {
        let tank = Tank::paper()?;
        let load: Vec<usize> = (0..tank.sigma.len())
            .filter(|&t| {
                let [x, y] = tank.mesh.centroid(t);
                (x - 0.09).hypot(y - 0.13) < 0.015
            })
            .collect();
        Self::of(tank, &load)
    }

    fn of(tank: Tank, load: &[usize]) -> Result<Self, Failure> {
        let volts = |sigma: &[f64]| -> Result<Vec<f64>, Failure> {
            let volts = tank.ours(&tank.contact, sigma)?;
            Ok(volts.into_iter().map(|v| CURRENT * v).collect())
        };
        let (baseline, frame) = (volts(&tank.sigma)?, volts(&tank.with(load, 0.5))?);
        let step = tank
            .one_step(OneStepOptions::default())
            .attempt("the one-step method")?;
        let noise = spread(&step)?;
        Ok(Self {
            baseline,
            frame,
            step,
            noise,
            tank,
        })
    }

    fn map(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<(DVector<f64>, usize), Failure> {
        let map = self
            .step
            .reconstruct(baseline, frame)
            .attempt("the one-step method")?;
        Ok((DVector::from_vec(map.values), map.masked))
    }
}

/// Rms over the map of the effect of the default noise.
fn spread(step: &OneStep) -> Result<f64, Failure> {
    let deviation = std::f64::consts::SQRT_2 * eit::DEFAULT_NOISE_V / CURRENT;
    let matrix = matrix(step)?;
    Ok(deviation * matrix.norm() / (matrix.nrows() as f64).sqrt())
}

fn matrix(step: &OneStep) -> Result<DMatrix<f64>, Failure> {
    step.matrix().attempt("the one-step method")
}

fn rms(map: &DVector<f64>) -> f64 {
    map.norm() / (map.len() as f64).sqrt()
}

/// 30: a missing reading.
pub(crate) fn no_reading() -> Result<Outcome, Failure> {
    let scene = Scene::tank()?;
    let (baseline, frame) = (measured(&scene.baseline), measured(&scene.frame));
    let (whole, _) = scene.map(&baseline, &frame)?;
    let matrix = matrix(&scene.step)?;
    let (mut ours, mut zeroed, mut miscounted) = (0.0, 0.0, 0);
    for k in 0..frame.len() {
        let mut holed = frame.clone();
        holed[k] = Reading::Overload;
        let (map, masked) = scene.map(&baseline, &holed)?;
        ours = worst(ours, rms(&(&map - &whole)) / scene.noise);
        miscounted += usize::from(masked != 1);
        // naive: the voltmeter's overload value used as a voltage
        let poison = matrix.column(k) * ((9.9e37 - scene.frame[k]) / CURRENT);
        zeroed = worst(zeroed, rms(&poison.into_owned()) / scene.noise);
    }
    let mut most = frame.clone();
    let count = (MOST_MISSING * frame.len() as f64) as usize + 1;
    most[..count].fill(Reading::NotMeasured);
    // naive: no change where readings are missing
    let change = DVector::from_fn(frame.len(), |k, _| match k < count {
        true => 0.0,
        false => (scene.frame[k] - scene.baseline[k]) / CURRENT,
    });
    let filled = matrix * change;
    let mapped = !matches!(
        scene.step.reconstruct(&baseline, &most),
        Err(ReconstructError::TooManyMissing { .. })
    );
    Ok(Outcome::of([
        Check::at_most(
            "change of the map without one reading, of its noise",
            Naive::Error(zeroed),
            ours,
            1.0,
        ),
        Check::at_most(
            "maps whose count of masked readings is wrong",
            Naive::Absent("a form that takes 9.9e37 for a voltage masks nothing".into()),
            miscounted as f64,
            0.0,
        ),
        Check::at_most(
            "maps made with more than half missing",
            Naive::Error(f64::from(u8::from(filled.iter().all(|v| v.is_finite())))),
            f64::from(u8::from(mapped)),
            0.0,
        ),
    ])
    .noted("naive: 9.9e37 is taken for a voltage; missing readings count as unchanged"))
}

/// 32: a baseline reading of nearly zero.
pub(crate) fn tiny_baseline() -> Result<Outcome, Failure> {
    let scene = Scene::paper()?;
    let size = |k: &usize| scene.baseline[*k].abs();
    let least = (0..scene.baseline.len())
        .min_by(|a, b| size(a).total_cmp(&size(b)))
        .unwrap_or(0);
    let most = (0..scene.baseline.len())
        .max_by(|a, b| size(a).total_cmp(&size(b)))
        .unwrap_or(0);
    let largest = scene.baseline[most].abs();
    let (whole, _) = scene.map(&measured(&scene.baseline), &measured(&scene.frame))?;
    let (mut baseline, mut frame) = (scene.baseline.clone(), scene.frame.clone());
    (baseline[least], frame[least]) = (0.0, 0.0);
    let (dead, _) = scene.map(&measured(&baseline), &measured(&frame))?;
    let relative = (frame[least] - baseline[least]) / baseline[least];
    // the change of the map by the noise of one reading
    let shaken = |k: usize| -> Result<f64, Failure> {
        let mut noisy = scene.frame.clone();
        noisy[k] += eit::DEFAULT_NOISE_V;
        let (map, _) = scene.map(&measured(&scene.baseline), &measured(&noisy))?;
        Ok(rms(&(map - &whole)))
    };
    Ok(Outcome::of([
        Check::at_most(
            "change of the map where the smallest reading is 0, of its noise",
            naive(relative, "0/0 in dv / v0"),
            rms(&(dead - &whole)) / scene.noise,
            1.0,
        ),
        Check::at_most(
            "effect of the smallest reading's noise, of that of the largest's",
            Naive::Error(largest / scene.baseline[least].abs()),
            shaken(least)? / shaken(most)?,
            3.0,
        ),
    ])
    .noted("no method of ours divides by a reading's own baseline: Eq. 6 divides by the largest, the linear methods by one factor for each distance of pairs"))
}

/// 33: a reversed pair of leads.
pub(crate) fn reversed_leads() -> Result<Outcome, Failure> {
    let scene = Scene::tank()?;
    let protocol = &scene.tank.protocol;
    let baseline = measured(&scene.baseline);
    let checks = Checks::new(protocol).against(&baseline);
    let (mut unseen, mut by_size) = (0, 0);
    for turned in protocol.drives() {
        let volts: Vec<f64> = protocol
            .measurements()
            .iter()
            .zip(&scene.frame)
            .map(|(question, v)| if question.sense == turned { -v } else { *v })
            .collect();
        let flags = checks.of(&frame(&scene, measured(&volts))).flags;
        unseen += usize::from(!flags.contains(&QualityFlag::Plausibility));
        let magnitudes: Vec<f64> = volts.iter().map(|v| v.abs()).collect();
        let own = measured(&scene.baseline.iter().map(|v| v.abs()).collect::<Vec<_>>());
        let flags = Checks::new(protocol)
            .against(&own)
            .of(&frame(&scene, measured(&magnitudes)))
            .flags;
        by_size += usize::from(!flags.contains(&QualityFlag::Plausibility));
    }
    let backwards: Vec<f64> = scene.baseline.iter().map(|v| -v).collect();
    let answer = scene
        .step
        .reconstruct(&measured(&backwards), &measured(&scene.frame));
    let taken = !matches!(answer, Err(ReconstructError::OppositeSign));
    Ok(Outcome::of([
        Check::at_most(
            "reversed sensing pairs not seen, of 16",
            Naive::Error(by_size as f64),
            unseen as f64,
            0.0,
        ),
        Check::at_most(
            "a source with its leads reversed, accepted",
            Naive::Absent("a magnitude has no sign to check".into()),
            f64::from(u8::from(taken)),
            0.0,
        ),
    ])
    .noted("naive: the magnitude of every reading"))
}

/// A frame as a rig would return it.
fn frame(scene: &Scene, readings: Vec<Reading>) -> Frame {
    let hash = scene.tank.protocol.hash();
    plain_frame(readings, hash, Amps(CURRENT), Volts(1.0))
}

/// 34: one channel with a reading a hundred times too large.
pub(crate) fn one_spike() -> Result<Outcome, Failure> {
    let scene = Scene::paper()?;
    let (whole, _) = scene.map(&measured(&scene.baseline), &measured(&scene.frame))?;
    let protocol = &scene.tank.protocol;
    let checks = Checks::new(protocol);
    let (mut ours, mut beyond, mut normalised) = (0.0, 0.0, 0.0);
    let (mut silent, mut within_range) = (0, 0);
    let largest = |volts: &[f64]| volts.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
    for k in 0..scene.frame.len() {
        let spiked = |volts: &[f64]| {
            let mut volts = volts.to_vec();
            volts[k] *= 100.0;
            volts
        };
        let (baseline, frame_volts) = (spiked(&scene.baseline), spiked(&scene.frame));
        let (map, _) = scene.map(&measured(&baseline), &measured(&frame_volts))?;
        ours = worst(ours, (&map - &whole).norm() / whole.norm());
        let mut without = [measured(&scene.baseline), measured(&scene.frame)];
        without
            .iter_mut()
            .for_each(|readings| readings[k] = Reading::Overload);
        let (masked, _) = scene.map(&without[0], &without[1])?;
        beyond = worst(beyond, (&map - &masked).norm() / whole.norm());
        normalised = worst(
            normalised,
            largest(&baseline) / largest(&scene.baseline) - 1.0,
        );
        within_range += usize::from(frame_volts[k].abs() <= largest(&scene.baseline));
        let flags = checks.of(&frame(&scene, measured(&frame_volts))).flags;
        silent += usize::from(!flags.contains(&QualityFlag::Reciprocity));
    }
    Ok(Outcome::of([
        Check::at_most(
            "change of the map by a channel 100 times too large",
            Naive::Error(normalised),
            ours,
            0.02,
        ),
        Check::at_most(
            "the same, beyond what that reading's absence changes",
            Naive::Error(normalised),
            beyond,
            1e-12,
        ),
        Check::at_most(
            "such channels not flagged, of 598",
            Naive::Error(within_range as f64),
            silent as f64,
            0.0,
        ),
    ])
    .noted(
        "1 % is asked; the bound is 2 %, because leaving out that reading alone, without a spike, changes the map by up to 1.0 %. A reading that contradicts its reciprocal twin is masked; a protocol without twins has no such check, and the divisor of a network stays the largest reading that is not masked, as in the paper. Naive: divide by the largest reading; a limit at the largest reading of the baseline",
    ))
}
