//! Accuracy of maps: methods against kinds of load, with and without a stated noise.

use std::collections::BTreeMap;
use std::f64::consts::SQRT_2;
use std::time::Instant;

use clap::ValueEnum;
use eit::metrics::likeness;
use imaging::{
    Conditions, Geometry, HyperChoice, Method, Model, ReconstructionSettings, build, map_noise,
};
use rayon::prelude::*;
use serde::Serialize;
use survey::{Amps, MapQuality, Reading, Verdict};

use super::sheet::{CURRENT, FineSheet, random};
use super::target::{Target, TargetKind};
use super::{MapSettings, Settings};
use crate::evaluation::{average, median, quantile};
use crate::{Failure, add_noise, measured, progress};

const ALL_LOADS: &str = "all loads together";

/// The noise that is stated to a method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stated {
    /// The true noise.
    Noise,
    /// No noise.
    Nothing,
    /// The true noise, from which one hyper-parameter for all frames is derived.
    NoiseAlone,
}

impl Stated {
    fn name(self) -> &'static str {
        match self {
            Self::Noise => "noise",
            Self::Nothing => "nothing",
            Self::NoiseAlone => "noise alone",
        }
    }
}

/// The methods that are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum MapMethod {
    /// One step
    OneStep,
    /// One step, bounded to losses
    OneStepLossOnly,
    /// Total variation
    Tv,
    /// Total variation, bounded to losses
    TvLossOnly,
    /// The method `best`
    Best,
}

impl MapMethod {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::OneStep => "one-step",
            Self::OneStepLossOnly => "one-step, loss only",
            Self::Tv => "tv",
            Self::TvLossOnly => "tv, loss only",
            Self::Best => "best",
        }
    }

    /// The method's settings.
    pub(crate) fn settings(self) -> ReconstructionSettings {
        let (method, loss_only) = match self {
            Self::OneStep => (Method::OneStep, false),
            Self::OneStepLossOnly => (Method::OneStep, true),
            Self::Tv => (Method::Tv, false),
            Self::TvLossOnly => (Method::Tv, true),
            Self::Best => (Method::Best, false),
        };
        ReconstructionSettings {
            method: Some(method),
            loss_only: loss_only.then_some(true),
            ..ReconstructionSettings::default()
        }
    }
}

/// Results of one method for one kind of load.
#[derive(Debug, Clone, Serialize)]
pub struct MapRow {
    /// The method.
    pub method: MapMethod,
    /// The noise that is stated to it.
    pub stated: Stated,
    /// The kind of load, or all kinds together.
    pub load: &'static str,
    /// Noise of a reading, uV; `None` for frames of all noises together.
    pub noise_uv: Option<f64>,
    /// Number of frames.
    pub frames: usize,
    /// Mean correlation of map and truth over the region; without a load the mean of the maps' largest losses.
    pub mean: f64,
    /// Standard error of the mean.
    pub error: f64,
    /// The smallest correlation of a map judged sound that shows a load; without a load the largest loss of a map
    /// judged sound.
    pub worst_sound: Option<f64>,
    /// Number of maps judged sound; with a load only of those that show a load.
    pub sound: usize,
    /// Number of maps whose largest loss is above the significance threshold, which is computed from other draws of the
    /// noise.
    pub above_noise: Option<usize>,
    /// Number of maps by the method that they name.
    pub methods: BTreeMap<String, usize>,
    /// Median time of a frame, ms.
    pub median_ms: f64,
    /// 95th percentile of the time of a frame, ms.
    pub p95_ms: f64,
}

/// A frame with the truth.
struct Trial {
    baseline: Vec<Reading>,
    frame: Vec<Reading>,
    truth: Vec<f64>,
}

/// A method with its significance threshold.
struct PreparedMethod {
    method: MapMethod,
    stated: Stated,
    model: Model,
    threshold: Option<f64>,
}

/// Results for one map.
struct Judged {
    /// Correlation with the truth; without a load the largest loss.
    value: f64,
    /// Judged sound; with a load only if the map shows a load.
    sound: bool,
    /// Whether the largest loss is above the significance threshold.
    above: bool,
    method: String,
    ms: f64,
}

