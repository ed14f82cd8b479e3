//! The conversation with one mainframe: what is held back, what is asked, how answers are read.

use std::collections::BTreeMap;
use std::time::Duration;

use rig::{Link, MeterSettings, RigError, Sample, Stream};
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
    /// Range of each channel as last set; that of the bare voltmeter under `None`. Empty: not known.
    ranges: BTreeMap<Option<Relay>, f64>,
    /// The scan list as last set, ascending.
    listed: Vec<Relay>,
    /// A measurement failed: what has been set is to be set again.
    doubted: bool,
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

    /// Sets up what is wanted, or only what the last frame has left otherwise.
    pub(super) async fn bring_to(
        &mut self,
        wanted: &Prepared,
        before: Option<Prepared>,
    ) -> Result<(), RigError> {
        let same = before.is_some_and(|before| before.is_set_as(wanted));
        if !same || std::mem::take(&mut self.doubted) {
            self.doubted = false;
            return self.set_up(wanted).await;
        }
        if self.listed != wanted.ascending() {
            self.tell(vec![Route::SetScan(wanted.list()).into()])
                .await?;
            self.listed = wanted.ascending();
        }
        Ok(())
    }

    async fn set_up(&mut self, wanted: &Prepared) -> Result<(), RigError> {
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
            Measure::SetCount(Some(wanted.meter.averages)).into(),
        ];
        if !wanted.scan.is_empty() {
            settings.push(set(Setting::Delay(
                wanted.meter.channel_delay.as_secs_f64(),
            )));
        }
        let fields = [Field::Unit, Field::Time, Field::Channel, Field::Alarm];
        settings.extend(fields.map(|field| Measure::SetField(field, false).into()));
        for setting in settings {
            self.tell(vec![setting]).await?;
        }
        let range = wanted.meter.range.0;
        self.listed = wanted.ascending();
        self.ranges = match wanted.scan.is_empty() {
            true => BTreeMap::from([(None, range)]),
            false => wanted.scan.iter().map(|one| (Some(*one), range)).collect(),
        };
        Ok(())
    }

    /// Reads every setting back that a reading depends on.
    pub(super) async fn verify(&mut self, wanted: &Prepared) -> Result<(), RigError> {
        let ask = |quantity| Command::from(Sense::Ask(quantity, None, Some(wanted.list())));
        let channels = wanted.scan.len().max(1);
        let number = |value: f64| vec![value; channels];
        let mut settings = vec![
            ("range", ask(Quantity::Range), self.ranges_of(wanted)),
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
            (
                "trigger count",
                Measure::Count(None).into(),
                vec![f64::from(wanted.meter.averages)],
            ),
            (
                "scan size",
                Route::ScanSize.into(),
                vec![wanted.scan.len() as f64],
            ),
        ];
        if !wanted.scan.is_empty() {
            let delay = wanted.meter.channel_delay.as_secs_f64();
            settings.push(("channel delay", ask(Quantity::Delay), number(delay)));
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
    pub(super) fn numbers(
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

    /// The ranges as last set, in the order in which the instrument tells them.
    fn ranges_of(&self, wanted: &Prepared) -> Vec<f64> {
        let set = |place| self.ranges.get(&place).copied();
        let otherwise = wanted.meter.range.0;
        match wanted.scan.is_empty() {
            true => vec![set(None).unwrap_or(otherwise)],
            false => wanted
                .ascending()
                .into_iter()
                .map(|relay| set(Some(relay)).unwrap_or(otherwise))
                .collect(),
        }
    }

    /// The commands that give channels other ranges than they have.
    fn change_ranges(&mut self, wanted: &[(Option<Relay>, Volts)]) -> Vec<Command> {
        let mut groups: Vec<(f64, Vec<Relay>)> = Vec::new();
        for (place, Volts(range)) in wanted.iter().copied() {
            if self.ranges.insert(place, range) == Some(range) {
                continue;
            }
            let relays = place.into_iter();
            match groups.iter_mut().find(|(known, _)| *known == range) {
                Some((_, group)) => group.extend(relays),
                None => groups.push((range, relays.collect())),
            }
        }
        groups
            .into_iter()
            .map(|(range, mut relays)| {
                relays.sort_unstable();
                let range = Setting::Range(Range::Fixed(range));
                Sense::Set(range, Some(compact(&relays))).into()
            })
            .collect()
    }

    fn prepared(&self) -> Result<Prepared, RigError> {
        self.prepared.clone().ok_or_else(|| RigError::Unable {
            instrument: self.link.instrument().to_owned(),
            what: "measure before it is prepared".to_owned(),
        })
    }

    /// Scans channels, and answers in the order asked for.
    pub(super) async fn scan(&mut self, samples: &[Sample]) -> Result<Vec<Reading>, RigError> {
        let prepared = self.prepared()?;
        let mut ascending: Vec<Relay> = samples.iter().map(|sample| sample.relay).collect();
        ascending.sort_unstable();
        let ranges: Vec<(Option<Relay>, Volts)> = samples
            .iter()
            .map(|sample| (Some(sample.relay), sample.range))
            .collect();
        let mut commands = self.change_ranges(&ranges);
        if self.listed != ascending {
            commands.push(Route::SetScan(compact(&ascending)).into());
            self.listed.clone_from(&ascending);
        }
        commands.push(Measure::Read(None).into());
        let sweeps = prepared.meter.averages as usize;
        let count = ascending.len();
        let answers = self
            .measure(commands, 1, count * sweeps, prepared.deadline)
            .await?;
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
    pub(super) async fn chain(
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
    async fn measure(
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
    async fn refused_message(
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

    /// The relay move among these that the relays do not show.
    async fn not_obeyed(&mut self, said: &[Command]) -> Option<String> {
        let mut meant: BTreeMap<Relay, (bool, &Command)> = BTreeMap::new();
        for command in said {
            let (list, closed) = match command {
                Command::Route(Route::Close(list)) => (list, true),
                Command::Route(Route::Open(list)) => (list, false),
                _ => continue,
            };
            for entry in list.entries() {
                let (first, last) = match entry {
                    ChannelEntry::One(one) => (*one, *one),
                    ChannelEntry::Range(first, last) => (*first, *last),
                };
                for relay in first..=last {
                    meant.insert(Relay(relay), (closed, command));
                }
            }
        }
        let relays: Vec<Relay> = meant.keys().copied().collect();
        let found = self.read_closed(&relays).await.ok()?;
        let found = relays.iter().zip(found);
        let mut other = found.filter_map(|(relay, found)| {
            let (closed, command) = meant.get(relay)?;
            (*closed != found).then_some(*command)
        });
        other.next().map(Command::to_string)
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

/// What a number means on its range. What a sound voltmeter cannot say there is no voltage, whatever number came.
fn reading(answer: &Answer, range: Volts) -> Reading {
    match answer {
        Answer::Value(volts) if volts.abs() <= range.0 * OVERRANGE => Reading::Ok(Volts(*volts)),
        Answer::Value(_) | Answer::Overload { .. } | Answer::NotANumber => Reading::Overload,
    }
}

/// The readings of an answer and the error entry behind them: the first piece that is no number begins it.
fn split_error(answer: &str) -> (&str, &str) {
    let mut from = 0;
    for piece in answer.split(';') {
        if piece.parse::<ErrorEntry>().is_ok() || piece.contains('"') {
            return (answer[..from].trim_end_matches(';'), &answer[from..]);
        }
        from += piece.len() + 1;
    }
    (answer, "")
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
