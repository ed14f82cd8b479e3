//! From configuration to a recording and its baseline.

use survey::{Amps, Protocol};

use super::Findings;
use crate::config::{Config, RecordingSection};
use crate::model::chain;
use crate::recording::{Playing, Recording};

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
