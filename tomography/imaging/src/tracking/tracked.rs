//! The result of the tracked baseline for a frame: empty or loaded, position and uncertainty of the load, or the reason
//! why these are unknown.

use std::fmt;

use drift::{AnchorAlarm, Answer, DiscFit, ElectrodeFault, Judgement, MOST_MASKED, TrackerState};
use serde::{Deserialize, Serialize};
use survey::Electrode;

use super::numbers;

/// A position with a larger standard deviation counts as unknown, m.
pub(super) const MOST_PLACE_SD_M: f64 = 2e-3;
/// From this age of the baseline on, s, at least one frame since the baseline must have been empty.
const EMPTY_WITHIN_S: f64 = 3600.0;
/// Square root of the 95 % quantile of chi squared with two degrees of freedom.
pub(super) const REGION_95: f64 = 2.447_746_830_680_816;
/// Square root of the 95 % quantile of chi squared with one degree of freedom.
const INTERVAL_95: f64 = 1.959_963_984_540_054;
/// Advice for a doubt that ends with an empty frame.
const TAKE_OFF: &str = "remove everything from the sheet for a few frames, or, if it is empty, run `tactus baseline empty-now`";

/// Result of the tracked baseline for a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tracked {
    /// Empty, loaded or unknown.
    pub judgement: Judgement,
    /// Whether the map and the position can be relied on.
    pub known: bool,
    /// Why they cannot be relied on; `None` if they can.
    pub reason: Option<Doubtful>,
    /// The reason as a sentence, with the remedy.
    pub text: Option<String>,
    /// Position of the load, if exactly one is on the sheet.
    pub place: Option<PlaceRegion>,
    /// Number of loads on the sheet.
    pub loads: usize,
    /// Whether the sheet counts as loaded because a user declared it loaded; ended by `tactus baseline empty-now`.
    #[serde(default)]
    pub held: bool,
    /// Whether a load was placed (true) or removed (false) with this frame; `None` if neither.
    pub came: Option<bool>,
    /// Faulty electrodes whose readings are not used, counted from 1.
    pub masked: Vec<usize>,
    /// The electrode fault detected in this frame, as a sentence.
    pub fault: Option<String>,
    /// A sentence about a place where conductance changed slowly, by a load or by ageing.
    pub slow_change: Option<String>,
    /// Time since the last frame without load, s.
    pub since_empty_s: f64,
    /// Rate of the drift relative to the built-in rates.
    pub pace: f64,
    /// Standard deviation of the tracked baseline, rms over the readings, uV.
    pub baseline_sd_uv: f64,
}

/// Why the result of a frame is unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Doubtful {
    /// More than three electrodes are faulty.
    TooManyElectrodes,
    /// Too few readings were measured.
    TooFewReadings,
    /// The sheet has not been empty for so long that the standard deviation of the position is more than 2 mm.
    NotEmptyForLong,
    /// The load changed while the frame was measured.
    ChangedWithinFrame,
    /// The sheet has not been empty since the baseline.
    NeverEmpty,
    /// The load is at a place where conductance changed slowly; load and ageing cannot be distinguished.
    SlowChange,
    /// A user declared the sheet loaded, and the readings do not show where.
    DeclaredLoaded,
}

impl Doubtful {
    /// A short text for a picture.
    pub fn words(self) -> &'static str {
        match self {
            Self::TooManyElectrodes => "too many faulty electrodes",
            Self::TooFewReadings => "too few readings",
            Self::NotEmptyForLong => "not empty for long",
            Self::ChangedWithinFrame => "the load changed within the frame",
            Self::NeverEmpty => "never empty since the baseline",
            Self::SlowChange => "the place changed slowly before",
            Self::DeclaredLoaded => "declared loaded by a user",
        }
    }
}

/// Position and size of a load: 95 % ellipse and 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PlaceRegion {
    /// Centre, mm.
    pub centre_mm: [f64; 2],
    /// Half axes of the 95 % ellipse of the centre, mm, the longer first.
    pub half_axes_mm: [f64; 2],
    /// Angle of the longer half axis from the x axis, degrees, counter-clockwise.
    pub angle_deg: f64,
    /// Lost conductance times area, mm2: the integral of 2 l / (2 - l) over the area, l being the relative loss.
    /// Readings determine this integral better than l.
    pub loss_mm2: f64,
    /// 95 % interval of `loss_mm2`, mm2.
    pub loss_interval_mm2: [f64; 2],
    /// Whether a disc or an ellipse explains the readings, so that region and interval are valid. If not, the region is
    /// as wide as the errors found for loads of other shapes; it is not valid if the sheet changed in a way that the
    /// model does not contain.
    pub accepted: bool,
}

