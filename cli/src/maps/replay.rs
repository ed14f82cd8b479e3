//! `tactus replay`: reconstructs a recording offline, frame by frame, with the daemon's mathematics.

use std::borrow::Cow;
use std::cell::Cell;
use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};

use eit::Mesh;
use imaging::recorded::{
    DeviationSummary, FRAMES_HEADING, MapCompanions, MapLine, MapOfRow, MapRow, RecordedFrame,
    Recording, WithoutMap, maps_heading, triangles_text,
};
use outfile::{Existing, OutFile};
use serde::Serialize;
use survey::Map;

use crate::args::{Global, Replay};
use crate::failure::Failure;
use crate::maps::drawing;
use crate::maps::frame_maps::FrameMaps;
use crate::maps::reconstruction::Reconstruction;
use crate::maps::recording::{self, Thinning};
use crate::output::Printer;
use crate::output::progress::progress;
use crate::output::time::utc;

/// One line of `replay --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct ReplayLine<'a> {
    #[serde(flatten)]
    map: MapLine<'a>,
    wall: Option<String>,
    map_hash: Option<String>,
    /// Whether the map has the bits of the recorded one; `None` if none was recorded.
    verified: Option<bool>,
    simulated: Option<bool>,
    png: Option<String>,
}

/// Reconstructs each frame of the recording; prints, draws and writes the requested outputs.
pub(crate) fn run(
    global: &Global,
    replay: &Replay,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let thinning = Thinning {
        every: replay.every,
        count: replay.count,
    };
    let recording = recording::open(global, &replay.from, replay.asked.geometry.electrodes)?;
    let count = recording::count(&recording, &replay.from, thinning)?;
    let damaged = Cell::new(0);
    let frames = recording::frames(&recording, &replay.from, thinning, &damaged)?;
    let reconstruction = Reconstruction::new(&replay.asked, &recording)?;
    let mut maps = FrameMaps::new(&reconstruction, &replay.asked.tracked, &recording)?
        .with_deviation(replay.sd);
    introduce(&recording, count, &reconstruction, printer)?;
    let existing = replay.replacing.existing();
    if let Some(directory) = &replay.png {
        outfile::make_folder(directory, existing)?;
    }
    let mesh = reconstruction.mesh();
    let areas = mesh.region_areas();
    let mut tables = match &replay.out {
        Some(path) => Some(MapTables::create(path, mesh, existing, replay.sd)?),
        None => None,
    };
    let progress = progress(count.map(|count| count as u64), printer.is_terminal());
    let draw = printer.is_terminal() && !replay.no_map;
    let mut summary = VerifySummary::default();
    let mut without = WithoutMap::default();
    for (recorded, asked) in frames {
        if !asked {
            maps.pass(&recorded)?;
            continue;
        }
        let made = maps.attempt(&recorded)?;
        let known = made.as_ref().ok();
        let deviation = known.and_then(|made| made.deviation.as_deref());
        let row = MapRow {
            frame: recorded.sequence,
            label: &recorded.label,
            time: recorded.wall,
            tracked: known.and_then(|made| made.tracked.as_ref()),
            map: match &made {
                Ok(made) => Ok(MapOfRow {
                    map: &made.map,
                    found: reconstruction.field.found(&made.map, reconstruction.noise),
                    noise: reconstruction.noise,
                    pressure: made.pressure.as_ref(),
                    deviation: deviation.map(|values| DeviationSummary::of(values, &areas)),
                }),
                Err(why) => Err(why.as_str()),
            },
        };
        without.take(&row);
        summary.take(&recorded, known.map(|made| &made.map));
        if let Some(tables) = &mut tables {
            tables.put(&row, deviation)?;
        }
        let drawn = row.map.ok().map(|found| (found, found.shown()));
        let style = |(found, shown): &(MapOfRow<'_>, Cow<'_, Map>)| {
            drawing::style(
                drawing::title(format!("frame {}", recorded.label), row.tracked),
                (replay.scale, shown.unit),
                recording.simulated == Some(true),
                found.found,
                found.map,
                found.noise,
            )
        };
        let png = match (&replay.png, &drawn) {
            (Some(directory), Some(drawn)) => {
                let path = directory.join(format!("frame-{:06}.png", recorded.sequence));
                let png = drawing::png(&reconstruction.field, &drawn.1, &style(drawn)?)?;
                outfile::write(&path, existing, &png)?;
                Some(path.display().to_string())
            }
            _ => None,
        };
        let map_hash = known.map(|made| made.map.hash());
        let line = ReplayLine {
            map: row.line(),
            wall: recorded.wall.map(utc),
            verified: recorded.map.as_ref().map(|kept| {
                let same = map_hash.as_ref().map(|hash| kept.is_of(hash));
                same.unwrap_or(false)
            }),
            map_hash,
            simulated: recording.simulated,
            png,
        };
        progress.suspend(|| -> Result<(), Failure> {
            printer.record(&line, sentence)?;
            if let Some(drawn) = drawn.as_ref().filter(|_| draw) {
                let style = drawing::terminal_style(printer, style(drawn)?);
                printer.drawn(&drawing::terminal(&reconstruction.field, &drawn.1, &style)?)?;
            }
            Ok(())
        })?;
        progress.inc(1);
    }
    progress.finish_and_clear();
    if let Some(tables) = tables.filter(|_| !without.is_all()) {
        let path = tables.finish()?;
        printer.text(&format!("maps: {}", path.display()))?;
    }
    if replay.verify {
        printer.record(&summary, VerifySummary::sentence)?;
        summary.result(&recording.name)?;
    }
    match without.text() {
        Some(text) => Err(Failure::Failed(text)),
        None => recording::check_undamaged(damaged.get(), &recording.name),
    }
}

