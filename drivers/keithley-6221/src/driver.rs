//! The driver: typed methods, every setting read back, every message closed by a look into the error queue.

use rig::{Compliance, CurrentSource, Link, RigError, Stream};
use scpi::{Common, ErrorEntry, parse_boolean, parse_integer, parse_reading};
use survey::{Amps, Volts};

use crate::command::{Ask, COMPLIANCE_BIT, Command, INTERLOCK_BIT, Message, Shield, StatusGroup};
use crate::range::{LARGEST_CURRENT, LARGEST_LIMIT, LIMIT_STEP, Range, SMALLEST_LIMIT};

const MODEL: &str = "MODEL 6221";
/// Looks into the error queue before it is taken for broken: several times its depth.
const MOST_ERRORS: usize = 64;

/// A 6221 at the end of a link.
#[derive(Debug)]
pub struct Keithley6221<S> {
    link: Link<S>,
    identity: String,
    range: Option<Range>,
}

impl<S: Stream> Keithley6221<S> {
    /// Asks who is there, refuses another model, and empties the error queue. Output and level stay as they are.
    ///
    /// # Errors
    /// [`RigError::WrongInstrument`], or the link's.
    pub async fn connect(mut link: Link<S>) -> Result<Self, RigError> {
        let identity = identify(&mut link, None).await?;
        let mut source = Self {
            link,
            identity,
            range: None,
        };
        source.empty_error_queue().await?;
        Ok(source)
    }

    /// Goes on over a fresh connection, if the same instrument (serial number included) is at its end. What had been
    /// prepared must be prepared again.
    ///
    /// # Errors
    /// [`RigError::WrongInstrument`], or the link's.
    pub async fn reconnect(&mut self, stream: S) -> Result<(), RigError> {
        self.range = None;
        self.link.replace(stream);
        identify(&mut self.link, Some(&self.identity)).await?;
        self.empty_error_queue().await
    }

    /// The reply to `*IDN?`.
    pub fn identity(&self) -> &str {
        &self.identity
    }

    /// Name and address for messages.
    pub fn instrument(&self) -> &str {
        self.link.instrument()
    }

    /// Read level and output.
    ///
    /// # Errors
    /// The link's, or a garbled answer.
    pub async fn output(&mut self) -> Result<(Amps, bool), RigError> {
        let asked = [Command::Level(Ask::Now), Command::Output];
        let answers = self.exchange(&asked).await?;
        self.level_and_output(&answers)
    }

    /// Sends commands in one segment with a look into the error queue behind them; gives the answers of the queries.
    ///
    /// # Errors
    /// [`RigError::Refused`] with the oldest error when there is one; the queue is emptied.
    async fn exchange(&mut self, commands: &[Command]) -> Result<Vec<String>, RigError> {
        let (answers, error) = self.exchange_unchecked(commands).await?;
        if error.code == 0 {
            return Ok(answers);
        }
        self.empty_error_queue().await?;
        Err(RigError::Refused {
            instrument: self.link.instrument().to_owned(),
            command: Message(commands).to_string(),
            code: error.code,
            message: error.message,
        })
    }

    async fn exchange_unchecked(
        &mut self,
        commands: &[Command],
    ) -> Result<(Vec<String>, ErrorEntry), RigError> {
        let mut commands = commands.to_vec();
        commands.push(Command::NextError);
        let message = Message(&commands).to_string();
        let reply = self.link.ask(&message).await?;
        let queries = commands.iter().filter(|c| c.is_query()).count();
        // The error entry comes last because its text may hold a semicolon.
        let mut answers: Vec<String> = reply.splitn(queries, ';').map(str::to_owned).collect();
        let error = answers.pop().and_then(|last| last.parse().ok());
        match error {
            Some(error) if answers.len() + 1 == queries => Ok((answers, error)),
            _ => Err(self.garbled(
                &commands,
                &reply,
                &format!("{queries} answers, an error entry last"),
            )),
        }
    }

    async fn empty_error_queue(&mut self) -> Result<(), RigError> {
        for _ in 0..MOST_ERRORS {
            let (_, error) = self.exchange_unchecked(&[]).await?;
            if error.code == 0 {
                return Ok(());
            }
            tracing::warn!(instrument = self.link.instrument(), %error, "left in the error queue");
        }
        Err(self.garbled(
            &[Command::NextError],
            "one error after another",
            "an end of the error queue",
        ))
    }

    fn level_and_output(&self, answers: &[String]) -> Result<(Amps, bool), RigError> {
        let asked = [Command::Level(Ask::Now), Command::Output];
        if let [level, output] = answers
            && let Some(level) = number(level)
            && let Ok(on) = parse_boolean(output)
        {
            return Ok((Amps(level), on));
        }
        Err(self.garbled(&asked, &answers.join(";"), "a level and 0 or 1"))
    }

