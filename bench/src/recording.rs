//! Transcripts played to the simulators: compared, or made into goldens.

use std::collections::VecDeque;
use std::time::Duration;

use rig::transcript::{Entry, Said};
use scpi::parse_message;

use crate::golden::{Expected, Golden, Line, Step};
use crate::stand::{Making, Stand};
use crate::{Instrument, SimulatedRig};

/// Why a transcript cannot be played, or where the simulators answer otherwise.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// An instrument that is not simulated.
    #[error(
        "{place}:{line}: there is no simulated '{instrument}'; an instrument's name begins with 6221, 34980a or gpio"
    )]
    Stranger {
        /// The file.
        place: String,
        /// Counted from 1.
        line: usize,
        /// Its name.
        instrument: String,
    },
    /// Nothing was said to the instrument.
    #[error("{place}: nothing is said to a {instrument}")]
    Nothing {
        /// The file.
        place: String,
        /// Which.
        instrument: Instrument,
    },
    /// Nobody can say what was asked.
    #[error(
        "{place}:{line}: '{text}' is received, and nothing was asked; replies stand behind their messages"
    )]
    Unasked {
        /// The file.
        place: String,
        /// Counted from 1.
        line: usize,
        /// What was received.
        text: String,
    },
    /// The first difference.
    #[error(
        "{place}:{line}: to '{said}' the {instrument} answered {recorded}, the simulator answers {simulated}"
    )]
    Differs {
        /// The file.
        place: String,
        /// The line of the reply, or of the message where the recording has none.
        line: usize,
        /// Which.
        instrument: Instrument,
        /// The message.
        said: String,
        /// What the recording has.
        recorded: String,
        /// What the simulator answers.
        simulated: String,
    },
}

/// What was played.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Played {
    /// Messages sent.
    pub messages: usize,
    /// Replies compared.
    pub replies: usize,
}

/// How closely replies are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Closeness {
    /// To the byte.
    Exact,
    /// Readings, times, counts and serial numbers in their shape, everything else to the byte.
    Shapes,
}

/// What a transcript is played to.
#[derive(Debug, Clone)]
pub enum Against {
    /// Each instrument on its own, as recorded: mainframes hold the modules that the transcript tells of. The source
    /// drives so many ohms, the voltmeter sees so many volts.
    Alone {
        /// What the mainframe holds, where the transcript does not tell.
        making: Making,
    },
    /// The instruments of one bench. Its pace should be instant: times are those of the transcript.
    Together(SimulatedRig),
}

/// A message under way.
#[derive(Debug)]
struct Sent {
    line: usize,
    said: String,
    reply: Option<String>,
}

/// One instrument's wire in a transcript.
struct Wire {
    name: String,
    instrument: Instrument,
    stand: Option<Stand>,
    free_at: Duration,
    under_way: VecDeque<Sent>,
}

/// Plays a transcript (see [`rig::transcript`]): every message to its simulator at its time, every reply compared.
///
/// # Errors
/// The first difference; an instrument that is not simulated; a reply to nothing.
pub fn replay(
    place: &str,
    entries: &[(usize, Entry)],
    against: &Against,
    closeness: Closeness,
) -> Result<Played, ReplayError> {
    let mut played = Played::default();
    let mut wires: Vec<Wire> = Vec::new();
    for (line, entry) in entries {
        let known = wires.iter().position(|wire| wire.name == entry.instrument);
        let index = match known {
            Some(index) => index,
            None => {
                wires.push(Wire::new(place, *line, entry, entries, against)?);
                wires.len() - 1
            }
        };
        let wire = &mut wires[index];
        match &entry.said {
            Said::Sent(message) => {
                played.messages += 1;
                let reply = wire.hear(message, entry.t_s, against);
                wire.under_way.push_back(Sent {
                    line: *line,
                    said: message.clone(),
                    reply,
                });
            }
            Said::Received(text) => {
                played.replies += 1;
                wire.compare(place, *line, text, closeness)?;
            }
            Said::Note(_) => {}
        }
    }
    for wire in &mut wires {
        while let Some(sent) = wire.under_way.pop_front() {
            wire.unanswered(place, &sent)?;
        }
    }
    Ok(played)
}

