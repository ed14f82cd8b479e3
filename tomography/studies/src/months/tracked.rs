//! Simulated days (up to 90) with a tracked baseline: presses, empty frames and nights of a scene.

use std::sync::Arc;

use drift::{Answer, Judgement, Tracker};
use imaging::Geometry;
use phantom::Load;
use rayon::prelude::*;
use serde::Serialize;

use super::Settings;
use super::simulated::{Family, Simulated, away_mm, model};
use super::single::covers;
use crate::evaluation::{average, quantile};
use crate::{Failure, progress};

/// Interval of the frames, s.
const EVERY_S: f64 = 600.0;
const DAY_S: f64 = 86_400.0;
/// Time of day of the night's load, s.
const NIGHT_S: [f64; 2] = [43_200.0, 72_000.0];
/// Frames of the day with presses: one of 10 mm, and two frames later one of 30 mm.
const PRESSES: [usize; 8] = [9, 21, 33, 45, 57, 124, 130, 137];
pub(super) const DIAMETERS_MM: [f64; 2] = [10.0, 30.0];
/// Spans of days of the tables.
const SPANS: [(&str, f64); 7] = [
    ("0-1", 1.0),
    ("1-3", 3.0),
    ("3-7", 7.0),
    ("7-14", 14.0),
    ("14-30", 30.0),
    ("30-60", 60.0),
    ("60-90", f64::INFINITY),
];
/// Spans of days for scenes in which a contact is lost from day 20 on, within a week or at once.
const SPANS_OF_A_LOSS: [(&str, f64); 6] = [
    ("0-20", 20.0),
    ("20-21", 21.0),
    ("21-27", 27.0),
    ("27-28", 28.0),
    ("28-60", 60.0),
    ("60-90", f64::INFINITY),
];
/// Prior standard deviation of local change, for the maps of empty frames.
pub(super) const MAP_SIZE: f64 = 0.01;
/// The map of one in this number of frames is judged, if the frame is empty.
const JUDGED_EVERY: usize = 6;

/// A scene of many days.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum LongScene {
    /// The scene month without detachment and wear
    Month,
    /// The scene month without wear: a contact detaches within a week from day 20 on
    MonthDetachment,
    /// The same with a contact that is lost at once on day 20
    MonthOpen,
    /// Faster and larger drift on a sprayed sheet with misplaced electrodes and a crack, none of it known to the
    /// tracker
    HoldOut,
    /// The drift of the scene bedside-night, with creep; a load every night
    Bedside,
    /// Contacts of a spread of 50 % that drift by 30 % within a day, not known to the tracker
    HoldOutContacts,
    /// A sheet sprayed unevenly by 15 % with misplaced electrodes, whose load sets by 2 % per decade, none of it known
    /// to the tracker
    HoldOutSpray,
    /// Noise of the readings and nothing else: the limit of any tracking
    Noise,
}