/// The rows of all methods and kinds of load.
pub(super) fn rows(
    settings: &Settings,
    maps: &MapSettings,
    sheet: &FineSheet,
    geometry: &Geometry,
) -> Result<Vec<MapRow>, Failure> {
    let stated = match maps.unstated {
        true => [Stated::Noise, Stated::Nothing, Stated::NoiseAlone].as_slice(),
        false => &[Stated::Noise],
    };
    let groups = settings.noises_uv.len() * maps.kinds.len();
    let bar = progress::bar(
        groups * maps.count * maps.methods.len() * stated.len(),
        "maps",
    );
    let mut rows = Vec::new();
    let mut of_all_noises = BTreeMap::<usize, Vec<Judged>>::new();
    for (level, &noise_uv) in settings.noises_uv.iter().enumerate() {
        let models: Vec<PreparedMethod> = maps
            .methods
            .iter()
            .flat_map(|method| stated.iter().map(move |stated| (*method, *stated)))
            .map(|(method, stated)| {
                let model = prepared(method, stated, noise_uv, sheet, geometry)?;
                Ok(PreparedMethod {
                    method,
                    stated,
                    threshold: threshold(&model, noise_uv, sheet),
                    model,
                })
            })
            .collect::<Result<_, Failure>>()?;
        let mut of_all: Vec<Vec<Judged>> = models.iter().map(|_| Vec::new()).collect();
        for &kind in &maps.kinds {
            // these series of random numbers follow those of the quality check
            let series = 1 << 16 | (level as u64) << 8 | kind as u64;
            let trials: Vec<Trial> = (0..maps.count)
                .into_par_iter()
                .map(|k| {
                    trial(
                        settings.seed,
                        series,
                        k as u64,
                        kind,
                        noise_uv,
                        sheet,
                        geometry,
                    )
                })
                .collect::<Result<_, Failure>>()?;
            for (compared, of_all) in models.iter().zip(&mut of_all) {
                let judged: Vec<Judged> = trials
                    .par_iter()
                    .map(|trial| {
                        let judged = judge(compared, trial, kind, geometry);
                        bar.inc(1);
                        judged
                    })
                    .collect::<Result<_, Failure>>()?;
                let load = (kind != TargetKind::Nothing).then_some(kind.name());
                rows.push(row(compared, load, Some(noise_uv), &judged));
                if load.is_some() {
                    of_all.extend(judged);
                }
            }
        }
        let last = level + 1 == settings.noises_uv.len();
        for (k, (compared, judged)) in models.iter().zip(of_all).enumerate() {
            if judged.len() > maps.count {
                rows.push(row(compared, Some(ALL_LOADS), Some(noise_uv), &judged));
            }
            let all = of_all_noises.entry(k).or_default();
            all.extend(judged);
            if last && level > 0 && !all.is_empty() {
                rows.push(row(compared, Some(ALL_LOADS), None, all));
            }
        }
    }
    bar.finish_and_clear();
    Ok(rows)
}

fn prepared(
    method: MapMethod,
    stated: Stated,
    noise_uv: f64,
    sheet: &FineSheet,
    geometry: &Geometry,
) -> Result<Model, Failure> {
    let settings = ReconstructionSettings {
        noise_uv: (stated != Stated::Nothing).then_some(noise_uv),
        choose: (stated == Stated::NoiseAlone).then_some(HyperChoice::Noise),
        ..method.settings()
    };
    let conditions = Conditions::live(geometry, &sheet.protocol, Amps(CURRENT));
    build(&settings, &conditions).map_err(|fault| Failure::of(method.name(), &fault))
}

/// Significance threshold of maps whose baseline is one frame.
fn threshold(model: &Model, noise_uv: f64, sheet: &FineSheet) -> Option<f64> {
    let volts: Vec<f64> = sheet.unloaded.iter().map(|ohms| CURRENT * ohms).collect();
    map_noise(model, &measured(&volts), SQRT_2 * 1e-6 * noise_uv)
}

