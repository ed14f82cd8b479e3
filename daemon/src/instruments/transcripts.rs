//! What was said over the wires, from memory to text and to disk.

use std::path::Path;

use rig::RingTranscript;
use rig::transcript::{Entry, TranscriptError, TranscriptWriter};

/// The last frames, oldest first, behind the opening of the first of them: a whole conversation. Empty before anything
/// was said. Frames of another opening (the rig was lost between) are left out with what precedes them.
pub(crate) fn last(transcript: &RingTranscript, frames: usize) -> Vec<Entry> {
    let transcripts = transcript.transcripts();
    let Some(newest) = transcripts.last() else {
        return transcript.opening();
    };
    let from = transcripts.len().saturating_sub(frames.max(1));
    let together: Vec<_> = transcripts[from..]
        .iter()
        .filter(|transcript| transcript.opening == newest.opening)
        .collect();
    let mut entries = newest.opening.to_vec();
    entries.extend(
        together
            .iter()
            .flat_map(|transcript| transcript.entries.clone()),
    );
    entries
}

/// Writes the last frame with its opening.
///
/// # Errors
/// A file that is there already, or a disk that refuses.
pub(crate) fn write_last(transcript: &RingTranscript, path: &Path) -> Result<(), TranscriptError> {
    let mut writer = TranscriptWriter::create(path)?;
    last(transcript, 1)
        .iter()
        .try_for_each(|entry| writer.write(entry))
}

/// As text: a line of JSON an entry.
///
/// # Errors
/// A time that is no number.
pub(crate) fn text(entries: &[Entry]) -> Result<String, serde_json::Error> {
    let mut text = String::new();
    for entry in entries {
        text.push_str(&serde_json::to_string(entry)?);
        text.push('\n');
    }
    Ok(text)
}
