//! `tactus export --format apng`: a session as a film, with time, one colour scale and hot spots.

use std::io::Write;
use std::path::Path;

use chrono::{DateTime, TimeDelta, Utc};
use imaging::recorded::{RecordedFrame, Recording, SessionParts};
use outfile::OutFile;
use render::{Film, Pace, Range, Style};
use survey::Map;

use super::Written;
use crate::args::Export;
use crate::failure::Failure;
use crate::maps::pictures::Pictures;
use crate::maps::reconstruction::Reconstruction;
use crate::options::duration::display_span;
use crate::output::Printer;
use crate::output::progress::progress;
use crate::output::time::local;

/// Default number of pictures of a film.
const USUAL: f64 = 600.0;
/// Most pictures. Their maps are in memory until the common scale is known: 30 kB each on the paper's sheet.
const MOST: usize = 3000;
/// Duration of a picture, s, unless `--every` and `--speed` determine another one.
const EACH_S: f64 = 0.1;
/// Shortest and longest duration of a picture, s: viewers skip shorter ones, and the format cannot store longer ones.
const DURATIONS_S: [f64; 2] = [0.02, 60.0];
/// Least time for which a frame is shown if no other follows, s.
const HOLD_S: f64 = 60.0;

/// Writes the film and reports its path.
pub(super) fn write(
    path: &Path,
    session: &SessionParts,
    export: &Export,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let header = session.header();
    super::check_comparable(session)?;
    let plan = Plan::new(session, export)?;
    let (recording, reconstruction) = Reconstruction::of_session(path, &export.asked)?;
    let mut pictures = Pictures::new(&reconstruction, &export.asked.tracked, &recording)?;
    // before the work, so that a file that cannot be written is reported first
    let mut file = OutFile::create(&export.out, export.replacing.existing())?;
    let (shots, damaged) = shots(
        &plan,
        &recording,
        &mut pictures,
        &reconstruction,
        export,
        printer,
    )?;
    let drawn = shots.iter().map(|shot| (&shot.map, &shot.style));
    let failed = |error| Failure::failed("the film cannot be drawn", &error);
    let range = Range::of_film(drawn.clone()).map_err(failed)?;
    let pace = Pace {
        pictures: u32::try_from(shots.len()).unwrap_or(u32::MAX),
        each_ms: (1e3 * plan.each_s).round() as u16,
    };
    let sheet = &reconstruction.field.sheet;
    let style = &shots[0].style;
    let mut film = Film::new(&mut file, sheet, range, style, pace).map_err(failed)?;
    for (map, style) in drawn {
        film.add(map, style).map_err(failed)?;
    }
    film.finish().map_err(failed)?;
    let path = file.finish()?;
    for remark in &reconstruction.remarks {
        printer.text(remark)?;
    }
    let written = Written {
        method: Some(reconstruction.method().to_owned()),
        noise: reconstruction.noise,
        pictures: Some(shots.len()),
        every_s: Some(plan.every_s),
        speed: Some(plan.every_s / plan.each_s),
        ..Written::table(
            "apng",
            &path,
            shots.iter().filter(|shot| shot.shows_frame).count(),
            header,
        )
    };
    printer.record(&written, |written| {
        format!(
            "{:<9} {}: {} pictures, one for each {} of the session, {} each ({:.3e} times faster)",
            written.what,
            written.path,
            shots.len(),
            display_span(survey::duration(plan.every_s)),
            display_span(survey::duration(plan.each_s)),
            plan.every_s / plan.each_s,
        )
    })?;
    super::check_undamaged(damaged, header)
}

/// The instants of the pictures.
#[derive(Debug, PartialEq)]
struct Plan {
    first: DateTime<Utc>,
    /// Number of pictures.
    count: usize,
    /// Time between two of them in the session, s.
    every_s: f64,
    /// Duration of each in the film, s.
    each_s: f64,
}

