//! The scenes shipped with the project, and opening of scenes by the name of a shipped one or by path.

use crate::scene::{Scene, SceneError};

/// Names (file names without extension) and texts of the scenes.
macro_rules! scenes {
    ($($name:literal)+) => {
        &[$(($name, include_str!(concat!("../scenes/", $name, ".toml")))),+]
    };
}

/// Why a scene cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Neither a shipped scene nor a file that can be read.
    #[error(
        "scene {name} is neither a shipped scene nor a file ({cause}){}; `tactus-lab scene list` lists the shipped ones",
        perhaps(name)
    )]
    Read {
        /// The name given.
        name: String,
        /// Why the file cannot be read.
        cause: std::io::Error,
    },
    /// The text is not a valid scene.
    #[error(transparent)]
    Text(#[from] SceneError),
}

fn perhaps(name: &str) -> String {
    survey::nearest(name, Scene::shipped().iter().map(|(name, _)| *name))
        .map_or_else(String::new, |near| format!("; did you mean '{near}'?"))
}

impl Scene {
    /// The shipped scenes: names and texts.
    pub fn shipped() -> &'static [(&'static str, &'static str)] {
        scenes! {
            "quiet"
            "paper-test1"
            "paper-test2"
            "clean-bench"
            "bedside-night"
            "month"
            "torture"
            "effect-electrode-placement"
            "effect-foam"
            "effect-gauge-law"
            "effect-exponential-law"
            "effect-log-law"
            "effect-hysteresis"
            "effect-creep"
            "effect-power-law-creep"
            "effect-set"
            "effect-stretch"
            "effect-body-contact"
            "effect-spray"
            "effect-temperature"
            "effect-humidity"
            "effect-long-drift"
            "effect-crack"
            "effect-contact-spread"
            "effect-contact-drift"
            "effect-detachment"
            "effect-short"
            "effect-isolation"
            "effect-channel-resistance"
            "effect-lead-resistance"
            "effect-wear"
            "effect-self-heating"
            "effect-current-error"
            "effect-current-noise"
            "effect-output-resistance"
            "effect-source-settling"
            "effect-charge-injection"
            "effect-crosstalk"
            "effect-thermal-emf"
            "effect-channel-noise"
            "effect-leakage"
            "effect-relay-bounce"
            "effect-mains-pickup"
            "effect-common-mode"
            "effect-input-resistance"
            "effect-bias-current"
            "effect-voltmeter-gain"
            "effect-autozero-off"
            "effect-voltmeter-noise"
            "effect-quantisation"
        }
    }

    /// A scene's description, from the first line of its text, a comment.
    pub fn what(text: &str) -> &str {
        let first = text.lines().next().unwrap_or_default();
        first.trim_start_matches(['#', ' '])
    }

    /// Opens a shipped scene by name, or a file by path.
    ///
    /// # Errors
    /// The file cannot be read, or the scene is invalid.
    pub fn open(name_or_path: &str) -> Result<Self, OpenError> {
        let shipped = Self::shipped()
            .iter()
            .find(|(name, _)| *name == name_or_path);
        match shipped {
            Some((name, text)) => Ok(Self::parse(&format!("{name}.toml"), text)?),
            None => {
                let text =
                    std::fs::read_to_string(name_or_path).map_err(|cause| OpenError::Read {
                        name: name_or_path.to_owned(),
                        cause,
                    })?;
                Ok(Self::parse(name_or_path, &text)?)
            }
        }
    }
}
