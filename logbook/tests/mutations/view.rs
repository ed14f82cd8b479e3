//! Everything that a reader can get from a session.

use std::path::Path;

use logbook::{FrameRecord, LogbookError, SessionReader};

#[derive(Debug, Default, PartialEq)]
pub struct View {
    header: String,
    pub closed: Option<String>,
    baseline: Option<String>,
    events: Vec<String>,
    pub frames: Vec<Seen>,
    /// Frames read one by one, which must equal those read in sequence.
    one_by_one: Vec<String>,
    refused: Vec<String>,
}

/// A frame, and the record of its map.
#[derive(Debug, PartialEq)]
pub struct Seen {
    frame: String,
    map: Option<String>,
}

fn shown(value: impl std::fmt::Debug) -> String {
    format!("{value:?}")
}

fn seen(record: FrameRecord) -> Seen {
    Seen {
        frame: shown((&record.frame, &record.quality)),
        map: record.map.map(shown),
    }
}

impl View {
    pub fn of(path: &Path) -> Self {
        let mut view = Self::default();
        let session = match SessionReader::open(path) {
            Ok(session) => session,
            Err(refusal) => {
                view.refused.push(shown(&refusal));
                return view;
            }
        };
        view.header = shown(session.header());
        view.closed = session.closed().map(shown);
        let refused = |refusal: LogbookError| vec![shown(refusal)];
        match session.baseline() {
            Ok(baseline) => view.baseline = baseline.map(shown),
            Err(refusal) => view.refused.extend(refused(refusal)),
        }
        match session.events() {
            Ok(events) => view.events = events.iter().map(shown).collect(),
            Err(refusal) => view.refused.extend(refused(refusal)),
        }
        for record in session.frames().take(10_000) {
            match record {
                Ok(record) => view.frames.push(seen(record)),
                Err(refusal) => view.refused.extend(refused(refusal)),
            }
        }
        for number in 0..=view.frames.len() as u64 + 1 {
            match session.frame(number) {
                Ok(record) => view.one_by_one.push(shown(seen(record))),
                Err(LogbookError::NoSuchFrame { .. }) => view.one_by_one.push("none".into()),
                Err(refusal) => view.refused.extend(refused(refusal)),
            }
        }
        let summary = session.summary().map(|summary| {
            let (last, frames) = (summary.last, summary.frames);
            shown((last, frames, summary.note))
        });
        view.one_by_one.push(shown(summary));
        view
    }

    /// Whether a writer that was killed earlier could have left this.
    pub fn is_beginning_of(&self, whole: &Self) -> bool {
        // killed before the header was on disk: the file is refused as not a session
        let before_the_header = self.header.is_empty()
            && self
                .refused
                .iter()
                .all(|refusal| refusal.starts_with("NotASession"));
        let frames = self.frames.iter().zip(&whole.frames);
        let alike = |(own, other): (&Seen, &Seen)| {
            own.frame == other.frame && (own.map.is_none() || own.map == other.map)
        };
        before_the_header
            || self.refused.is_empty()
                && self.header == whole.header
                && self.closed == whole.closed
                && (self.baseline.is_none() || self.baseline == whole.baseline)
                && whole.events.starts_with(&self.events)
                && self.frames.len() <= whole.frames.len()
                && frames.into_iter().all(alike)
    }
}
