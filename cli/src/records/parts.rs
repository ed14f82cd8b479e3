//! A recorded session as one, whatever parts it was rolled over into; read frame by frame, however many there are.

use std::path::Path;

use logbook::{LogbookError, Record, SessionHeader, SessionReader};
use survey::Baseline;

use crate::failure::Failure;
use crate::records::directory::{open, refused};

/// Parts in their order, one at least.
pub(crate) struct Parts(Vec<SessionReader>);

impl Parts {
    /// What a person named: a session by its first part with all that follow, or a later part by itself.
    ///
    /// # Errors
    /// A part that cannot be read.
    pub(crate) fn open(path: &Path) -> Result<Self, Failure> {
        let mut parts = vec![open(path)?];
        if parts[0].header().continues.is_none() {
            let all = logbook::parts(path).map_err(|error| refused(&error))?;
            let named = path.file_name();
            for other in all.iter().filter(|other| other.file_name() != named) {
                match SessionReader::open(other) {
                    // the making of a part that was cut short: it never held anything
                    Err(LogbookError::NotASession { .. }) => {}
                    part => parts.push(part.map_err(|error| refused(&error))?),
                }
            }
        }
        Ok(Self(parts))
    }

    /// Of the part that was named.
    pub(crate) fn header(&self) -> &SessionHeader {
        self.0[0].header()
    }

    pub(crate) fn each(&self) -> &[SessionReader] {
        &self.0
    }

    /// Every part has the same one.
    pub(crate) fn baseline(&self) -> Result<Option<Baseline>, Failure> {
        self.0[0].baseline().map_err(|error| refused(&error))
    }

    /// How many frames there are.
    pub(crate) fn len(&self) -> Result<u64, Failure> {
        let mut frames = 0;
        for (part, next) in self.with_next() {
            let last = part.last_sequence().map_err(|error| refused(&error))?;
            let begun_again = next.map_or(0, |next| (last + 1).saturating_sub(next));
            let own = part.len().map_err(|error| refused(&error))?;
            frames += own.saturating_sub(begun_again);
        }
        Ok(frames)
    }

    /// Sequence of the last frame; one less than the first's where there is none.
    pub(crate) fn last_sequence(&self) -> Result<u64, Failure> {
        self.0
            .last()
            .unwrap_or(&self.0[0])
            .last_sequence()
            .map_err(|error| refused(&error))
    }

    pub(crate) fn frame(&self, sequence: u64) -> Result<Record, Failure> {
        let mut before = self.0.iter().rev();
        let part = before.find(|part| part.header().first_sequence <= sequence);
        part.unwrap_or(&self.0[0])
            .frame(sequence)
            .map_err(|error| refused(&error))
    }

    /// All frames in order, one after the other as they are asked for.
    pub(crate) fn frames(&self) -> impl Iterator<Item = Result<Record, LogbookError>> {
        self.with_next().flat_map(|(part, next)| {
            // what a part has from where the next one begins was written again there
            let own = move |record: &Result<Record, LogbookError>| match (record, next) {
                (Ok(record), Some(next)) => record.frame.sequence < next,
                _ => true,
            };
            part.frames().filter(own)
        })
    }

    /// Each part, and the sequence that the next one begins with.
    fn with_next(&self) -> impl Iterator<Item = (&SessionReader, Option<u64>)> {
        let next = self.0.iter().skip(1);
        let begins = next.map(|part| Some(part.header().first_sequence));
        self.0.iter().zip(begins.chain([None]))
    }
}

/// Says that a frame cannot be read.
pub(crate) fn left_out(error: &LogbookError) {
    eprintln!(
        "tactus: a frame is left out: {}",
        crate::failure::chain(error)
    );
}
