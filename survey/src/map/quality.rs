//! Reliability of a map: a verdict with its reasons, which name the electrode or pair.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::Electrode;

/// Reliability of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The readings agree with the model and the stated noise.
    Sound,
    /// Some readings do not agree; the map may be wrong at the place that the reason names.
    Doubtful,
    /// The map cannot be relied on.
    Unreliable,
}

impl Verdict {
    /// The verdict of a word; `None` for an unknown word.
    pub fn from_word(word: &str) -> Option<Self> {
        [Self::Sound, Self::Doubtful, Self::Unreliable]
            .into_iter()
            .find(|verdict| verdict.word() == word)
    }

    /// The word used on D-Bus and in `--json`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Sound => "sound",
            Self::Doubtful => "doubtful",
            Self::Unreliable => "unreliable",
        }
    }
}

/// A remark on a map for its user, in most cases why the map is not sound. Shares are fractions of the rms change of
/// the readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Doubt {
    /// Readings that use this electrode do not agree with the model (in the baseline) or with the baseline (in the
    /// frame).
    DeadElectrode {
        /// The electrode.
        electrode: Electrode,
        /// Whether it was dead when the baseline was recorded.
        in_baseline: bool,
    },
    /// The differences of reciprocal readings do not agree with the stated noise.
    Noise {
        /// Noise of the readings divided by the stated noise.
        ratio: f64,
    },
    /// One pair of electrodes is noisier than the others.
    NoisyPair {
        /// The pair's first electrode.
        electrode: Electrode,
        /// Its noise divided by that of the others.
        ratio: f64,
    },
    /// The gains of the injections differ from those of the baseline: readings differ from their reciprocal ones.
    Gains {
        /// The first electrode of the pair that differs most.
        electrode: Electrode,
        /// Relative change of its gain.
        gain: f64,
        /// Share of the change that no map can explain, because it is not reciprocal.
        share: f64,
    },
    /// The best map of the whole sheet leaves this share of the change unexplained.
    Unexplained {
        /// The share.
        share: f64,
    },
    /// A contact impedance explains the change better than the conductance of the sheet does: the contact has
    /// changed, or a load lies over the electrode.
    AtElectrode {
        /// The electrode.
        electrode: Electrode,
    },
    /// Most of the change comes from outside the region that maps show. The map of the region can still be right.
    OutsideRegion {
        /// The electrode nearest to it.
        electrode: Electrode,
        /// Integral of the relative loss near it, mm2.
        lost_mm2: f64,
    },
    /// Different loads explain the frame equally well within the noise.
    NoiseLimit {
        /// Mean correlation of the map with the loads that the posterior leaves possible.
        correlation: f64,
    },
    /// The map shows more conductance lost than there is.
    LossAboveOne {
        /// The largest relative loss.
        loss: f64,
    },
    /// A learned map leaves a larger share of the change unexplained than it does for changes like those of its
    /// training.
    OwnMisfit {
        /// The share that it leaves.
        share: f64,
        /// The limit below which the share of 99.9 % of the held-out cases lies, or of all cases if there are fewer
        /// than 1000.
        limit: f64,
        /// Number of held-out cases from which the limit was computed.
        cases: usize,
    },
    /// The frame is farther from the training inputs of a learned method than 99.9 % of these, but not so far that
    /// the method refuses it.
    Novelty {
        /// Its distance divided by the distance within which 99.9 % of the training inputs lie.
        ratio: f64,
    },
}

impl Doubt {
    /// Share of unexplained or non-reciprocal change above which a map is unreliable.
    pub const UNRELIABLE_SHARE: f64 = 0.3;
    /// The same for changed gains: a change of 1e-3 moves the position of a small press by centimetres.
    pub const UNRELIABLE_GAIN_SHARE: f64 = 0.05;

