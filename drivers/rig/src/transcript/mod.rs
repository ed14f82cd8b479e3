//! Transcripts of the messages to and from instruments, one JSON object a line, for reading and for replay to a
//! simulator.
//!
//! ```json
//! {"t_s":0.0,"instrument":"meter at 10.0.0.7:5025","sent":"*IDN?"}
//! {"t_s":0.0031,"instrument":"meter at 10.0.0.7:5025","received":"A MAKER,A METER,MY44000001,2.43"}
//! {"t_s":0.0032,"instrument":"meter at 10.0.0.7:5025","note":"the cover of the sheet was opened"}
//! ```
//!
//! Messages and replies have no line ends; they are in the order of transmission.

pub(crate) mod ring;

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

/// Longest transcript that is read, bytes.
const LARGEST: u64 = 256 * 1024 * 1024;

/// One line of a transcript.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Line")]
pub struct Entry {
    /// Seconds since the transcript began; finite, not negative.
    pub t_s: f64,
    /// The instrument's name; its first word identifies the model, the rest may be its address.
    pub instrument: String,
    /// The entry's content.
    #[serde(flatten)]
    pub content: EntryContent,
}

impl Entry {
    /// The first word of the instrument's name, in lower case.
    pub fn model(&self) -> String {
        let first = self.instrument.split_whitespace().next();
        first.unwrap_or_default().to_lowercase()
    }
}

/// A transmitted line, or a note.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EntryContent {
    /// A message to the instrument.
    Sent(String),
    /// A line from the instrument.
    Received(String),
    /// Anything else: connected, no answer within 5 s, disconnected.
    Note(String),
}

/// An entry as it is read.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    t_s: f64,
    instrument: String,
    sent: Option<String>,
    received: Option<String>,
    note: Option<String>,
}

impl TryFrom<Line> for Entry {
    type Error = String;

    fn try_from(line: Line) -> Result<Self, String> {
        if !(line.t_s.is_finite() && line.t_s >= 0.0) {
            return Err(format!("t_s is {}, not a time since the start", line.t_s));
        }
        if line.instrument.trim().is_empty() {
            return Err("instrument is empty".to_owned());
        }
        let content = match (line.sent, line.received, line.note) {
            (Some(sent), None, None) => EntryContent::Sent(sent),
            (None, Some(received), None) => EntryContent::Received(received),
            (None, None, Some(note)) => EntryContent::Note(note),
            _ => return Err("exactly one of sent, received and note must be given".to_owned()),
        };
        Ok(Self {
            t_s: line.t_s,
            instrument: line.instrument,
            content,
        })
    }
}

/// Why a transcript cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum TranscriptError {
    /// The file cannot be opened or read.
    #[error("the transcript {} cannot be read; check the path and that it is text", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        #[source]
        cause: io::Error,
    },
    /// The file exceeds the limit.
    #[error("the transcript {} has more than {LARGEST} bytes; cut out the part of interest", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
    },
    /// A line that is not an entry.
    #[error(
        "{place}:{line}: {problem}; a line is {{\"t_s\":SECONDS,\"instrument\":\"NAME\",\"sent\":\"TEXT\"}}, or with received or note in place of sent"
    )]
    Line {
        /// The file, or the name used for it in messages.
        place: String,
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong with the line.
        problem: String,
    },
    /// The file cannot be created or written.
    #[error("the transcript {} cannot be written; check the folder, its permissions and the space on the disk", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        #[source]
        cause: io::Error,
    },
}

/// Reads a transcript from a file. Returns the entries in order, each with its line number (from 1).
///
/// # Errors
/// A file that cannot be read or is larger than 256 MiB; a line that is not an entry, with file and line.
pub fn read_transcript(path: &Path) -> Result<Vec<(usize, Entry)>, TranscriptError> {
    let unreadable = |cause| TranscriptError::Unreadable {
        path: path.to_owned(),
        cause,
    };
    if std::fs::metadata(path).map_err(unreadable)?.len() > LARGEST {
        return Err(TranscriptError::TooLarge {
            path: path.to_owned(),
        });
    }
    let text = std::fs::read_to_string(path).map_err(unreadable)?;
    parse_transcript(&path.display().to_string(), &text)
}