impl Wire {
    fn new(
        place: &str,
        line: usize,
        entry: &Entry,
        entries: &[(usize, Entry)],
        against: &Against,
    ) -> Result<Self, ReplayError> {
        let instrument = Instrument::named(&entry.model());
        let instrument = instrument.ok_or_else(|| ReplayError::Stranger {
            place: place.to_owned(),
            line,
            instrument: entry.instrument.clone(),
        })?;
        let stand = match against {
            Against::Alone { making } => {
                let told = told_making(entries, instrument, making);
                Some(Stand::new(&told))
            }
            Against::Together(_) => None,
        };
        Ok(Self {
            name: entry.instrument.clone(),
            instrument,
            stand,
            free_at: Duration::ZERO,
            under_way: VecDeque::new(),
        })
    }

    fn hear(&mut self, message: &str, t_s: f64, against: &Against) -> Option<String> {
        let at = Duration::try_from_secs_f64(t_s).unwrap_or_default();
        match (&mut self.stand, against) {
            (Some(stand), _) => {
                let at = at.max(self.free_at);
                let (reply, busy) = stand.hear(message, at);
                self.free_at = at.saturating_add(busy);
                reply
            }
            (None, Against::Together(rig)) => {
                rig.advance(at.saturating_sub(rig.now()));
                rig.hear(self.instrument, message).0
            }
            (None, Against::Alone { .. }) => None,
        }
    }

    /// Compares a reply to that of the message it must be the answer of: the oldest that was answered, or may have
    /// been.
    fn compare(
        &mut self,
        place: &str,
        line: usize,
        text: &str,
        closeness: Closeness,
    ) -> Result<(), ReplayError> {
        let unasked = || ReplayError::Unasked {
            place: place.to_owned(),
            line,
            text: text.to_owned(),
        };
        // Commands before the question have no reply on either side.
        let answered = self.under_way.iter().position(|sent| sent.reply.is_some());
        let asks = |sent: &Sent| sent.said.contains('?');
        let index = answered
            .or_else(|| self.under_way.iter().rposition(asks))
            .or(self.under_way.len().checked_sub(1))
            .ok_or_else(unasked)?;
        self.under_way.drain(..index);
        let sent = self.under_way.pop_front().ok_or_else(unasked)?;
        let expected = match closeness {
            Closeness::Shapes if varies(self.instrument, &sent.said) => {
                Expected::Shape(text.to_owned())
            }
            _ => Expected::Text(text.to_owned()),
        };
        if sent
            .reply
            .as_deref()
            .is_some_and(|reply| expected.holds(reply))
        {
            return Ok(());
        }
        Err(self.differs(place, line, &sent, format!("'{text}'")))
    }

    fn unanswered(&self, place: &str, sent: &Sent) -> Result<(), ReplayError> {
        match sent.reply {
            None => Ok(()),
            Some(_) => Err(self.differs(place, sent.line, sent, "nothing".to_owned())),
        }
    }

    fn differs(&self, place: &str, line: usize, sent: &Sent, recorded: String) -> ReplayError {
        let simulated = sent.reply.as_ref();
        ReplayError::Differs {
            place: place.to_owned(),
            line,
            instrument: self.instrument,
            said: sent.said.clone(),
            recorded,
            simulated: simulated.map_or_else(|| "nothing".to_owned(), |text| format!("'{text}'")),
        }
    }
}

