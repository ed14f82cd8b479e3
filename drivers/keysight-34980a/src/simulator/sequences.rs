//! Sequences of switching commands in non-volatile memory, and the running sequence (section 6).

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use scpi::{ParseError, quote};

use super::{Session, Simulator34980a, Wires};
use crate::command::{Command, Message};
use crate::simulator::errors::QueuedError;
use crate::simulator::execute::Execution;

/// Limits of the memory: number of sequences, and bytes of each.
const MOST: usize = 500;
const LONGEST: usize = 1024;
/// Deepest nesting of sequences.
const DEEPEST: u32 = 4;
/// Number of sequences that may wait for the running one; assumed, because the sources give no number.
const MOST_WAITING: usize = 8;

#[derive(Debug, Default)]
pub(crate) struct Sequences {
    definitions: BTreeMap<String, Message>,
    /// The remaining steps, with their nesting depth.
    steps: VecDeque<(u32, Command)>,
    /// Time of the next step, or of the end of the last; `None` while nothing is running.
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

    pub(crate) fn define(&mut self, name: String, commands: Message) -> Result<(), QueuedError> {
        if commands.to_string().len() > LONGEST {
            return Err(ParseError::TooMuchData.into());
        }
        if self.definitions.len() == MOST && !self.definitions.contains_key(&name) {
            return Err(QueuedError::MEMORY);
        }
        self.definitions.insert(name, commands);
        Ok(())
    }

    fn find(&self, name: &str) -> Result<&Message, QueuedError> {
        self.definitions.get(name).ok_or(QueuedError::NO_SEQUENCE)
    }

    pub(crate) fn definition(&self, name: &str) -> Result<String, QueuedError> {
        Ok(quote(&format!(":{}", self.find(name)?)))
    }

    pub(crate) fn delete(&mut self, name: Option<&str>) -> Result<(), QueuedError> {
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

    /// Starts a sequence, or queues it if one is running.
    pub(crate) fn run(&mut self, name: &str, now: Duration) -> Result<(), QueuedError> {
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

    /// Inserts the commands of a sequence as the next steps of the running one.
    pub(crate) fn run_within(&mut self, name: &str, depth: u32) -> Result<(), QueuedError> {
        if depth >= DEEPEST {
            return Err(QueuedError::NESTED_TOO_DEEP);
        }
        let commands = self.find(name)?.0.clone();
        for command in commands.into_iter().rev() {
            self.steps.push_front((depth + 1, command));
        }
        Ok(())
    }

    /// Stops the running sequence, and drops the queued ones.
    pub(crate) fn abort(&mut self) {
        self.steps.clear();
        self.waiting.clear();
        self.due = None;
    }
}

impl Simulator34980a {
    /// Executes the next step of the running sequence.
    pub(crate) fn step(&mut self, due: Duration, wires: &mut dyn Wires) {
        let Some((depth, command)) = self.sequences.steps.pop_front() else {
            self.sequences.due = None;
            if let Some(next) = self.sequences.waiting.pop_front()
                && let Err(error) = self.sequences.run(&next, due)
            {
                self.fail(error);
            }
            return;
        };
        let mut execution = Execution {
            session: Session::default(),
            now: due,
            replied: false,
            last: false,
            depth,
            wires,
        };
        match self.execute(command, &mut execution) {
            // A nested command may have stopped the sequence.
            Ok(_) if self.sequences.is_running() => self.sequences.due = Some(execution.now),
            Ok(_) => {}
            Err(error) => {
                self.sequences.steps.clear();
                self.fail(error);
            }
        }
    }
}
