//! Sequences of switching commands in non-volatile memory, and the one that runs (section 6).

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use scpi::{ParseError, quote};

use super::{Session, Simulator34980a, Wires};
use crate::command::{Command, Message};
use crate::simulator::errors::Trouble;
use crate::simulator::execute::Turn;

/// Sequences that the memory holds, and bytes of each.
const MOST: usize = 500;
const LONGEST: usize = 1024;
/// Sequences within sequences.
const DEEPEST: u32 = 4;
/// Sequences that wait for the one that runs. The sources give no number.
const MOST_WAITING: usize = 8;

#[derive(Debug, Default)]
pub(crate) struct Sequences {
    definitions: BTreeMap<String, Message>,
    /// What is still to be done, with how deep it is nested.
    steps: VecDeque<(u32, Command)>,
    /// When the next step is done, or the last has been; `None` while nothing runs.
    due: Option<Duration>,
    waiting: VecDeque<String>,
}

impl Sequences {
    pub(crate) fn due(&self) -> Option<Duration> {
        self.due
    }

    pub(crate) fn is_running(&self) -> bool {
        self.due.is_some()
    }

    pub(crate) fn define(&mut self, name: String, commands: Message) -> Result<(), Trouble> {
        if commands.to_string().len() > LONGEST {
            return Err(ParseError::TooMuchData.into());
        }
        if self.definitions.len() == MOST && !self.definitions.contains_key(&name) {
            return Err(Trouble::MEMORY);
        }
        self.definitions.insert(name, commands);
        Ok(())
    }

    fn find(&self, name: &str) -> Result<&Message, Trouble> {
        self.definitions.get(name).ok_or(Trouble::NO_SEQUENCE)
    }

    pub(crate) fn definition(&self, name: &str) -> Result<String, Trouble> {
        Ok(quote(&format!(":{}", self.find(name)?)))
    }

    pub(crate) fn delete(&mut self, name: Option<&str>) -> Result<(), Trouble> {
        match name {
            None => self.definitions.clear(),
            Some(name) => {
                self.find(name)?;
                self.definitions.remove(name);
            }
        }
        Ok(())
    }

    pub(crate) fn catalog(&self) -> String {
        if self.definitions.is_empty() {
            return quote("");
        }
        let names: Vec<String> = self.definitions.keys().map(|name| quote(name)).collect();
        names.join(",")
    }

    /// Begins a sequence, or lets it wait for the one that runs.
    pub(crate) fn run(&mut self, name: &str, now: Duration) -> Result<(), Trouble> {
        let commands = self.find(name)?.0.clone();
        if self.is_running() {
            if self.waiting.len() == MOST_WAITING {
                return Err(ParseError::TriggerIgnored.into());
            }
            self.waiting.push_back(name.to_owned());
            return Ok(());
        }
        self.steps = commands.into_iter().map(|command| (1, command)).collect();
        self.due = Some(now);
        Ok(())
    }

    /// Does a sequence within the one that runs.
    pub(crate) fn run_within(&mut self, name: &str, depth: u32) -> Result<(), Trouble> {
        if depth >= DEEPEST {
            return Err(Trouble::NESTED_TOO_DEEP);
        }
        let commands = self.find(name)?.0.clone();
        for command in commands.into_iter().rev() {
            self.steps.push_front((depth + 1, command));
        }
        Ok(())
    }

    /// Stops what runs, and forgets what waits.
    pub(crate) fn abort(&mut self) {
        self.steps.clear();
        self.waiting.clear();
        self.due = None;
    }
}

impl Simulator34980a {
    /// Does the next step of the sequence that runs.
    pub(crate) fn step(&mut self, due: Duration, wires: &mut dyn Wires) {
        let Some((depth, command)) = self.sequences.steps.pop_front() else {
            self.sequences.due = None;
            if let Some(next) = self.sequences.waiting.pop_front()
                && let Err(trouble) = self.sequences.run(&next, due)
            {
                self.fail(trouble);
            }
            return;
        };
        let mut turn = Turn {
            session: Session::default(),
            now: due,
            replied: false,
            last: false,
            depth,
            wires,
        };
        match self.obey(command, &mut turn) {
            // A command within may have stopped the sequence.
            Ok(_) if self.sequences.is_running() => self.sequences.due = Some(turn.now),
            Ok(_) => {}
            Err(trouble) => {
                self.sequences.steps.clear();
                self.fail(trouble);
            }
        }
    }
}