    /// Zero and off with the read-back of both, in one segment. Errors left over from elsewhere do not stand in its way.
    async fn off_once(&mut self) -> Result<(), RigError> {
        if !self.link.is_in_step() {
            self.link.resynchronise().await?;
        }
        let commands = [
            Command::ClearSource,
            Command::SetOutput(false),
            Command::Level(Ask::Now),
            Command::Output,
        ];
        let (answers, error) = self.exchange_unchecked(&commands).await?;
        if error.code != 0 {
            tracing::warn!(instrument = self.link.instrument(), %error, "while switching off");
            self.empty_error_queue().await?;
        }
        let (level, on) = self.level_and_output(&answers)?;
        if on || level != Amps(0.0) {
            return Err(RigError::NotOff {
                instrument: self.link.instrument().to_owned(),
                output: if on { "on" } else { "off" }.to_owned(),
                level,
            });
        }
        Ok(())
    }

    /// Refuses a read-back that is further from what was set than `tolerance`.
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
        Err(RigError::Mismatch {
            instrument: self.link.instrument().to_owned(),
            setting: setting.to_owned(),
            set: set.to_string(),
            read: read.to_string(),
        })
    }

    /// Refuses a level that the prepared range does not hold.
    fn check_level(&self, current: Amps) -> Result<(), RigError> {
        // Written so that what is no number is refused as well.
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

    fn garbled(&self, asked: &[Command], answer: &str, expected: &str) -> RigError {
        RigError::Garbled {
            instrument: self.link.instrument().to_owned(),
            command: Message(asked).to_string(),
            answer: answer.chars().take(80).collect(),
            expected: expected.to_owned(),
        }
    }

    fn interlock(&self) -> RigError {
        RigError::Interlock {
            instrument: self.link.instrument().to_owned(),
        }
    }

    fn out_of_range(&self, asked: Amps, most: Amps) -> RigError {
        RigError::CurrentOutOfRange {
            instrument: self.link.instrument().to_owned(),
            asked,
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
                instrument: self.link.instrument().to_owned(),
                asked: compliance,
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
            // what had latched before this is not this survey's
            Command::Events(StatusGroup::Measurement),
            Command::Interlock,
            Command::Level(Ask::Now),
            Command::Output,
        ];
        let answers = match self.exchange_unchecked(&commands).await {
            Ok((answers, error)) if error.code == 0 => answers,
            // Off comes first, whatever an earlier error or a link out of step is in the way of.
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
            return Err(self.garbled(&commands, &answers.join(";"), expected));
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
            return Err(self.garbled(&commands, &answers.join(";"), "a level"));
        };
        self.verify_level(current, Amps(level))
    }

    async fn set_output(&mut self, on: bool) -> Result<(), RigError> {
        let commands = [Command::SetOutput(on), Command::Output];
        let answers = self.exchange(&commands).await?;
        let Some(read) = answers.first().and_then(|read| parse_boolean(read).ok()) else {
            return Err(self.garbled(&commands, &answers.join(";"), "0 or 1"));
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
        let garbled = || self.garbled(&commands, &answers.join(";"), "two integers");
        let [events, conditions] = answers.as_slice() else {
            return Err(garbled());
        };
        let events = parse_integer(events).map_err(|_| garbled())?;
        let conditions = parse_integer(conditions).map_err(|_| garbled())?;
        // without output the voltmeter reads numbers that look like any others
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
            // A lost or late answer, or a level that did not go down: once more, because a live sheet is worse than a
            // second message.
            Err(first) => {
                tracing::warn!(instrument = self.link.instrument(), %first, "switching off again");
                self.off_once().await
            }
        }
    }
}

/// A finite number, or nothing: 9.9E37 is no level.
fn number(answer: &str) -> Option<f64> {
    parse_reading(answer).ok()?.value()
}

/// Asks who is there; the model must be the 6221 (case does not matter, the firmware neither), and if a known one is
/// expected then also its serial number.
async fn identify<S: Stream>(
    link: &mut Link<S>,
    expected: Option<&str>,
) -> Result<String, RigError> {
    let found = link
        .ask(&Command::Common(Common::Identify).to_string())
        .await?;
    let field = |identity: &str, at: usize| -> Option<String> {
        identity
            .split(',')
            .nth(at)
            .map(|field| field.trim().to_ascii_uppercase())
    };
    let same = expected.is_none_or(|expected| field(&found, 2) == field(expected, 2));
    if same && field(&found, 1).as_deref() == Some(MODEL) {
        return Ok(found);
    }
    Err(RigError::WrongInstrument {
        instrument: link.instrument().to_owned(),
        expected: expected.unwrap_or(MODEL).to_owned(),
        found,
    })
}
