//! The recording for `replay` and `quantities`: a case folder with measured frames, or a session of the logbook.

use std::cell::Cell;
use std::cmp::Ordering;
use std::path::Path;

use chrono::{DateTime, Utc};
use imaging::recorded::{RecordedError, RecordedFrame, Recording, TableOptions};
use logbook::LogbookError;

use crate::args::{Global, RecordingSource};
use crate::failure::Failure;
use crate::options::moment::Moment;
use crate::output::time::local;
use crate::session_files;

/// Opens a folder, a session file, or a session by its id in the state directory.
/// `electrodes`: their number, for a folder whose protocol does not state it.
pub(crate) fn open(
    global: &Global,
    source: &RecordingSource,
    electrodes: Option<usize>,
) -> Result<Recording, Failure> {
    let path = Path::new(&source.source);
    if path.is_dir() {
        from_folder(path, source, electrodes)
    } else {
        from_session(
            &session_files::session_file(global, &source.source)?,
            source,
        )
    }
}

/// Selection of the frames between `--from` and `--to`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Thinning {
    /// Every nth frame, from the first one.
    pub(crate) every: u64,
    /// At most this number of frames.
    pub(crate) count: Option<u64>,
}

impl Thinning {
    /// All frames.
    pub(crate) const NONE: Self = Self {
        every: 1,
        count: None,
    };

    fn every(self) -> usize {
        usize::try_from(self.every).unwrap_or(usize::MAX)
    }

    fn most(self) -> usize {
        let count = self.count.and_then(|count| usize::try_from(count).ok());
        count.unwrap_or(usize::MAX)
    }
}

/// Number of frames that [`frames`] selects, unless some cannot be read; `None` if it depends on their numbers or
/// times.
pub(crate) fn count(
    recording: &Recording,
    source: &RecordingSource,
    thinning: Thinning,
) -> Result<Option<usize>, Failure> {
    if has_places(source) {
        return Ok(None);
    }
    let frames = recording.len()?.div_ceil(thinning.every());
    Ok(Some(frames.min(thinning.most())))
}

/// The readable frames in order, each with whether it is selected, from the first one, as a tracked baseline needs it,
/// to the last selected one. Damaged frames before it are named on the error stream and counted in `damaged`; if
/// `--to` is a time, also those behind it that may be within the span.
///
/// # Errors
/// `--from` or `--to` is a time, and the frames have none; no frame is between them.
pub(crate) fn frames<'a>(
    recording: &'a Recording,
    source: &'a RecordingSource,
    thinning: Thinning,
    damaged: &'a Cell<usize>,
) -> Result<impl Iterator<Item = (RecordedFrame, bool)> + 'a, Failure> {
    let readable = || recording.frames().filter_map(Result::ok);
    let first = has_places(source)
        .then(|| readable().next()?.wall)
        .flatten();
    for place in [source.from, source.to].into_iter().flatten() {
        if first.is_none() && !matches!(place, Moment::Frame(_)) {
            return Err(Failure::Usage(
                "the frames of a case folder have no times; name --from and --to by their numbers (rows from 1)"
                    .to_owned(),
            ));
        }
    }
    let is_between = move |number: u64, wall: Option<DateTime<Utc>>| {
        let lies = |place: Option<Moment>, excluded: Ordering| {
            place.and_then(|place| place.compare(number, wall, first)) != Some(excluded)
        };
        lies(source.from, Ordering::Less) && lies(source.to, Ordering::Greater)
    };
    let chosen = move |frame: &RecordedFrame| is_between(frame.sequence, frame.wall);
    let mut within = readable().filter(|frame| chosen(frame));
    // numbers ascend; times need not, because a clock may be set back, so the last one is searched from the end, by
    // times alone; all frames are read only if the times of a damaged part cannot be
    let search = || -> Result<Option<RecordedFrame>, LogbookError> {
        for time in recording.wall_times_back() {
            let (number, wall) = time?;
            if is_between(number, Some(wall))
                && let Ok(frame) = recording.frame(number)
                && chosen(&frame)
            {
                return Ok(Some(frame));
            }
        }
        Ok(None)
    };
    let last = match source.to {
        None => within.next().map(|_| u64::MAX),
        Some(Moment::Frame(number)) => within.next().map(|_| number),
        // the times of unreadable frames up to the next readable one are not known
        Some(_) => search().unwrap_or_else(|_| within.last()).map(|frame| {
            let mut behind = recording.frames_from(frame.sequence.saturating_add(1));
            let next = behind.find_map(Result::ok);
            next.map_or(u64::MAX, |next| next.sequence - 1)
        }),
    };
    if has_places(source) && last.is_none() {
        return Err(Failure::Usage(format!(
            "no frame of {} lies between --from and --to; it has {} frames{}",
            recording.name,
            recording.len()?,
            first.map_or_else(String::new, |first| format!(
                ", the first of {}",
                local(first)
            ))
        )));
    }
    // frames behind the last one are not even read: reading and tracking a long rest takes long
    let frames = recording.frames_between(0, last.unwrap_or(u64::MAX));
    let mut readable = frames.filter_map(|frame| match frame {
        Ok(frame) => Some(frame),
        Err(error) => {
            left_out(&error);
            damaged.set(damaged.get() + 1);
            None
        }
    });
    let (mut within, mut shown) = (0_usize, 0_usize);
    let mut ended = false;
    Ok(std::iter::from_fn(move || {
        if ended {
            return None;
        }
        let frame = readable.next()?;
        let is_within = chosen(&frame);
        let asked = is_within && within.is_multiple_of(thinning.every());
        within += usize::from(is_within);
        shown += usize::from(asked);
        ended = shown >= thinning.most();
        Some((frame, asked))
    }))
}

