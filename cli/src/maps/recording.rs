//! The recording for `replay`: a case folder with measured frames, or a session of the logbook.

use std::path::Path;

use imaging::recorded::{RecordedError, RecordedFrame, Recording, TableOptions};
use logbook::LogbookError;

use crate::args::{Global, Replay};
use crate::failure::Failure;
use crate::session_files;

/// Opens a folder, a session file, or a session by its id in the state directory.
pub(crate) fn open(global: &Global, replay: &Replay) -> Result<Recording, Failure> {
    let path = Path::new(&replay.source);
    if path.is_dir() {
        from_folder(path, replay)
    } else {
        from_session(
            &session_files::session_file(global, &replay.source)?,
            replay,
        )
    }
}

/// Number of frames of [`frames`], including unreadable ones.
pub(crate) fn count(recording: &Recording, replay: &Replay) -> Result<usize, Failure> {
    Ok(recording.len()?.min(most(replay)))
}

/// The requested frames in order; unreadable ones are reported on standard error.
pub(crate) fn frames<'a>(
    recording: &'a Recording,
    replay: &Replay,
) -> impl Iterator<Item = RecordedFrame> + 'a {
    let readable = recording.frames().filter_map(|frame| match frame {
        Ok(frame) => Some(frame),
        Err(error) => {
            left_out(&error);
            None
        }
    });
    readable.take(most(replay))
}

/// Reports an unreadable frame.
pub(crate) fn left_out(error: &LogbookError) {
    eprintln!(
        "tactus: a frame is left out: {}",
        crate::failure::chain(error)
    );
}

fn most(replay: &Replay) -> usize {
    let count = replay.count.and_then(|count| usize::try_from(count).ok());
    count.unwrap_or(usize::MAX)
}

fn from_folder(folder: &Path, replay: &Replay) -> Result<Recording, Failure> {
    let options = TableOptions {
        frames: replay.frames.as_deref(),
        baseline: replay.baseline.as_ref(),
        negate: replay.negate,
    };
    let electrodes = replay.geometry.electrodes;
    Ok(Recording::from_folder(folder, &options, electrodes)?)
}

fn from_session(path: &Path, replay: &Replay) -> Result<Recording, Failure> {
    if let Some(file) = &replay.frames {
        return Err(Failure::Usage(format!(
            "--frames {} belongs to a case folder; a session has its own frames",
            file.display()
        )));
    }
    Ok(Recording::from_session(
        path,
        replay.baseline.as_ref(),
        replay.negate,
    )?)
}

impl From<RecordedError> for Failure {
    fn from(error: RecordedError) -> Self {
        match error {
            RecordedError::Session(error) => error.into(),
            RecordedError::First { .. } => Self::Usage(format!("--{error}")),
            RecordedError::NoBaseline(id) => Self::Failed(format!(
                "session {id} holds no baseline; say --baseline first:N for its first N frames"
            )),
            RecordedError::NoFrames(_) => Self::Usage(error.to_string()),
            RecordedError::Protocol(_)
            | RecordedError::Frames(_)
            | RecordedError::Currents(_)
            | RecordedError::Provenance { .. }
            | RecordedError::Missing { .. }
            | RecordedError::Baseline { .. } => Self::Failed(crate::failure::chain(&error)),
        }
    }
}

impl From<LogbookError> for Failure {
    fn from(error: LogbookError) -> Self {
        session_files::refused(&error)
    }
}