fn trial(
    seed: u64,
    series: u64,
    number: u64,
    kind: TargetKind,
    noise_uv: f64,
    sheet: &FineSheet,
    geometry: &Geometry,
) -> Result<Trial, Failure> {
    let mut random = random(seed, series, number);
    let mesh = &geometry.mesh;
    let target = Target::draw(kind, mesh, &mut random);
    let factors = target.factors(sheet.mesh());
    let mut at = |readings: &[f64]| -> Vec<Reading> {
        let mut volts: Vec<f64> = readings.iter().map(|ohms| CURRENT * ohms).collect();
        add_noise(&mut volts, 1e-6 * noise_uv, &mut random);
        measured(&volts)
    };
    Ok(Trial {
        baseline: at(&sheet.unloaded),
        frame: at(&sheet.readings(&factors)?),
        truth: target.change(mesh, mesh.region().iter().copied()),
    })
}

fn judge(
    PreparedMethod {
        model, threshold, ..
    }: &PreparedMethod,
    trial: &Trial,
    kind: TargetKind,
    geometry: &Geometry,
) -> Result<Judged, Failure> {
    let begun = Instant::now();
    let map = model
        .reconstruct(&trial.baseline, &trial.frame)
        .map_err(|fault| Failure::of(model.reconstructor.method(), &fault))?;
    let ms = 1e3 * begun.elapsed().as_secs_f64();
    let sound = |quality: &MapQuality| quality.verdict == Verdict::Sound;
    let loss = map.largest_loss().map_or(0.0, |(_, loss)| loss);
    let above = threshold.is_some_and(|most| loss > most);
    let shows = map.method != eit::NOISE_ONLY && (above || threshold.is_none());
    Ok(Judged {
        value: match kind {
            TargetKind::Nothing => loss,
            _ => likeness(&map.values, &trial.truth, &geometry.mesh.region_areas()).correlation,
        },
        sound: map.quality.as_ref().is_some_and(sound) && (shows || kind == TargetKind::Nothing),
        above,
        method: map.method,
        ms,
    })
}

fn row(
    compared: &PreparedMethod,
    load: Option<&'static str>,
    noise_uv: Option<f64>,
    judged: &[Judged],
) -> MapRow {
    let mean = average(judged.iter().map(|one| one.value));
    let square = average(judged.iter().map(|one| (one.value - mean).powi(2)));
    let sound = || judged.iter().filter(|one| one.sound);
    let worst = match load {
        None => f64::max,
        Some(_) => f64::min,
    };
    let mut methods = BTreeMap::new();
    for one in judged {
        *methods.entry(one.method.clone()).or_default() += 1;
    }
    let mut times: Vec<f64> = judged.iter().map(|one| one.ms).collect();
    let median_ms = median(&mut times);
    MapRow {
        method: compared.method,
        stated: compared.stated,
        load: load.unwrap_or(TargetKind::Nothing.name()),
        noise_uv,
        frames: judged.len(),
        mean,
        error: (square / judged.len() as f64).sqrt(),
        worst_sound: sound().map(|one| one.value).reduce(worst),
        sound: sound().count(),
        above_noise: compared
            .threshold
            .map(|_| judged.iter().filter(|one| one.above).count()),
        methods,
        median_ms,
        p95_ms: quantile(&mut times, 0.95),
    }
}

/// The rows as text.
pub(super) fn text(rows: &[MapRow]) -> String {
    let mut text = String::from(
        "method               stated      load                       noise uV frames      correlation  sound worst sound above noise median ms    p95 ms\n",
    );
    for row in rows {
        let worst = row
            .worst_sound
            .map_or("-".to_owned(), |worst| format!("{worst:.3}"));
        text += &format!(
            "{:<20} {:<11} {:<26} {:>8} {:>6} {:>7.3} +- {:.3} {:>6} {:>11} {:>11} {:>9.1} {:>9.1}\n",
            row.method.name(),
            row.stated.name(),
            row.load,
            row.noise_uv.map_or("all".to_owned(), |uv| uv.to_string()),
            row.frames,
            row.mean,
            row.error,
            row.sound,
            worst,
            row.above_noise
                .map_or("-".to_owned(), |above| above.to_string()),
            row.median_ms,
            row.p95_ms
        );
    }
    text
}
