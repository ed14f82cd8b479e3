//! Messages that read, and what their answers are.

use std::time::Duration;

use rig::{RigError, Sample, Stream};
use scpi::{Answer, ErrorEntry};
use survey::{Reading, Relay, Volts};

use super::{Prepared, Unit, compact, garbled};
use crate::command::{Command, Measure, Route, System};

/// How far over its range the voltmeter reads (section 5: 20 %), with room for the last digit.
const OVERRANGE: f64 = 1.2 * (1.0 + 1e-6);

impl<S: Stream> Unit<S> {
    pub(super) fn prepared(&self) -> Result<Prepared, RigError> {
        self.prepared.clone().ok_or_else(|| RigError::Unable {
            instrument: self.link.instrument().to_owned(),
            what: "measure before it is prepared".to_owned(),
        })
    }

    /// Scans channels, and answers in the order asked for.
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
            // Every relay asked for is in its sorted copy, whose length each sweep has.
            .filter_map(|sample| Some((sample, ascending.binary_search(&sample.relay).ok()?)))
            .map(|(sample, place)| {
                let each: Vec<Reading> = (0..sweeps)
                    .map(|sweep| reading(&answers[sweep * count + place], sample.range))
                    .collect();
                rig::mean(&each)
            })
            .collect())
    }

    /// Joins and reads one pair after the other.
    pub(in crate::driver) async fn chain(
        &mut self,
        hops: Vec<(Vec<Command>, Volts)>,
    ) -> Result<Vec<Reading>, RigError> {
        let prepared = self.prepared()?;
        let (mut commands, mut ranges) = (Vec::new(), Vec::new());
        for (moves, range) in hops {
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

    /// Sends commands with so many READ? among them, each of which answers so many numbers, and looks into the error
    /// queue in the same message.
    pub(super) async fn measure(
        &mut self,
        commands: Vec<Command>,
        questions: usize,
        numbers: usize,
        deadline: Duration,
    ) -> Result<Vec<Answer>, RigError> {
        self.doubted = true;
        let mut said = self.held.clone();
        said.extend(commands.iter().cloned());
        let mut message = commands;
        message.push(System::NextError.into());
        let (asked, answer) = self.ask(message, deadline).await?;
        // The error entry comes last, and its text may hold a semicolon; a refused question answers nothing.
        let (readings, error) = split_error(&answer);
        let error = self.error(&asked, error)?;
        if error.code != 0 {
            return Err(self.refused_message(said, &asked, error).await);
        }
        let mut answers = Vec::with_capacity(questions * numbers);
        for piece in readings.split(';') {
            answers.extend(self.numbers(&asked, piece, numbers)?);
        }
        if answers.len() != questions * numbers {
            let expected = format!("{questions} answers of {numbers} number(s)");
            return Err(garbled(self.link.instrument(), &asked, &answer, &expected));
        }
        self.unchecked = false;
        self.doubted = false;
        Ok(answers)
    }

    /// An error out of a message of many commands: empties the queue, and names the command where that can be told.
    pub(super) async fn refused_message(
        &mut self,
        said: Vec<Command>,
        asked: &str,
        error: ErrorEntry,
    ) -> RigError {
        // Whatever else goes wrong now, the first error is the one to tell.
        let _ = self.drain("").await;
        self.unchecked = false;
        let culprit = match said.as_slice() {
            [only] => Some(only.to_string()),
            _ => self.not_obeyed(&said).await,
        };
        let command = match culprit {
            Some(culprit) => format!("{culprit}' in '{asked}"),
            None => asked.to_owned(),
        };
        self.refused(command, error)
    }

    /// Reads exactly so many numbers. With another count nobody knows which is whose.
    pub(in crate::driver) fn numbers(
        &self,
        asked: &str,
        answer: &str,
        count: usize,
    ) -> Result<Vec<Answer>, RigError> {
        let numbers = scpi::parse_readings(answer);
        match numbers {
            Ok(numbers) if numbers.len() == count => Ok(numbers),
            Ok(_) | Err(_) => Err(garbled(
                self.link.instrument(),
                asked,
                answer,
                &format!("{count} number(s)"),
            )),
        }
    }
}

/// What a number means on its range. What a sound voltmeter cannot say there is no voltage, whatever number came.
fn reading(answer: &Answer, range: Volts) -> Reading {
    match answer {
        Answer::Value(volts) if volts.abs() <= range.0 * OVERRANGE => Reading::Ok(Volts(*volts)),
        Answer::Value(_) | Answer::Overload { .. } | Answer::NotANumber => Reading::Overload,
    }
}

/// The readings of an answer and the error entry behind them: the first piece that is no number begins it.
pub(super) fn split_error(answer: &str) -> (&str, &str) {
    let mut from = 0;
    for piece in answer.split(';') {
        if piece.parse::<ErrorEntry>().is_ok() || piece.contains('"') {
            return (answer[..from].trim_end_matches(';'), &answer[from..]);
        }
        from += piece.len() + 1;
    }
    (answer, "")
}
