//! Settings for maps: from the options, otherwise from the session, otherwise the defaults.

use std::path::PathBuf;

use imaging::recorded::Origin;
use imaging::{MethodArguments, ReconstructionSettings, find_model, find_model_in, short_hash};

use crate::failure::Failure;
use crate::maps::session_settings;

/// Settings of a reconstruction, with their origin and remarks.
pub(crate) struct ChosenSettings {
    pub(crate) settings: ReconstructionSettings,
    /// Whether the settings are those of the session's daemon: the noise is then at the current of its frames.
    pub(crate) as_recorded: bool,
    /// The session's calibration, if the options do not change its method.
    pub(crate) calibration: Option<PathBuf>,
    /// Remarks about the choice for the user, a sentence each.
    pub(crate) remarks: Vec<String>,
}

impl ChosenSettings {
    /// Combines the options with the configuration stored in the session.
    ///
    /// # Errors
    /// A session with an invalid configuration, or options that do not fit the method.
    pub(crate) fn new(requested: &MethodArguments, origin: &Origin) -> Result<Self, Failure> {
        let mut remarks = Vec::new();
        let requested = requested.settings().map_err(Failure::Usage)?;
        // a session recorded without a daemon has no configuration
        let header = match origin {
            Origin::Session(header) if !header.config_toml.is_empty() => Some(header),
            Origin::Session(_) | Origin::Folder(_) => None,
        };
        let kept = match header.filter(|_| requested.file.is_none()) {
            Some(header) => Some(session_settings::stored_config(header)?.model),
            None => None,
        };
        // maps of a model that the options name have the same bounds as those of the session
        let loss_only = requested.loss_only.or(header
            .and_then(|header| session_settings::stored_config(header).ok())
            .and_then(|kept| kept.model.loss_only));
        let as_recorded = kept.is_some();
        let unchanged = as_recorded && requested.given().is_empty();
        let calibration = kept
            .as_ref()
            .and_then(|kept| kept.calibration.clone())
            .filter(|_| unchanged);
        let file = model_file(&requested, origin, kept.as_ref(), &mut remarks)?;
        let settings = ReconstructionSettings {
            file,
            loss_only,
            ..match kept {
                Some(kept) => requested.clone().over(kept),
                None => requested.clone().for_recording(),
            }
        };
        if settings.file.is_none() {
            let method = settings.method.unwrap_or_default();
            MethodArguments::check(&requested, method).map_err(Failure::Usage)?;
        }
        Ok(Self {
            settings,
            as_recorded,
            calibration,
            remarks,
        })
    }
}

/// The trained model: the one given by option, otherwise the session's if its file is available.
fn model_file(
    requested: &ReconstructionSettings,
    origin: &Origin,
    kept: Option<&ReconstructionSettings>,
    remarks: &mut Vec<String>,
) -> Result<Option<PathBuf>, Failure> {
    let method_requested = requested.given().iter().any(|key| *key != "loss_only");
    let hash = match origin {
        Origin::Session(header) => header.model_hash.as_deref(),
        Origin::Folder(_) => None,
    };
    match (&requested.file, hash) {
        (Some(folder), Some(hash)) if folder.is_dir() => match find_model_in(folder, hash) {
            Some(file) => Ok(Some(file)),
            None => Err(Failure::Failed(format!(
                "no file in {} is the session's model {}",
                folder.display(),
                short_hash(hash)
            ))),
        },
        (Some(model), _) => Ok(Some(model.clone())),
        (None, Some(hash)) if !method_requested => {
            let here = find_model(kept.and_then(|kept| kept.file.as_deref()), hash);
            if here.is_none() {
                remarks.push(format!(
                    "the session's maps were made with model {}, which is not here; the one-step method is used \
                     instead; give the model with --model FILE",
                    short_hash(hash)
                ));
            }
            Ok(here)
        }
        (None, _) => Ok(None),
    }
}
