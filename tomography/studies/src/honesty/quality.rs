//! The quality check on healthy frames, which must have no reasons for doubt, and on faults, which must be detected and
//! named.

use std::collections::BTreeMap;

use imaging::{Conditions, Geometry, ReconstructionSettings, build};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;
use serde::Serialize;
use survey::{Amps, Electrode, MapQuality, Verdict};

use super::Settings;
use super::sheet::{CURRENT, FineSheet, Kind, random};
use crate::failure::Attempt;
use crate::{Failure, add_noise, measured, progress};

/// Faults of a rig that must be detected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    None,
    /// The gain of each injection changes by 1e-3 (standard deviation) after the baseline.
    Gains,
    /// One contact impedance is ten times as large as in the baseline.
    Contact,
    /// The readings of one electrode are noise after the baseline.
    Dead,
    /// The readings of one electrode are noise, also in the baseline.
    DeadInBaseline,
    /// One sense pair has 50 times the noise.
    NoisyPair,
    /// The stated noise is a tenth of the true one.
    StatedTooSmall,
    /// The stated noise is ten times the true one.
    StatedTooLarge,
}

impl Fault {
    const ALL: [Self; 7] = [
        Self::Gains,
        Self::Contact,
        Self::Dead,
        Self::DeadInBaseline,
        Self::NoisyPair,
        Self::StatedTooSmall,
        Self::StatedTooLarge,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Gains => "gain of each injection, 1e-3",
            Self::Contact => "one contact, ten times",
            Self::Dead => "a dead electrode after the baseline",
            Self::DeadInBaseline => "a dead electrode, in the baseline too",
            Self::NoisyPair => "one sense pair, 50 times the noise",
            Self::StatedTooSmall => "noise stated ten times too small",
            Self::StatedTooLarge => "noise stated ten times too large",
        }
    }

    /// Stated noise over the true one.
    fn stated(self) -> f64 {
        match self {
            Self::StatedTooSmall => 0.1,
            Self::StatedTooLarge => 10.0,
            _ => 1.0,
        }
    }
}

/// Verdicts on the frames of one group.
#[derive(Debug, Clone, Serialize)]
pub struct QualityRow {
    /// Noise of a reading, uV.
    pub noise_uv: f64,
    /// The fault, or the kind of load of healthy frames.
    pub what: &'static str,
    /// Whether the frames are healthy.
    pub healthy: bool,
    /// Number of frames.
    pub frames: usize,
    /// Number of frames judged doubtful or unreliable.
    pub not_sound: usize,
    /// Number of frames judged unreliable.
    pub unreliable: usize,
    /// Number of frames whose faulty electrode or pair is named; `None` for faults without one.
    pub named: Option<usize>,
    /// Number of frames by kind of reason.
    pub reasons: BTreeMap<String, usize>,
}

impl QualityRow {
    fn new(noise_uv: f64, what: &'static str, healthy: bool) -> Self {
        Self {
            noise_uv,
            what,
            healthy,
            frames: 0,
            not_sound: 0,
            unreliable: 0,
            named: None,
            reasons: BTreeMap::new(),
        }
    }

    fn add(&mut self, found: &MapQuality, blamed: Option<Electrode>) {
        self.frames += 1;
        self.not_sound += usize::from(!found.is_sound());
        self.unreliable += usize::from(found.verdict == Verdict::Unreliable);
        if let Some(electrode) = blamed {
            let named = found
                .reasons
                .iter()
                .any(|reason| reason.electrode == Some(electrode.number()));
            *self.named.get_or_insert(0) += usize::from(named);
        }
        for reason in &found.reasons {
            *self.reasons.entry(reason.kind.clone()).or_default() += 1;
        }
    }
}

/// A frame, and the fault that must be detected.
struct Trial {
    baseline: Vec<f64>,
    frame: Vec<f64>,
    row: &'static str,
    blamed: Option<Electrode>,
}

