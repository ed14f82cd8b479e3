//! Whether the tracked baseline absorbs loads that remain for days or rise slowly: their amplitude at the true
//! position, relative to the first one.

use std::sync::Arc;

use drift::{DriftError, DriftModel, Judgement, Tracker, Whitened};
use imaging::Geometry;
use nalgebra::DMatrix;
use phantom::Load;
use rayon::prelude::*;
use serde::Serialize;
use survey::Reading;

use super::simulated::{Simulated, away_mm, model};
use super::tracked::LongScene;
use crate::{Failure, progress};

const DAY_S: f64 = 86_400.0;
/// Prior standard deviation of local changes of ln conductance in the maps of a night.
const MAP_SIZE: f64 = 0.3;

/// One result of the run of one load.
#[derive(Debug, Clone, Serialize)]
pub struct LoadRow {
    /// The load.
    pub load: String,
    /// The measured quantity, with its unit.
    pub what: &'static str,
    /// The value, in the unit given by `what`.
    pub value: f64,
    /// The goal for the value.
    pub goal: &'static str,
}

/// The loads of the study.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    /// A disc of 60 mm with a loss of 30 %, from day 2 to 9, in addition to the night's load.
    Week,
    /// The night's load of 70 x 50 mm with a loss of 40 %, every night.
    Nights,
    /// A disc of 30 mm whose loss rises to 20 % from day 8 on within `days`, with the night's load or on an empty
    /// sheet.
    Slow { days: f64, nights: bool },
}

/// One frame of a run.
struct Seen {
    day: f64,
    /// Amplitude of the load at its true position, as change of ln conductance.
    amplitude: f64,
    /// Integral of the map's change of ln conductance over the area near the load, mm2; NaN except for frames of a
    /// night.
    of_map_mm2: f64,
    loaded: bool,
    /// Whether the comparison with an earlier baseline shows a change at the true position.
    anchor: bool,
}

impl Kind {
    const ALL: [Self; 6] = [
        Self::Week,
        Self::Nights,
        Self::slow(3.0, true),
        Self::slow(3.0, false),
        Self::slow(14.0, true),
        Self::slow(14.0, false),
    ];

    const fn slow(days: f64, nights: bool) -> Self {
        Self::Slow { days, nights }
    }

    fn name(self) -> String {
        match self {
            Self::Week => "60 mm, a week".to_owned(),
            Self::Nights => "night's load".to_owned(),
            Self::Slow { days, nights } => {
                let nights = if nights {
                    "with nights"
                } else {
                    "nothing else"
                };
                format!("30 mm, over {days} days, {nights}")
            }
        }
    }

    /// Position and diameter of the load, mm. The night's rectangle is approximated by a disc.
    fn disc_mm(self) -> ([f64; 2], f64) {
        match self {
            Self::Week => ([60.0, 180.0], 60.0),
            Self::Nights => ([100.0, 115.0], 60.0),
            Self::Slow { .. } => ([60.0, 150.0], 30.0),
        }
    }

    fn scene(self) -> String {
        match self {
            Self::Week => {
                LongScene::Month.text()
                    + "[[load]]\nname = \"weight\"\nshape = \"disc\"\ndiameter_mm = 60.0\nx_mm = 60.0\ny_mm = 180.0\n\
                       loss_percent = 30.0\nfrom_s = 172800.0\nto_s = 777600.0\n"
            }
            Self::Nights | Self::Slow { nights: true, .. } => LongScene::Month.text(),
            Self::Slow { nights: false, .. } => LongScene::Month.effects(),
        }
    }

    /// Days of the run, and the interval of its frames, s.
    fn extent(self, days: f64) -> (f64, f64) {
        match self {
            Self::Week => (10.0, 600.0),
            Self::Nights => (days, 3600.0),
            Self::Slow { days, .. } => (8.5 + days, 600.0),
        }
    }

    /// The load in addition to those of the scene.
    fn pressed(self, day: f64) -> Option<Load> {
        let Self::Slow { days: rise, .. } = self else {
            return None;
        };
        let loss = 0.2 * ((day - 8.0) / rise).clamp(0.0, 1.0);
        let (place, diameter) = self.disc_mm();
        (loss > 0.0).then(|| Load::disc(place, diameter, loss))
    }
}