    /// The word used in `--json`.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::DeadElectrode { .. } => "dead_electrode",
            Self::Noise { .. } => "noise",
            Self::NoisyPair { .. } => "noisy_pair",
            Self::Gains { .. } => "gains",
            Self::Unexplained { .. } => "unexplained",
            Self::AtElectrode { .. } => "at_electrode",
            Self::OutsideRegion { .. } => "outside_region",
            Self::NoiseLimit { .. } => "noise_limit",
            Self::LossAboveOne { .. } => "loss_above_one",
            Self::OwnMisfit { .. } => "own_misfit",
            Self::Novelty { .. } => "novelty",
        }
    }

    /// The electrode that the remark names, if any.
    pub fn electrode(&self) -> Option<Electrode> {
        match *self {
            Self::DeadElectrode { electrode, .. }
            | Self::NoisyPair { electrode, .. }
            | Self::Gains { electrode, .. }
            | Self::AtElectrode { electrode }
            | Self::OutsideRegion { electrode, .. } => Some(electrode),
            Self::Noise { .. }
            | Self::Unexplained { .. }
            | Self::NoiseLimit { .. }
            | Self::LossAboveOne { .. }
            | Self::OwnMisfit { .. }
            | Self::Novelty { .. } => None,
        }
    }

    /// The verdict on a map for this reason alone.
    pub fn verdict(&self) -> Verdict {
        let unreliable = match *self {
            Self::OutsideRegion { .. } => return Verdict::Sound,
            Self::DeadElectrode { .. } => true,
            Self::Gains { share, .. } => share > Self::UNRELIABLE_GAIN_SHARE,
            Self::Unexplained { share } => share > Self::UNRELIABLE_SHARE,
            Self::Noise { .. }
            | Self::NoisyPair { .. }
            | Self::AtElectrode { .. }
            | Self::NoiseLimit { .. }
            | Self::LossAboveOne { .. }
            | Self::OwnMisfit { .. }
            | Self::Novelty { .. } => false,
        };
        match unreliable {
            true => Verdict::Unreliable,
            false => Verdict::Doubtful,
        }
    }
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::DeadElectrode {
                electrode,
                in_baseline: true,
            } => write!(
                f,
                "electrode {electrode} is dead in the baseline: its readings do not follow the model"
            ),
            Self::DeadElectrode { electrode, .. } => write!(
                f,
                "electrode {electrode} is dead: its readings no longer follow the baseline"
            ),
            Self::Noise { ratio } => write!(f, "the noise is {ratio:.2} times the stated one"),
            Self::NoisyPair { electrode, ratio } => write!(
                f,
                "the pair that begins at electrode {electrode} has {ratio:.0} times the noise of the others"
            ),
            Self::Gains {
                electrode,
                gain,
                share,
            } => write!(
                f,
                "gains of the injections have changed, most at electrode {electrode} ({:+.3} %): {:.0} % of the change is \
                 not reciprocal",
                100.0 * gain,
                100.0 * share
            ),
            Self::Unexplained { share } => write!(
                f,
                "{:.0} % of the change is not explained by any map of the whole sheet",
                100.0 * share
            ),
            Self::AtElectrode { electrode } => write!(
                f,
                "at electrode {electrode}: its contact has changed, or a load lies over it"
            ),
            Self::OutsideRegion {
                electrode,
                lost_mm2,
            } => write!(
                f,
                "a load lies outside the region, near electrode {electrode}: about {lost_mm2:.0} mm2 lost there"
            ),
            Self::NoiseLimit { correlation } => write!(
                f,
                "the noise leaves the load uncertain: equally probable loads correlate with this map by {correlation:.2} on average"
            ),
            Self::LossAboveOne { loss } => {
                write!(f, "a loss of {:.0} % is impossible", 100.0 * loss)
            }
            Self::OwnMisfit {
                share,
                limit,
                cases,
            } => {
                write!(
                    f,
                    "the map itself leaves {:.0} % of the change unexplained; ",
                    100.0 * share
                )?;
                match cases {
                    0..1000 => write!(f, "all {cases}")?,
                    _ => f.write_str("99.9 % of the")?,
                }
                write!(
                    f,
                    " held-out cases with changes of that size leave at most {:.0} %",
                    100.0 * limit
                )
            }
            Self::Novelty { ratio } => write!(
                f,
                "the frame's distance from the training inputs is {ratio:.1} times the distance within which 99.9 % of them lie"
            ),
        }
    }
}

/// The verdict on a map and its reasons. As JSON: `verdict`, and `reasons` with `kind`, `electrode` and `text` each.
///
/// ```
/// use survey::{Doubt, Electrode, MapQuality, Verdict};
/// assert_eq!(MapQuality::of(&[]).verdict, Verdict::Sound);
/// let noisy = MapQuality::of(&[Doubt::Noise { ratio: 10.0 }]);
/// assert_eq!(noisy.to_string(), "doubtful: the noise is 10.00 times the stated one");
/// let dead = Doubt::DeadElectrode { electrode: Electrode(6), in_baseline: false };
/// let dead = MapQuality::of(&[Doubt::Noise { ratio: 10.0 }, dead]);
/// assert_eq!((dead.verdict, dead.reasons[1].electrode), (Verdict::Unreliable, Some(7)));
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MapQuality {
    /// The worst verdict of all reasons.
    pub verdict: Verdict,
    /// Why the map is not sound, and whether the load lies outside the region; empty if neither applies.
    pub reasons: Vec<Reason>,
}

/// A [`Doubt`] in words.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reason {
    /// [`Doubt::kind`].
    pub kind: String,
    /// The electrode that it names, counted from 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub electrode: Option<usize>,
    /// A sentence for people.
    pub text: String,
}

impl MapQuality {
    /// The quality of a map with these remarks.
    pub fn of(doubts: &[Doubt]) -> Self {
        let reason = |doubt: &Doubt| Reason {
            kind: doubt.kind().to_owned(),
            electrode: doubt.electrode().map(Electrode::number),
            text: doubt.to_string(),
        };
        let verdicts = doubts.iter().map(Doubt::verdict);
        Self {
            verdict: verdicts.max().unwrap_or(Verdict::Sound),
            reasons: doubts.iter().map(reason).collect(),
        }
    }

    /// Adds the reasons of another judgement; the worse verdict applies.
    #[must_use]
    pub fn and(mut self, other: Self) -> Self {
        self.verdict = self.verdict.max(other.verdict);
        self.reasons.extend(other.reasons);
        self
    }

    /// Whether the verdict is sound.
    pub fn is_sound(&self) -> bool {
        self.verdict == Verdict::Sound
    }

    /// Whether there is no remark for the user.
    pub fn is_silent(&self) -> bool {
        self.reasons.is_empty()
    }

    /// The reasons in one line, joined by semicolons; empty if there is none.
    pub fn text(&self) -> String {
        let texts: Vec<&str> = self
            .reasons
            .iter()
            .map(|reason| reason.text.as_str())
            .collect();
        texts.join("; ")
    }
}

impl fmt::Display for MapQuality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.verdict.word())?;
        match self.reasons.is_empty() {
            true => Ok(()),
            false => write!(f, ": {}", self.text()),
        }
    }
}