/// Reads a transcript from text; `place` is its name in errors. Returns the entries in order, each with its line number
/// (from 1). Empty lines are skipped; an incomplete last line (left by a killed process) is an error.
///
/// # Errors
/// A line that is not an entry.
pub fn parse_transcript(place: &str, text: &str) -> Result<Vec<(usize, Entry)>, TranscriptError> {
    let lines = text.lines().enumerate();
    lines
        .filter(|(_, line)| !line.trim().is_empty())
        .map(|(index, line)| {
            let entry = serde_json::from_str(line).map_err(|fault| TranscriptError::Line {
                place: place.to_owned(),
                line: index + 1,
                problem: fault.to_string(),
            })?;
            Ok((index + 1, entry))
        })
        .collect()
}

/// Writes a transcript. Each entry is flushed at once, so that the transcript survives a crash of the process.
#[derive(Debug)]
pub struct TranscriptWriter {
    file: BufWriter<File>,
    path: PathBuf,
}

impl TranscriptWriter {
    /// Creates the file, which must not exist.
    ///
    /// # Errors
    /// A file that cannot be created, or exists.
    pub fn create(path: &Path) -> Result<Self, TranscriptError> {
        let made = outfile::create_in_place(path);
        Ok(Self {
            file: BufWriter::new(made.map_err(|refused| TranscriptError::Unwritable {
                path: path.to_owned(),
                cause: refused.into_io(),
            })?),
            path: path.to_owned(),
        })
    }

    /// Appends an entry.
    ///
    /// # Errors
    /// A disk error; a time that is not finite.
    pub fn write(&mut self, entry: &Entry) -> Result<(), TranscriptError> {
        let unwritable = |cause| TranscriptError::Unwritable {
            path: self.path.clone(),
            cause,
        };
        if !(entry.t_s.is_finite() && entry.t_s >= 0.0) {
            let problem = format!("an entry at {} s", entry.t_s);
            return Err(unwritable(io::Error::new(
                io::ErrorKind::InvalidInput,
                problem,
            )));
        }
        let mut line = serde_json::to_vec(entry).map_err(|fault| unwritable(fault.into()))?;
        line.push(b'\n');
        self.file.write_all(&line).map_err(unwritable)?;
        self.file.flush().map_err(unwritable)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(t_s: f64, content: EntryContent) -> Entry {
        Entry {
            t_s,
            instrument: "34980A at 10.0.0.7:5025".to_owned(),
            content,
        }
    }

    #[test]
    fn what_is_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("talk.jsonl");
        let entries = [
            entry(0.0, EntryContent::Sent("*IDN?".to_owned())),
            entry(0.25, EntryContent::Received("\"Zürich\", 1".to_owned())),
            entry(1.0, EntryContent::Note(String::new())),
        ];
        let mut writer = TranscriptWriter::create(&path).unwrap();
        for entry in &entries {
            writer.write(entry).unwrap();
        }
        assert!(
            writer
                .write(&entry(f64::NAN, EntryContent::Note(String::new())))
                .is_err()
        );
        // an existing transcript is not overwritten
        assert!(TranscriptWriter::create(&path).is_err());
        let read = read_transcript(&path).unwrap();
        assert_eq!(
            read.iter().map(|(line, _)| *line).collect::<Vec<_>>(),
            [1, 2, 3]
        );
        assert!(read.iter().map(|(_, entry)| entry).eq(&entries));
        assert_eq!(read[0].1.model(), "34980a");
        let text = std::fs::read_to_string(&path).unwrap();
        let first = r#"{"t_s":0.0,"instrument":"34980A at 10.0.0.7:5025","sent":"*IDN?"}"#;
        assert_eq!(text.lines().next(), Some(first));
    }

    #[test]
    fn what_is_no_entry_is_named_by_its_line() {
        let sound = r#"{"t_s":0,"instrument":"6221","sent":"*RST"}"#;
        for wrong in [
            r#"{"t_s":0,"instrument":"6221"}"#,
            r#"{"t_s":0,"instrument":"6221","sent":"a","received":"b"}"#,
            r#"{"t_s":-1,"instrument":"6221","sent":"a"}"#,
            r#"{"t_s":1e999,"instrument":"6221","sent":"a"}"#,
            r#"{"t_s":0,"instrument":" ","sent":"a"}"#,
            r#"{"t_s":0,"instrument":"6221","sent":"a","spoken":"b"}"#,
            r#"{"t_s":0,"instru"#,
        ] {
            let refused = parse_transcript("talk.jsonl", &format!("{sound}\n\n{wrong}\n"));
            let refused = refused.unwrap_err().to_string();
            assert!(refused.starts_with("talk.jsonl:3: "), "{wrong}: {refused}");
        }
        let refused = read_transcript(Path::new("/nowhere/talk.jsonl")).unwrap_err();
        assert!(refused.to_string().contains("/nowhere/talk.jsonl"));
    }
}
