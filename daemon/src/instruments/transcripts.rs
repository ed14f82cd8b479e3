//! Transcripts of the messages to and from the instruments: as text and as files.

use std::path::{Path, PathBuf};

use rig::RingTranscript;
use rig::transcript::{Entry, TranscriptError, TranscriptWriter};

/// The last frames, oldest first, after the opening messages of their connection: a complete conversation. Empty before
/// the first message. Frames of an earlier connection are left out.
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

/// Writes the last frame with its opening messages.
///
/// # Errors
/// A file that exists already, or a disk error.
fn write_last(transcript: &RingTranscript, path: &Path) -> Result<(), TranscriptError> {
    let mut writer = TranscriptWriter::create(path)?;
    last(transcript, 1)
        .iter()
        .try_for_each(|entry| writer.write(entry))
}

/// Maximum number of transcripts of failed frames stored for a session: each is some 100 kB, and the first ones are the
/// most useful.
pub(crate) const MOST_OF_A_SESSION: u64 = 100;

/// Result of storing the transcript of a failed frame.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum FailedFrame {
    /// The transcript was written to this file.
    Written(PathBuf),
    /// The same, and no more are stored for this session.
    WrittenLast(PathBuf),
    /// Not written: the session has reached its limit.
    OverLimit,
}

/// Stores the transcript of a session's failed frame in the folder, up to [`MOST_OF_A_SESSION`]. `failure` is the
/// number of the failure since the start of the daemon, from 1. The file gets the first free number from `failure` on,
/// because an earlier daemon may have stored transcripts.
///
/// # Errors
/// As [`write_last`].
pub(crate) fn write_failed(
    transcript: &RingTranscript,
    folder: &Path,
    session: &str,
    failure: u64,
) -> Result<FailedFrame, TranscriptError> {
    let path = |number| folder.join(format!("{session}-failed-{number}.transcript.jsonl"));
    let free = (failure..=MOST_OF_A_SESSION).find(|number| !path(*number).exists());
    let Some(number) = free else {
        return Ok(FailedFrame::OverLimit);
    };
    let path = path(number);
    write_last(transcript, &path)?;
    Ok(match number == MOST_OF_A_SESSION {
        true => FailedFrame::WrittenLast(path),
        false => FailedFrame::Written(path),
    })
}

/// As text: a line of JSON for each entry.
///
/// # Errors
/// A time that is not a finite number.
pub(crate) fn text(entries: &[Entry]) -> Result<String, serde_json::Error> {
    let mut text = String::new();
    for entry in entries {
        text.push_str(&serde_json::to_string(entry)?);
        text.push('\n');
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_leaves_at_most_a_hundred_transcripts() {
        let folder = tempfile::tempdir().unwrap();
        let transcript = RingTranscript::new(2);
        let written = |failures: std::ops::RangeInclusive<u64>| -> [usize; 2] {
            let outcomes: Vec<FailedFrame> = failures
                .map(|failure| write_failed(&transcript, folder.path(), "m1", failure).unwrap())
                .collect();
            let count =
                |is: fn(&FailedFrame) -> bool| outcomes.iter().filter(|one| is(one)).count();
            [
                count(|one| matches!(one, FailedFrame::Written(_))),
                count(|one| matches!(one, FailedFrame::WrittenLast(_))),
            ]
        };
        assert_eq!(written(1..=30), [30, 0]);
        // after a restart of the daemon failures are counted from 1 again, and no file is replaced
        assert_eq!(written(1..=250), [69, 1], "the limit is reported once");
        assert_eq!(written(1..=10), [0, 0]);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 100);
        // another session has its own limit
        let other = write_failed(&transcript, folder.path(), "m2", 1).unwrap();
        assert!(matches!(other, FailedFrame::Written(path) if path.is_file()));
    }
}
