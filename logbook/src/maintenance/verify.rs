//! Verifies a session: checksums, sequence, references, baseline, the chain of parts, and an event for every gap.

use std::path::Path;

use chrono::{DateTime, TimeDelta, Utc};
use serde::Serialize;

use crate::files::{id_of, part_of, parts};
use crate::maintenance::prune::pruned_parts;
use crate::writer::CONTINUED_IN;
use crate::{CUT, Event, FrameRecord, LogbookError, RESUMED, SessionReader};
use outfile::folder_of;

/// A gap in a scheduled session: frames further apart than this many periods.
const GAP_PERIODS: f64 = 1.5;
/// A gap in a session without a schedule: frames further apart than this many times the usual interval.
const GAP_FACTOR: f64 = 5.0;
/// Shorter intervals are never a gap, s.
const MIN_GAP_S: f64 = 1.0;
/// An event this long after a frame may still explain the gap.
const EVENT_MAY_FOLLOW_S: TimeDelta = TimeDelta::try_seconds(5).unwrap();

/// A defect of a session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Id of the part.
    pub part: String,
    /// Machine-readable kind: `unreadable`, `header`, `closing`, `damaged`, `missing`, `chain`, `baseline`, `event`,
    /// `gap`.
    pub kind: &'static str,
    /// Text for people.
    pub text: String,
}

/// Two frames further apart than usual in this session.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Gap {
    /// Sequence of the frame before.
    pub after: u64,
    /// Its length, s.
    pub seconds: f64,
    /// The event that explains it, if there is one.
    pub explained: Option<String>,
}

/// Result of the verification.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verified {
    /// Id of the session: its first part's.
    pub session: String,
    /// Ids of its parts, in order.
    pub parts: Vec<String>,
    /// Intact frames.
    pub frames: u64,
    /// Whether the last part was closed.
    pub closed: bool,
    /// Every gap, explained or not.
    pub gaps: Vec<Gap>,
    /// What is wrong; empty where nothing is.
    pub findings: Vec<Finding>,
}

/// Verifies all parts of a session, whichever part is given. `progress` is called with the number of frames read.
///
/// # Errors
/// The folder cannot be read. Unreadable files and damage are findings, not errors.
pub fn verify(
    path: impl AsRef<Path>,
    mut progress: impl FnMut(u64),
) -> Result<Verified, LogbookError> {
    let path = path.as_ref();
    let mut look = VerifyState::default();
    let mut files = parts(path)?;
    if files.is_empty() {
        files.push(path.to_owned());
    }
    for file in &files {
        look.part(file, &mut progress);
    }
    look.ends(folder_of(path));
    let gaps = look.gaps();
    for gap in gaps.iter().filter(|gap| gap.explained.is_none()) {
        let part = look.part_of_frame(gap.after);
        look.found(
            &part,
            "gap",
            format!(
                "{:.1} s without a frame after frame {}, and no event explains it",
                gap.seconds, gap.after
            ),
        );
    }
    Ok(Verified {
        session: match look.session.is_empty() {
            true => part_of(id_of(path)).0.to_owned(),
            false => look.session,
        },
        parts: look.parts.into_iter().map(|(id, _)| id).collect(),
        frames: look.frames,
        closed: look.closed,
        gaps,
        findings: look.findings,
    })
}

/// The times of a frame.
#[derive(Clone, Copy)]
struct FrameTime {
    sequence: u64,
    monotonic: f64,
    wall: DateTime<Utc>,
}

/// Intermediate results.
#[derive(Default)]
struct VerifyState {
    session: String,
    /// Ids, with the first sequence of each.
    parts: Vec<(String, u64)>,
    /// Each part with the part that it continues.
    continues: Vec<(String, String)>,
    /// Each closed part with its closing reason.
    closings: Vec<(String, String)>,
    /// Files that are not sessions, and why: unfinished new parts, or remains of one.
    strangers: Vec<(String, String)>,
    frames: u64,
    closed: bool,
    /// Intervals between neighbouring frames that may be gaps, s.
    distances: Vec<f64>,
    moments: Vec<(FrameTime, FrameTime, f64)>,
    last: Option<FrameTime>,
    events: Vec<Event>,
    period: Option<f64>,
    findings: Vec<Finding>,
    /// Sequence of the last frame that was found or is known to be missing.
    expected: Option<u64>,
}

impl VerifyState {
    fn found(&mut self, part: &str, kind: &'static str, text: String) {
        self.findings.push(Finding {
            part: part.to_owned(),
            kind,
            text,
        });
    }

