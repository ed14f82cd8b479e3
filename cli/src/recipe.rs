//! How maps are to be made: what the options say, else what the session had, else the defaults.

use std::path::PathBuf;

use crate::choices::{MethodChoice, Prior};
use crate::eye::short;
use crate::failure::Failure;
use crate::recording::Home;

/// What was asked of the reconstruction; what was not asked is as the session had it, else the default.
pub(crate) struct Recipe {
    pub(crate) model: Option<PathBuf>,
    pub(crate) prior: Option<Prior>,
    pub(crate) exponent: Option<f64>,
    pub(crate) lambda: Option<f64>,
    pub(crate) noise_v: Option<f64>,
    /// Current at which that noise is met, A; `None` where the record's unit is not known to be the volt.
    pub(crate) current_a: Option<f64>,
    pub(crate) loss_only: bool,
    pub(crate) remarks: Vec<String>,
}

impl Recipe {
    /// Looks at the options first, then at the configuration that the session kept.
    ///
    /// # Errors
    /// A session whose configuration cannot be read.
    pub(crate) fn choose(asked: &MethodChoice, home: &Home) -> Result<Self, Failure> {
        let mut remarks = Vec::new();
        // A session made without a daemon keeps no configuration.
        let kept = match home {
            Home::Session(header) if asked.model.is_none() && !header.config_toml.is_empty() => {
                Some(crate::state::kept(header)?)
            }
            Home::Session(_) | Home::Folder(_) => None,
        };
        let current_a = kept.as_ref().map(|kept| kept.survey.current_ua * 1e-6);
        let session_noise = kept
            .as_ref()
            .map(|kept| kept.model.noise_uv.unwrap_or(DAEMON_NOISE_UV) * 1e-6);
        let kept = kept.map(|kept| kept.model).unwrap_or_default();
        let one_step = asked.method.is_some()
            || asked.prior.is_some()
            || asked.exponent.is_some()
            || asked.lambda.is_some()
            || asked.noise_v.is_some()
            || asked.loss_only;
        let model_hash = match home {
            Home::Session(header) => header.model_hash.as_deref(),
            Home::Folder(_) => None,
        };
        let model = match (&asked.model, model_hash) {
            (Some(model), _) => Some(model.clone()),
            (None, Some(hash)) if !one_step => {
                let here = kept.file.filter(|file| file.is_file());
                if here.is_none() {
                    remarks.push(format!(
                        "the session's maps were made with model {}, which is not here; the one-step method is used \
                         instead, --model FILE says where it is",
                        short(hash)
                    ));
                }
                here
            }
            (None, _) => None,
        };
        let told = asked.lambda.is_some() || asked.noise_v.is_some();
        Ok(Self {
            model,
            prior: asked.prior.or(kept.prior),
            exponent: asked.exponent.or(kept.exponent),
            lambda: asked.lambda.or(kept.lambda.filter(|_| !told)),
            noise_v: asked.noise_v.or(session_noise.filter(|_| !told)),
            current_a,
            loss_only: asked.loss_only || kept.loss_only.unwrap_or(false),
            remarks,
        })
    }
}

/// The daemon's own default, uV: a map can only be verified when it is made as the daemon made it.
const DAEMON_NOISE_UV: f64 = 2.0;