impl PlaceRegion {
    fn new(fit: &DiscFit) -> Self {
        let (deviations, angle_deg) = principal_axes(fit.covariance);
        let loss_mm2 = 1e6 * std::f64::consts::FRAC_PI_4 * fit.load;
        let width = INTERVAL_95 * fit.load_sd * loss_mm2.abs();
        Self {
            centre_mm: fit.disc.centre.map(|metres| 1e3 * metres),
            half_axes_mm: deviations.map(|metres| 1e3 * REGION_95 * metres),
            angle_deg,
            loss_mm2,
            loss_interval_mm2: [loss_mm2 - width, loss_mm2 + width],
            accepted: fit.accepted,
        }
    }
}

/// Standard deviations along the two principal axes of a covariance, the larger first, and the angle of the axis of the
/// larger one from the x axis, degrees, counter-clockwise.
pub(crate) fn principal_axes([[xx, xy], [_, yy]]: [[f64; 2]; 2]) -> ([f64; 2], f64) {
    let (middle, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
    let deviation = |variance: f64| variance.max(0.0).sqrt();
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    (
        [deviation(middle + half), deviation(middle - half)],
        angle.to_degrees(),
    )
}

impl Tracked {
    /// `load`: the disc fitted to the load, and the fit of its position. `alarm`: the last alarm. `began_s`, `at_s`:
    /// times of the first baseline and of the frame, s.
    pub(super) fn new(
        answer: &Answer,
        load: Option<&[DiscFit; 2]>,
        state: &TrackerState,
        alarm: Option<AnchorAlarm>,
        (began_s, at_s): (f64, f64),
    ) -> Self {
        let place = load.map(|[_, place]| PlaceRegion::new(place));
        let of_disc = load.map(|[disc, _]| disc).zip(place.as_ref());
        let (reason, text) = doubt(answer, of_disc, alarm, at_s - began_s).unzip();
        Self {
            judgement: answer.judgement,
            known: reason.is_none(),
            reason,
            text,
            place,
            came: answer
                .event
                .as_ref()
                .filter(|event| !event.same_load)
                .map(|event| event.came),
            fault: answer.fault.map(fault_text),
            slow_change: alarm.map(|alarm| slow_change(&alarm)),
            ..Self::unanswered(state, at_s)
        }
    }

    /// The result for a frame with too few readings, from the state after earlier frames.
    pub(super) fn unanswered(state: &TrackerState, at_s: f64) -> Self {
        Self {
            judgement: Judgement::Unknown,
            known: false,
            reason: Some(Doubtful::TooFewReadings),
            text: Some(too_few(&state.masked())),
            place: None,
            loads: state.loads(),
            held: state.held(),
            came: None,
            masked: numbers(&state.masked()),
            fault: None,
            slow_change: None,
            since_empty_s: state.since_empty_s(at_s),
            pace: state.pace(),
            baseline_sd_uv: 1e6 * state.deviation(),
        }
    }
}

/// The first reason not to rely on a frame, and the same as a sentence with the remedy; `None` if there is none.
fn doubt(
    answer: &Answer,
    load: Option<(&DiscFit, &PlaceRegion)>,
    alarm: Option<AnchorAlarm>,
    age_s: f64,
) -> Option<(Doubtful, String)> {
    if answer.judgement == Judgement::Unknown && answer.masked.len() <= MOST_MASKED {
        return Some((Doubtful::TooFewReadings, too_few(&answer.masked)));
    }
    if answer.judgement == Judgement::Unknown {
        let text = format!(
            "{} electrodes are faulty, more than three; repair their contacts: they are used again an hour later (no \
             order ends this state)",
            answer.masked.len()
        );
        return Some((Doubtful::TooManyElectrodes, text));
    }
    if answer.judgement == Judgement::Loaded {
        if age_s > EMPTY_WITHIN_S && answer.since_empty_s >= age_s {
            let text = format!(
                "the sheet was never empty since its baseline, so that drift and load cannot be distinguished; {TAKE_OFF}"
            );
            return Some((Doubtful::NeverEmpty, text));
        }
        if answer.held && load.is_none() {
            let text = "a user declared the sheet loaded, and the readings do not show where; run `tactus baseline \
                empty-now` when the sheet is empty";
            return Some((Doubtful::DeclaredLoaded, text.to_owned()));
        }
        let (disc, place) = load?;
        // the covariance of the disc fit is used: that of the position also contains errors of the shape, which do not
        // put the baseline in doubt
        let sd_mm = 1e3 * principal_axes(disc.covariance).0[0];
        if sd_mm > 1e3 * MOST_PLACE_SD_M && answer.event.is_some() && !disc.accepted {
            let text =
                "the load changed, possibly while this frame was measured; wait for the next frame";
            return Some((Doubtful::ChangedWithinFrame, text.to_owned()));
        }
        if sd_mm > 1e3 * MOST_PLACE_SD_M {
            let text = format!(
                "the sheet was last empty {} ago, so that the position is uncertain by {sd_mm:.1} mm; {TAKE_OFF}",
                Hours(answer.since_empty_s)
            );
            return Some((Doubtful::NotEmptyForLong, text));
        }
        let here = alarm.filter(|alarm| is_at(alarm, place))?;
        return Some((Doubtful::SlowChange, slow_change(&here)));
    }
    None
}

/// The sentence for [`Doubtful::TooFewReadings`]. `masked`: the faulty electrodes, counted from 0.
fn too_few(masked: &[usize]) -> String {
    let faulty: Vec<String> = numbers(masked).iter().map(usize::to_string).collect();
    let unused = match faulty.is_empty() {
        true => String::new(),
        false => format!(
            ", and those of faulty electrodes ({}) are not used",
            faulty.join(", ")
        ),
    };
    format!(
        "fewer than half of the pairs of readings are left: readings are missing or nearly 0 V{unused}; this ends with \
         the next complete frame"
    )
}

/// Whether a load overlaps the place of an alarm.
fn is_at(alarm: &AnchorAlarm, place: &PlaceRegion) -> bool {
    let [x, y] = [0, 1].map(|axis| place.centre_mm[axis] - 1e3 * alarm.centre[axis]);
    x.hypot(y) < 500.0 * alarm.diameter + place.half_axes_mm[0]
}

fn slow_change(alarm: &AnchorAlarm) -> String {
    let percent = -100.0 * alarm.loss();
    // readings hardly distinguish larger gains
    let changed = match percent > 1000.0 {
        true => "more than 1000 %".to_owned(),
        false => format!("{percent:.1} %"),
    };
    let [x, y] = alarm.centre.map(|metres| 1e3 * metres);
    format!(
        "conductance at ({x:.0}, {y:.0}) mm changed slowly by {changed} within {:.0} days: a load or ageing, which \
         readings cannot distinguish; inspect the sheet, then run `tactus baseline forget-anchor` (ageing), \
         `loaded-now` (a load) or `empty-now` (the sheet is empty)",
        alarm.age_days
    )
}

impl fmt::Display for Tracked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.judgement, &self.place) {
            (Judgement::Empty, _) => write!(f, "the sheet is empty")?,
            (Judgement::Loaded, Some(place)) => {
                let ([x, y], [half, _]) = (place.centre_mm, place.half_axes_mm);
                match place.accepted {
                    true => write!(
                        f,
                        "a load at ({x:.1}, {y:.1}) mm within {half:.1} mm (95 %)"
                    )?,
                    false => write!(
                        f,
                        "a load near ({x:.0}, {y:.0}) mm, unlike a disc or an ellipse"
                    )?,
                }
            }
            (Judgement::Loaded, None) if self.held => write!(f, "a load, declared by a user")?,
            (Judgement::Loaded, None) => write!(f, "{} loads", self.loads)?,
            (Judgement::Unknown, _) => write!(f, "this frame cannot be evaluated")?,
        }
        if let Some(fault) = &self.fault {
            write!(f, "; {fault}")?;
        }
        match &self.text {
            Some(text) => write!(f, "; not known: {text}"),
            None => Ok(()),
        }
    }
}

