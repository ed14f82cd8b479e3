//! The driver: methods with typed arguments. Every setting is read back, and every message ends with a query of the
//! error queue.

use rig::{Compliance, Conversation, CurrentSource, Link, Replies, RigError, Stream};
use scpi::{join_units, parse_boolean, parse_integer, parse_reading};
use survey::{Amps, Volts};

use crate::command::{Ask, COMPLIANCE_BIT, Command, INTERLOCK_BIT, Shield, StatusGroup};
use crate::range::{LARGEST_CURRENT, LARGEST_LIMIT, LIMIT_STEP, Range, SMALLEST_LIMIT};

const MODEL: &str = "MODEL 6221";
/// Errors read from the queue before the queue counts as broken: several times its depth.
const MOST_ERRORS: usize = 64;

/// A 6221 at the other end of a link.
#[derive(Debug)]
pub struct Keithley6221<S> {
    conversation: Conversation<S>,
    identity: String,
    range: Option<Range>,
}

impl<S: Stream> Keithley6221<S> {
    /// Queries the identity, rejects another model, and empties the error queue. Output and level stay as they are.
    ///
    /// # Errors
    /// [`RigError::WrongInstrument`], or an error of the link.
    pub async fn connect(link: Link<S>) -> Result<Self, RigError> {
        let mut conversation = Conversation::new(link, Command::NextError, MOST_ERRORS);
        let identity = conversation.identify(MODEL, is_6221).await?;
        conversation.drain_errors().await?;
        Ok(Self {
            conversation,
            identity,
            range: None,
        })
    }

    /// The reply to `*IDN?`.
    pub fn identity(&self) -> &str {
        &self.identity
    }

    /// Name and address for messages.
    pub fn instrument(&self) -> &str {
        self.conversation.instrument()
    }

    /// Reads level and output.
    ///
    /// # Errors
    /// An error of the link, or an invalid reply.
    pub async fn output(&mut self) -> Result<(Amps, bool), RigError> {
        let commands = [Command::Level(Ask::Now), Command::Output];
        let answers = self.exchange(&commands).await?;
        self.level_and_output(&answers)
    }

    /// Sends commands followed by a query of the error queue; returns the replies to the queries among the commands.
    ///
    /// # Errors
    /// [`RigError::Refused`] with the oldest error if there is one; the queue is emptied.
    async fn exchange(&mut self, commands: &[Command]) -> Result<Vec<String>, RigError> {
        let replies = self.exchange_unchecked(commands).await?;
        if replies.error.code == 0 {
            return Ok(replies.answers);
        }
        self.conversation.drain_further_errors().await;
        let refused = join_units(commands);
        Err(self.conversation.refused(refused, replies.error))
    }

    async fn exchange_unchecked(&mut self, commands: &[Command]) -> Result<Replies, RigError> {
        let replies = self.conversation.send(commands).await?;
        let queries = commands.iter().filter(|c| c.is_query()).count();
        if replies.answers.len() != queries {
            let expected = format!("{} answers, an error entry last", queries + 1);
            let (message, reply) = (&replies.message, &replies.reply);
            return Err(self.conversation.garbled(message, reply, expected));
        }
        Ok(replies)
    }

    fn level_and_output(&self, answers: &[String]) -> Result<(Amps, bool), RigError> {
        let commands = [Command::Level(Ask::Now), Command::Output];
        if let [level, output] = answers
            && let Some(level) = number(level)
            && let Ok(on) = parse_boolean(output)
        {
            return Ok((Amps(level), on));
        }
        Err(self.garbled(&commands, answers, "a level and 0 or 1"))
    }

    /// Sets the level to 0 and the output off, and reads both back, in one segment. Earlier entries of the error queue
    /// are ignored.
    async fn off_once(&mut self) -> Result<(), RigError> {
        if !self.conversation.link().is_synchronised() {
            self.conversation.link_mut().resynchronise().await?;
        }
        let commands = [
            Command::ClearSource,
            Command::SetOutput(false),
            Command::Level(Ask::Now),
            Command::Output,
        ];
        let Replies { answers, error, .. } = self.exchange_unchecked(&commands).await?;
        if error.code != 0 {
            tracing::warn!(instrument = self.instrument(), %error, "while switching off");
            self.conversation.drain_errors().await?;
        }
        let (level, on) = self.level_and_output(&answers)?;
        if on || level != Amps(0.0) {
            return Err(RigError::NotOff {
                instrument: self.instrument().to_owned(),
                output: if on { "on" } else { "off" }.to_owned(),
                level,
            });
        }
        Ok(())
    }