/// Largest relative distance of a map from one recorded by another build or processor: far above the effect of rounding
/// in the readings (1e-13), and a hundredth of the effect of 2 uV. The test of the tolerance prints both.
const TOLERANCE: f64 = 1e-4;

/// The last line of `replay --verify`; see `docs/reference/json.md`.
#[derive(Debug, Default, Serialize)]
struct VerifySummary {
    /// Number of maps with the recorded bits.
    same: u64,
    /// Frames whose map differs although it was made by this build on this processor, or is farther away than
    /// [`TOLERANCE`].
    different: Vec<u64>,
    /// Number of maps of another build or processor within [`TOLERANCE`].
    near: u64,
    /// The largest such distance, relative.
    furthest: Option<f64>,
    /// Frames whose map differs and was made by another build or on another processor, which recorded its hash only.
    elsewhere: Vec<u64>,
    /// The first of those builds and processors.
    made_by: Option<String>,
    /// Number of frames without a recorded map.
    without: u64,
}

impl VerifySummary {
    fn take(&mut self, recorded: &RecordedFrame, map: Option<&Map>) {
        let Some(kept) = &recorded.map else {
            self.without += 1;
            return;
        };
        let Some(map) = map else {
            self.different.push(recorded.sequence);
            return;
        };
        let version = kept.build.split_whitespace().last();
        if kept.is_of(&map.hash()) {
            self.same += 1;
            return;
        }
        if version == Some(env!("CARGO_PKG_VERSION")) && kept.cpu == eit::cpu_features() {
            self.different.push(recorded.sequence);
            return;
        }
        self.made_by
            .get_or_insert_with(|| format!("{} on {}", kept.build, kept.cpu));
        match kept.distance(map) {
            Some(distance) if distance <= TOLERANCE => {
                self.near += 1;
                self.furthest = Some(self.furthest.unwrap_or(0.0).max(distance));
            }
            Some(_) => self.different.push(recorded.sequence),
            None => self.elsewhere.push(recorded.sequence),
        }
    }

