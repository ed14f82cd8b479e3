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

/// Opens existing frames.
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
/// its maps to the bit.
///
/// A recorded session has a configuration of its own, which is used. Plain frames have no known unit: their noise is
/// the baseline's (the rms of the readings' standard deviations, else a thousandth of the readings' rms), scaled to the
/// geometry as the one-step method scales the readings.
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
    let kept = recording
        .kept_config()
        .and_then(|text| toml::from_str::<Config>(text).ok());
    if let Some(kept) = kept {
        config.survey.current_ua = kept.survey.current_ua;
        if !reported {
            config.model.lambda = kept.model.lambda;
            let measured = Noise::of(baseline).and_then(Noise::measured);
            config.model.noise_uv = kept.model.noise_uv.or(measured.map(|volts| 1e6 * volts));
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

/// Ratio of the baseline to the geometry's readings at 1 A; `None` if they do not match.
fn gain(baseline: &Baseline, geometry: &Geometry, protocol: &Protocol) -> Option<f64> {
    let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m).ok()?;
    noise::gain(&forward, &geometry.sigma0, protocol, &baseline.readings).ok()?
}
