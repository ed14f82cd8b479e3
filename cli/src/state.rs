//! Session files on disk, found and read without a daemon.

use std::path::{Path, PathBuf};

use eit::{DiscTank, PaperSheet, Preset};
use logbook::{LogbookError, Record, SessionHeader, SessionReader};
use serde::Deserialize;

use crate::args::Global;
use crate::choices::{PresetName, Prior};
use crate::eye::{Ground, case_ground, preset_ground, short};
use crate::failure::Failure;

/// The directory of session files: `--state`, `TACTUS_STATE`, `$XDG_STATE_HOME/tactus`, `~/.local/state/tactus` where it
/// exists, `/var/lib/tactus`.
pub(crate) fn directory(global: &Global) -> PathBuf {
    if let Some(directory) = &global.state {
        return directory.clone();
    }
    let set = |name: &str| {
        std::env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    if let Some(directory) = set("TACTUS_STATE") {
        return directory;
    }
    if let Some(directory) = set("XDG_STATE_HOME") {
        return directory.join("tactus");
    }
    set("HOME")
        .map(|home| home.join(".local/state/tactus"))
        .filter(|directory| directory.is_dir())
        .unwrap_or_else(|| PathBuf::from("/var/lib/tactus"))
}

/// The file of a session: a path as it is, else the id (or its beginning) in the state directory.
pub(crate) fn session_file(global: &Global, named: &str) -> Result<PathBuf, Failure> {
    let path = Path::new(named);
    if path.is_file() {
        return Ok(path.to_owned());
    }
    logbook::find(directory(global), named).map_err(|error| refused(&error))
}

/// Opens a session file.
pub(crate) fn open(path: &Path) -> Result<SessionReader, Failure> {
    SessionReader::open(path).map_err(|error| refused(&error))
}

/// All frames of a session that can be read; the others are named on the error stream and counted.
pub(crate) fn frames(session: &SessionReader) -> (Vec<Record>, usize) {
    let mut readable = Vec::new();
    let mut damaged = 0;
    for record in session.frames() {
        match record {
            Ok(record) => readable.push(record),
            Err(error) => {
                eprintln!(
                    "tactus: a frame is left out: {}",
                    crate::failure::chain(&error)
                );
                damaged += 1;
            }
        }
    }
    (readable, damaged)
}

/// What the logbook's refusal means here.
pub(crate) fn refused(error: &LogbookError) -> Failure {
    let text = crate::failure::chain(error);
    match error {
        LogbookError::NoSuchSession { .. } => Failure::Missing(format!(
            "{text}; --state DIR names another directory of session files"
        )),
        LogbookError::Ambiguous { .. } => Failure::Usage(text),
        LogbookError::BadId { .. } => Failure::Usage(text),
        LogbookError::NotASession { .. } | LogbookError::NewerSchema { .. } => {
            Failure::Configuration(text)
        }
        _ => Failure::Failed(text),
    }
}

/// The part of a daemon's configuration that says how maps are made; the daemon has checked it, so unknown keys are
/// none of our business.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(crate) struct Kept {
    geometry: KeptGeometry,
    pub(crate) model: KeptModel,
    pub(crate) survey: KeptSurvey,
}

#[derive(Debug, Deserialize)]
#[serde(default)]
pub(crate) struct KeptSurvey {
    pub(crate) current_ua: f64,
}

impl Default for KeptSurvey {
    /// The daemon's own default.
    fn default() -> Self {
        Self { current_ua: 1000.0 }
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "kebab-case")]
struct KeptGeometry {
    preset: Option<PresetName>,
    case: Option<PathBuf>,
    paper_sheet: Option<PaperSheet>,
    disc_tank: Option<DiscTank>,
}

/// How the daemon made the session's maps.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(crate) struct KeptModel {
    pub(crate) file: Option<PathBuf>,
    pub(crate) prior: Option<Prior>,
    pub(crate) exponent: Option<f64>,
    pub(crate) noise_uv: Option<f64>,
    pub(crate) lambda: Option<f64>,
    pub(crate) loss_only: Option<bool>,
}

/// The effective configuration kept in a session.
///
/// # Errors
/// Text that is no configuration of a daemon.
pub(crate) fn kept(header: &SessionHeader) -> Result<Kept, Failure> {
    toml::from_str(&header.config_toml).map_err(|error| {
        Failure::configuration(
            &format!(
                "the configuration kept in session {} cannot be read; {NAME_IT}",
                header.id
            ),
            &error,
        )
    })
}

const NAME_IT: &str =
    "say --preset paper-sheet or disc-tank, --case DIR with a mesh, or --model FILE";

/// The geometry of a session, from the configuration kept in it, verified by the hash kept beside it.
///
/// # Errors
/// The geometry that is named is not the one that was used.
pub(crate) fn ground(header: &SessionHeader) -> Result<Ground, Failure> {
    let named = kept(header)?.geometry;
    let mut ground = match (named.case, named.preset) {
        (Some(case), _) => case_ground(&case)?,
        (None, Some(PresetName::DiscTank)) => {
            preset_ground(&Preset::DiscTank(named.disc_tank.unwrap_or_else(|| {
                DiscTank {
                    electrodes: header.protocol.electrodes(),
                    ..DiscTank::default()
                }
            })))?
        }
        (None, Some(PresetName::PaperSheet) | None) => {
            preset_ground(&Preset::PaperSheet(named.paper_sheet.unwrap_or_default()))?
        }
    };
    // As the daemon takes it where a case folder does not say.
    let triangles = ground.mesh.triangles().len();
    ground.sigma.get_or_insert_with(|| vec![1e-3; triangles]);
    match &header.geometry_hash {
        Some(hash) if hash != ground.mesh.hash() => Err(Failure::Configuration(format!(
            "session {} was recorded on geometry {}, its configuration gives {} here; {NAME_IT}",
            header.id,
            short(hash),
            short(ground.mesh.hash()),
        ))),
        _ => Ok(ground),
    }
}