    fn sentence(&self) -> String {
        let mut text = format!("{} maps are identical to the recorded ones", self.same);
        if let Some(furthest) = self.furthest {
            text.push_str(&format!(
                ", {} of another build or processor are within {furthest:.1e} of them (allowed: {TOLERANCE:e})",
                self.near
            ));
        }
        if !self.different.is_empty() {
            text.push_str(&format!(", {} differ", self.different.len()));
        }
        if !self.elsewhere.is_empty() {
            text.push_str(&format!(
                ", {} by another build or processor differ and cannot be verified: only their hashes were recorded",
                self.elsewhere.len()
            ));
        }
        if let Some(made_by) = &self.made_by {
            text.push_str(&format!("; the other build: {made_by}"));
        }
        if self.without > 0 {
            text.push_str(&format!(", {} frames have no recorded map", self.without));
        }
        text
    }

    fn result(&self, session: &str) -> Result<(), Failure> {
        let Some(first) = self.different.first() else {
            if self.same == 0 && self.near == 0 && self.elsewhere.is_empty() {
                return Err(Failure::Failed(format!(
                    "{session} has no recorded map checksum: there is nothing to verify"
                )));
            }
            return Ok(());
        };
        let listed: Vec<String> = self
            .different
            .iter()
            .take(20)
            .map(ToString::to_string)
            .collect();
        Err(Failure::Failed(format!(
            "{} of {session}'s maps differ from the recorded ones, from frame {first} on: {}{}",
            self.different.len(),
            listed.join(", "),
            if self.different.len() > listed.len() {
                ", ..."
            } else {
                ""
            }
        )))
    }
}

fn introduce(
    recording: &Recording,
    count: Option<usize>,
    reconstruction: &Reconstruction,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let count = match count {
        Some(count) => count.to_string(),
        None => format!("some of {}", recording.len()?),
    };
    printer.text(&format!(
        "{count} frames of {} readings, {} electrodes; baseline: {}; {} on {} triangles{}",
        recording.protocol.len(),
        recording.protocol.electrodes(),
        recording.baseline_name,
        reconstruction.method(),
        reconstruction.field.sheet.triangles.len(),
        if recording.simulated == Some(true) {
            "; SIMULATED"
        } else {
            ""
        },
    ))?;
    for remark in &reconstruction.remarks {
        printer.text(remark)?;
    }
    Ok(())
}

fn sentence(line: &ReplayLine<'_>) -> String {
    let (map, verified) = (&line.map, line.verified);
    let mut text = format!("frame {}", map.frame);
    if map.label.parse::<u64>().is_err() {
        let _ = write!(text, " ({})", map.label);
    }
    if let Some(why) = map.no_map {
        return format!("{text}: no map: {why}");
    }
    text.push_str(&match (map.significant, map.noise) {
        (Some(false), Some(noise)) => format!(": {}", render::nothing_above(noise)),
        _ => format!(
            ": found {}, {}",
            drawing::place(map.found_mm),
            drawing::map_summary(
                map.largest_loss.unwrap_or_default(),
                map.newtons.zip(map.largest_kpa),
                None
            ),
        ),
    });
    if let Some(masked) = map.masked.filter(|masked| *masked > 0) {
        let _ = write!(text, ", {masked} readings left out");
    }
    if let Some(quality) = map.quality.filter(|quality| !quality.is_silent()) {
        text.push_str(&format!(", {quality}"));
    }
    if let Some(tracked) = map.tracked {
        let _ = write!(text, "; {tracked}");
    }
    match verified {
        Some(true) => text.push_str(", identical to the recorded map"),
        Some(false) => {
            text.push_str(", differs from the recorded map (other method, build or processor)")
        }
        None => {}
    }
    text
}

/// The table of maps and its companion tables.
struct MapTables {
    path: PathBuf,
    maps: OutFile,
    frames: Option<OutFile>,
    elements: Option<OutFile>,
    deviations: Option<OutFile>,
    /// Companions of earlier maps that these do not have, removed when these are complete.
    outdated: Option<(PathBuf, Existing)>,
    /// Columns of the maps.
    triangles: usize,
}