    fn part_of_frame(&self, sequence: u64) -> String {
        self.parts
            .iter()
            .rev()
            .find(|(_, first)| *first <= sequence)
            .map(|(id, _)| id.clone())
            .unwrap_or_default()
    }

    fn part(&mut self, path: &Path, progress: &mut impl FnMut(u64)) {
        let stem = id_of(path);
        let session = match SessionReader::open(path) {
            Ok(session) => session,
            Err(damage @ LogbookError::Damaged { .. }) => {
                return self.found(stem, "header", damage.to_string());
            }
            Err(stranger @ LogbookError::NotASession { .. }) => {
                return self.strangers.push((stem.to_owned(), stranger.to_string()));
            }
            Err(refusal) => return self.found(stem, "unreadable", survey::error_chain(&refusal)),
        };
        let header = session.header().clone();
        let id = header.id.clone();
        self.session = header.session().to_owned();
        self.closed = session.closed().is_some();
        if let Some(earlier) = &header.continues {
            self.continues.push((id.clone(), earlier.clone()));
        }
        if let Some(closing) = session.closed() {
            self.closings.push((id.clone(), closing.reason.clone()));
        }
        for (kind, text) in session.faults() {
            self.found(&id, kind, text);
        }
        self.period = serde_json::from_str::<serde_json::Value>(&header.asked)
            .ok()
            .and_then(|asked| asked["every_s"].as_f64())
            .filter(|period| *period > 0.0)
            .or(self.period);
        self.chain(
            folder_of(path),
            &header.continues,
            header.first_sequence,
            &id,
        );
        self.parts.push((id.clone(), header.first_sequence));
        match session.events_and_damaged() {
            Ok((events, damaged)) => {
                self.events.extend(events);
                for number in damaged {
                    let text = format!("event {number} does not agree with its checksum");
                    self.found(&id, "event", text);
                }
            }
            Err(damage) => self.found(&id, "event", damage.to_string()),
        }
        if let Err(damage) = session.baseline() {
            self.found(&id, "baseline", damage.to_string());
        }
        self.expected = Some(header.first_sequence);
        let first_sequence = header.first_sequence;
        // Frames of an earlier part from this sequence on were written again in this part.
        self.moments
            .retain(|(_, later, _)| later.sequence < first_sequence);
        if self
            .last
            .is_some_and(|last| last.sequence >= first_sequence)
        {
            self.last = self.moments.last().map(|(_, later, _)| *later);
        }
        // Counted before reading, because a running session grows meanwhile.
        let rows = session.rows();
        let mut met = 0;
        for record in session.frames() {
            met += 1;
            match record {
                Ok(record) => self.frame(&id, &record),
                Err(damage) => {
                    self.found(&id, "damaged", damage.to_string());
                    // The error names its sequence; the row exists, intact or not.
                    self.expected = self.expected.map(|expected| expected + 1);
                }
            }
            progress(self.frames);
        }
        match rows {
            Ok(rows) => {
                if let Some(text) = session.unmet(rows, met) {
                    self.found(&id, "damaged", text);
                }
            }
            Err(damage) => self.found(&id, "damaged", damage.to_string()),
        }
    }

    /// Checks that the parts named by others exist. A file that is not a session does not count: its creation was
    /// interrupted, and the session continued in another part.
    fn ends(&mut self, folder: &Path) {
        let ids: Vec<&str> = self.parts.iter().map(|(id, _)| id.as_str()).collect();
        let mut found = Vec::new();
        for (id, reason) in &self.closings {
            let Some(next) = reason.strip_prefix(CONTINUED_IN) else {
                continue;
            };
            let is_known = ids.contains(&next) || self.strangers.iter().any(|(id, _)| id == next);
            if !is_known && !pruned_parts(folder).contains(next) {
                let text = format!("it was closed as continued in {next}, which is missing");
                found.push((id.clone(), "chain", text));
            }
        }
        for (stem, why) in &self.strangers {
            let number = part_of(stem).1;
            let is_named = self
                .closings
                .iter()
                .any(|(_, reason)| reason.strip_prefix(CONTINUED_IN) == Some(stem.as_str()));
            let was_passed_over = self
                .continues
                .iter()
                .any(|(later, earlier)| part_of(later).1 > number && part_of(earlier).1 < number);
            if is_named || !was_passed_over {
                found.push((stem.clone(), "unreadable", why.clone()));
            }
        }
        for (part, kind, text) in found {
            self.found(&part, kind, text);
        }
    }

