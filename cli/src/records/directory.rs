//! Session files on disk, found and read without a daemon.

use std::path::{Path, PathBuf};
use std::time::Duration;

use eit::{DiscTank, PaperSheet, Preset};
use logbook::{LogbookError, SessionHeader, SessionReader};
use serde::Deserialize;

use crate::args::Global;
use crate::failure::Failure;
use crate::maps::reconstruction::{Ground, case_ground, preset_ground, short};
use crate::options::choices::{Method, PresetName, Prior};

/// A running daemon that has not said within this where it records is passed over.
const DAEMON_SAYS_WITHIN: Duration = Duration::from_secs(2);

/// Where session files are looked for: `--state` or `TACTUS_STATE` alone where one is given; else the directory of the
/// running daemon, `$XDG_STATE_HOME/tactus`, `~/.local/state/tactus`, `/var/lib/tactus`.
///
/// # Errors
/// A `--bus` that is no address.
pub(crate) fn directories(global: &Global) -> Result<Vec<PathBuf>, Failure> {
    if let Some(directory) = &global.state {
        return Ok(vec![directory.clone()]);
    }
    let set = |name: &str| {
        std::env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    if let Some(directory) = set("TACTUS_STATE") {
        return Ok(vec![directory]);
    }
    let usual = [
        set("XDG_STATE_HOME").map(|state| state.join("tactus")),
        set("HOME").map(|home| home.join(".local/state/tactus")),
        Some(PathBuf::from("/var/lib/tactus")),
    ];
    let mut places: Vec<PathBuf> = Vec::new();
    for place in [daemon_directory(global)?].into_iter().chain(usual) {
        places.extend(place.filter(|place| !places.contains(place)));
    }
    Ok(places)
}

/// Where a running daemon records; `None` where none answers.
fn daemon_directory(global: &Global) -> Result<Option<PathBuf>, Failure> {
    let Ok(runtime) = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
    else {
        return Ok(None);
    };
    let hurried = Global {
        timeout: global.timeout.min(DAEMON_SAYS_WITHIN),
        ..global.clone()
    };
    let said = runtime.block_on(async {
        let daemon = crate::control::connection::open(&hurried).await?;
        daemon
            .ask("the record", daemon.manager.record_directory())
            .await
    });
    match said {
        Ok(directory) => Ok(Some(PathBuf::from(directory))),
        Err(Failure::Usage(wrong)) => Err(Failure::Usage(wrong)),
        Err(_) => Ok(None),
    }
}

/// Places as a person reads them.
pub(crate) fn listed(places: &[PathBuf]) -> String {
    let places: Vec<String> = places
        .iter()
        .map(|place| place.display().to_string())
        .collect();
    places.join(", ")
}

/// The file of a session: a path as it is, else the id (or its beginning) in the first of [`directories`] that has it.
pub(crate) fn session_file(global: &Global, named: &str) -> Result<PathBuf, Failure> {
    let path = Path::new(named);
    if path.is_file() {
        return Ok(path.to_owned());
    }
    if named.contains('/') || named.ends_with(".tactus") {
        return Err(Failure::Failed(format!(
            "there is no file or folder {named}; `tactus sessions` lists what is recorded"
        )));
    }
    let places = directories(global)?;
    let mut unreadable = Vec::new();
    for place in &places {
        match logbook::find(place, named) {
            Ok(file) => return Ok(file),
            Err(LogbookError::NoSuchSession { .. }) => {}
            Err(error @ (LogbookError::Ambiguous { .. } | LogbookError::BadId { .. })) => {
                return Err(refused(&error));
            }
            Err(_) if !place.exists() => {}
            Err(error) => unreadable.push(crate::failure::chain(&error)),
        }
    }
    let mut text = format!(
        "no session '{named}' in {}; --state DIR names another directory of session files",
        listed(&places)
    );
    for why in unreadable {
        text.push_str("\n  ");
        text.push_str(&why);
    }
    Err(Failure::Missing(text))
}

/// Opens a session file.
pub(crate) fn open(path: &Path) -> Result<SessionReader, Failure> {
    SessionReader::open(path).map_err(|error| refused(&error))
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
        LogbookError::NotASession { .. } | LogbookError::OtherSchema { .. } => {
            Failure::Failed(text)
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
    pub(crate) method: Option<Method>,
    pub(crate) gap: Option<f64>,
    pub(crate) prior: Option<Prior>,
    pub(crate) exponent: Option<f64>,
    pub(crate) length_mm: Option<f64>,
    pub(crate) noise_figure: Option<f64>,
    pub(crate) map_error: Option<f64>,
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