impl LongScene {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Month => "month",
            Self::MonthDetachment => "detached",
            Self::MonthOpen => "open",
            Self::HoldOut => "hold-out",
            Self::Bedside => "bedside",
            Self::HoldOutContacts => "contacts",
            Self::HoldOutSpray => "spray",
            Self::Noise => "noise",
        }
    }

    /// The effects as text of a scene.
    pub(super) fn effects(self) -> String {
        match self {
            Self::Month => {
                Family::Month.effects() + "[effects.set]\npercent_per_decade = 1.0\n"
            }
            Self::MonthDetachment => Self::MonthOpen.effects() + "over_s = 604800.0\n",
            Self::MonthOpen => {
                Self::Month.effects() + "[effects.detachment]\nelectrode = 20\nfrom_s = 1728000.0\n"
            }
            Self::HoldOut => "[effects.temperature]\npercent_per_c = -0.4\nroom_c = 3.0\n\
                [effects.long-drift]\nwander_percent = 1.0\nwalk_percent = 0.1\nrunning_in_percent = 6.0\n\
                [effects.contact-spread]\nstd = 0.4\n[effects.contact-drift]\npercent = 20.0\ntau_h = 12.0\n\
                [effects.spray]\nstd = 0.1\n[effects.electrode-placement]\n[effects.thermal-emf]\nuv = 0.9\n\
                [effects.crack]\nfrom_mm = [60.0, 160.0]\nto_mm = [90.0, 190.0]\ndays = 20.0\n"
                .to_owned(),
            Self::Bedside => {
                Family::Bedside.effects()
                    + "[effects.creep]\npercent = [5.0, 10.0]\ntau_s = [100.0, 3000.0]\nevery_s = 600.0\n"
            }
            Self::HoldOutContacts => "[effects.temperature]\npercent_per_c = -0.3\nroom_c = 2.0\n\
                [effects.contact-spread]\nstd = 0.5\n[effects.contact-drift]\npercent = 30.0\ntau_h = 24.0\n\
                [effects.thermal-emf]\nuv = 0.9\n"
                .to_owned(),
            Self::HoldOutSpray => {
                Family::Spray.effects().replace("std = 0.1\n", "std = 0.15\n")
                    + "[effects.electrode-placement]\n[effects.set]\npercent_per_decade = 2.0\n"
            }
            Self::Noise => String::new(),
        }
    }

    /// The text of the scene, with a load every night.
    pub(super) fn text(self) -> String {
        self.effects()
            + "[[load]]\nname = \"night\"\nshape = \"rectangle\"\nwidth_mm = 70.0\nheight_mm = 50.0\nx_mm = 100.0\n\
               y_mm = 115.0\nloss_percent = 40.0\nfrom_s = 43200.0\nto_s = 72000.0\n\
               repeat = { every_s = 86400.0, times = 90 }\n"
    }

    /// Number of judged days in a run of `days`.
    pub(super) fn days(self, days: f64) -> f64 {
        match self {
            Self::HoldOut | Self::HoldOutContacts | Self::HoldOutSpray => days.min(20.0),
            _ => days,
        }
    }

    fn spans(self) -> &'static [(&'static str, f64)] {
        match self {
            Self::MonthDetachment | Self::MonthOpen => &SPANS_OF_A_LOSS,
            _ => &SPANS,
        }
    }
}

/// Results for presses of one diameter in one span of days.
#[derive(Debug, Clone, Serialize)]
pub struct PressRow {
    /// Scene.
    pub scene: LongScene,
    /// Days since the baseline.
    pub days: &'static str,
    /// Diameter of the presses, mm.
    pub diameter_mm: f64,
    /// Number of presses.
    pub presses: usize,
    /// Number of presses judged as an empty sheet.
    pub missed: usize,
    /// Mean distance of the detected presses from the truth, mm.
    pub mean_mm: f64,
    /// 95th percentile of that distance, mm.
    pub p95_mm: f64,
    /// Largest distance, mm.
    pub most_mm: f64,
    /// Number of accepted fits.
    pub accepted: usize,
    /// Number of accepted fits whose 95 % ellipse contains the truth.
    pub covered: usize,
}

/// Results for frames without a press in one span of days.
#[derive(Debug, Clone, Serialize)]
pub struct FrameRow {
    /// Scene.
    pub scene: LongScene,
    /// Days since the baseline.
    pub days: &'static str,
    /// Number of empty frames.
    pub empty: usize,
    /// Number of empty frames judged as loaded.
    pub false_loads: usize,
    /// Number of frames of nights.
    pub night: usize,
    /// Number of frames of nights judged as empty.
    pub missed_nights: usize,
    /// Mean rms of the maps of empty frames, %.
    pub zero_percent: f64,
    /// Largest rms of these maps, %.
    pub zero_most_percent: f64,
    /// Mean chi squared per row of the data of empty frames.
    pub chi: f64,
    /// Number of frames in which the comparison with earlier baselines raised an alarm.
    pub anchor_alarms: usize,
    /// Number of frames in which a faulty electrode was named.
    pub faults: usize,
    /// Rate of the drift relative to the built-in rates, at the end.
    pub pace: f64,
    /// Mean computing time of a frame, ms.
    pub frame_ms: f64,
}