    fn chain(&mut self, folder: &Path, continues: &Option<String>, first: u64, id: &str) {
        let before = self.parts.last().map(|(id, _)| id.clone());
        match (continues, before) {
            (None, None) => {}
            (Some(earlier), Some(before)) if *earlier == before => {
                let next = self.expected.unwrap_or(first);
                if next < first {
                    self.missing(id, next, first - 1);
                }
            }
            (Some(earlier), _) => {
                if !pruned_parts(folder).contains(earlier) {
                    let text = format!("it continues {earlier}, which is missing");
                    self.found(id, "chain", text);
                }
            }
            (None, Some(before)) => {
                let text = format!("it is named as a part after {before}, but continues none");
                self.found(id, "chain", text);
            }
        }
    }

    fn missing(&mut self, part: &str, from: u64, to: u64) {
        let cut = format!("frames {from} to {to} ");
        let is_cut = |event: &Event| event.kind == CUT && event.text.starts_with(&cut);
        if !self.events.iter().any(is_cut) {
            let text = format!("frames {from} to {to} are missing");
            self.found(part, "missing", text);
        }
    }

    fn frame(&mut self, part: &str, record: &FrameRecord) {
        let sequence = record.frame.sequence;
        if let Some(expected) = self.expected
            && sequence > expected
        {
            self.missing(part, expected, sequence - 1);
        }
        self.expected = Some(sequence + 1);
        self.frames += 1;
        let now = FrameTime {
            sequence,
            monotonic: record.frame.monotonic.as_secs_f64(),
            wall: record.frame.wall,
        };
        if let Some(last) = self.last {
            let by_wall = (now.wall - last.wall).as_seconds_f64();
            let by_clock = now.monotonic - last.monotonic;
            // A monotonic clock that restarted belongs to another process: use the wall clock.
            let apart = if by_clock < 0.0 { by_wall } else { by_clock };
            self.distances.push(apart);
            let least = self.period.map_or(MIN_GAP_S, |period| GAP_PERIODS * period);
            if apart > least || by_clock < 0.0 {
                self.moments.push((last, now, apart));
            }
        }
        self.last = Some(now);
    }

    /// The intervals that are gaps.
    fn gaps(&mut self) -> Vec<Gap> {
        let usual = match self.distances.len() {
            0 => 0.0,
            count => {
                let (_, median, _) = self
                    .distances
                    .select_nth_unstable_by(count / 2, f64::total_cmp);
                *median
            }
        };
        let most = match self.period {
            // A frame that takes longer than its period directly follows the previous one.
            Some(period) => GAP_PERIODS * period.max(usual),
            None => (GAP_FACTOR * usual).max(MIN_GAP_S),
        };
        let explains = |before: &FrameTime, after: &FrameTime| {
            let (from, to) = match before.wall <= after.wall {
                true => (before.wall, after.wall),
                // The clock was set back.
                false => (after.wall, before.wall),
            };
            // a forged session may name a time at the end of the calendar
            let to = to
                .checked_add_signed(EVENT_MAY_FOLLOW_S)
                .unwrap_or(DateTime::<Utc>::MAX_UTC);
            let within = |event: &&Event| (from..=to).contains(&event.at);
            let mut events = self.events.iter().filter(within);
            let restart = events.clone().find(|event| event.kind == RESUMED);
            restart.or_else(|| events.next())
        };
        self.moments
            .iter()
            .filter(|(.., apart)| *apart > most)
            .map(|(before, after, apart)| Gap {
                after: before.sequence,
                seconds: *apart,
                explained: explains(before, after)
                    .map(|event| format!("{}: {}", event.kind, event.text)),
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn gap_at_the_end_of_the_calendar_is_explained_by_an_event() {
        let frame = |sequence, wall| FrameTime {
            sequence,
            monotonic: 100.0 * sequence as f64,
            wall,
        };
        let last = DateTime::<Utc>::MAX_UTC;
        let (before, after) = (frame(1, last - Duration::from_secs(100)), frame(2, last));
        let mut look = VerifyState {
            moments: vec![(before, after, 100.0)],
            events: vec![Event {
                at: last,
                kind: "note".into(),
                text: "the end".into(),
            }],
            ..VerifyState::default()
        };
        let gaps = look.gaps();
        assert_eq!(gaps[0].explained.as_deref(), Some("note: the end"));
    }
}
