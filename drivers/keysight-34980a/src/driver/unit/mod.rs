//! The conversation with one mainframe: what is held back, what is asked, how answers are read.

mod readings;
mod relays;
mod settings;

use std::collections::BTreeMap;
use std::time::Duration;

use rig::{Link, MeterSettings, RigError, Stream};
use scpi::{ChannelEntry, ChannelList, ErrorEntry};
use survey::Relay;

use crate::command::{Command, Message, System};
use readings::split_error;

/// Entries of the error queue (section 7), and some more.
const MOST_ERRORS: usize = 25;

#[derive(Debug)]
pub(super) struct Unit<S> {
    pub(super) link: Link<S>,
    /// Relay moves that wait for the next question.
    pub(super) held: Vec<Command>,
    /// Moves were sent whose refusal nobody has looked for.
    pub(super) unchecked: bool,
    pub(super) prepared: Option<Prepared>,
    /// Range of each channel as last set; that of the bare voltmeter under `None`. Empty: not known.
    ranges: BTreeMap<Option<Relay>, f64>,
    /// Delay of each channel that has another one than all.
    delays: BTreeMap<Relay, Duration>,
    /// The scan list as last set, ascending.
    listed: Vec<Relay>,
    /// A measurement failed: what has been set is to be set again.
    doubted: bool,
    /// `*RST` is sent once, before the first preparation.
    reset: bool,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Prepared {
    pub(super) meter: MeterSettings,
    /// As asked for. The instrument scans ascending.
    pub(super) scan: Vec<Relay>,
    pub(super) deadline: Duration,
}

impl Prepared {
    fn ascending(&self) -> Vec<Relay> {
        let mut relays = self.scan.clone();
        relays.sort_unstable();
        relays
    }

    /// The scan list as written in commands; `(@)` means the bare voltmeter.
    fn list(&self) -> ChannelList {
        compact(&self.ascending())
    }

    /// Whether nothing has to be set for this that was not set for the other.
    pub(super) fn is_set_as(&self, other: &Self) -> bool {
        self.meter == other.meter && self.scan == other.scan
    }
}

impl<S: Stream> Unit<S> {
    pub(super) fn new(link: Link<S>) -> Self {
        Self {
            link,
            held: Vec::new(),
            unchecked: false,
            prepared: None,
            ranges: BTreeMap::new(),
            delays: BTreeMap::new(),
            listed: Vec::new(),
            doubted: false,
            reset: false,
        }
    }

    /// Sends what was held back together with these commands, the last of which is a question.
    pub(super) async fn ask(
        &mut self,
        commands: Vec<Command>,
        deadline: Duration,
    ) -> Result<(String, String), RigError> {
        // Taken, not lent: after a fault the moves must not be made at some later time.
        let mut message = std::mem::take(&mut self.held);
        message.extend(commands);
        let message = Message(message).to_string();
        let answer = self.link.ask_within(&message, deadline).await?;
        Ok((message, answer))
    }

    /// Asks several questions, none of which answers with a semicolon, and looks into the error queue, all in one
    /// message; gives an answer for each.
    async fn ask_all(
        &mut self,
        questions: Vec<Command>,
    ) -> Result<(String, Vec<String>), RigError> {
        let count = questions.len();
        let mut message = questions;
        message.push(System::NextError.into());
        let (asked, answer) = self.ask(message, self.link.deadline()).await?;
        let (answers, error) = split_error(&answer);
        let error = self.error(&asked, error)?;
        let answers: Vec<String> = answers.split(';').map(str::to_owned).collect();
        if error.code != 0 {
            self.drain("").await.ok();
            return Err(self.refused(asked, error));
        }
        if answers.len() != count {
            let expected = format!("{count} answers and an error entry");
            return Err(garbled(self.link.instrument(), &asked, &answer, &expected));
        }
        Ok((asked, answers))
    }

    /// Sends commands and looks whether they were refused.
    async fn tell(&mut self, commands: Vec<Command>) -> Result<(), RigError> {
        let said = Message(commands.clone()).to_string();
        let mut message = commands;
        message.push(System::NextError.into());
        let (asked, answer) = self.ask(message, self.link.deadline()).await?;
        let error = self.error(&asked, &answer)?;
        match error.code {
            0 => Ok(()),
            _ => Err(self.refused(said, error)),
        }
    }

    /// Empties the error queue; the first entry is an error.
    pub(super) async fn drain(&mut self, suspect: &str) -> Result<(), RigError> {
        let mut first = None;
        for _ in 0..MOST_ERRORS {
            let (asked, answer) = self
                .ask(vec![System::NextError.into()], self.link.deadline())
                .await?;
            let error = self.error(&asked, &answer)?;
            if error.code == 0 {
                break;
            }
            first.get_or_insert(error);
        }
        match first {
            None => Ok(()),
            Some(error) => Err(self.refused(suspect.to_owned(), error)),
        }
    }

    fn error(&self, asked: &str, answer: &str) -> Result<ErrorEntry, RigError> {
        answer
            .parse()
            .map_err(|_| garbled(self.link.instrument(), asked, answer, "an error entry"))
    }

    fn refused(&self, command: String, error: ErrorEntry) -> RigError {
        RigError::Refused {
            instrument: self.link.instrument().to_owned(),
            command,
            code: error.code,
            message: error.message,
        }
    }

    fn mismatch(&self, setting: &str, set: String, read: String) -> RigError {
        RigError::Mismatch {
            instrument: self.link.instrument().to_owned(),
            setting: setting.to_owned(),
            set,
            read,
        }
    }
}

pub(super) fn garbled(instrument: &str, command: &str, answer: &str, expected: &str) -> RigError {
    let shown = |text: &str| text.chars().take(60).collect();
    RigError::Garbled {
        instrument: instrument.to_owned(),
        command: shown(command),
        answer: shown(answer),
        expected: expected.to_owned(),
    }
}

/// The list in its order, runs of neighbours as ranges.
pub(super) fn compact(relays: &[Relay]) -> ChannelList {
    let mut entries: Vec<ChannelEntry> = Vec::new();
    for Relay(number) in relays.iter().copied() {
        // A range skips ABus relays, so those are always written out.
        let bus = number % 1000 > 900;
        match entries.last_mut() {
            Some(ChannelEntry::Range(_, last)) if !bus && *last + 1 == number => *last = number,
            _ => {
                let run = match entries.as_slice() {
                    [.., ChannelEntry::One(first), ChannelEntry::One(second)]
                        if !bus && first + 1 == *second && second + 1 == number =>
                    {
                        Some(*first)
                    }
                    _ => None,
                };
                match run {
                    Some(first) => {
                        entries.truncate(entries.len() - 2);
                        entries.push(ChannelEntry::Range(first, number));
                    }
                    None => entries.push(ChannelEntry::One(number)),
                }
            }
        }
    }
    entries.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_written_as_a_range_and_bus_relays_never() {
        let written = |numbers: &[u32]| {
            let relays: Vec<Relay> = numbers.iter().copied().map(Relay).collect();
            compact(&relays).to_string()
        };
        assert_eq!(written(&[]), "(@)");
        assert_eq!(written(&[1001, 1002, 1003, 1004]), "(@1001:1004)");
        assert_eq!(written(&[1001, 1002, 1005]), "(@1001,1002,1005)");
        assert_eq!(written(&[1003, 1002, 1001]), "(@1003,1002,1001)");
        assert_eq!(written(&[1911, 1912, 1913]), "(@1911,1912,1913)");
        assert_eq!(
            written(&[1001, 1002, 1003, 1036, 1037, 1038]),
            "(@1001:1003,1036:1038)"
        );
    }
}
