//! Tests of the quality verdicts of maps (`tactus-lab honesty`): healthy frames must be judged sound, and faults must
//! be detected and named. In addition maps of many kinds of load are compared with the truth.
//!
//! All frames are simulated on a finer mesh than the model's, with noise on baseline and frame.

mod maps;
mod quality;
mod sheet;
mod target;

use std::path::Path;

use outfile::Existing;

use crate::sheet::{geometry, protocol};
use crate::{Failure, tagged, write_tables};

pub use maps::{MapMethod, MapRow, Stated};
pub use quality::QualityRow;
pub use sheet::FineSheet;
pub use target::TargetKind;

/// Extent of the study.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Seed of loads and noise.
    pub seed: u64,
    /// Number of healthy frames at each noise.
    pub healthy: usize,
    /// Number of frames of each fault at each noise.
    pub faulty: usize,
    /// Noises of a reading, uV.
    pub noises_uv: Vec<f64>,
    /// Maps that are compared with the truth; `None` for the quality check alone.
    pub maps: Option<MapSettings>,
}

/// Which maps are compared with the truth.
#[derive(Debug, Clone)]
pub struct MapSettings {
    /// Number of frames of each kind of load at each noise.
    pub count: usize,
    /// Kinds of load.
    pub kinds: Vec<TargetKind>,
    /// The methods.
    pub methods: Vec<MapMethod>,
    /// Whether methods are also run without a stated noise, and with a hyper-parameter derived from the noise alone.
    pub unstated: bool,
}

/// The results.
#[derive(Debug)]
pub struct Report {
    /// The quality check.
    pub quality: Vec<QualityRow>,
    /// Maps compared with the truth.
    pub maps: Vec<MapRow>,
}

/// Runs the study.
///
/// # Errors
/// A sheet that cannot be computed.
pub fn run(settings: &Settings) -> Result<Report, Failure> {
    let protocol = protocol(26)?;
    let sheet = FineSheet::new(&protocol)?;
    let geometry = geometry()?;
    Ok(Report {
        quality: match settings.healthy + settings.faulty {
            0 => Vec::new(),
            _ => quality::rows(settings, &sheet, &geometry)?,
        },
        maps: match &settings.maps {
            Some(maps) => maps::rows(settings, maps, &sheet, &geometry)?,
            None => Vec::new(),
        },
    })
}

impl Report {
    /// The tables as text.
    pub fn text(&self) -> String {
        let mut text = String::from(
            "frames                                 noise uV  frames not sound unreliable   named  reasons\n",
        );
        for row in &self.quality {
            let share = |count: usize| 100.0 * count as f64 / row.frames as f64;
            let reasons: Vec<String> = row
                .reasons
                .iter()
                .map(|(kind, count)| format!("{kind} {count}"))
                .collect();
            text += &format!(
                "{:<38} {:>8} {:>7} {:>7.2} % {:>8.2} % {:>7}  {}\n",
                row.what,
                row.noise_uv,
                row.frames,
                share(row.not_sound),
                share(row.unreliable),
                row.named
                    .map_or("-".to_owned(), |named| format!("{:.1} %", share(named))),
                reasons.join(", ")
            );
        }
        if !self.maps.is_empty() {
            text += &format!("\n{}", maps::text(&self.maps));
        }
        text
    }

    /// The tables as JSON, one object per row.
    pub fn lines(&self) -> Vec<serde_json::Value> {
        tagged("quality", &self.quality)
            .chain(tagged("maps", &self.maps))
            .collect()
    }

    /// Writes `honesty.txt` and `honesty.json`.
    ///
    /// # Errors
    /// Files that exist and may not be replaced, or that cannot be written.
    pub fn write(&self, folder: &Path, existing: Existing) -> Result<(), Failure> {
        write_tables(folder, "honesty", existing, self.text(), self.lines())
    }
}
