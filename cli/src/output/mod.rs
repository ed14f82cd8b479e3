//! Output: text for people, or one JSON object per line for scripts.

pub(crate) mod progress;
pub(crate) mod screen;
pub(crate) mod table;
pub(crate) mod time;

use std::io::{IsTerminal, Write};

use serde::Serialize;
use survey::{printable_json, printable_lines};

use crate::failure::Failure;

/// Destination and format of the output.
pub(crate) struct Printer<W> {
    json: bool,
    colour: Colour,
    terminal: bool,
    sink: W,
}

/// Whether maps are drawn in colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum Colour {
    /// True colour on a terminal, plain otherwise.
    #[default]
    Auto,
    /// True colour always.
    Always,
    /// Never.
    Never,
}

impl Printer<std::io::Stdout> {
    pub(crate) fn stdout(json: bool, colour: Colour) -> Self {
        Self {
            json,
            colour,
            terminal: std::io::stdout().is_terminal(),
            sink: std::io::stdout(),
        }
    }
}

impl<W: Write> Printer<W> {
    /// Prints to any sink, as if it were not a terminal.
    #[cfg(test)]
    pub(crate) fn into(json: bool, sink: W) -> Self {
        Self {
            json,
            colour: Colour::Never,
            terminal: false,
            sink,
        }
    }

    #[cfg(test)]
    pub(crate) fn sink(self) -> W {
        self.sink
    }

    pub(crate) fn is_json(&self) -> bool {
        self.json
    }

    /// Whether text goes to a terminal.
    pub(crate) fn is_terminal(&self) -> bool {
        self.terminal && !self.json
    }

    /// Columns of the terminal; 80 if unknown.
    pub(crate) fn width(&self) -> usize {
        let measured = self.terminal.then(terminal_size).flatten();
        let from_environment = || std::env::var("COLUMNS").ok()?.parse().ok();
        measured
            .map(|(columns, _)| columns)
            .or_else(from_environment)
            .unwrap_or(80)
            .clamp(20, 400)
    }

    /// The colours of maps.
    pub(crate) fn map_colour(&self) -> render::TerminalColour {
        let wanted = match self.colour {
            Colour::Always => true,
            Colour::Never => false,
            Colour::Auto => self.terminal && std::env::var_os("NO_COLOR").is_none(),
        };
        if !wanted {
            return render::TerminalColour::Plain;
        }
        let says = std::env::var("COLORTERM").unwrap_or_default();
        if self.colour == Colour::Always || says == "truecolor" || says == "24bit" {
            render::TerminalColour::TrueColour
        } else {
            render::TerminalColour::Ansi256
        }
    }

    /// Prints one record: as a JSON line, or as the text from `person`.
    ///
    /// # Errors
    /// [`Failure::Closed`] if the reader has closed the output.
    pub(crate) fn record<T: Serialize>(
        &mut self,
        record: &T,
        person: impl FnOnce(&T) -> String,
    ) -> Result<(), Failure> {
        let line =
            if self.json {
                let json = serde_json::to_string(record);
                printable_json(json.map_err(|error| {
                    Failure::failed("a result cannot be written as JSON", &error)
                })?)
            } else {
                printable_lines(&person(record)).into_owned()
            };
        self.line(&line)
    }

    /// Prints records: each as a JSON line, or as a row of a table.
    ///
    /// # Errors
    /// As [`Printer::record`].
    pub(crate) fn table<T: Serialize, const N: usize>(
        &mut self,
        heading: [&str; N],
        records: &[T],
        row: impl Fn(&T) -> [String; N],
    ) -> Result<(), Failure> {
        if self.json {
            return records
                .iter()
                .try_for_each(|record| self.record(record, |_| String::new()));
        }
        let rows: Vec<[String; N]> = records.iter().map(row).collect();
        self.text(&table::columns(heading, &rows))
    }

    /// Prints text; nothing with `--json`.
    pub(crate) fn text(&mut self, text: &str) -> Result<(), Failure> {
        if self.json {
            return Ok(());
        }
        self.line(&printable_lines(text))
    }