/// Judges frames without a fault and with each fault, at each noise, with the one-step method.
pub(super) fn rows(
    settings: &Settings,
    sheet: &FineSheet,
    geometry: &Geometry,
) -> Result<Vec<QualityRow>, Failure> {
    let mut rows = Vec::new();
    let frames = settings.healthy + Fault::ALL.len() * settings.faulty;
    let bar = progress::bar(settings.noises_uv.len() * frames, "frames judged");
    for (level, &noise_uv) in settings.noises_uv.iter().enumerate() {
        let groups = [(Fault::None, settings.healthy)]
            .into_iter()
            .chain(Fault::ALL.map(|fault| (fault, settings.faulty)));
        for (fault, count) in groups {
            let series = (level as u64) << 8 | fault as u64;
            let noise_v = 1e-6 * noise_uv;
            let mut conditions = Conditions::live(geometry, &sheet.protocol, Amps(CURRENT));
            conditions.noise_v = Some(fault.stated() * noise_v);
            let model = build(&ReconstructionSettings::default(), &conditions)
                .attempt("the one-step method")?;
            let judged: Vec<(Trial, MapQuality)> = (0..count)
                .into_par_iter()
                .map(|frame| {
                    let random = &mut random(settings.seed, series, frame as u64);
                    // faulty frames have the paper's smallest press or no load
                    let kind = match (fault, frame % 2) {
                        (Fault::None, _) => Kind::ALL[frame % Kind::ALL.len()],
                        (_, 0) => Kind::Press,
                        _ => Kind::Nothing,
                    };
                    let trial = trial(sheet, fault, kind, noise_v, random)?;
                    let map = model
                        .reconstruct(&measured(&trial.baseline), &measured(&trial.frame))
                        .attempt("the one-step method")?;
                    bar.inc(1);
                    let quality = map
                        .quality
                        .ok_or_else(|| Failure::because("a map was not judged"))?;
                    Ok((trial, quality))
                })
                .collect::<Result<_, Failure>>()?;
            for (trial, quality) in judged {
                let at = rows
                    .iter()
                    .position(|row: &QualityRow| row.what == trial.row && row.noise_uv == noise_uv);
                let at = at.unwrap_or_else(|| {
                    rows.push(QualityRow::new(noise_uv, trial.row, fault == Fault::None));
                    rows.len() - 1
                });
                rows[at].add(&quality, trial.blamed);
            }
        }
    }
    bar.finish_and_clear();
    Ok(rows)
}

fn trial(
    sheet: &FineSheet,
    fault: Fault,
    kind: Kind,
    noise_v: f64,
    random: &mut ChaCha8Rng,
) -> Result<Trial, Failure> {
    let load = sheet.load(kind, random);
    let electrode = random.random_range(0..sheet.protocol.electrodes());
    let mut ohms = match fault {
        Fault::Contact => sheet.readings_with_contact(&load.factors, electrode, 10.0)?,
        _ => sheet.readings(&load.factors)?,
    };
    let mut unloaded = sheet.unloaded.clone();
    let questions = sheet.protocol.measurements();
    if fault == Fault::Gains {
        let spread = Normal::new(1.0, 1e-3).ok();
        let gains: BTreeMap<_, f64> = sheet
            .protocol
            .drives()
            .into_iter()
            .map(|drive| (drive, spread.map_or(1.0, |spread| spread.sample(random))))
            .collect();
        for (value, question) in ohms.iter_mut().zip(questions) {
            *value *= gains[&question.drive];
        }
    }
    if matches!(fault, Fault::Dead | Fault::DeadInBaseline) {
        for (k, question) in questions.iter().enumerate() {
            let dipoles = [question.drive, question.sense];
            if dipoles
                .iter()
                .any(|dipole| dipole.contains(Electrode(electrode)))
            {
                ohms[k] = 0.0;
                if fault == Fault::DeadInBaseline {
                    unloaded[k] = 0.0;
                }
            }
        }
    }
    let [baseline, mut frame] = [unloaded, ohms].map(|ohms| {
        let mut volts: Vec<f64> = ohms.iter().map(|ohms| CURRENT * ohms).collect();
        add_noise(&mut volts, noise_v, random);
        volts
    });
    if fault == Fault::NoisyPair {
        let own = frame
            .iter_mut()
            .zip(questions)
            .filter(|(_, question)| question.sense.plus == Electrode(electrode));
        add_noise(own.map(|(value, _)| value), 50.0 * noise_v, random);
    }
    let row = match fault {
        Fault::None if load.at_electrode => "load within 8 mm of an electrode",
        Fault::None => load.kind.name(),
        _ => fault.name(),
    };
    let blamed = match fault {
        Fault::Contact | Fault::Dead | Fault::DeadInBaseline | Fault::NoisyPair => {
            Some(Electrode(electrode))
        }
        Fault::None | Fault::Gains | Fault::StatedTooSmall | Fault::StatedTooLarge => None,
    };
    Ok(Trial {
        baseline,
        frame,
        row,
        blamed,
    })
}
