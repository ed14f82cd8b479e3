//! The paper's claims compared with the results of this study. A disagreement is a finding, not an error.

use eit::metrics::likeness;

use super::experiments::{Experiments, FIGURES_AT, Outcome};
use super::plan::{DEEP, Method, Plan, RBF, TV, Trained};
use crate::evaluation::{average, mean_and_deviation};
use crate::failure::Failure;

/// Smallest correlation at which amplitudes count as proportional.
const PROPORTIONAL: f64 = 0.9;
/// Largest location error at which a load counts as found, mm: the diameter of the pressing disc.
const FOUND_MM: f64 = 10.0;
/// The paper's times per frame, ms, on an Intel i7-8700 at 3.2 GHz with MATLAB R2020b (its section 5.4).
const PAPER_MS: [f64; 3] = [650.0, 5.0, 3.0];

/// Whether the results agree with a claim of the paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// All parts of the claim agree.
    Agrees,
    /// No part of the claim agrees.
    Disagrees,
    /// Some parts of the claim agree.
    Partly,
}

impl Verdict {
    /// Name in the tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Agrees => "agrees",
            Self::Disagrees => "disagrees",
            Self::Partly => "partly",
        }
    }

    fn of(parts: &[bool]) -> Self {
        match parts.iter().filter(|part| **part).count() {
            0 => Self::Disagrees,
            count if count == parts.len() => Self::Agrees,
            _ => Self::Partly,
        }
    }
}

/// A claim of the paper, and the result of this study.
#[derive(Debug)]
pub struct Claim {
    /// Section of the paper.
    pub section: &'static str,
    /// The claim.
    pub paper: &'static str,
    /// The result.
    pub ours: String,
    /// Comparison of both.
    pub verdict: Verdict,
}

impl Claim {
    /// The claim as an entry of `claims.json`.
    pub fn described(&self) -> serde_json::Value {
        serde_json::json!({
            "section": self.section,
            "paper": self.paper,
            "ours": self.ours,
            "verdict": self.verdict.name(),
        })
    }

    /// The claim as a line of text.
    pub fn line(&self) -> String {
        format!("{:>9}  {}: {}", self.verdict.name(), self.paper, self.ours)
    }
}

/// Every claim, in the order of the paper.
pub(super) fn judge(
    plan: &Plan,
    methods: &[Method],
    experiments: &Experiments,
) -> Result<Vec<Claim>, Failure> {
    let at = |method: &'static str, test| found(experiments, method, test, FIGURES_AT);
    let [tv, deep, rbf] = [at(TV, 1)?, at(DEEP, 1)?, at(RBF, 1)?];
    // results without noise
    let quiet = |method: &'static str| found(experiments, method, 1, 0.0);
    let [quiet_tv, quiet_deep, quiet_rbf] = [quiet(TV)?, quiet(DEEP)?, quiet(RBF)?];
    let [quiet_deep2, quiet_rbf2] = [
        found(experiments, DEEP, 2, 0.0)?,
        found(experiments, RBF, 2, 0.0)?,
    ];
    // the paper states no noise for its figures, so such a claim must hold without noise and with that of the paper's
    // voltmeter
    let pairs = [
        (
            "without noise".to_owned(),
            [quiet_tv, quiet_deep, quiet_rbf],
        ),
        (format!("at {FIGURES_AT} uV"), [tv, deep, rbf]),
    ];
    let mut claims = vec![
        places(&pairs),
        resolution(&pairs),
        shapes(
            [quiet_deep2, quiet_rbf2, quiet_deep, quiet_rbf],
            [at(DEEP, 2)?, at(RBF, 2)?, deep, rbf],
        ),
        near_electrodes(quiet_tv),
        varies(quiet_tv, quiet_deep, quiet_rbf),
        proportional(quiet_tv, quiet_deep, quiet_rbf),
    ];
    claims.extend(noise(plan, experiments));
    claims.extend(sprayed(plan, experiments));
    claims.push(times(tv, deep, rbf));
    let trained = |name| {
        methods
            .iter()
            .find(|m| m.name == name)
            .and_then(|m| m.model.as_ref())
    };
    if let (Some(deep), Some(rbf)) = (trained(DEEP), trained(RBF)) {
        claims.push(memory(deep, rbf));
    }
    Ok(claims)
}