    /// Rejects a read-back that differs from the set value by more than `tolerance`.
    fn verify(
        &self,
        setting: &str,
        set: impl ToString,
        read: impl ToString,
        difference: f64,
        tolerance: f64,
    ) -> Result<(), RigError> {
        if difference.abs() <= tolerance {
            return Ok(());
        }
        Err(self.conversation.mismatch(setting, set, read))
    }

    /// Rejects a level beyond the prepared range.
    fn check_level(&self, current: Amps) -> Result<(), RigError> {
        // the condition also rejects NaN
        if current == Amps(0.0) || self.range.is_some_and(|range| range.holds(current)) {
            return Ok(());
        }
        let most = self.range.map_or(Amps(0.0), Range::most);
        Err(self.out_of_range(current, most))
    }

    fn verify_level(&self, set: Amps, read: Amps) -> Result<(), RigError> {
        let tolerance = match set == Amps(0.0) {
            true => 0.0,
            false => self.range.map_or(0.0, |range| range.step.0),
        };
        self.verify("level", set, read, read.0 - set.0, tolerance)
    }

    fn garbled(&self, commands: &[Command], answers: &[String], expected: &str) -> RigError {
        let (message, answers) = (join_units(commands), answers.join(";"));
        self.conversation.garbled(&message, &answers, expected)
    }

    fn interlock(&self) -> RigError {
        RigError::Interlock {
            instrument: self.instrument().to_owned(),
        }
    }

    fn out_of_range(&self, requested: Amps, most: Amps) -> RigError {
        RigError::CurrentOutOfRange {
            instrument: self.instrument().to_owned(),
            requested,
            most,
        }
    }
}

impl<S: Stream> CurrentSource for Keithley6221<S> {
    async fn prepare(&mut self, current: Amps, compliance: Volts) -> Result<(), RigError> {
        let range = Range::holding(current)
            .filter(|_| current.abs() <= LARGEST_CURRENT)
            .ok_or_else(|| self.out_of_range(current, LARGEST_CURRENT))?;
        let steps = compliance.0 / LIMIT_STEP.0;
        if !(SMALLEST_LIMIT..=LARGEST_LIMIT).contains(&compliance)
            || (steps - steps.round()).abs() > 1e-6
        {
            return Err(RigError::VoltageOutOfRange {
                instrument: self.instrument().to_owned(),
                requested: compliance,
                allowed: format!("{SMALLEST_LIMIT} to {LARGEST_LIMIT} in steps of {LIMIT_STEP}"),
            });
        }
        self.range = None;
        let commands = [
            Command::ClearSource,
            Command::SetOutput(false),
            Command::SetAutorange(false),
            Command::SetRange(range.full_scale),
            Command::SetCompliance(compliance),
            Command::SetShield(Shield::OutputLow),
            Command::SetLowToEarth(false),
            Command::Autorange,
            Command::Range(Ask::Now),
            Command::Compliance(Ask::Now),
            // reading clears compliance events latched before this survey
            Command::Events(StatusGroup::Measurement),
            Command::Interlock,
            Command::Level(Ask::Now),
            Command::Output,
        ];
        let answers = match self.exchange_unchecked(&commands).await {
            Ok(replies) if replies.error.code == 0 => replies.answers,
            // an entry in the error queue, or a failed exchange: the output is switched off first
            _ => {
                self.off().await?;
                self.exchange(&commands).await?
            }
        };
        let read = match answers.as_slice() {
            [auto, full_scale, limit, _, interlock, level, output] => parse_boolean(auto)
                .ok()
                .zip(number(full_scale).zip(number(limit)))
                .zip(parse_boolean(interlock).ok())
                .map(|read| (read, [level.clone(), output.clone()])),
            _ => None,
        };
        let Some((((auto, (full_scale, limit)), interlock_closed), off)) = read else {
            let expected = "autorange, range, compliance, events, interlock, level and output";
            return Err(self.garbled(&commands, &answers, expected));
        };
        if self.level_and_output(&off)? != (Amps(0.0), false) {
            self.off().await?;
        }
        if !interlock_closed {
            return Err(self.interlock());
        }
        self.verify(
            "autorange",
            0,
            u8::from(auto),
            f64::from(u8::from(auto)),
            0.0,
        )?;
        let difference = full_scale - range.full_scale.0;
        let tolerance = range.full_scale.0 * 1e-4;
        self.verify(
            "range",
            range.full_scale,
            Amps(full_scale),
            difference,
            tolerance,
        )?;
        let difference = limit - compliance.0;
        self.verify(
            "compliance",
            compliance,
            Volts(limit),
            difference,
            LIMIT_STEP.0 / 2.0,
        )?;
        self.range = Some(range);
        Ok(())
    }