impl Plan {
    fn new(session: &SessionParts, export: &Export) -> Result<Self, Failure> {
        let first = super::first_frame(session)?.frame.wall;
        let mut last = first;
        // the last readable frame; the wall clock may have been set back before it, hence `max`
        for sequence in (session.header().first_sequence..=session.last_sequence()?).rev() {
            if let Ok(record) = session.frame(sequence) {
                last = record.frame.wall.max(first);
                break;
            }
        }
        let every_s = export.every.map(|every| every.as_secs_f64());
        let plan = Self::of(first, last, session.len()?, (every_s, export.speed));
        plan.map_err(|why| {
            Failure::Usage(format!(
                "session {}, from {} to {}: {why}",
                session.header().id,
                local(first),
                local(last)
            ))
        })
    }

    fn of(
        first: DateTime<Utc>,
        last: DateTime<Utc>,
        frames: u64,
        (every_s, speed): (Option<f64>, Option<f64>),
    ) -> Result<Self, String> {
        let whole_s = 1e-6 * (last - first).num_microseconds().unwrap_or(i64::MAX) as f64;
        let between_frames = whole_s / (frames.max(2) - 1) as f64;
        let usual = (whole_s / (USUAL - 1.0)).max(between_frames);
        // a session of one frame has one picture for any interval
        let least = |interval: f64| if interval > 0.0 { interval } else { EACH_S };
        let (every_s, each_s) = match (every_s, speed) {
            (Some(every_s), Some(speed)) => (every_s, every_s / speed),
            (Some(every_s), None) => (every_s, EACH_S),
            (None, Some(speed)) => (speed * EACH_S, EACH_S),
            (None, None) => (least(usual), EACH_S),
        };
        if !(DURATIONS_S[0]..=DURATIONS_S[1]).contains(&each_s) {
            return Err(format!(
                "a picture for each {every_s} s would be shown for {each_s:.3} s; between {} and {} s are possible: change --every or \
                 --speed",
                DURATIONS_S[0], DURATIONS_S[1]
            ));
        }
        // a millionth is added, so that rounding does not lose the last frame
        let count = (whole_s / every_s + 1e-6).floor() + 1.0;
        if count > MOST as f64 {
            return Err(format!(
                "the film would have {count} pictures; at most {MOST} are possible: name a longer --every or a larger --speed"
            ));
        }
        Ok(Self {
            first,
            count: count as usize,
            every_s,
            each_s,
        })
    }

    /// The instant of a picture.
    fn at(&self, picture: usize) -> DateTime<Utc> {
        let micros = (1e6 * self.every_s * picture as f64).round() as i64;
        self.first + TimeDelta::microseconds(micros)
    }

    /// Whether a frame is too old to be shown at an instant.
    fn is_over(&self, frame: DateTime<Utc>, at: DateTime<Utc>) -> bool {
        let hold_s = HOLD_S.max(1.5 * self.every_s);
        (at - frame).as_seconds_f64() > hold_s
    }
}

/// A picture of the film.
struct Shot {
    map: Map,
    style: Style,
    shows_frame: bool,
}

/// The maps of all pictures: at each instant the map of the newest frame.
fn shots(
    plan: &Plan,
    recording: &Recording,
    pictures: &mut Pictures<'_>,
    reconstruction: &Reconstruction,
    export: &Export,
    printer: &Printer<impl Write>,
) -> Result<(Vec<Shot>, usize), Failure> {
    let bar = progress(Some(recording.len()? as u64), printer.is_terminal());
    let mut shots: Vec<Shot> = Vec::with_capacity(plan.count);
    let mut newest: Option<RecordedFrame> = None;
    let mut damaged = 0;
    let mut take = |shots: &mut Vec<Shot>,
                    frame: Option<&RecordedFrame>,
                    until: Option<DateTime<Utc>>|
     -> Result<(), Failure> {
        let due = |picture: usize| {
            picture < plan.count && until.is_none_or(|until| plan.at(picture) < until)
        };
        let shown = |frame: &&RecordedFrame| {
            let wall = frame.wall;
            due(shots.len()) && wall.is_some_and(|wall| !plan.is_over(wall, plan.at(shots.len())))
        };
        let made = match frame {
            Some(frame) if shown(&frame) => {
                Some(shot(frame, pictures, reconstruction, recording, export)?)
            }
            Some(frame) => {
                pictures.pass(frame)?;
                None
            }
            None => None,
        };
        while due(shots.len()) {
            let at = plan.at(shots.len());
            let wall = frame.and_then(|frame| frame.wall);
            shots.push(match &made {
                Some((map, style)) if wall.is_some_and(|wall| !plan.is_over(wall, at)) => Shot {
                    map: map.clone(),
                    style: style.clone(),
                    shows_frame: map.values.iter().any(|value| value.is_finite()),
                },
                _ => missing(
                    &format!("{}, {}", recording.name, local(at)),
                    "no frame at this time",
                    reconstruction,
                    recording,
                ),
            });
        }
        Ok(())
    };
    for frame in recording.frames() {
        bar.inc(1);
        let frame = match frame {
            Ok(frame) => frame,
            Err(error) => {
                bar.suspend(|| crate::maps::recording::left_out(&error));
                damaged += 1;
                continue;
            }
        };
        take(&mut shots, newest.as_ref(), frame.wall)?;
        newest = Some(frame);
    }
    take(&mut shots, newest.as_ref(), None)?;
    bar.finish_and_clear();
    Ok((shots, damaged))
}

