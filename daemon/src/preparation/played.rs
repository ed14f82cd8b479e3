//! From configuration to a recording and its baseline.

use std::sync::Arc;

use eit::Forward;
use survey::{Amps, Baseline, Protocol};

use crate::acquisition::playback::{Playing, Recording};
use crate::config::{Config, RecordingSection};
use crate::preparation::Findings;
use crate::recording::model::{DEFAULT_NOISE_UV, Geometry, chain};

/// Opens what was measured before.
pub(super) fn recorded(
    config: &Config,
    findings: &mut Findings<'_>,
) -> Option<(Protocol, Recording, survey::Baseline)> {
    let Some(section) = &config.recording else {
        findings.add("rig.kind", "a recording needs a section [recording]");
        return None;
    };
    let playing = Playing {
        negate: section.negate,
        frames_per_s: section.frames_per_s,
        speed: section.speed.unwrap_or(1.0),
    };
    let (protocol, recording) = match section {
        RecordingSection {
            session: Some(session),
            case: None,
            ..
        } => {
            let opened = Recording::session(session, playing).map_err(|cause| chain(&cause));
            let (recording, protocol) = findings.taken("recording.session", opened)?;
            (protocol, recording)
        }
        RecordingSection {
            session: None,
            case: Some(case),
            frames: Some(frames),
            ..
        } => {
            let read =
                eit::read_protocol(&case.join("protocol.csv"), None).map_err(|cause| chain(&cause));
            let (protocol, currents) = findings.taken("recording.case", read)?;
            let current = Amps(currents.first().copied().unwrap_or(1.0));
            let opened =
                Recording::csv(frames, &protocol, current, playing).map_err(|cause| chain(&cause));
            (protocol, findings.taken("recording.frames", opened)?)
        }
        _ => {
            findings.add(
                "recording",
                "give either session = \"FILE\", or case = \"FOLDER\" and frames = \"FILE\"",
            );
            return None;
        }
    };
    let baseline = recording
        .baseline(section.baseline.as_deref(), &protocol, chrono::Utc::now())
        .map_err(|cause| chain(&cause));
    let baseline = findings.taken("recording.baseline", baseline)?;
    Some((protocol, recording, baseline))
}

/// Noise assumed of a baseline that does not show any, as a share of its readings' rms; `tactus replay` assumes the same.
const ASSUMED_NOISE: f64 = 1e-3;
/// What rounding alone leaves of a mean, as a share of the readings' rms; below it there is no noise to speak of.
const SMALLEST_NOISE: f64 = 1e-12;

/// Fills in what the recording itself says of current and noise, so that the configuration kept in a session is enough
/// to make its maps again, to the bit.
///
/// A session was made under a configuration of its own, which goes on. Of plain frames nobody knows the unit: their noise
/// is the baseline's own (the rms of the readings' standard deviations, else a thousandth of the readings' rms), brought to
/// the geometry's scale as the one-step method brings the readings.
pub(super) fn complete(
    config: &mut Config,
    recording: &Recording,
    baseline: &Baseline,
    geometry: &Geometry,
    protocol: &Protocol,
) {
    let current_ua = recording
        .settings()
        .map_or(1e6, |settings| settings.current.0 * 1e6);
    let told = config.model.lambda.is_some() || config.model.noise_uv.is_some();
    let kept = recording
        .kept_config()
        .and_then(|text| toml::from_str::<Config>(text).ok());
    if let Some(kept) = kept {
        config.survey.current_ua = kept.survey.current_ua;
        if !told {
            config.model.lambda = kept.model.lambda;
            config.model.noise_uv = match kept.model.lambda {
                Some(_) => None,
                None => Some(kept.model.noise_uv.unwrap_or(DEFAULT_NOISE_UV)),
            };
        }
        return;
    }
    config.survey.current_ua = current_ua;
    if told {
        return;
    }
    match gain(baseline, geometry, protocol) {
        Some(gain) => {
            let noise = noise(baseline);
            tracing::info!("noise of one reading: {noise:.2e} in the recording's unit");
            config.model.noise_uv = Some(noise / gain * current_ua);
        }
        None => tracing::warn!(
            "the baseline does not look like this geometry, so its noise says nothing; if its readings are magnitudes, \
             set negate = true in [recording]"
        ),
    }
}

/// In the baseline's own unit.
fn noise(baseline: &Baseline) -> f64 {
    let size = rms(baseline
        .readings
        .iter()
        .filter_map(|reading| reading.volts())
        .map(|volts| volts.0));
    rms(baseline.deviation.iter().flatten().copied())
        .zip(size)
        .and_then(|(noise, size)| (noise > SMALLEST_NOISE * size).then_some(noise))
        .or(size.map(|size| ASSUMED_NOISE * size))
        .unwrap_or(DEFAULT_NOISE_UV * 1e-6)
}

fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, squares) = values.fold((0_usize, 0.0), |(count, squares), value| {
        (count + 1, squares + value * value)
    });
    (count > 0 && squares > 0.0).then(|| (squares / count as f64).sqrt())
}

/// By how much the baseline exceeds the geometry's own readings at 1 A, in the least squares; `None` where they do not
/// agree in sign.
fn gain(baseline: &Baseline, geometry: &Geometry, protocol: &Protocol) -> Option<f64> {
    let model = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m)
        .ok()?
        .readings(&geometry.sigma0, protocol)
        .ok()?;
    let (mut both, mut own) = (0.0, 0.0);
    for (reading, &ohms) in baseline.readings.iter().zip(model.iter()) {
        if let Some(volts) = reading.volts() {
            both += ohms * volts.0;
            own += ohms * ohms;
        }
    }
    Some(both / own).filter(|gain| *gain > 0.0 && gain.is_finite())
}