fn found<'a>(
    experiments: &'a Experiments,
    method: &'static str,
    test: u8,
    noise_uv: f64,
) -> Result<&'a Outcome, Failure> {
    experiments.of(method, test, noise_uv).ok_or_else(|| {
        Failure::because(format!(
            "{method} was not run on Test #{test} at {noise_uv} uV"
        ))
    })
}

fn three(tv: f64, deep: f64, rbf: f64, unit: &str, decimals: usize) -> String {
    format!("TV {tv:.decimals$}{unit}, deep {deep:.decimals$}{unit}, RBF {rbf:.decimals$}{unit}")
}

/// A description of the noise, and the results of TV, deep network and RBF network at this noise.
type AtNoise<'a> = (String, [&'a Outcome; 3]);

fn places(pairs: &[AtNoise<'_>; 2]) -> Claim {
    let errors = |outcomes: &[&Outcome; 3]| outcomes.map(|outcome| outcome.figures.error_mm);
    let words = pairs.iter().map(|(noise, outcomes)| {
        let [tv, deep, rbf] = errors(outcomes);
        format!("{noise}: {}", three(tv, deep, rbf, " mm", 1))
    });
    Claim {
        section: "5.4",
        paper: "the place of the largest change is in general identified, by all three methods",
        ours: format!(
            "mean location error on S1, {}; found means within {FOUND_MM} mm",
            words.collect::<Vec<_>>().join("; ")
        ),
        verdict: Verdict::of(
            &pairs
                .iter()
                .flat_map(|(_, outcomes)| errors(outcomes).map(|error| error <= FOUND_MM))
                .collect::<Vec<_>>(),
        ),
    }
}

fn resolution(pairs: &[AtNoise<'_>; 2]) -> Claim {
    let mut words = Vec::new();
    let mut parts = Vec::new();
    for (noise, outcomes) in pairs {
        let width = outcomes.map(|outcome| outcome.figures.greit[2]);
        let like = outcomes.map(|outcome| outcome.figures.correlation);
        words.push(format!(
            "{noise}: GREIT resolution (smaller is sharper) {}, correlation with the truth {}",
            three(width[0], width[1], width[2], "", 3),
            three(like[0], like[1], like[2], "", 3)
        ));
        parts.extend([
            width[1] < width[0] && like[1] > like[0],
            width[2] > width[1],
        ]);
    }
    Claim {
        section: "5.4",
        paper: "on S1 the deep network is sharper than TV, the RBF network coarser than the deep one",
        ours: words.join("; "),
        verdict: Verdict::of(&parts),
    }
}

/// `quiet` and `noisy` contain: deep and RBF network on Test #2, then both on Test #1.
fn shapes(quiet: [&Outcome; 4], noisy: [&Outcome; 4]) -> Claim {
    // S4 is the last of the three shapes of Test #2, each of which has three positions
    let s4 = |outcome: &Outcome, of: fn(&crate::evaluation::OfFrame) -> f64| {
        average(outcome.of_frames.iter().skip(6).map(of))
    };
    let mut words = Vec::new();
    let mut parts = Vec::new();
    for (noise, [deep2, rbf2, deep, rbf]) in [
        ("without noise".to_owned(), quiet),
        (format!("at {FIGURES_AT} uV"), noisy),
    ] {
        let dice = [deep2, rbf2].map(|outcome| s4(outcome, |frame| frame.dice));
        let like = [deep2, rbf2].map(|outcome| s4(outcome, |frame| frame.correlation));
        let small = [deep, rbf].map(|outcome| outcome.figures.correlation);
        let small_dice = [deep, rbf].map(|outcome| outcome.figures.dice);
        words.push(format!(
            "{noise}: S4, Dice and correlation: deep {:.2}, {:.2}, RBF {:.2}, {:.2}; S1: deep {:.2}, {:.2}, RBF {:.2}, {:.2}",
            dice[0], like[0], dice[1], like[1], small_dice[0], small[0], small_dice[1], small[1]
        ));
        parts.extend([
            dice[1] > dice[0] && like[1] > like[0],
            small_dice[0] > small_dice[1] && small[0] > small[1],
        ]);
    }
    Claim {
        section: "5.4",
        paper: "the RBF network is better than the deep one on S4, the deep one better on small spots",
        ours: words.join("; "),
        verdict: Verdict::of(&parts),
    }
}

fn peaks(outcome: &Outcome) -> Vec<f64> {
    outcome.of_frames.iter().map(|frame| frame.peak).collect()
}

fn near_electrodes(tv: &Outcome) -> Claim {
    let peaks = peaks(tv);
    // four by four positions: the inner four are the farthest from the electrodes
    let inner = [5, 6, 9, 10];
    let of = |inside: bool| {
        average(
            peaks
                .iter()
                .enumerate()
                .filter(|(k, _)| inner.contains(k) == inside)
                .map(|(_, peak)| *peak),
        )
    };
    let (outer, middle) = (of(false), of(true));
    Claim {
        section: "5.4",
        paper: "the change that TV finds is larger near the electrodes",
        ours: format!(
            "without noise, largest change at the twelve outer places over the four inner: {:.2}",
            outer / middle
        ),
        verdict: Verdict::of(&[outer > 1.1 * middle]),
    }
}

fn varies(tv: &Outcome, deep: &Outcome, rbf: &Outcome) -> Claim {
    let spread = [tv, deep, rbf].map(|outcome| {
        let (mean, deviation) = mean_and_deviation(&peaks(outcome));
        100.0 * deviation / mean
    });
    Claim {
        section: "5.4",
        paper: "the magnitude depends on the place at equal load",
        ours: format!(
            "without noise, standard deviation over mean of the largest change at 16 places: {}",
            three(spread[0], spread[1], spread[2], " %", 0)
        ),
        verdict: Verdict::of(&spread.map(|spread| spread > 10.0)),
    }
}

fn proportional(tv: &Outcome, deep: &Outcome, rbf: &Outcome) -> Claim {
    let with_tv = [deep, rbf].map(|outcome| correlation(&peaks(outcome), &peaks(tv)));
    Claim {
        section: "5.4",
        paper: "the networks' magnitudes are almost proportional to TV's",
        ours: format!(
            "without noise, correlation of the largest change at 16 places with TV's: deep {:.2}, RBF {:.2}; proportional means {PROPORTIONAL} \
             or more",
            with_tv[0], with_tv[1]
        ),
        verdict: Verdict::of(&with_tv.map(|r| r >= PROPORTIONAL)),
    }
}

/// Share of noise in a map: the standard deviation between draws, relative to the map.
fn noise(plan: &Plan, experiments: &Experiments) -> Option<Claim> {
    let largest = plan.noises.iter().copied().fold(0.0, f64::max);
    let share = |method: &'static str| -> Option<f64> {
        let draws: Vec<&Outcome> = experiments.at(method, 1, largest, 0.0).collect();
        let count = draws.len() as f64;
        let frames = draws.first()?.maps.len();
        let (mut differing, mut whole) = (0.0, 0.0);
        for k in 0..frames {
            for t in 0..draws[0].maps[k].map.values.len() {
                let values = || draws.iter().map(|draw| draw.maps[k].map.values[t]);
                let mean = values().sum::<f64>() / count;
                differing += values().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0);
                whole += mean * mean;
            }
        }
        (count > 1.0).then(|| (differing / whole).sqrt())
    };
    let [tv, deep, rbf] = [share(TV)?, share(DEEP)?, share(RBF)?];
    Some(Claim {
        section: "5.4",
        paper: "the RBF network is less sensitive to noise",
        ours: format!(
            "at {largest} uV, what draws of the noise change over the mean map (rms): {}",
            three(100.0 * tv, 100.0 * deep, 100.0 * rbf, " %", 0)
        ),
        verdict: Verdict::of(&[rbf < deep, rbf < tv]),
    })
}