/// The truth of one frame, and the tracker's result.
struct Judged {
    span: usize,
    truth: Truth,
    answer: Answer,
    /// Distance from the truth, mm; whether the fit is accepted; whether its 95 % ellipse contains the truth.
    press: Option<(f64, bool, bool)>,
    zero: Option<f64>,
    ms: f64,
}

#[derive(Clone, Copy, PartialEq)]
enum Truth {
    Empty,
    Night,
    Press(usize),
}

/// All rows.
pub(super) fn rows(
    settings: &Settings,
    geometry: &Geometry,
) -> Result<(Vec<PressRow>, Vec<FrameRow>), Failure> {
    let frames: f64 = settings
        .scenes
        .iter()
        .map(|scene| scene.days(settings.days))
        .sum();
    let bar = progress::bar((frames * DAY_S / EVERY_S) as usize, "tracked");
    let judged: Vec<Vec<Judged>> = settings
        .scenes
        .par_iter()
        .map(|&scene| run(scene, settings, geometry, &bar))
        .collect::<Result<_, _>>()?;
    bar.finish_and_clear();
    let (mut presses, mut frames) = (Vec::new(), Vec::new());
    for (&scene, judged) in settings.scenes.iter().zip(&judged) {
        for (span, (days, _)) in scene.spans().iter().enumerate() {
            let of: Vec<&Judged> = judged.iter().filter(|one| one.span == span).collect();
            if of.is_empty() {
                continue;
            }
            for (diameter, diameter_mm) in DIAMETERS_MM.into_iter().enumerate() {
                presses.push(press_row(scene, days, diameter, diameter_mm, &of));
            }
            frames.push(frame_row(scene, days, &of));
        }
    }
    Ok((presses, frames))
}

fn run(
    scene: LongScene,
    settings: &Settings,
    geometry: &Geometry,
    bar: &indicatif::ProgressBar,
) -> Result<Vec<Judged>, Failure> {
    let mut simulated = Simulated::of(scene.name(), &scene.text(), settings.seed)?;
    let baseline = simulated.frame(0.0, None)?;
    let failed = |fault| Failure::of("the tracked baseline", &fault);
    let model = Arc::new(model(geometry, &baseline)?);
    let mut tracker = Tracker::new(model, 0.0).map_err(failed)?;
    let frames = (scene.days(settings.days) * DAY_S / EVERY_S) as usize;
    let per_day = (DAY_S / EVERY_S) as usize;
    let mut out = Vec::with_capacity(frames);
    for number in 1..=frames {
        let at_s = number as f64 * EVERY_S;
        let of_day = number % per_day;
        let pressed = DIAMETERS_MM.iter().enumerate().find_map(|(k, diameter)| {
            PRESSES
                .iter()
                .any(|press| press + 2 * k == of_day)
                .then_some((k, *diameter))
        });
        let place = simulated.place();
        let load = pressed.map(|(_, diameter)| Load::disc(place, diameter, 0.5));
        let frame = simulated.frame(at_s, load)?;
        let begun = std::time::Instant::now();
        let answer = tracker.follow(&frame, at_s).map_err(failed)?;
        let ms = 1e3 * begun.elapsed().as_secs_f64();
        let second = at_s % DAY_S;
        let truth = match pressed {
            Some((k, _)) => Truth::Press(k),
            None if (NIGHT_S[0]..NIGHT_S[1]).contains(&second) => Truth::Night,
            None => Truth::Empty,
        };
        let press = match (&answer.event, truth) {
            (Some(event), Truth::Press(_)) => {
                let error = away_mm(event.fit.disc.centre, place);
                Some((error, event.fit.accepted, covers(&event.fit, place)))
            }
            _ => None,
        };
        let zero = if truth == Truth::Empty && number % JUDGED_EVERY == 1 {
            let values = tracker.map(MAP_SIZE).map_err(failed)?;
            let mesh = &geometry.mesh;
            let (mut sum, mut area) = (0.0, 0.0);
            for &triangle in mesh.region() {
                sum += mesh.area(triangle) * values[triangle].powi(2);
                area += mesh.area(triangle);
            }
            Some((sum / area).sqrt())
        } else {
            None
        };
        let day = at_s / DAY_S;
        let spans = scene.spans().iter();
        let span = spans.take_while(|(_, to)| day > *to).count();
        bar.inc(1);
        out.push(Judged {
            span,
            truth,
            answer,
            press,
            zero,
            ms,
        });
    }
    Ok(out)
}

