//! Frames, baseline and provenance in a case folder.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::readings::{BaselineRule, LabelledReadings, first, mean, read_frames};
use super::{RecordedError, Unloaded};

/// Default file of frames in a case folder.
pub const FRAMES: &str = "frames.csv";
/// Default file of the baseline in a case folder.
pub const BASELINE: &str = "baseline.csv";
/// File with the origin of the frames in a case folder.
pub const PROVENANCE: &str = "provenance.toml";

/// Origin of the frames in a case folder: the file [`PROVENANCE`], written by `tactus export`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Id of the session.
    pub session: String,
    /// Start of the session, RFC 3339, UTC.
    pub started: String,
    /// Whether the voltages are simulated.
    pub simulated: bool,
    /// Name and version of the program that recorded the session.
    pub build: String,
    /// Id of the session's baseline.
    pub baseline: Option<String>,
    /// Number of frames averaged for the baseline.
    pub baseline_frames: Option<usize>,
    /// Standard deviation of one reading over the frames of the baseline, V.
    pub noise_v: Option<f64>,
    /// SHA-256 of the mesh of the session's maps.
    pub geometry_hash: Option<String>,
    /// SHA-256 of the session's configuration.
    pub config_hash: String,
    /// Note of the session.
    pub note: String,
    /// Instruments: role, identity, address.
    pub instruments: Vec<[String; 3]>,
    /// The session's descriptions of sheet, foam, ink, operator, wiring and calibration.
    pub about: std::collections::BTreeMap<String, String>,
}

impl Provenance {
    /// Reads the file in a folder; `None` if it does not exist.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn of(folder: &Path) -> Result<Option<Self>, RecordedError> {
        let path = folder.join(PROVENANCE);
        let refused = |why: String| RecordedError::Provenance {
            path: path.clone(),
            why,
        };
        match std::fs::read_to_string(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(refused(error.to_string())),
            Ok(text) => toml::from_str(&text)
                .map(Some)
                .map_err(|error| refused(error.message().to_owned())),
        }
    }

    /// The text of the file.
    ///
    /// # Errors
    /// A value that TOML cannot represent.
    pub fn text(&self) -> Result<String, toml::ser::Error> {
        toml::to_string_pretty(self)
    }
}

/// Which frames of a case folder to read, and their baseline.
#[derive(Debug, Clone, Copy, Default)]
pub struct TableOptions<'a> {
    /// The table; a name without a folder is searched in the case folder first. Default: [`FRAMES`] of the folder.
    pub frames: Option<&'a Path>,
    /// The baseline. Default: [`BASELINE`] of the folder, otherwise the first frame.
    pub baseline: Option<&'a BaselineRule>,
    /// Inverts every sign, for instruments that give magnitudes.
    pub negate: bool,
}

/// A table of frames with its baseline.
#[derive(Debug, Clone)]
pub struct FrameTable {
    /// Every frame of the table, including those of the baseline.
    pub frames: Vec<LabelledReadings>,
    /// Frame numbers: those of the session if all labels are `f` and a number, ascending; otherwise the row numbers,
    /// from 1.
    pub numbers: Vec<u64>,
    /// The baseline.
    pub unloaded: Unloaded,
    /// Description of the frames averaged for the baseline.
    pub baseline_name: String,
    /// The origin of the frames, if they are in the folder's default table and the folder has a provenance file.
    pub provenance: Option<Provenance>,
}