/// A duration in hours or days.
struct Hours(f64);

impl fmt::Display for Hours {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let hours = self.0 / 3600.0;
        match hours < 48.0 {
            true => write!(f, "{hours:.1} h"),
            false => write!(f, "{:.1} days", hours / 24.0),
        }
    }
}

fn fault_text(fault: ElectrodeFault) -> String {
    match fault {
        ElectrodeFault::Shorted { electrode } => {
            format!(
                "electrode {} and the next one are shorted",
                Electrode(electrode)
            )
        }
        ElectrodeFault::Risen { electrode, .. } => {
            format!(
                "the contact of electrode {} is open or has risen",
                Electrode(electrode)
            )
        }
        ElectrodeFault::Floating { electrode } => {
            format!("electrode {} floats", Electrode(electrode))
        }
        ElectrodeFault::DistantShort { electrodes } => {
            let [a, b] = electrodes.map(Electrode);
            format!("electrodes {a} and {b} are connected")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_change_is_the_share_that_was_lost_or_gained() {
        for (change, percent) in [
            (-2.0 / 3.0, "-50.0 %"),
            (-2.0, "-100.0 %"),
            (-5.0, "-100.0 %"),
            (0.5, "66.7 %"),
            (2.0, "more than 1000 %"),
            (5.0, "more than 1000 %"),
        ] {
            let text = slow_change(&AnchorAlarm {
                age_days: 1.0,
                centre: [0.06, 0.15],
                diameter: 0.02,
                change,
                score: 50.0,
            });
            assert!(
                text.contains(&format!("slowly by {percent} within")),
                "{change}: {text}"
            );
        }
    }
}