    /// Prints a map drawn by this program, including escape sequences; nothing with `--json`.
    pub(crate) fn drawn(&mut self, map: &str) -> Result<(), Failure> {
        if self.json {
            return Ok(());
        }
        self.line(map)
    }

    /// Prints unchanged bytes (a script for a shell, a CSV table).
    pub(crate) fn raw(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        self.sink
            .write_all(bytes)
            .and_then(|()| self.sink.flush())
            .map_err(|error| written(&error))
    }

    fn line(&mut self, line: &str) -> Result<(), Failure> {
        if line.is_empty() {
            return Ok(());
        }
        writeln!(self.sink, "{}", line.trim_end_matches('\n'))
            .and_then(|()| self.sink.flush())
            .map_err(|error| written(&error))
    }
}

/// Columns and rows of the terminal on standard output; `None` if it is not one.
fn terminal_size() -> Option<(usize, usize)> {
    let size = rustix::termios::tcgetwinsize(std::io::stdout()).ok()?;
    Some((usize::from(size.ws_col), usize::from(size.ws_row)))
        .filter(|&(columns, rows)| columns > 0 && rows > 0)
}

/// Prints on standard error why the command failed, as text or as one JSON object.
pub(crate) fn report(failure: &Failure, json: bool) {
    let text = failure.to_string();
    if !json {
        return complain(&format!("tactus: {text}"));
    }
    eprintln!(
        "{}",
        survey::error_line(failure.kind(), failure.code(), &text)
    );
}

/// Prints a message on standard error. Its further lines are indented, so that text from outside cannot imitate a
/// message of this program.
pub(crate) fn complain(text: &str) {
    eprintln!("{}", printable_lines(text.trim_end()).replace('\n', "\n  "));
}

pub(crate) fn written(error: &std::io::Error) -> Failure {
    if error.kind() == std::io::ErrorKind::BrokenPipe {
        Failure::Closed
    } else {
        Failure::failed("the output cannot be written", error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize)]
    struct Answer {
        state: &'static str,
    }

    #[test]
    fn a_record_is_one_line_in_either_language() {
        let mut json = Printer::into(true, Vec::new());
        json.record(&Answer { state: "idle" }, |_| unreachable!())
            .unwrap();
        json.text("for a person only").unwrap();
        assert_eq!(json.sink(), b"{\"state\":\"idle\"}\n");
        let mut text = Printer::into(false, Vec::new());
        text.record(&Answer { state: "idle" }, |answer| {
            format!("state: {}", answer.state)
        })
        .unwrap();
        assert_eq!(text.sink(), b"state: idle\n");
    }

    #[test]
    fn nothing_that_acts_on_a_terminal_is_printed() {
        #[derive(Serialize)]
        struct Note {
            text: String,
        }
        let text = "\x1b[2J\u{202e}\u{9b}\r\0".to_owned();
        let note = Note { text };
        let mut json = Printer::into(true, Vec::new());
        json.record(&note, |_| unreachable!()).unwrap();
        let json = String::from_utf8(json.sink()).unwrap();
        assert!(
            json.trim_end()
                .chars()
                .all(|letter| letter.is_ascii_graphic()),
            "{json:?}"
        );
        let back: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(back["text"], note.text);
        let mut person = Printer::into(false, Vec::new());
        person.record(&note, |note| note.text.clone()).unwrap();
        person.text(&note.text).unwrap();
        let shown = String::from_utf8(person.sink()).unwrap();
        let line = "\\u{1b}[2J\\u{202e}\\u{9b}\\r\\0\n";
        assert_eq!(shown, [line, line].concat());
    }

    #[test]
    fn a_reader_that_has_gone_is_no_failure() {
        struct Gone;
        impl Write for Gone {
            fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
                Err(std::io::ErrorKind::BrokenPipe.into())
            }
            fn flush(&mut self) -> std::io::Result<()> {
                Ok(())
            }
        }
        let refusal = Printer::into(false, Gone).text("x").unwrap_err();
        assert_eq!(refusal.code(), 0);
    }
}