/// All rows; `days` is the duration of the run of nights.
pub(super) fn rows(seed: u64, days: f64, geometry: &Geometry) -> Result<Vec<LoadRow>, Failure> {
    let bar = progress::bar(Kind::ALL.len(), "loads");
    let rows: Vec<Vec<LoadRow>> = Kind::ALL
        .par_iter()
        .map(|&kind| {
            let seen = run(kind, seed, days, geometry)?;
            bar.inc(1);
            Ok(judged(kind, &seen))
        })
        .collect::<Result<_, Failure>>()?;
    bar.finish_and_clear();
    Ok(rows.into_iter().flatten().collect())
}

fn run(kind: Kind, seed: u64, days: f64, geometry: &Geometry) -> Result<Vec<Seen>, Failure> {
    let failed = |fault| Failure::of("the tracked baseline", &fault);
    let mut simulated = Simulated::of(&kind.name(), &kind.scene(), seed)?;
    let baseline = simulated.frame(0.0, None)?;
    let model = Arc::new(model(geometry, &baseline)?);
    let mut tracker = Tracker::new(Arc::clone(&model), 0.0).map_err(failed)?;
    let (place, diameter) = kind.disc_mm();
    let atom = model.disc(place.map(|mm| 1e-3 * mm), 1e-3 * diameter);
    let atom = DMatrix::from_column_slice(atom.len(), 1, atom.as_slice());
    let (days, every_s) = kind.extent(days);
    let mut out = Vec::new();
    for number in 1..=(days * DAY_S / every_s) as usize {
        let at_s = every_s * number as f64;
        let day = at_s / DAY_S;
        let frame = simulated.frame(at_s, kind.pressed(day))?;
        let answer = tracker.follow(&frame, at_s).map_err(failed)?;
        let white = tracker.whitened().map_err(failed)?;
        let column = white.sensitivity(&atom);
        let night = kind == Kind::Nights && at_night(day);
        let of_map_mm2 = match night {
            true => load_of_map(&tracker, &frame, place, diameter).map_err(failed)?,
            false => f64::NAN,
        };
        out.push(Seen {
            day,
            of_map_mm2,
            amplitude: column.column(0).dot(white.data()) / column.norm_squared(),
            loaded: answer.judgement == Judgement::Loaded,
            anchor: answer
                .anchor
                .is_some_and(|anchor| away_mm(anchor.centre, place) < diameter),
        });
    }
    Ok(out)
}

/// The integral of a linear map of the last frame over the triangles within `diameter_mm` of a position, mm2. Like maps
/// of the daemon, the frame is compared with the tracked baseline plus the most probable changes that this baseline
/// does not contain.
fn load_of_map(
    tracker: &Tracker,
    frame: &[Reading],
    place_mm: [f64; 2],
    diameter_mm: f64,
) -> Result<f64, DriftError> {
    let model: &DriftModel = tracker.model();
    let relative = model.relative(frame)?;
    let mut change = relative.data - tracker.baseline();
    if let Some(unlearnt) = tracker.unlearnt()? {
        change -= unlearnt;
    }
    let white = Whitened::new(model.noise(), &change, &relative.rows)?;
    let map = white.one_step(model, MAP_SIZE)?;
    let mesh = model.mesh();
    let near = (0..map.len()).filter(|&t| away_mm(mesh.centroid(t), place_mm) < diameter_mm);
    Ok(near.map(|t| 1e6 * mesh.area(t) * map[t]).sum())
}

/// Whether the night's load is on the sheet. A frame at the end of the night, except for rounding of the time of day,
/// has no load.
fn at_night(day: f64) -> bool {
    const ROUNDING: f64 = 1e-6;
    (0.5 - ROUNDING..20.0 / 24.0 - ROUNDING).contains(&day.fract())
}