/// The failure of a command that left out damaged frames.
///
/// # Errors
/// `damaged` is not 0.
pub(crate) fn check_undamaged(damaged: usize, name: &str) -> Result<(), Failure> {
    match damaged {
        0 => Ok(()),
        _ => Err(Failure::Failed(format!(
            "{damaged} damaged frames of {name} are left out; the others are written"
        ))),
    }
}

/// Whether `--from` or `--to` is given.
fn has_places(source: &RecordingSource) -> bool {
    source.from.is_some() || source.to.is_some()
}

/// Reports an unreadable frame.
pub(crate) fn left_out(error: &LogbookError) {
    eprintln!(
        "tactus: a frame is left out: {}",
        crate::failure::chain(error)
    );
}

fn from_folder(
    folder: &Path,
    source: &RecordingSource,
    electrodes: Option<usize>,
) -> Result<Recording, Failure> {
    let options = TableOptions {
        frames: source.frames.as_deref(),
        baseline: source.baseline.as_ref(),
        negate: source.negate,
    };
    Ok(Recording::from_folder(folder, &options, electrodes)?)
}

fn from_session(path: &Path, source: &RecordingSource) -> Result<Recording, Failure> {
    if let Some(file) = &source.frames {
        return Err(Failure::Usage(format!(
            "--frames {} belongs to a case folder; a session has its own frames",
            file.display()
        )));
    }
    Ok(Recording::from_session(
        path,
        source.baseline.as_ref(),
        source.negate,
    )?)
}

impl From<RecordedError> for Failure {
    fn from(error: RecordedError) -> Self {
        match error {
            RecordedError::Session(error) => error.into(),
            RecordedError::First { .. } => Self::Usage(format!("--{error}")),
            RecordedError::NoBaseline(id) => Self::Failed(format!(
                "session {id} has no baseline; give --baseline first:N for its first N frames"
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

#[cfg(test)]
mod tests {
    use std::path::PathBuf;
    use std::time::Duration;

    use imaging::recorded::BaselineRule;
    use logbook::{SessionHeader, SessionWriter};
    use survey::{Amps, Frame, Precautions, Protocol, Reading, Settings, Volts};

    use super::*;

    /// Records a session of this number of frames, one a second. The clock was set back by 100 s before frame 200.
    fn recorded(folder: &Path, frames: u64) -> PathBuf {
        let protocol = Protocol::sheffield(16).unwrap();
        let at = DateTime::UNIX_EPOCH;
        let header = SessionHeader::new("m1", at, protocol.clone());
        let mut writer = SessionWriter::create(folder, &header).unwrap();
        let volts = |number: u64, reading: usize| {
            let bits = (number * 512 + reading as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            Reading::Ok(Volts(bits as f64 / u64::MAX as f64))
        };
        let readings = 0..protocol.len();
        let all: Vec<Frame> = (1..=frames)
            .map(|number| Frame {
                sequence: number,
                readings: readings
                    .clone()
                    .map(|reading| volts(number, reading))
                    .collect(),
                monotonic: Duration::from_secs(number),
                wall: at + Duration::from_secs(number + if number < 200 { 1000 } else { 900 }),
                duration: Duration::from_millis(500),
                settings: Settings {
                    protocol_hash: protocol.hash(),
                    current: Amps(1.0),
                    range: Volts(10.0),
                    nplc: 1.0,
                    settle: Duration::ZERO,
                    wiring: "wiring".to_owned(),
                    precautions: Precautions::default(),
                },
                extra: Vec::new(),
                compliance: Vec::new(),
                simulated: false,
            })
            .collect();
        for frames in all.chunks(8) {
            let frames = frames.iter().map(|frame| (frame, None));
            writer.append_all(frames).unwrap();
        }
        let path = writer.path().to_owned();
        writer.close(at, "end").unwrap();
        path
    }

    /// Bytes that this thread has read so far.
    fn bytes_read() -> u64 {
        let counters = std::fs::read_to_string("/proc/thread-self/io").unwrap();
        let read = counters
            .lines()
            .find_map(|line| line.strip_prefix("rchar: "));
        read.unwrap().parse().unwrap()
    }

    #[test]
    fn last_frame_at_a_time_is_found_without_reading_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = recorded(folder.path(), 2000);
        let size = std::fs::metadata(&path).unwrap().len();
        let rule = BaselineRule::First(1);
        let recording = Recording::from_session(&path, Some(&rule), false).unwrap();
        let seconds = |count| Some(Moment::Since(Duration::from_secs(count)));
        for (from, to, count, last) in [
            (None, seconds(9), 10, 10),
            (None, seconds(149), 150 + 51, 250),
            (seconds(1000), seconds(1000), 1, 1101),
        ] {
            let source = RecordingSource {
                source: String::new(),
                frames: None,
                baseline: None,
                negate: false,
                from,
                to,
            };
            let damaged = Cell::new(0);
            let before = bytes_read();
            let frames = frames(&recording, &source, Thinning::NONE, &damaged).unwrap();
            let read = bytes_read() - before;
            let numbers: Vec<u64> = frames
                .filter_map(|(frame, asked)| asked.then_some(frame.sequence))
                .collect();
            assert_eq!((numbers.len(), numbers.last()), (count, Some(&last)));
            assert!(
                read < size / 2,
                "{read} of {size} bytes to find frame {last}"
            );
        }
    }
}
