//! The mainframe as [`Switch`] and [`Voltmeter`].
//!
//! Relay moves are held back and leave in one segment with the next question, so that an injection costs one message:
//! `ROUT:CLOS (@1037);:ROUT:OPEN (@1036);:READ?`. A move that only closes is sent at once: whoever switches a source on
//! next must find its relay closed.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use rig::{Link, MeterSettings, Move, RigError, Stream, Switch, Voltmeter};
use scpi::{Answer, ChannelEntry, ChannelList, Common, ErrorEntry};
use survey::{Reading, Relay, Volts, Wiring};
use tokio::sync::Mutex;

use crate::command::{Command, Field, INTEGRATION, Message, RANGES, Range, TriggerSource};
use crate::modules::{Module, split};

const MODEL: &str = "34980A";
/// Both names that the maker has had (fact sheet section 1).
const VENDORS: [&str; 2] = ["Agilent Technologies", "Keysight Technologies"];
/// Entries of the error queue (section 7), and some more.
const MOST_ERRORS: usize = 25;
/// The slower of the two mains frequencies: deadlines must suffice on both.
const SLOWEST_LINE_HZ: f64 = 50.0;

/// A handle of one mainframe. Clones mean the same instrument and take turns.
#[derive(Debug)]
pub struct Keysight34980a<S> {
    unit: Arc<Mutex<Unit<S>>>,
    about: Arc<About>,
}

impl<S> Clone for Keysight34980a<S> {
    fn clone(&self) -> Self {
        Self {
            unit: Arc::clone(&self.unit),
            about: Arc::clone(&self.about),
        }
    }
}

/// What does not change while connected.
#[derive(Debug)]
struct About {
    instrument: String,
    identity: String,
    cards: [Option<String>; 8],
    modules: [Option<Module>; 8],
}

#[derive(Debug)]
struct Unit<S> {
    link: Link<S>,
    /// Relay moves that wait for the next question.
    held: Vec<Command>,
    /// Moves were sent whose refusal nobody has looked for.
    unchecked: bool,
    prepared: Option<Prepared>,
    /// `*RST` is sent once, before the first preparation.
    reset: bool,
}

#[derive(Debug, Clone, PartialEq)]
struct Prepared {
    meter: MeterSettings,
    /// As asked for. The instrument scans ascending.
    scan: Vec<Relay>,
    deadline: Duration,
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

impl<S: Stream> Keysight34980a<S> {
    /// Asks who is there and what is in the slots. Moves nothing and resets nothing: relays left closed by somebody
    /// else must be found so.
    ///
    /// # Errors
    /// Another instrument, a garbled answer, or a failing wire.
    pub async fn connect(mut link: Link<S>) -> Result<Self, RigError> {
        let identity = link
            .ask(&Command::Common(Common::Identify).to_string())
            .await?;
        let fields: Vec<&str> = identity.split(',').map(str::trim).collect();
        let right = matches!(fields.as_slice(), [vendor, model, ..]
            if *model == MODEL && VENDORS.iter().any(|known| known.eq_ignore_ascii_case(vendor)));
        if !right {
            return Err(RigError::WrongInstrument {
                instrument: link.instrument().to_owned(),
                expected: format!("{MODEL} of {}", VENDORS.join(" or ")),
                found: identity,
            });
        }
        let mut cards = [const { None }; 8];
        for (slot, card) in (1..).zip(&mut cards) {
            let asked = Command::CardType(slot).to_string();
            let answer = link.ask(&asked).await?;
            let model = answer
                .trim()
                .trim_matches('"')
                .split(',')
                .nth(1)
                .map(str::trim)
                .ok_or_else(|| garbled(link.instrument(), &asked, &answer, "vendor,model,..."))?;
            *card = (model != "0").then(|| model.to_owned());
        }
        let modules = cards.each_ref().map(|card| {
            card.as_deref()
                .and_then(|card| Module::from_card_type(card).ok())
        });
        let about = About {
            instrument: link.instrument().to_owned(),
            identity,
            cards,
            modules,
        };
        let unit = Unit {
            link,
            held: Vec::new(),
            unchecked: false,
            prepared: None,
            reset: false,
        };
        Ok(Self {
            unit: Arc::new(Mutex::new(unit)),
            about: Arc::new(about),
        })
    }