fn judged(kind: Kind, seen: &[Seen]) -> Vec<LoadRow> {
    let row = |what, value, goal| LoadRow {
        load: kind.name(),
        what,
        value,
        goal,
    };
    let extremes = |values: &mut dyn Iterator<Item = f64>| {
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
            [low.min(value), high.max(value)]
        })
    };
    match kind {
        Kind::Week => {
            let lies = |one: &&Seen| (2.001..8.999).contains(&one.day);
            let alone: Vec<f64> = seen
                .iter()
                .filter(lies)
                .filter(|one| !at_night(one.day))
                .map(|one| one.amplitude)
                .collect();
            let first = alone.first().copied().unwrap_or(f64::NAN);
            let [low, high] = extremes(&mut alone.iter().map(|value| 100.0 * value / first));
            let after = seen
                .iter()
                .filter(|one| one.day > 9.3 && !at_night(one.day));
            vec![
                row("least of its first amplitude, %", low, "97"),
                row("most of its first amplitude, %", high, "104"),
                row(
                    "its frames called empty",
                    seen.iter().filter(lies).filter(|one| !one.loaded).count() as f64,
                    "0",
                ),
                row(
                    "frames called loaded after it was taken away",
                    after.filter(|one| one.loaded).count() as f64,
                    "0",
                ),
            ]
        }
        Kind::Nights => {
            let whole = 0..seen.last().map_or(0, |last| last.day as usize);
            let nights: Vec<Vec<&Seen>> = whole
                .map(|night| {
                    let of = seen.iter().filter(|one| one.day as usize == night);
                    of.filter(|one| at_night(one.day)).collect()
                })
                .filter(|night: &Vec<&Seen>| !night.is_empty())
                .collect();
            // rms deviation of the first frames of the nights from their mean, %, and the largest change within a
            // night, %
            let spread = |value: fn(&Seen) -> f64| {
                let firsts = || nights.iter().map(|night| value(night[0]));
                let mean = firsts().sum::<f64>() / nights.len() as f64;
                let squares = firsts().map(|first| (first / mean - 1.0).powi(2));
                let rms = (squares.sum::<f64>() / nights.len() as f64).sqrt();
                let within = nights.iter().map(|night| {
                    let first = value(night[0]);
                    let [low, high] = extremes(&mut night.iter().map(|one| value(one) / first));
                    (high - 1.0).max(1.0 - low)
                });
                [100.0 * rms, 100.0 * within.fold(0.0, f64::max)]
            };
            let [rms, within] = spread(|one| one.amplitude);
            let [map_rms, map_within] = spread(|one| one.of_map_mm2);
            vec![
                row("nights", nights.len() as f64, ""),
                row("first amplitude of each night, % rms", rms, "1"),
                row("largest change within a night, %", within, "4"),
                row("first load of each night's maps, % rms", map_rms, "1"),
                row("its largest change within a night, %", map_within, "4"),
            ]
        }
        Kind::Slow { days: rise, nights } => {
            let loss = |one: &Seen| 20.0 * ((one.day - 8.0) / rise).clamp(0.0, 1.0);
            let up = seen.iter().find(|one| one.day >= 8.0 + rise);
            // ln of the remaining conductance, in the linear approximation of a disc
            let whole = -2.0 * 0.2 / (2.0 - 0.2);
            // during the night's load nothing is known of the slow load
            let alone = move |one: &&Seen| one.day > 8.0 && !(nights && at_night(one.day));
            let rising = || seen.iter().filter(alone);
            let never = f64::INFINITY;
            vec![
                row(
                    "kept when it is up, %",
                    100.0 * up.map_or(f64::NAN, |one| one.amplitude / whole),
                    "85 (3 days)",
                ),
                row(
                    "called loaded at a loss of, %",
                    rising().find(|one| one.loaded).map_or(never, loss),
                    "",
                ),
                row(
                    "an anchor speaks at a loss of, %",
                    rising().find(|one| one.anchor).map_or(never, loss),
                    "5",
                ),
            ]
        }
    }
}

/// The table as text.
pub(super) fn text(rows: &[LoadRow]) -> String {
    let mut text = String::from(
        "load                                                                                  value  goal\n",
    );
    for row in rows {
        text += &format!(
            "{:<34} {:<46} {:>9.2}  {}\n",
            row.load, row.what, row.value, row.goal
        );
    }
    text
}
