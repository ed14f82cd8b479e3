//! How maps are to be made: what the options say, else what the session had, else the defaults.

use imaging::recorded::Origin;
use imaging::{Method, ReconstructionSettings, find_model, find_model_in, short_hash};

use crate::failure::Failure;
use crate::maps::session_settings;
use crate::options::choices::MethodChoice;

/// Settings of a reconstruction, with what only these programs know about them.
pub(crate) struct Chosen {
    pub(crate) settings: ReconstructionSettings,
    /// Noise of one reading that the options name, V.
    pub(crate) noise_v: Option<f64>,
    /// Whether the session keeps how its daemon made the maps: noise then counts at the current of its frames.
    pub(crate) as_recorded: bool,
    /// What a person should know about the choice, a sentence each.
    pub(crate) remarks: Vec<String>,
}

impl Chosen {
    /// Looks at the options first, then at the configuration that the session kept.
    ///
    /// # Errors
    /// A session whose configuration cannot be read, or options that do not fit the method.
    pub(crate) fn new(asked: &MethodChoice, origin: &Origin) -> Result<Self, Failure> {
        let mut remarks = Vec::new();
        // A session made without a daemon keeps no configuration.
        let header = match origin {
            Origin::Session(header) if !header.config_toml.is_empty() => Some(header),
            Origin::Session(_) | Origin::Folder(_) => None,
        };
        let kept = match header.filter(|_| asked.model.is_none()) {
            Some(header) => Some(session_settings::kept(header)?.model),
            None => None,
        };
        // maps of a model that is named are bounded as the session's were
        let loss_only = asked.loss_only
            || header
                .and_then(|header| session_settings::kept(header).ok())
                .and_then(|kept| kept.model.loss_only)
                .unwrap_or(false);
        let as_recorded = kept.is_some();
        let kept = kept.unwrap_or_default();
        let file = model_file(asked, origin, &kept, &mut remarks)?;
        let (lambda, noise_v) = (asked.lambda, asked.noise_v);
        let strength_asked = lambda.is_some() || noise_v.is_some();
        // a prior or a lambda is of the one-step method, whatever the session used
        let one_step_asked =
            asked.prior.is_some() || asked.exponent.is_some() || asked.lambda.is_some();
        let method = asked
            .method
            .or(kept.method.filter(|_| !one_step_asked))
            .unwrap_or_default();
        let settings = ReconstructionSettings {
            file,
            method: Some(method),
            prior: asked.prior.or(kept.prior),
            exponent: asked.exponent.or(kept.exponent),
            lambda: lambda.or(kept.lambda.filter(|_| !strength_asked)),
            noise_figure: kept.noise_figure.filter(|_| !strength_asked),
            noise_uv: kept.noise_uv.filter(|_| !strength_asked),
            loss_only: Some(loss_only),
            calibration: None,
            ..kept
        };
        if settings.file.is_none() && method == Method::Tv {
            if settings.lambda.is_some() {
                return Err(Failure::Usage(
                    "--lambda belongs to the one-step method; total variation takes --noise-v"
                        .to_owned(),
                ));
            }
            if asked.prior.is_some() || asked.exponent.is_some() {
                return Err(Failure::Usage(
                    "--prior and --exponent belong to the one-step method".to_owned(),
                ));
            }
        }
        Ok(Self {
            settings,
            noise_v,
            as_recorded,
            remarks,
        })
    }
}

/// The trained model to use: the one that is named, else the session's where it is here.
fn model_file(
    asked: &MethodChoice,
    origin: &Origin,
    kept: &ReconstructionSettings,
    remarks: &mut Vec<String>,
) -> Result<Option<std::path::PathBuf>, Failure> {
    let method_asked = asked.method.is_some()
        || asked.prior.is_some()
        || asked.exponent.is_some()
        || asked.lambda.is_some()
        || asked.noise_v.is_some();
    let hash = match origin {
        Origin::Session(header) => header.model_hash.as_deref(),
        Origin::Folder(_) => None,
    };
    match (&asked.model, hash) {
        (Some(folder), Some(hash)) if folder.is_dir() => match find_model_in(folder, hash) {
            Some(file) => Ok(Some(file)),
            None => Err(Failure::Failed(format!(
                "no file in {} is the session's model {}",
                folder.display(),
                short_hash(hash)
            ))),
        },
        (Some(model), _) => Ok(Some(model.clone())),
        (None, Some(hash)) if !method_asked => {
            let here = find_model(kept.file.as_deref(), hash);
            if here.is_none() {
                remarks.push(format!(
                    "the session's maps were made with model {}, which is not here; the one-step method is used \
                     instead, --model FILE says where it is",
                    short_hash(hash)
                ));
            }
            Ok(here)
        }
        (None, _) => Ok(None),
    }
}