    /// The reply to `*IDN?`.
    pub fn identity(&self) -> &str {
        &self.about.identity
    }

    /// The modules in slots 1 to 8, where they are known to this house.
    pub fn modules(&self) -> [Option<Module>; 8] {
        self.about.modules
    }

    /// What the slots say they hold, known or not.
    pub fn cards(&self) -> &[Option<String>; 8] {
        &self.about.cards
    }

    /// Whether every relay of a wiring is there, and can be scanned if it is to be.
    ///
    /// # Errors
    /// [`RigError::WrongModule`] for a slot without a module that is known, [`RigError::Unable`] for a channel that
    /// the module does not have or cannot scan.
    pub fn check_wiring(&self, wiring: &Wiring) -> Result<(), RigError> {
        self.check_exist(&wiring.injecting_relays())?;
        self.check_exist(&wiring.bus)?;
        let measuring = wiring.measuring_relays();
        match wiring.sensing {
            survey::Sensing::Scan => self.check_scan(&measuring),
            survey::Sensing::Single => self.check_exist(&measuring),
        }
    }

    fn module_of(&self, relay: Relay) -> Result<(Module, u32), RigError> {
        let Some((slot, channel)) = split(relay) else {
            return Err(self.unable(format!(
                "reach relay {relay}: numbers are slot x 1000 + channel, slots 1 to 8"
            )));
        };
        // `split` yields slots 1 to 8.
        let index = slot as usize - 1;
        let module = self.about.modules[index].ok_or_else(|| RigError::WrongModule {
            instrument: self.about.instrument.clone(),
            slot,
            found: self.about.cards[index]
                .clone()
                .unwrap_or_else(|| "no module".to_owned()),
            expected: format!("a module with channel {channel}"),
        })?;
        if module.contact(channel).is_none() {
            return Err(self.unable(format!(
                "reach relay {relay}: the {module} in slot {slot} has no channel {channel}"
            )));
        }
        Ok((module, channel))
    }

    fn check_exist(&self, relays: &[Relay]) -> Result<(), RigError> {
        relays
            .iter()
            .try_for_each(|relay| self.module_of(*relay).map(drop))
    }

    fn check_scan(&self, relays: &[Relay]) -> Result<(), RigError> {
        let mut seen = BTreeSet::new();
        for relay in relays {
            let (module, channel) = self.module_of(*relay)?;
            if !module.scannable(channel) {
                return Err(self.unable(format!(
                    "scan relay {relay}: channel {channel} of a {module} cannot be scanned"
                )));
            }
            if !seen.insert(relay) {
                return Err(self.unable(format!("scan relay {relay} twice in one list")));
            }
        }
        Ok(())
    }

    fn unable(&self, what: String) -> RigError {
        RigError::Unable {
            instrument: self.about.instrument.clone(),
            what,
        }
    }

    /// How long one READ? may take (section 9), with half as much again, beside what any answer may take.
    fn deadline(&self, meter: MeterSettings, scan: &[Relay], link: Duration) -> Duration {
        let zero = if meter.autozero { 2.0 } else { 1.0 };
        let integration = zero * meter.nplc / SLOWEST_LINE_HZ;
        let channel = |relay: &Relay| {
            let rate = self
                .module_of(*relay)
                .ok()
                .and_then(|(module, _)| module.model().scan_rate());
            1.0 / f64::from(rate.unwrap_or(100)) + integration
        };
        let seconds = if scan.is_empty() {
            integration
        } else {
            scan.iter().map(channel).sum()
        };
        link + Duration::from_secs_f64(1.5 * seconds)
    }
}

impl<S: Stream> Unit<S> {
    /// Sends what was held back together with these commands, the last of which is a question.
    async fn ask(
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
        message.push(Command::NextError);
        let (asked, answer) = self.ask(message, self.link.deadline()).await?;
        let error = self.error(&asked, &answer)?;
        match error.code {
            0 => Ok(()),
            _ => Err(self.refused(said, error)),
        }
    }