fn sprayed(plan: &Plan, experiments: &Experiments) -> Option<Claim> {
    let worst = plan.sprays.iter().copied().fold(0.0, f64::max);
    let mut parts = Vec::new();
    let mut words = Vec::new();
    for &spray in plan.sprays.iter().filter(|spray| **spray > 0.0) {
        let found: Vec<f64> = [TV, DEEP, RBF]
            .into_iter()
            .filter_map(|method| experiments.at(method, 1, FIGURES_AT, spray).next())
            .map(|outcome| outcome.figures.error_mm)
            .collect();
        let [tv, deep, rbf] = found[..] else {
            return None;
        };
        words.push(format!(
            "{:.0} %: {}",
            100.0 * spray,
            three(tv, deep, rbf, " mm", 1)
        ));
        if spray == worst {
            for (method, error) in [TV, DEEP, RBF].into_iter().zip(found) {
                let even = experiments.of(method, 1, FIGURES_AT)?.figures.error_mm;
                parts.push(error <= even + 2.0);
            }
        }
    }
    Some(Claim {
        section: "5.3",
        paper: "a conductance that is uneven from the spraying cancels in difference imaging",
        ours: format!(
            "location error on S1, sheet sprayed with a standard deviation of {}; cancels means at most 2 mm worse at the largest",
            words.join("; ")
        ),
        verdict: Verdict::of(&parts),
    })
}