/// A line in a table of maps.
fn line(frame: u64, values: &[f64]) -> String {
    let mut line = format!("f{frame}");
    for value in values {
        let _infallible = match value.is_nan() {
            true => write!(line, ",nan"),
            false => write!(line, ",{value}"),
        };
    }
    line.push('\n');
    line
}

impl MapTables {
    fn create(path: &Path, mesh: &Mesh, existing: Existing, sd: bool) -> Result<Self, Failure> {
        if sd && outfile::is_stream(path) {
            let text = "--sd writes a file next to the maps; --out must be a file";
            return Err(Failure::Usage(text.to_owned()));
        }
        let mut maps = OutFile::create(path, existing)?;
        maps.put(maps_heading(mesh).as_bytes())?;
        // no companion file can be written next to a device or a pipe
        let (mut frames, mut elements, mut deviations) = (None, None, None);
        let mut outdated = None;
        if !outfile::is_stream(path) {
            let beside = MapCompanions::of(path);
            let mut table = OutFile::create(&beside.frames, existing)?;
            table.put(FRAMES_HEADING.as_bytes())?;
            frames = Some(table);
            let mut table = OutFile::create(&beside.triangles, existing)?;
            table.put(triangles_text(mesh).as_bytes())?;
            elements = Some(table);
            if sd {
                let mut table = OutFile::create(&beside.deviations, existing)?;
                table.put(maps_heading(mesh).as_bytes())?;
                deviations = Some(table);
            } else {
                outfile::check(&beside.deviations, existing)?;
                outdated = Some((beside.deviations, existing));
            }
        }
        Ok(Self {
            path: path.to_owned(),
            maps,
            frames,
            elements,
            deviations,
            outdated,
            triangles: mesh.region().len(),
        })
    }

    fn put(&mut self, row: &MapRow<'_>, deviation: Option<&[f64]>) -> Result<(), Failure> {
        let maps = line(row.frame, &row.values(self.triangles));
        self.maps.put(maps.as_bytes())?;
        if let Some(table) = &mut self.deviations {
            let unknown = || vec![f64::NAN; self.triangles];
            let deviation = deviation.map_or_else(unknown, <[f64]>::to_vec);
            table.put(line(row.frame, &deviation).as_bytes())?;
        }
        if let Some(frames) = &mut self.frames {
            frames.put(row.text().as_bytes())?;
        }
        Ok(())
    }

    fn finish(self) -> Result<PathBuf, Failure> {
        let companions = [self.frames, self.elements, self.deviations];
        let mut tables = vec![self.maps];
        tables.extend(companions.into_iter().flatten());
        outfile::finish_all(tables)?;
        if let Some((path, existing)) = self.outdated {
            outfile::remove(&path, existing)?;
        }
        Ok(self.path)
    }
}

#[cfg(test)]
mod tests {
    use eit::DiscTank;

    use super::*;

    #[test]
    fn companions_are_kept_where_the_maps_are_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("maps.csv");
        let beside = MapCompanions::of(&path);
        let companions = [&beside.frames, &beside.triangles, &beside.deviations];
        let earlier = "of earlier maps";
        for companion in companions {
            std::fs::write(companion, earlier).unwrap();
        }
        let mesh = DiscTank::default().mesh().unwrap();
        let create = || MapTables::create(&path, &mesh, Existing::Replace, false).unwrap();
        let tables = create();
        std::fs::create_dir(&path).unwrap();
        assert!(tables.finish().is_err());
        for companion in companions {
            assert_eq!(std::fs::read_to_string(companion).unwrap(), earlier);
        }
        std::fs::remove_dir(&path).unwrap();
        assert_eq!(create().finish().unwrap(), path);
        assert!(path.exists() && !beside.deviations.exists());
        for companion in [&beside.frames, &beside.triangles] {
            assert_ne!(std::fs::read_to_string(companion).unwrap(), earlier);
        }
    }
}
