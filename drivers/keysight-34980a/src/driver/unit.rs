//! The conversation with one mainframe: what is held back, what is asked, how answers are read.

use std::time::Duration;

use rig::{Link, MeterSettings, RigError, Stream};
use scpi::{Answer, ChannelEntry, ChannelList, Common, ErrorEntry};
use survey::{Reading, Relay, Volts};

use crate::command::{
    Command, Field, Measure, Message, Quantity, Range, Route, Sense, Setting, System, TriggerSource,
};

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
    /// `*RST` is sent once, before the first preparation.
    reset: bool,
}

/// How far over its range the voltmeter reads (section 5: 20 %), with room for the last digit.
const OVERRANGE: f64 = 1.2 * (1.0 + 1e-6);

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
}

impl<S: Stream> Unit<S> {
    pub(super) fn new(link: Link<S>) -> Self {
        Self {
            link,
            held: Vec::new(),
            unchecked: false,
            prepared: None,
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

    pub(super) async fn set_up(&mut self, wanted: &Prepared) -> Result<(), RigError> {
        if !self.reset {
            self.tell(vec![Common::Reset.into(), Common::ClearStatus.into()])
                .await?;
            self.reset = true;
        }
        let list = || Some(wanted.list());
        let set = |setting: Setting| Command::from(Sense::Set(setting, list()));
        let mut settings = vec![
            Command::from(Sense::Configure {
                range: Range::Fixed(wanted.meter.range.0),
                resolution: None,
                channels: list(),
            }),
            set(Setting::Nplc(wanted.meter.nplc)),
            set(Setting::Autozero(wanted.meter.autozero)),
            set(Setting::InputAuto(true)),
            Measure::SetSource(TriggerSource::Immediate).into(),
            Measure::SetCount(Some(1)).into(),
        ];
        if !wanted.scan.is_empty() {
            settings.push(set(Setting::Delay(0.0)));
        }
        let fields = [Field::Unit, Field::Time, Field::Channel, Field::Alarm];
        settings.extend(fields.map(|field| Measure::SetField(field, false).into()));
        for setting in settings {
            self.tell(vec![setting]).await?;
        }
        Ok(())
    }

    /// Reads every setting back that a reading depends on.
    pub(super) async fn verify(&mut self, wanted: &Prepared) -> Result<(), RigError> {
        let ask = |quantity| Command::from(Sense::Ask(quantity, None, Some(wanted.list())));
        let channels = wanted.scan.len().max(1);
        let number = |value: f64| vec![value; channels];
        let mut settings = vec![
            ("range", ask(Quantity::Range), number(wanted.meter.range.0)),
            (
                "integration",
                ask(Quantity::Nplc),
                number(wanted.meter.nplc),
            ),
            (
                "autozero",
                ask(Quantity::Autozero),
                number(f64::from(u8::from(wanted.meter.autozero))),
            ),
            ("input impedance", ask(Quantity::InputAuto), number(1.0)),
            ("trigger count", Measure::Count(None).into(), vec![1.0]),
            (
                "scan size",
                Route::ScanSize.into(),
                vec![wanted.scan.len() as f64],
            ),
        ];
        if !wanted.scan.is_empty() {
            settings.push(("channel delay", ask(Quantity::Delay), number(0.0)));
        }
        for (setting, question, set) in settings {
            let (asked, answer) = self.ask(vec![question], self.link.deadline()).await?;
            let read = self.numbers(&asked, &answer, set.len())?;
            let differs = |(read, set): (&Answer, &f64)| {
                !read
                    .value()
                    .is_some_and(|read| (read - set).abs() <= 1e-6 * set.abs())
            };
            if let Some(place) = read.iter().zip(&set).position(differs) {
                return Err(self.mismatch(setting, set[place].to_string(), answer));
            }
        }
        let (asked, answer) = self
            .ask(vec![Route::Scan.into()], self.link.deadline())
            .await?;
        let meant = ChannelList::of(wanted.ascending().iter().map(|relay| relay.0));
        let read = scpi::parse_block(answer.as_bytes())
            .ok()
            .and_then(|block| std::str::from_utf8(block).ok())
            .and_then(|text| text.parse::<ChannelList>().ok())
            .ok_or_else(|| {
                garbled(
                    self.link.instrument(),
                    &asked,
                    &answer,
                    "a channel list in a block",
                )
            })?;
        if read != meant && read != wanted.list() {
            return Err(self.mismatch("scan list", meant.to_string(), read.to_string()));
        }
        Ok(())
    }

    fn mismatch(&self, setting: &str, set: String, read: String) -> RigError {
        RigError::Mismatch {
            instrument: self.link.instrument().to_owned(),
            setting: setting.to_owned(),
            set,
            read,
        }
    }

    /// Reads exactly so many numbers. With another count nobody knows which is whose.
    fn numbers(&self, asked: &str, answer: &str, count: usize) -> Result<Vec<Answer>, RigError> {
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

    /// Measures, and answers in the order asked for.
    pub(super) async fn measure(&mut self) -> Result<Vec<Reading>, RigError> {
        let Some(prepared) = self.prepared.clone() else {
            return Err(RigError::Unable {
                instrument: self.link.instrument().to_owned(),
                what: "measure before it is prepared".to_owned(),
            });
        };
        let (asked, answer) = self
            .ask(vec![Measure::Read(None).into()], prepared.deadline)
            .await?;
        let answers = self.numbers(&asked, &answer, prepared.scan.len().max(1))?;
        // what a sound voltmeter cannot say on this range is no voltage, whatever number came
        let most = prepared.meter.range.0 * OVERRANGE;
        let reading = |answer: &Answer| match answer {
            Answer::Value(volts) if volts.abs() <= most => Reading::Ok(Volts(*volts)),
            Answer::Value(_) | Answer::Overload { .. } | Answer::NotANumber => Reading::Overload,
        };
        if prepared.scan.is_empty() {
            return Ok(answers.iter().map(reading).collect());
        }
        let ascending = prepared.ascending();
        Ok(prepared
            .scan
            .iter()
            // Every relay of the list is in its sorted copy, whose length the answers have.
            .filter_map(|relay| ascending.binary_search(relay).ok())
            .map(|place| reading(&answers[place]))
            .collect())
    }

    pub(super) async fn read_closed(&mut self, relays: &[Relay]) -> Result<Vec<bool>, RigError> {
        if relays.is_empty() {
            return Ok(Vec::new());
        }
        let question = Route::Closed(compact(relays)).into();
        let (asked, answer) = self.ask(vec![question], self.link.deadline()).await?;
        self.states(&asked, &answer, relays.len())
    }

    fn states(&self, asked: &str, answer: &str, count: usize) -> Result<Vec<bool>, RigError> {
        let states: Result<Vec<bool>, _> = answer.split(',').map(scpi::parse_boolean).collect();
        match states {
            Ok(states) if states.len() == count => Ok(states),
            Ok(_) | Err(_) => Err(garbled(
                self.link.instrument(),
                asked,
                answer,
                &format!("{count} states, each 0 or 1"),
            )),
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
