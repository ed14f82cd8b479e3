//! Maps over months (`tactus-lab months`): location of presses while the sheet drifts, with the baseline of day 0 and
//! with a tracked baseline.
//!
//! All frames are simulated on the phantom's finer mesh, with 2 uV of noise on baseline and frame. The methods are
//! given the nominal sheet and the noise, and the kinds of drift of [`drift::Sizes`], but not their sizes.

pub(crate) mod course;
mod loads;
mod maps;
mod simulated;
mod single;
mod tracked;

use std::path::Path;

use outfile::Existing;

use crate::{Failure, sheet, tagged, write_tables};

pub use loads::LoadRow;
pub use maps::{LoadKind, MapRow, MapSettings};
pub use simulated::Family;
pub(crate) use simulated::{CURRENT_A, Simulated, away_mm, model};
pub(crate) use single::shipped;
pub use single::{Locator, SheetRow, SingleRow};
pub use tracked::{FrameRow, LongScene, PressRow};

/// Extent of the study.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Seed of sheets, positions and noise.
    pub seed: u64,
    /// Kinds of drift of the single frames.
    pub families: Vec<Family>,
    /// Number of sheets of each kind.
    pub sheets: usize,
    /// Number of presses of each diameter on each of eight days.
    pub presses: usize,
    /// Scenes with a tracked baseline.
    pub scenes: Vec<LongScene>,
    /// Days of the scenes, with a frame every ten minutes.
    pub days: f64,
    /// Maps of single frames, with and without removal of drift.
    pub maps: MapSettings,
    /// Days of the run of nights in the test of loads that remain for days or rise slowly; 0 to skip this test.
    pub load_days: f64,
}

/// The results.
#[derive(Debug)]
pub struct Report {
    /// Presses in single frames.
    pub single: Vec<SingleRow>,
    /// The sheets of the single frames.
    pub sheets: Vec<SheetRow>,
    /// Presses with a tracked baseline.
    pub presses: Vec<PressRow>,
    /// Frames without presses, with a tracked baseline.
    pub frames: Vec<FrameRow>,
    /// Maps of single frames.
    pub maps: Vec<MapRow>,
    /// Loads that remain for days or rise slowly.
    pub loads: Vec<LoadRow>,
}

/// Runs the study.
///
/// # Errors
/// A sheet that cannot be computed.
pub fn run(settings: &Settings) -> Result<Report, Failure> {
    let geometry = sheet::geometry()?;
    let (single, sheets) = match settings.sheets.min(settings.presses) {
        0 => Default::default(),
        _ => single::rows(settings, &geometry)?,
    };
    let maps = match settings.maps.loads {
        0 => Vec::new(),
        _ => maps::rows(settings, &geometry)?,
    };
    let (presses, frames) = tracked::rows(settings, &geometry)?;
    let loads = match settings.load_days > 0.0 {
        true => loads::rows(settings.seed, settings.load_days, &geometry)?,
        false => Vec::new(),
    };
    Ok(Report {
        maps,
        loads,
        single,
        sheets,
        presses,
        frames,
    })
}

impl Report {
    /// The tables as text.
    pub fn text(&self) -> String {
        let mut text = String::new();
        if !self.single.is_empty() {
            text += &single::text(&self.single, &self.sheets);
            text.push('\n');
        }
        if !self.maps.is_empty() {
            text += &maps::text(&self.maps);
            text.push('\n');
        }
        if !self.frames.is_empty() {
            text += &tracked::text(&self.presses, &self.frames);
        }
        if !self.loads.is_empty() {
            text.push('\n');
            text += &loads::text(&self.loads);
        }
        text
    }

    /// The tables as JSON, one object per row.
    pub fn lines(&self) -> Vec<serde_json::Value> {
        tagged("single", &self.single)
            .chain(tagged("sheets", &self.sheets))
            .chain(tagged("maps", &self.maps))
            .chain(tagged("presses", &self.presses))
            .chain(tagged("frames", &self.frames))
            .chain(tagged("loads", &self.loads))
            .collect()
    }

    /// Writes `months.txt` and `months.json`.
    ///
    /// # Errors
    /// Files that exist and may not be replaced, or that cannot be written.
    pub fn write(&self, folder: &Path, existing: Existing) -> Result<(), Failure> {
        write_tables(folder, "months", existing, self.text(), self.lines())
    }
}
