//! How maps are to be made: what the options say, else what the session had, else the defaults.

use std::path::{Path, PathBuf};

use eit::inverse::learned::network::is_onnx;

use crate::failure::Failure;
use crate::maps::reconstruction::short;
use crate::maps::recording::Home;
use crate::options::choices::{Method, MethodChoice, Prior};

/// What was asked of the reconstruction; what was not asked is as the session had it, else the default.
pub(crate) struct Recipe {
    pub(crate) model: Option<PathBuf>,
    pub(crate) method: Method,
    /// Where total variation stops, as a share of the objective.
    pub(crate) gap: Option<f64>,
    /// Whether the options name a prior or its exponent.
    pub(crate) prior_asked: bool,
    pub(crate) prior: Option<Prior>,
    pub(crate) exponent: Option<f64>,
    /// Correlation length of the gaussian prior, mm.
    pub(crate) length_mm: Option<f64>,
    pub(crate) noise_figure: Option<f64>,
    /// Error that a quicker frame may have.
    pub(crate) map_error: Option<f64>,
    pub(crate) lambda: Option<f64>,
    pub(crate) noise_v: Option<f64>,
    /// Whether the session kept how its daemon made the maps: noise is then told at the current of its frames.
    pub(crate) as_the_daemon: bool,
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
                Some(crate::records::directory::kept(header)?)
            }
            Home::Session(_) | Home::Folder(_) => None,
        };
        // maps of a model that is named are cut as the session's were
        let cut = match home {
            Home::Session(header) if !header.config_toml.is_empty() => {
                crate::records::directory::kept(header)
                    .ok()
                    .and_then(|kept| kept.model.loss_only)
            }
            Home::Session(_) | Home::Folder(_) => None,
        };
        let as_the_daemon = kept.is_some();
        let session_noise = kept
            .as_ref()
            .map(|kept| kept.model.noise_uv.unwrap_or(DAEMON_NOISE_UV) * 1e-6);
        let kept = kept.map(|kept| kept.model).unwrap_or_default();
        let one_step = asked.method.is_some()
            || asked.prior.is_some()
            || asked.exponent.is_some()
            || asked.lambda.is_some()
            || asked.noise_v.is_some();
        let model_hash = match home {
            Home::Session(header) => header.model_hash.as_deref(),
            Home::Folder(_) => None,
        };
        let model = match (&asked.model, model_hash) {
            (Some(folder), Some(hash)) if folder.is_dir() => {
                Some(in_folder(folder, hash).ok_or_else(|| {
                    Failure::Failed(format!(
                        "no file in {} is the session's model {}",
                        folder.display(),
                        short(hash)
                    ))
                })?)
            }
            (Some(model), _) => Some(model.clone()),
            (None, Some(hash)) if !one_step => {
                let here = recorded_model(kept.file.as_deref(), hash);
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
            // a prior or a lambda is of the one-step method, whatever the session used
            method: asked
                .method
                .or(kept.method.filter(|_| {
                    asked.prior.is_none() && asked.exponent.is_none() && asked.lambda.is_none()
                }))
                .unwrap_or(Method::OneStep),
            gap: kept.gap,
            prior_asked: asked.prior.is_some() || asked.exponent.is_some(),
            prior: asked.prior.or(kept.prior),
            exponent: asked.exponent.or(kept.exponent),
            length_mm: kept.length_mm,
            noise_figure: kept.noise_figure.filter(|_| !told),
            map_error: kept.map_error,
            lambda: asked.lambda.or(kept.lambda.filter(|_| !told)),
            noise_v: asked.noise_v.or(session_noise.filter(|_| !told)),
            as_the_daemon,
            loss_only: asked.loss_only || cut.unwrap_or(false),
            remarks,
        })
    }
}

/// The file whose hash the session kept: the configured one, or any beside it, here, or in `models` here.
fn recorded_model(configured: Option<&Path>, hash: &str) -> Option<PathBuf> {
    let beside = configured.and_then(Path::parent);
    configured
        .filter(|file| is_model(file, hash))
        .map(Path::to_owned)
        .or_else(|| {
            beside
                .into_iter()
                .chain([Path::new("models"), Path::new(".")])
                .find_map(|folder| in_folder(folder, hash))
        })
}

fn in_folder(folder: &Path, hash: &str) -> Option<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .ok()?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| is_onnx(path) || path.extension().is_some_and(|name| name == "safetensors"))
        .collect();
    files.sort();
    files.into_iter().find(|file| is_model(file, hash))
}

fn is_model(file: &Path, hash: &str) -> bool {
    std::fs::read(file).is_ok_and(|bytes| eit::model::fingerprint(&bytes) == hash)
}

/// The daemon's own default, uV: a map can only be verified when it is made as the daemon made it.
const DAEMON_NOISE_UV: f64 = 2.0;

#[cfg(test)]
mod tests {
    use crate::maps::settings::*;

    #[test]
    fn a_model_is_known_by_its_hash_and_not_by_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let [configured, other] =
            ["a.safetensors", "b.safetensors"].map(|name| folder.path().join(name));
        std::fs::write(&configured, "one").unwrap();
        std::fs::write(&other, "two").unwrap();
        let of = |text: &str| eit::model::fingerprint(text.as_bytes());
        let found = |text: &str| recorded_model(Some(&configured), &of(text));
        assert_eq!(found("one"), Some(configured.clone()));
        assert_eq!(found("two"), Some(other));
        assert_eq!(found("three"), None);
    }
}