    /// Empties the error queue; the first entry is an error.
    async fn drain(&mut self, suspect: &str) -> Result<(), RigError> {
        let mut first = None;
        for _ in 0..MOST_ERRORS {
            let (asked, answer) = self
                .ask(vec![Command::NextError], self.link.deadline())
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

    async fn set_up(&mut self, wanted: &Prepared) -> Result<(), RigError> {
        use Command as C;
        if !self.reset {
            self.tell(vec![
                C::Common(Common::Reset),
                C::Common(Common::ClearStatus),
            ])
            .await?;
            self.reset = true;
        }
        let list = || Some(wanted.list());
        let mut settings = vec![
            C::ConfigureVolts {
                range: Range::Fixed(wanted.meter.range.0),
                resolution: None,
                channels: list(),
            },
            C::SetNplc(wanted.meter.nplc, list()),
            C::SetAutozero(wanted.meter.autozero, list()),
            C::SetInputAuto(true, list()),
            C::SetTriggerSource(TriggerSource::Immediate),
            C::SetTriggerCount(1),
        ];
        if !wanted.scan.is_empty() {
            settings.push(C::SetChannelDelay(0.0, list()));
        }
        let fields = [Field::Unit, Field::Time, Field::Channel, Field::Alarm];
        settings.extend(fields.map(|field| C::SetField(field, false)));
        for setting in settings {
            self.tell(vec![setting]).await?;
        }
        Ok(())
    }

    /// Reads every setting back that a reading depends on.
    async fn verify(&mut self, wanted: &Prepared) -> Result<(), RigError> {
        use Command as C;
        let list = || Some(wanted.list());
        let channels = wanted.scan.len().max(1);
        let number = |value: f64| vec![value; channels];
        let mut settings = vec![
            ("range", C::Range(list()), number(wanted.meter.range.0)),
            ("integration", C::Nplc(list()), number(wanted.meter.nplc)),
            (
                "autozero",
                C::Autozero(list()),
                number(f64::from(u8::from(wanted.meter.autozero))),
            ),
            ("input impedance", C::InputAuto(list()), number(1.0)),
            ("trigger count", C::TriggerCount, vec![1.0]),
            ("scan size", C::ScanSize, vec![wanted.scan.len() as f64]),
        ];
        if !wanted.scan.is_empty() {
            settings.push(("channel delay", C::ChannelDelay(list()), number(0.0)));
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
        let (asked, answer) = self.ask(vec![C::Scan], self.link.deadline()).await?;
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
    async fn measure(&mut self) -> Result<Vec<Reading>, RigError> {
        let Some(prepared) = self.prepared.clone() else {
            return Err(RigError::Unable {
                instrument: self.link.instrument().to_owned(),
                what: "measure before it is prepared".to_owned(),
            });
        };
        let (asked, answer) = self
            .ask(vec![Command::Read(None)], prepared.deadline)
            .await?;
        let answers = self.numbers(&asked, &answer, prepared.scan.len().max(1))?;
        let reading = |answer: &Answer| match answer {
            Answer::Value(volts) => Reading::Ok(Volts(*volts)),
            Answer::Overload { .. } | Answer::NotANumber => Reading::Overload,
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

    async fn read_closed(&mut self, relays: &[Relay]) -> Result<Vec<bool>, RigError> {
        if relays.is_empty() {
            return Ok(Vec::new());
        }
        let question = Command::Closed(compact(relays));
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

impl<S: Stream> Switch for Keysight34980a<S> {
    /// Holds the moves back for the next question, unless nothing is opened: then the relays close at once.
    async fn move_relays(&mut self, moves: &[Move]) -> Result<(), RigError> {
        let mut commands = Vec::new();
        let mut opens = false;
        for one in moves {
            let (Move::Close(relays) | Move::Open(relays)) = one;
            self.check_exist(relays)?;
            if relays.is_empty() {
                continue;
            }
            let list = compact(relays);
            commands.push(match one {
                Move::Close(_) => Command::Close(list),
                Move::Open(_) => {
                    opens = true;
                    Command::Open(list)
                }
            });
        }
        if commands.is_empty() {
            return Ok(());
        }
        let mut unit = self.unit.lock().await;
        unit.held.extend(commands);
        unit.unchecked = true;
        drop(unit);
        if opens { Ok(()) } else { self.settle().await }
    }

    async fn settle(&mut self) -> Result<(), RigError> {
        let mut unit = self.unit.lock().await;
        if unit.held.is_empty() {
            return Ok(());
        }
        let deadline = unit.link.deadline();
        let question = Command::Common(Common::WhenComplete);
        let (asked, answer) = unit.ask(vec![question], deadline).await?;
        match scpi::parse_boolean(&answer) {
            Ok(true) => Ok(()),
            Ok(false) | Err(_) => Err(garbled(unit.link.instrument(), &asked, &answer, "1")),
        }
    }

    async fn closed(&mut self, relays: &[Relay]) -> Result<Vec<bool>, RigError> {
        self.check_exist(relays)?;
        self.unit.lock().await.read_closed(relays).await
    }

    /// Opens the relays, reads them back, and then looks whether a move made since the last time was refused.
    async fn open_verified(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        self.check_exist(relays)?;
        let mut unit = self.unit.lock().await;
        // On the way to safety nothing closes.
        unit.held
            .retain(|command| !matches!(command, Command::Close(_)));
        if !relays.is_empty() {
            unit.held.push(Command::Open(compact(relays)));
        }
        let closed = unit.read_closed(relays).await?;
        let stuck: Vec<Relay> = relays
            .iter()
            .zip(closed)
            .filter(|(_, closed)| *closed)
            .map(|(relay, _)| *relay)
            .collect();
        if !stuck.is_empty() {
            return Err(RigError::StillClosed {
                instrument: self.about.instrument.clone(),
                relays: stuck,
            });
        }
        if std::mem::take(&mut unit.unchecked) {
            unit.drain("a relay move since the last check").await?;
        }
        Ok(())
    }
}

impl<S: Stream> Voltmeter for Keysight34980a<S> {
    /// Sets everything once, and reads it back every time. The first time the instrument is reset, which opens every
    /// relay.
    async fn prepare(&mut self, meter: MeterSettings, scan: &[Relay]) -> Result<(), RigError> {
        if !RANGES.contains(&meter.range.0) {
            return Err(RigError::VoltageOutOfRange {
                instrument: self.about.instrument.clone(),
                asked: meter.range,
                allowed: "0.1, 1, 10, 100 and 300 V".to_owned(),
            });
        }
        if !INTEGRATION.iter().any(|(nplc, _)| *nplc == meter.nplc) {
            return Err(self.unable(format!(
                "integrate over {} power-line cycles; 0.02, 0.2, 1, 2, 10, 20, 100 and 200 can be",
                meter.nplc
            )));
        }
        self.check_scan(scan)?;
        let mut unit = self.unit.lock().await;
        let wanted = Prepared {
            meter,
            scan: scan.to_vec(),
            deadline: self.deadline(meter, scan, unit.link.deadline()),
        };
        if unit.prepared.take().as_ref() != Some(&wanted) {
            unit.set_up(&wanted).await?;
        }
        unit.verify(&wanted).await?;
        unit.prepared = Some(wanted);
        Ok(())
    }

    async fn scan(&mut self) -> Result<Vec<Reading>, RigError> {
        let mut unit = self.unit.lock().await;
        if unit
            .prepared
            .as_ref()
            .is_some_and(|prepared| prepared.scan.is_empty())
        {
            return Err(self.unable("scan: it was prepared for single readings".to_owned()));
        }
        unit.measure().await
    }

    async fn read(&mut self) -> Result<Reading, RigError> {
        let mut unit = self.unit.lock().await;
        if unit
            .prepared
            .as_ref()
            .is_some_and(|prepared| !prepared.scan.is_empty())
        {
            return Err(self.unable("read once: it was prepared to scan".to_owned()));
        }
        // `measure` has seen to it that there is exactly one.
        let readings = unit.measure().await?;
        Ok(readings.first().copied().unwrap_or(Reading::NotMeasured))
    }
}

fn garbled(instrument: &str, command: &str, answer: &str, expected: &str) -> RigError {
    let shown = |text: &str| text.chars().take(60).collect();
    RigError::Garbled {
        instrument: instrument.to_owned(),
        command: shown(command),
        answer: shown(answer),
        expected: expected.to_owned(),
    }
}

/// The list in its order, runs of neighbours as ranges.
fn compact(relays: &[Relay]) -> ChannelList {
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