fn times(tv: &Outcome, deep: &Outcome, rbf: &Outcome) -> Claim {
    let ms = [tv, deep, rbf].map(|outcome| outcome.figures.ms);
    let ratios = [ms[0] / ms[1], ms[0] / ms[2]];
    Claim {
        section: "5.4",
        paper: "650, 5 and 3 ms a frame by TV, deep and RBF network on an Intel i7-8700: ratios of 130 and 217",
        ours: format!(
            "{}, ratios of {:.2} and {:.2}: one linear step needs no new factorisation, its matrix is made once; ours against \
             the paper's {:.0}, {:.1} and {:.0} times as fast, on another machine",
            three(ms[0], ms[1], ms[2], " ms", 3),
            ratios[0],
            ratios[1],
            PAPER_MS[0] / ms[0],
            PAPER_MS[1] / ms[1],
            PAPER_MS[2] / ms[2]
        ),
        verdict: Verdict::of(&[ratios[0] > 10.0, ratios[1] > 10.0]),
    }
}

fn memory(deep: &Trained, rbf: &Trained) -> Claim {
    let ratio = deep.weights as f64 / rbf.weights as f64;
    let megabytes = |bytes: u64| bytes as f64 / 1e6;
    let resident = |model: &Trained| {
        model.resident.map_or("unknown".to_owned(), |bytes| {
            format!("{:.1}", megabytes(bytes))
        })
    };
    Claim {
        section: "5.4",
        paper: "over 21 million weights against 369,000: 58 times",
        ours: format!(
            "{} against {} weights: {ratio:.0} times; {:.1} and {:.1} MB on disk, {} and {} MB of memory to load them",
            deep.weights,
            rbf.weights,
            megabytes(deep.bytes),
            megabytes(rbf.bytes),
            resident(deep),
            resident(rbf)
        ),
        verdict: Verdict::of(&[(ratio - 58.0).abs() < 2.0]),
    }
}

/// Pearson's correlation.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    likeness(a, b, &vec![1.0; a.len()]).correlation
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_claim_of_two_parts_can_hold_in_part() {
        assert_eq!(Verdict::of(&[true, true]), Verdict::Agrees);
        assert_eq!(Verdict::of(&[true, false]), Verdict::Partly);
        assert_eq!(Verdict::of(&[false, false]), Verdict::Disagrees);
    }

    #[test]
    fn what_is_proportional_correlates() {
        assert!((correlation(&[1.0, 2.0, 4.0], &[0.5, 1.0, 2.0]) - 1.0).abs() < 1e-12);
        assert!((correlation(&[1.0, 2.0, 3.0], &[3.0, 2.0, 1.0]) + 1.0).abs() < 1e-12);
    }
}
