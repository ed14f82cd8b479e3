//! Messages with readings, and the parsing of their replies.

use std::time::Duration;

use rig::{Replies, RigError, Sample, Stream};
use scpi::Answer;
use survey::{Reading, Relay, Volts};

use super::{Prepared, Unit, compact};
use crate::command::{Command, Measure, Route};

/// Largest reading as a factor of the range, with a margin for the last digit.
const OVERRANGE: f64 = crate::OVERRANGE * (1.0 + 1e-6);

impl<S: Stream> Unit<S> {
    pub(super) fn prepared(&self) -> Result<Prepared, RigError> {
        let unprepared = || self.conversation.unable("measure before it is prepared");
        self.prepared.clone().ok_or_else(unprepared)
    }

    /// Scans channels, and returns readings in the requested order.
    pub(in crate::driver) async fn scan(
        &mut self,
        samples: &[Sample],
    ) -> Result<Vec<Reading>, RigError> {
        let prepared = self.prepared()?;
        let mut ascending: Vec<Relay> = samples.iter().map(|sample| sample.relay).collect();
        ascending.sort_unstable();
        let ranges: Vec<(Option<Relay>, Volts)> = samples
            .iter()
            .map(|sample| (Some(sample.relay), sample.range))
            .collect();
        let mut commands = self.change_ranges(&ranges);
        commands.extend(self.change_delays(samples, prepared.meter.channel_delay));
        let waits: Duration = samples.iter().map(|sample| sample.wait).sum();
        let deadline = prepared.deadline + waits * prepared.meter.averages;
        if self.listed != ascending {
            commands.push(Route::SetScan(compact(&ascending)).into());
            self.listed.clone_from(&ascending);
        }
        commands.push(Measure::Read(None).into());
        let sweeps = prepared.meter.averages as usize;
        let count = ascending.len();
        let answers = self.measure(commands, 1, count * sweeps, deadline).await?;
        Ok(samples
            .iter()
            // every requested relay is in the sorted copy, and each sweep has one value for each of them
            .filter_map(|sample| Some((sample, ascending.binary_search(&sample.relay).ok()?)))
            .map(|(sample, place)| {
                let each: Vec<Reading> = (0..sweeps)
                    .map(|sweep| reading(&answers[sweep * count + place], sample.range))
                    .collect();
                rig::mean(&each)
            })
            .collect())
    }

    /// Connects and reads one pair after the other.
    pub(in crate::driver) async fn chain(
        &mut self,
        chained: Vec<(Vec<Command>, Volts)>,
    ) -> Result<Vec<Reading>, RigError> {
        let prepared = self.prepared()?;
        let (mut commands, mut ranges) = (Vec::new(), Vec::new());
        for (moves, range) in chained {
            commands.extend(moves);
            commands.extend(self.change_ranges(&[(None, range)]));
            commands.push(Measure::Read(None).into());
            ranges.push(range);
        }
        let sweeps = prepared.meter.averages as usize;
        let answers = self
            .measure(commands, ranges.len(), sweeps, prepared.deadline)
            .await?;
        Ok(answers
            .chunks(sweeps.max(1))
            .zip(ranges)
            .map(|(answers, range)| {
                let each: Vec<Reading> = answers.iter().map(|one| reading(one, range)).collect();
                rig::mean(&each)
            })
            .collect())
    }

    /// Sends commands that contain `queries` READ?, each of which returns `numbers` values, with a query of the error
    /// queue in the same message.
    pub(super) async fn measure(
        &mut self,
        commands: Vec<Command>,
        queries: usize,
        numbers: usize,
        deadline: Duration,
    ) -> Result<Vec<Answer>, RigError> {
        self.doubted = true;
        let sent = self.with_held(commands);
        let replies = self.conversation.send_within(&sent, deadline).await?;
        if replies.error.code != 0 {
            return Err(self.refused_message(sent, replies).await);
        }
        let mut answers = Vec::with_capacity(queries * numbers);
        for answer in &replies.answers {
            answers.extend(self.numbers(&replies.message, answer, numbers)?);
        }
        if answers.len() != queries * numbers {
            let expected = format!("{queries} answers of {numbers} number(s)");
            return Err(self.garbled(&replies, expected));
        }
        self.unchecked = false;
        self.doubted = false;
        Ok(answers)
    }

    /// The error for a rejected message of several commands. Empties the error queue, and names the rejected command if
    /// it can be found.
    async fn refused_message(&mut self, sent: Vec<Command>, replies: Replies) -> RigError {
        self.conversation.drain_further_errors().await;
        self.unchecked = false;
        let culprit = match sent.as_slice() {
            [only] => Some(only.to_string()),
            _ => self.move_not_made(&sent).await,
        };
        let command = match culprit {
            Some(culprit) => format!("{culprit}' in '{}", replies.message),
            None => replies.message,
        };
        self.conversation.refused(command, replies.error)
    }

    /// Parses exactly `count` values; another number of values could not be assigned to channels.
    pub(in crate::driver) fn numbers(
        &self,
        message: &str,
        answer: &str,
        count: usize,
    ) -> Result<Vec<Answer>, RigError> {
        let numbers = scpi::parse_readings(answer).ok();
        numbers
            .filter(|numbers| numbers.len() == count)
            .ok_or_else(|| {
                let expected = format!("{count} number(s)");
                self.conversation.garbled(message, answer, expected)
            })
    }
}

/// Converts a number to a reading on its range. A number beyond the overrange is an overload, not a voltage.
fn reading(answer: &Answer, range: Volts) -> Reading {
    match answer {
        Answer::Value(volts) if volts.abs() <= range.0 * OVERRANGE => Reading::Ok(Volts(*volts)),
        Answer::Value(_) | Answer::Overload { .. } | Answer::NotANumber => Reading::Overload,
    }
}