fn press_row(
    scene: LongScene,
    days: &'static str,
    diameter: usize,
    diameter_mm: f64,
    of: &[&Judged],
) -> PressRow {
    let presses: Vec<&&Judged> = of
        .iter()
        .filter(|one| one.truth == Truth::Press(diameter))
        .collect();
    let found: Vec<(f64, bool, bool)> = presses.iter().filter_map(|one| one.press).collect();
    let mut errors: Vec<f64> = found.iter().map(|(error, ..)| *error).collect();
    let loaded = |one: &&&&Judged| one.answer.judgement == Judgement::Loaded && one.press.is_some();
    PressRow {
        scene,
        days,
        diameter_mm,
        presses: presses.len(),
        missed: presses.len() - presses.iter().filter(loaded).count(),
        mean_mm: average(errors.iter().copied()),
        p95_mm: quantile(&mut errors, 0.95),
        most_mm: errors.last().copied().unwrap_or(f64::NAN),
        accepted: found.iter().filter(|(_, accepted, _)| *accepted).count(),
        covered: found
            .iter()
            .filter(|(_, accepted, covered)| *accepted && *covered)
            .count(),
    }
}

fn frame_row(scene: LongScene, days: &'static str, of: &[&Judged]) -> FrameRow {
    let with = |truth: Truth| of.iter().filter(move |one| one.truth == truth);
    let judged = |truth: Truth, judgement: Judgement| {
        with(truth)
            .filter(|one| one.answer.judgement == judgement)
            .count()
    };
    let zeros: Vec<f64> = of.iter().filter_map(|one| one.zero).collect();
    let chis = with(Truth::Empty).filter_map(|one| one.answer.chi);
    FrameRow {
        scene,
        days,
        empty: with(Truth::Empty).count(),
        false_loads: judged(Truth::Empty, Judgement::Loaded),
        night: with(Truth::Night).count(),
        missed_nights: judged(Truth::Night, Judgement::Empty),
        zero_percent: 100.0 * average(zeros.iter().copied()),
        zero_most_percent: 100.0 * zeros.iter().copied().fold(0.0, f64::max),
        chi: average(chis),
        anchor_alarms: of.iter().filter(|one| one.answer.anchor.is_some()).count(),
        faults: of.iter().filter(|one| one.answer.fault.is_some()).count(),
        pace: of.last().map_or(f64::NAN, |one| one.answer.pace),
        frame_ms: average(of.iter().map(|one| one.ms)),
    }
}

/// The tables as text.
pub(super) fn text(presses: &[PressRow], frames: &[FrameRow]) -> String {
    let mut text = String::from(
        "scene     days     mm presses missed  mean mm  p95 mm  max mm accepted covered\n",
    );
    for row in presses {
        text += &format!(
            "{:<9} {:<6} {:>4} {:>7} {:>6} {:>8.2} {:>7.2} {:>7.2} {:>8} {:>7}\n",
            row.scene.name(),
            row.days,
            row.diameter_mm,
            row.presses,
            row.missed,
            row.mean_mm,
            row.p95_mm,
            row.most_mm,
            row.accepted,
            row.covered
        );
    }
    text += "\nscene     days    empty  false  night  missed  zero %   max %  chi/n anchors faults  pace ms a frame\n";
    for row in frames {
        text += &format!(
            "{:<9} {:<6} {:>6} {:>6} {:>6} {:>7} {:>7.3} {:>7.3} {:>6.2} {:>7} {:>6} {:>5} {:>9.1}\n",
            row.scene.name(),
            row.days,
            row.empty,
            row.false_loads,
            row.night,
            row.missed_nights,
            row.zero_percent,
            row.zero_most_percent,
            row.chi,
            row.anchor_alarms,
            row.faults,
            row.pace,
            row.frame_ms
        );
    }
    text
}
