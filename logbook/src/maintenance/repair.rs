//! Repair: copies the readable part of a damaged session to a new file.

use std::path::{Path, PathBuf};

use chrono::{DateTime, Utc};
use serde::Serialize;

use crate::files::{id_of, path_of};
use crate::reader::SMALLEST;
use crate::{FrameRecord, LogbookError, SessionHeader, SessionReader, SessionWriter, schema};
use outfile::folder_of;

/// Kind of the event that lists the frames lost in a repair; its text begins with, for example, `frames 5 to 9 `.
pub const CUT: &str = "cut";

/// Number of frames written together.
const GROUP: usize = 256;
/// Number of event rows tried one by one if they cannot be read in order.
const EVENTS: i64 = 100_000;

/// Frames that could not be read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LostFrames {
    /// The first of them.
    pub first: u64,
    /// The last of them.
    pub last: u64,
    /// Why, for the first of them.
    pub why: String,
}

/// Result of a repair.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Repaired {
    /// The new file.
    pub path: PathBuf,
    /// Frames kept.
    pub frames: u64,
    /// Events kept.
    pub events: usize,
    /// Whether a baseline was kept.
    pub baseline: bool,
    /// Frames that were lost.
    pub cut: Vec<LostFrames>,
    /// Other losses, a sentence each.
    pub lost: Vec<String>,
}

/// Copies the readable part of a session's file to a new file, which is closed; the damaged one is not changed. `out`
/// is the new file, by default `<id>_repaired.tactus` next to the damaged one.
///
/// # Errors
/// A header that cannot be read (without the protocol no reading means anything), an existing output file, or a disk
/// error.
pub fn repair(
    path: impl AsRef<Path>,
    out: Option<&Path>,
    at: DateTime<Utc>,
    mut progress: impl FnMut(u64),
) -> Result<Repaired, LogbookError> {
    let path = path.as_ref();
    let session = SessionReader::open_without_end(path)?;
    let beside = path_of(
        folder_of(path),
        &format!("{}_repaired", session.header().id),
    );
    let out = out.unwrap_or(&beside);
    let header = SessionHeader {
        id: id_of(out).to_owned(),
        ..session.header().clone()
    };
    let mut repaired = Repaired {
        path: path_of(folder_of(out), &header.id),
        frames: 0,
        events: 0,
        baseline: false,
        cut: Vec::new(),
        lost: Vec::new(),
    };
    let mut writer = SessionWriter::create(folder_of(out), &header)?;
    match session.baseline() {
        Ok(Some(baseline)) => {
            writer.baseline(&baseline)?;
            repaired.baseline = true;
        }
        Ok(None) => {}
        Err(damage) => repaired.lost.push(format!("the baseline: {damage}")),
    }
    events(&session, &mut writer, &mut repaired)?;
    let rows = session.rows();
    let mut met = 0;
    let size = std::fs::metadata(path).map_or(0, |found| found.len());
    let mut next = Rows {
        session: &session,
        next: header.first_sequence,
        end: header.first_sequence + size / SMALLEST as u64 + u64::from(schema::PAGE),
    };
    let mut group: Vec<FrameRecord> = Vec::new();
    for (number, found) in &mut next {
        met += 1;
        match found {
            Ok(record) => {
                let expected = group
                    .last()
                    .map_or(writer.acknowledged(), |last| last.frame.sequence)
                    + 1;
                if number > expected {
                    flush(&mut writer, &mut group, &mut repaired)?;
                    cut(&mut repaired, expected, number - 1, "not there");
                    writer.skip_to(number);
                }
                group.push(record);
                if group.len() == GROUP {
                    flush(&mut writer, &mut group, &mut repaired)?;
                    progress(repaired.frames);
                }
            }
            Err(damage) => cut(&mut repaired, number, number, &damage.to_string()),
        }
    }
    flush(&mut writer, &mut group, &mut repaired)?;
    if let Ok(rows) = rows {
        repaired.lost.extend(session.unmet(rows, met));
    }
    // Unreadable rows after the last intact frame may never have existed.
    let last = writer.acknowledged();
    if repaired.cut.iter().any(|cut| cut.last > last) {
        let text = format!("after frame {last} nothing can be read");
        repaired.lost.push(text);
    }
    repaired.cut.retain_mut(|cut| {
        cut.last = cut.last.min(last);
        cut.first <= last
    });
    for cut in &repaired.cut {
        let text = format!("frames {} to {} were cut: {}", cut.first, cut.last, cut.why);
        writer.event(at, CUT, &text)?;
    }
    for lost in &repaired.lost {
        writer.event(at, CUT, lost)?;
    }
    let text = format!("made from {} by repair", path.display());
    writer.event(at, "repaired", &text)?;
    match session.closed() {
        Some(closing) => {
            let reason = format!("{} (repaired)", closing.reason);
            writer.close(closing.at, &reason)?;
        }
        None => writer.close(at, "not closed (repaired)")?,
    }
    Ok(repaired)
}

fn events(
    session: &SessionReader,
    writer: &mut SessionWriter,
    repaired: &mut Repaired,
) -> Result<(), LogbookError> {
    let (events, damaged) = match session.events_and_damaged() {
        Ok(read) => read,
        Err(damage) => {
            repaired.lost.push(format!("events: {damage}"));
            let one_by_one = (1..=EVENTS).map_while(|number| session.event(number).transpose());
            (one_by_one.flatten().collect(), Vec::new())
        }
    };
    for number in damaged {
        let text = format!("event {number}: its checksum does not agree");
        repaired.lost.push(text);
    }
    for event in events {
        writer.event(event.at, &event.kind, &event.text)?;
        repaired.events += 1;
    }
    Ok(())
}

fn flush(
    writer: &mut SessionWriter,
    group: &mut Vec<FrameRecord>,
    repaired: &mut Repaired,
) -> Result<(), LogbookError> {
    repaired.frames += group.len() as u64;
    writer.append_kept(group)?;
    group.clear();
    Ok(())
}

fn cut(repaired: &mut Repaired, first: u64, last: u64, why: &str) {
    match repaired.cut.last_mut() {
        Some(before) if before.last + 1 >= first => before.last = before.last.max(last),
        _ => repaired.cut.push(LostFrames {
            first,
            last,
            why: why.to_owned(),
        }),
    }
}

/// Rows in order; a row that cannot be read yields an error and the next number is tried.
struct Rows<'a> {
    session: &'a SessionReader,
    next: u64,
    end: u64,
}

impl Iterator for Rows<'_> {
    type Item = (u64, Result<FrameRecord, LogbookError>);

    fn next(&mut self) -> Option<Self::Item> {
        while self.next < self.end {
            let number = self.next;
            match self.session.kept(number) {
                Ok(Some(record)) => {
                    self.next += 1;
                    return Some((number, Ok(record)));
                }
                Err(damage) => {
                    self.next += 1;
                    return Some((number, Err(damage)));
                }
                // A gap in the sequence, or the end.
                Ok(None) => match self.session.sequence_behind(number) {
                    Ok(Some(behind)) => self.next = behind,
                    Ok(None) => return None,
                    Err(_) => self.next += 1,
                },
            }
        }
        None
    }
}