/// Makes a golden of what a transcript has of one instrument. Readings, times, counts and serial numbers are kept in
/// their shape.
///
/// # Errors
/// Nothing said to that instrument; a reply to nothing.
pub fn golden_of(
    place: &str,
    entries: &[(usize, Entry)],
    making: &Making,
    cites: Vec<String>,
) -> Result<Golden, ReplayError> {
    let instrument = making.instrument;
    let of_it = entries
        .iter()
        .filter(|(_, entry)| Instrument::named(&entry.model()) == Some(instrument));
    let mut steps: Vec<Step> = Vec::new();
    let (mut last, mut began) = (0.0, None);
    // Messages whose reply is still to come, by their place among the steps: clients may send ahead.
    let mut open: VecDeque<(usize, String)> = VecDeque::new();
    for (line, entry) in of_it {
        match &entry.said {
            Said::Sent(message) => {
                let began = *began.get_or_insert(entry.t_s);
                let at = ((entry.t_s - began) * 1e3).round() / 1e3;
                if at > last {
                    last = at;
                    let at = Duration::try_from_secs_f64(at).unwrap_or_default();
                    steps.push(Step::At(at));
                }
                steps.push(Step::Say(message.clone()));
                steps.push(Step::Silence);
                open.push_back((steps.len() - 1, message.clone()));
            }
            Said::Received(text) => {
                let asked = open.iter().position(|(_, message)| message.contains('?'));
                let index = asked.or(open.len().checked_sub(1));
                let found = index.and_then(|index| open.drain(..=index).next_back());
                let (step, said) = found.ok_or_else(|| ReplayError::Unasked {
                    place: place.to_owned(),
                    line: *line,
                    text: text.clone(),
                })?;
                steps[step] = Step::Answer(match varies(instrument, &said) {
                    true => Expected::Shape(text.clone()),
                    false => Expected::Text(text.clone()),
                });
            }
            Said::Note(_) => {}
        }
    }
    if steps.is_empty() {
        return Err(ReplayError::Nothing {
            place: place.to_owned(),
            instrument,
        });
    }
    let lines = steps.into_iter().map(|step| Line { number: 0, step });
    Ok(Golden {
        making: told_making(entries, instrument, making),
        cites,
        lines: lines.collect(),
    })
}

/// What an instrument is made of, completed by what it tells of itself in the transcript.
fn told_making(entries: &[(usize, Entry)], instrument: Instrument, making: &Making) -> Making {
    let mut told = Making {
        instrument,
        ..making.clone()
    };
    if instrument != Instrument::Mainframe {
        return told;
    }
    let of_it = entries
        .iter()
        .filter(|(_, entry)| Instrument::named(&entry.model()) == Some(instrument));
    let mut asked: Option<keysight_34980a::Command> = None;
    for (_, entry) in of_it {
        match &entry.said {
            Said::Sent(message) => asked = message.parse().ok(),
            Said::Received(text) => match asked.take() {
                Some(keysight_34980a::Command::Common(scpi::Common::Identify)) => {
                    let vendor = text.split(',').next().map(str::to_owned);
                    told.vendor = told.vendor.or(vendor);
                }
                Some(keysight_34980a::Command::System(keysight_34980a::System::CardType(slot))) => {
                    let model = text.trim_matches('"').split(',').nth(1).unwrap_or_default();
                    // A 34934A appends its layout.
                    let module = model.replacen('-', ",", 1).parse().ok();
                    if let Some(place) = told.slots.get_mut(slot as usize - 1) {
                        *place = place.or(module);
                    }
                }
                _ => {}
            },
            Said::Note(_) => {}
        }
    }
    told
}

/// Whether the reply to a message depends on what cannot be the same twice: the specimen, the clock, the unit's age.
fn varies(instrument: Instrument, message: &str) -> bool {
    use keithley_6221::Command as Source;
    use keysight_34980a::{Command as Mainframe, Measure, System};
    if instrument == Instrument::Board {
        let command = message.parse();
        return matches!(
            command,
            Ok(gpio_mux::Command::Identify | gpio_mux::Command::AskLastEdge)
        );
    }
    parse_message(message)
        .into_iter()
        .flatten()
        .any(|call| match instrument {
            Instrument::Source => matches!(
                Source::of(&call),
                Ok(Source::Common(scpi::Common::Identify)
                    | Source::BoardSerial(_)
                    | Source::BoardRevision(_)
                    | Source::Address(_))
            ),
            Instrument::Mainframe => matches!(
                Mainframe::of(&call),
                Ok(Mainframe::Common(scpi::Common::Identify)
                    | Mainframe::Measure(
                        Measure::Read(_)
                            | Measure::Volts { .. }
                            | Measure::Fetch
                            | Measure::ReadAndErase(_)
                            | Measure::Remove(_)
                    )
                    | Mainframe::System(
                        System::CardType(_)
                            | System::Date
                            | System::Time
                            | System::ScanTime
                            | System::RelayCycles(_)
                    ))
            ),
            Instrument::Board => false,
        })
}