/// The map of a frame with its style; if it cannot be made, an empty map with the reason.
fn shot(
    frame: &RecordedFrame,
    pictures: &mut Pictures<'_>,
    reconstruction: &Reconstruction,
    recording: &Recording,
    export: &Export,
) -> Result<(Map, Style), Failure> {
    let picture = match pictures.attempt(frame)? {
        Ok(picture) => picture,
        Err(why) => {
            let shot = missing(&pictures.title(frame), &why, reconstruction, recording);
            return Ok((shot.map, shot.style));
        }
    };
    let style = pictures.style(frame, &picture, export.scale)?;
    Ok((picture.shown, style))
}

/// A picture without a map.
fn missing(title: &str, why: &str, reconstruction: &Reconstruction, recording: &Recording) -> Shot {
    let values = vec![f64::NAN; reconstruction.field.sheet.triangles.len()];
    Shot {
        map: Map {
            unit: reconstruction.unit(),
            ..Map::relative(reconstruction.mesh().hash(), values, why)
        },
        style: Style {
            title: title.to_owned(),
            simulated: recording.simulated == Some(true),
            hot_spots: Some(Vec::new()),
            ..Style::default()
        },
        shows_frame: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(
        whole_s: u64,
        frames: u64,
        every_s: Option<f64>,
        speed: Option<f64>,
    ) -> Result<Plan, String> {
        let first = DateTime::from_timestamp(1_800_000_000, 0).unwrap();
        Plan::of(
            first,
            first + std::time::Duration::from_secs(whole_s),
            frames,
            (every_s, speed),
        )
    }

    #[test]
    fn a_film_has_600_pictures_or_one_for_each_frame() {
        let day = plan(86_399, 86_400, None, None).unwrap();
        assert_eq!((day.count, day.each_s), (600, EACH_S));
        assert!((day.every_s - 86_399.0 / 599.0).abs() < 1e-9);
        let short = plan(2, 3, None, None).unwrap();
        assert_eq!((short.count, short.every_s), (3, 1.0));
        assert_eq!(plan(0, 1, None, None).unwrap().count, 1);
        let named = plan(86_399, 86_400, Some(60.0), Some(1200.0)).unwrap();
        assert_eq!((named.count, named.each_s), (1440, 0.05));
        let fast = plan(86_399, 86_400, None, Some(600.0)).unwrap();
        assert_eq!((fast.count, fast.every_s), (1440, 60.0));
    }

    #[test]
    fn films_of_too_many_or_too_brief_pictures_are_refused() {
        let refusal = plan(86_399, 86_400, Some(10.0), None).unwrap_err();
        assert!(
            refusal.contains("8640 pictures") && refusal.contains("3000"),
            "{refusal}"
        );
        let refusal = plan(100, 100, Some(1.0), Some(100.0)).unwrap_err();
        assert!(refusal.contains("0.010 s"), "{refusal}");
        assert!(plan(1000, 100, Some(100.0), Some(1.0)).is_err());
    }
}
