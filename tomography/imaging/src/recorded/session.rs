//! A recorded session with all its parts as one sequence, read frame by frame.

use std::path::Path;

use logbook::{Event, LogbookError, Record, SessionHeader, SessionReader};
use survey::Baseline;

/// The parts of a session in order, at least one.
#[derive(Debug)]
pub struct SessionParts(Vec<SessionReader>);

impl SessionParts {
    /// Opens a session from its first part with all that follow, or a later part alone.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub fn open(path: &Path) -> Result<Self, LogbookError> {
        let mut parts = vec![SessionReader::open(path)?];
        if parts[0].header().continues.is_none() {
            let all = logbook::parts(path)?;
            let named = path.file_name();
            for other in all.iter().filter(|other| other.file_name() != named) {
                match SessionReader::open(other) {
                    // a part whose creation was interrupted: it never contained frames
                    Err(LogbookError::NotASession { .. }) => {}
                    part => parts.push(part?),
                }
            }
        }
        Ok(Self(parts))
    }

    /// The header of the part that was opened.
    pub fn header(&self) -> &SessionHeader {
        self.0[0].header()
    }

    /// The reader of each part.
    pub fn each(&self) -> &[SessionReader] {
        &self.0
    }

    /// The baseline, which is the same in every part.
    ///
    /// # Errors
    /// The baseline cannot be read.
    pub fn baseline(&self) -> Result<Option<Baseline>, LogbookError> {
        self.0[0].baseline()
    }

    /// The events of all parts, in their order.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub fn events(&self) -> Result<Vec<Event>, LogbookError> {
        let mut events = Vec::new();
        for part in &self.0 {
            events.extend(part.events()?);
        }
        Ok(events)
    }

    /// Number of frames.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub fn len(&self) -> Result<u64, LogbookError> {
        let mut frames = 0;
        for (part, next) in self.with_next() {
            let last = part.last_sequence()?;
            let begun_again = next.map_or(0, |next| (last + 1).saturating_sub(next));
            frames += part.len()?.saturating_sub(begun_again);
        }
        Ok(frames)
    }

    /// Whether there is no frame.
    ///
    /// # Errors
    /// As [`SessionParts::len`].
    pub fn is_empty(&self) -> Result<bool, LogbookError> {
        Ok(self.len()? == 0)
    }

    /// Sequence number of the last frame; one less than the first's if there are none.
    ///
    /// # Errors
    /// The last part cannot be read.
    pub fn last_sequence(&self) -> Result<u64, LogbookError> {
        self.0.last().unwrap_or(&self.0[0]).last_sequence()
    }

    /// The frame with this sequence number.
    ///
    /// # Errors
    /// It does not exist or is damaged.
    pub fn frame(&self, sequence: u64) -> Result<Record, LogbookError> {
        let mut before = self.0.iter().rev();
        let part = before.find(|part| part.header().first_sequence <= sequence);
        part.unwrap_or(&self.0[0]).frame(sequence)
    }

    /// All frames in order, each read on demand.
    pub fn frames(&self) -> impl Iterator<Item = Result<Record, LogbookError>> {
        self.frames_from(1)
    }

    /// The frames from a sequence number on, as [`SessionParts::frames`].
    pub fn frames_from(&self, sequence: u64) -> impl Iterator<Item = Result<Record, LogbookError>> {
        let reaches = move |(_, next): &(_, Option<u64>)| next.is_none_or(|next| next > sequence);
        self.with_next()
            .filter(reaches)
            .flat_map(move |(part, next)| {
                // frames after the start of the next part were written again there
                let own = move |record: &Result<Record, LogbookError>| match (record, next) {
                    (Ok(record), Some(next)) => record.frame.sequence < next,
                    _ => true,
                };
                part.frames_from(sequence).filter(own)
            })
    }

    /// Each part, and the first sequence number of the next.
    fn with_next(&self) -> impl Iterator<Item = (&SessionReader, Option<u64>)> {
        let next = self.0.iter().skip(1);
        let begins = next.map(|part| Some(part.header().first_sequence));
        self.0.iter().zip(begins.chain([None]))
    }
}
