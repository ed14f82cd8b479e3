//! Opens a configured recording and its baseline.

use std::sync::Arc;

use eit::Forward;
use imaging::Geometry;
use imaging::noise::{self, Noise};
use imaging::recorded::IndexedFrames;
use survey::{Amps, Baseline, Protocol, error_chain as chain};

use crate::acquisition::playback::{Playing, Recording};
use crate::preparation::Findings;
use config::{Config, RecordingSection};

/// Opens the configured recording and its baseline.
pub(super) fn recorded(
    config: &Config,
    findings: &mut Findings<'_>,
) -> Option<(Protocol, Recording, survey::Baseline)> {
    let Some(section) = &config.recording else {
        findings.add("rig.kind", "a recording needs a section [recording]");
        return None;
    };
    let playing = Playing {
        frames_per_s: section.frames_per_s,
        speed: section.speed.unwrap_or(1.0),
    };
    let (protocol, frames) = match section {
        RecordingSection {
            session: Some(session),
            case: None,
            ..
        } => {
            let opened =
                IndexedFrames::session(session, section.negate).map_err(|cause| chain(&cause));
            let (frames, protocol) = findings.value_or_problem("recording.session", opened)?;
            (protocol, frames)
        }
        RecordingSection {
            session: None,
            case: Some(case),
            frames: Some(frames),
            ..
        } => {
            let read =
                eit::read_protocol(&case.join("protocol.csv"), None).map_err(|cause| chain(&cause));
            let (protocol, currents) = findings.value_or_problem("recording.case", read)?;
            let current = Amps(currents.first().copied().unwrap_or(1.0));
            let opened = IndexedFrames::table(frames, &protocol, current, section.negate)
                .map_err(|cause| chain(&cause));
            (
                protocol,
                findings.value_or_problem("recording.frames", opened)?,
            )
        }
        _ => {
            findings.add(
                "recording",
                "give either session = \"FILE\", or case = \"FOLDER\" and frames = \"FILE\"",
            );
            return None;
        }
    };
    let baseline = frames
        .baseline(section.baseline.as_deref(), &protocol, chrono::Utc::now())
        .map_err(|cause| chain(&cause));
    let baseline = findings.value_or_problem("recording.baseline", baseline)?;
    Some((protocol, Recording::new(frames, playing), baseline))
}

/// Fills in current and noise from the recording, so that the configuration stored in a session suffices to recompute
/// its maps bit for bit.
///
/// A recorded session contains its configuration, which is used. Frames without one have no known unit: their noise is
/// the rms of the standard deviations of the baseline's readings, scaled to the geometry as the one-step method scales
/// the readings. It is not set if the baseline has no standard deviations.
pub(super) fn complete(
    config: &mut Config,
    recording: &IndexedFrames,
    baseline: &Baseline,
    geometry: &Geometry,
    protocol: &Protocol,
) {
    let current_ua = recording
        .settings()
        .map_or(1e6, |settings| settings.current.0 * 1e6);
    let model = &config.model;
    let reported = model.lambda.is_some()
        || model.noise_uv.is_some()
        || model.noise_figure.is_some()
        || model.choose.is_some();
    let kept = recording.kept_config().and_then(Kept::read);
    if let Some(kept) = kept {
        config.survey.current_ua = kept.current_ua.unwrap_or(current_ua);
        if !reported {
            config.model.lambda = kept.lambda;
            let measured = Noise::of(baseline).and_then(Noise::measured);
            config.model.noise_uv = kept.noise_uv.or(measured.map(|volts| 1e6 * volts));
        }
        return;
    }
    config.survey.current_ua = current_ua;
    if reported {
        return;
    }
    match gain(baseline, geometry, protocol) {
        Some(gain) => {
            let noise = Noise::of(baseline).and_then(Noise::measured);
            if let Some(noise) = noise {
                tracing::info!("noise of one reading: {noise:.2e} in the recording's unit");
            }
            config.model.noise_uv = noise.map(|noise| noise / gain * current_ua);
        }
        None => tracing::warn!(
            "the baseline does not match this geometry, so its noise is not used; if its readings are magnitudes, set \
             negate = true in [recording]"
        ),
    }
}

/// Settings read from the configuration stored with a session. Its other keys are not read, because they may be unknown
/// in this version.
#[derive(Debug, PartialEq)]
struct Kept {
    current_ua: Option<f64>,
    lambda: Option<f64>,
    noise_uv: Option<f64>,
}

impl Kept {
    /// `None` for a text that is not TOML.
    fn read(text: &str) -> Option<Self> {
        let table: toml::Table = toml::from_str(text).ok()?;
        let number = |section: &str, key: &str| match table.get(section)?.get(key)? {
            toml::Value::Float(number) => Some(*number),
            toml::Value::Integer(whole) => Some(*whole as f64),
            _ => None,
        };
        Some(Self {
            current_ua: number("survey", "current_ua"),
            lambda: number("model", "lambda"),
            noise_uv: number("model", "noise_uv"),
        })
    }
}

/// Ratio of the baseline's readings to the computed readings of the geometry at 1 A; `None` if they do not match.
fn gain(baseline: &Baseline, geometry: &Geometry, protocol: &Protocol) -> Option<f64> {
    let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m).ok()?;
    noise::gain(&forward, &geometry.sigma0, protocol, &baseline.readings).ok()?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_of_a_session_of_another_version_are_used() {
        // a section that was renamed since, and a key of a later version
        let text = "[care]\n[survey]\ncurrent_ua = 500\nfuture = 1\n[model]\nlambda = 1e-3\n";
        assert!(toml::from_str::<Config>(text).is_err());
        let kept = Kept::read(text).unwrap();
        assert_eq!(
            (kept.current_ua, kept.lambda, kept.noise_uv),
            (Some(500.0), Some(1e-3), None)
        );
        assert_eq!(Kept::read("[survey"), None);
    }
}