    async fn set_current(&mut self, current: Amps) -> Result<(), RigError> {
        self.check_level(current)?;
        let commands = [Command::SetLevel(current), Command::Level(Ask::Now)];
        let answers = self.exchange(&commands).await?;
        let Some(level) = answers.first().and_then(|level| number(level)) else {
            return Err(self.garbled(&commands, &answers, "a level"));
        };
        self.verify_level(current, Amps(level))
    }

    async fn set_output(&mut self, on: bool) -> Result<(), RigError> {
        let commands = [Command::SetOutput(on), Command::Output];
        let answers = self.exchange(&commands).await?;
        let Some(read) = answers.first().and_then(|read| parse_boolean(read).ok()) else {
            return Err(self.garbled(&commands, &answers, "0 or 1"));
        };
        let difference = f64::from(u8::from(read != on));
        self.verify("output", u8::from(on), u8::from(read), difference, 0.0)
    }

    async fn switch_on(&mut self, current: Amps) -> Result<(), RigError> {
        self.check_level(current)?;
        let commands = [
            Command::SetOutput(true),
            Command::SetLevel(current),
            Command::Level(Ask::Now),
            Command::Output,
        ];
        let answers = self.exchange(&commands).await?;
        let (level, on) = self.level_and_output(&answers)?;
        let off = f64::from(u8::from(!on));
        self.verify("output", 1, u8::from(on), off, 0.0)?;
        self.verify_level(current, level)
    }

    async fn compliance(&mut self) -> Result<Compliance, RigError> {
        let commands = [
            Command::Events(StatusGroup::Measurement),
            Command::Conditions(StatusGroup::Measurement),
        ];
        let answers = self.exchange(&commands).await?;
        let garbled = || self.garbled(&commands, &answers, "two integers");
        let [events, conditions] = answers.as_slice() else {
            return Err(garbled());
        };
        let events = parse_integer(events).map_err(|_| garbled())?;
        let conditions = parse_integer(conditions).map_err(|_| garbled())?;
        // an error, because the readings taken without output look like valid ones
        if (events | conditions) & 1 << INTERLOCK_BIT != 0 {
            return Err(self.interlock());
        }
        Ok(Compliance {
            now: conditions & 1 << COMPLIANCE_BIT != 0,
            since: events & 1 << COMPLIANCE_BIT != 0,
        })
    }

    async fn off(&mut self) -> Result<(), RigError> {
        match self.off_once().await {
            Ok(()) => Ok(()),
            // a lost or late reply, or a level that did not go to 0: a second attempt, because an energised sheet is
            // worse than a second message
            Err(first) => {
                tracing::warn!(instrument = self.instrument(), %first, "switching off again");
                self.off_once().await
            }
        }
    }
}

/// A finite number, or `None`: 9.9E37 is not a level.
fn number(answer: &str) -> Option<f64> {
    parse_reading(answer).ok()?.value()
}

/// Whether the fields of an identity are those of a 6221; case and firmware version do not matter.
fn is_6221(fields: &[&str]) -> bool {
    fields
        .get(1)
        .is_some_and(|model| model.eq_ignore_ascii_case(MODEL))
}