impl FrameTable {
    /// Reads frames with the given number of readings from a case folder.
    ///
    /// # Errors
    /// A missing or unreadable file, or more baseline frames than there are.
    pub fn read(
        folder: &Path,
        options: &TableOptions<'_>,
        readings: usize,
    ) -> Result<Self, RecordedError> {
        let path = match options.frames {
            Some(file) => within(folder, file)?,
            None => Some(folder.join(FRAMES))
                .filter(|path| path.exists())
                .ok_or_else(|| RecordedError::NoFrames(folder.to_owned()))?,
        };
        let own_baseline = folder.join(BASELINE);
        let rule = match options.baseline {
            Some(rule) => rule.clone(),
            None if own_baseline.exists() => BaselineRule::File(own_baseline.clone()),
            None => BaselineRule::First(1),
        };
        let frames = read_frames(&path, readings, options.negate)?;
        let provenance = match path == folder.join(FRAMES) {
            true => Provenance::of(folder)?,
            false => None,
        };
        let unloaded = match &rule {
            BaselineRule::First(count) => first(&frames, *count)?,
            BaselineRule::File(file) => {
                let file = within(folder, file)?;
                let mut unloaded = mean(&read_frames(&file, readings, options.negate)?);
                if file == own_baseline {
                    let recorded = provenance.as_ref().and_then(|from| from.noise_v);
                    unloaded.noise = unloaded.noise.or(recorded);
                }
                unloaded
            }
        };
        Ok(Self {
            numbers: numbers(&frames),
            frames,
            unloaded,
            baseline_name: rule.to_string(),
            provenance,
        })
    }
}

fn numbers(frames: &[LabelledReadings]) -> Vec<u64> {
    let recorded: Option<Vec<u64>> = frames
        .iter()
        .map(|(label, _)| label.strip_prefix('f')?.parse().ok())
        .collect();
    recorded
        .filter(|numbers| numbers.windows(2).all(|pair| pair[0] < pair[1]))
        .unwrap_or_else(|| (1..=frames.len() as u64).collect())
}

/// Resolves the path of a file. A name without a folder is searched in the case folder, then in the current directory;
/// any other path is tried as given, then relative to the case folder.
fn within(folder: &Path, file: &Path) -> Result<PathBuf, RecordedError> {
    let inside = folder.join(file);
    let bare = file.parent() == Some(Path::new(""));
    let places = if bare {
        [inside, file.to_owned()]
    } else {
        [file.to_owned(), inside]
    };
    places
        .into_iter()
        .find(|place| place.exists())
        .ok_or_else(|| RecordedError::Missing {
            file: file.to_owned(),
            folder: folder.to_owned(),
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bare_name_is_looked_for_in_the_folder_first() {
        let folder = tempfile::tempdir().unwrap();
        let named = Path::new("Cargo.toml");
        // the tests run in a directory with a file of this name
        assert_eq!(within(folder.path(), named).unwrap(), named);
        let inside = folder.path().join(named);
        std::fs::write(&inside, "").unwrap();
        assert_eq!(within(folder.path(), named).unwrap(), inside);
        let error = within(folder.path(), Path::new("no.csv")).unwrap_err();
        assert!(matches!(error, RecordedError::Missing { .. }));
    }

    #[test]
    fn frames_and_baseline_of_the_folder_are_the_default() {
        let folder = tempfile::tempdir().unwrap();
        let read = |options: &TableOptions<'_>| FrameTable::read(folder.path(), options, 2);
        let error = read(&TableOptions::default()).unwrap_err().to_string();
        assert!(error.contains("--frames"), "{error}");
        std::fs::write(folder.path().join(FRAMES), "frame,m0,m1\nf7,1,2\nf9,3,4\n").unwrap();
        let table = read(&TableOptions::default()).unwrap();
        assert_eq!(table.numbers, [7, 9]);
        assert_eq!(table.unloaded.readings, table.frames[0].1);
        std::fs::write(folder.path().join(BASELINE), "frame,m0,m1\nbaseline,5,6\n").unwrap();
        let table = read(&TableOptions::default()).unwrap();
        assert_eq!(table.unloaded.readings[1].volts().unwrap().0, 6.0);
        let rule = BaselineRule::First(2);
        let first = read(&TableOptions {
            baseline: Some(&rule),
            ..TableOptions::default()
        });
        assert_eq!(first.unwrap().unloaded.readings[1].volts().unwrap().0, 3.0);
    }

    #[test]
    fn rows_without_numbers_of_a_session_count_from_one() {
        for labels in [["0", "1"], ["f2", "f2"], ["f1", "ball"]] {
            let frames = labels.map(|label| (label.to_owned(), Vec::new()));
            assert_eq!(numbers(&frames), [1, 2], "{labels:?}");
        }
    }
}
