//! Transcripts replayed to the simulators for comparison, or converted to goldens.

mod conversion;

use std::collections::VecDeque;
use std::time::Duration;

use rig::transcript::{Entry, EntryContent};

use crate::instrument::isolated::{InstrumentSetup, IsolatedInstrument};
use crate::transcripts::golden::Expected;
pub use crate::transcripts::playback::conversion::golden_of;
use crate::transcripts::playback::conversion::setup_of_transcript;
use crate::{Instrument, SimulatedRig};

/// Why a transcript cannot be replayed, or the first difference.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// An instrument that is not simulated.
    #[error(
        "{place}:{line}: there is no simulated '{instrument}'; an instrument's name begins with {}",
        Instrument::listed(|kind| kind.name, "or")
    )]
    Stranger {
        /// The file.
        place: String,
        /// Counted from 1.
        line: usize,
        /// Its name.
        instrument: String,
    },
    /// The transcript has no message to the instrument.
    #[error("{place}: no message is sent to a {instrument}")]
    Nothing {
        /// The file.
        place: String,
        /// The instrument.
        instrument: Instrument,
    },
    /// A reply without a message.
    #[error(
        "{place}:{line}: the reply '{text}' has no message before it; a reply must follow its message"
    )]
    Unrequested {
        /// The file.
        place: String,
        /// Counted from 1.
        line: usize,
        /// The reply.
        text: String,
    },
    /// The first difference.
    #[error(
        "{place}:{line}: the {instrument} replied {recorded} to '{message}', the simulator replies {simulated}"
    )]
    Differs {
        /// The file.
        place: String,
        /// The line of the reply, or of the message where the recording has none.
        line: usize,
        /// The instrument.
        instrument: Instrument,
        /// The message.
        message: String,
        /// The recorded reply.
        recorded: String,
        /// The simulator's reply.
        simulated: String,
    },
}

/// Statistics of a replay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ReplayStatistics {
    /// Messages sent.
    pub messages: usize,
    /// Replies compared.
    pub replies: usize,
}

/// Accuracy of the comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Comparison {
    /// Exact.
    Exact,
    /// Readings, times, counts and serial numbers by shape, everything else exactly.
    Shapes,
}

/// Target of a replay.
#[derive(Debug, Clone)]
pub enum ReplayTarget {
    /// Each instrument alone, as recorded: mainframes contain the modules identified in the transcript, the source has
    /// a resistor as its load, the voltmeter a constant voltage.
    Alone {
        /// Configuration of the mainframe, as far as the transcript does not identify it.
        setup: InstrumentSetup,
    },
    /// The instruments of one simulated rig. Its speed should be instant: times are those of the transcript.
    Together(SimulatedRig),
}

/// A message without its reply yet.
#[derive(Debug)]
struct PendingMessage {
    line: usize,
    message: String,
    reply: Option<String>,
}

/// State of one instrument's messages in a transcript.
struct InstrumentProgress {
    name: String,
    instrument: Instrument,
    isolated: Option<IsolatedInstrument>,
    free_at: Duration,
    under_way: VecDeque<PendingMessage>,
}

/// Replays a transcript (see [`rig::transcript`]): sends every message to its simulator at its time, and compares every
/// reply.
///
/// # Errors
/// The first difference; an instrument that is not simulated; a reply without a message.
pub fn replay(
    place: &str,
    entries: &[(usize, Entry)],
    target: &ReplayTarget,
    comparison: Comparison,
) -> Result<ReplayStatistics, ReplayError> {
    let mut played = ReplayStatistics::default();
    let mut wires: Vec<InstrumentProgress> = Vec::new();
    for (line, entry) in entries {
        let known = wires.iter().position(|wire| wire.name == entry.instrument);
        let index = match known {
            Some(index) => index,
            None => {
                wires.push(InstrumentProgress::new(
                    place, *line, entry, entries, target,
                )?);
                wires.len() - 1
            }
        };
        let wire = &mut wires[index];
        match &entry.content {
            EntryContent::Sent(message) => {
                played.messages += 1;
                let reply = wire.receive(message, entry.t_s, target);
                wire.under_way.push_back(PendingMessage {
                    line: *line,
                    message: message.clone(),
                    reply,
                });
            }
            EntryContent::Received(text) => {
                played.replies += 1;
                wire.compare(place, *line, text, comparison)?;
            }
            EntryContent::Note(_) => {}
        }
    }
    for wire in &mut wires {
        while let Some(sent) = wire.under_way.pop_front() {
            wire.unanswered(place, &sent)?;
        }
    }
    Ok(played)
}

impl InstrumentProgress {
    fn new(
        place: &str,
        line: usize,
        entry: &Entry,
        entries: &[(usize, Entry)],
        target: &ReplayTarget,
    ) -> Result<Self, ReplayError> {
        let instrument = Instrument::named(&entry.model());
        let instrument = instrument.ok_or_else(|| ReplayError::Stranger {
            place: place.to_owned(),
            line,
            instrument: entry.instrument.clone(),
        })?;
        let isolated = match target {
            ReplayTarget::Alone { setup } => {
                let setup = setup_of_transcript(entries, instrument, setup);
                Some(IsolatedInstrument::new(&setup))
            }
            ReplayTarget::Together(_) => None,
        };
        Ok(Self {
            name: entry.instrument.clone(),
            instrument,
            isolated,
            free_at: Duration::ZERO,
            under_way: VecDeque::new(),
        })
    }

    fn receive(&mut self, message: &str, t_s: f64, target: &ReplayTarget) -> Option<String> {
        let at = Duration::try_from_secs_f64(t_s).unwrap_or_default();
        match (&mut self.isolated, target) {
            (Some(isolated), _) => {
                let at = at.max(self.free_at);
                let (reply, busy) = isolated.receive(message, at);
                self.free_at = at.saturating_add(busy);
                reply
            }
            (None, ReplayTarget::Together(rig)) => {
                rig.advance(at.saturating_sub(rig.now()));
                rig.receive(self.instrument, message).0
            }
            (None, ReplayTarget::Alone { .. }) => None,
        }
    }

    /// Compares a recorded reply with the simulated one of the oldest message that has one, otherwise of the last
    /// query.
    fn compare(
        &mut self,
        place: &str,
        line: usize,
        text: &str,
        comparison: Comparison,
    ) -> Result<(), ReplayError> {
        let unrequested = || ReplayError::Unrequested {
            place: place.to_owned(),
            line,
            text: text.to_owned(),
        };
        // Commands before the query have no reply on either side.
        let answered = self.under_way.iter().position(|sent| sent.reply.is_some());
        let asks = |sent: &PendingMessage| sent.message.contains('?');
        let index = answered
            .or_else(|| self.under_way.iter().rposition(asks))
            .or(self.under_way.len().checked_sub(1))
            .ok_or_else(unrequested)?;
        self.under_way.drain(..index);
        let sent = self.under_way.pop_front().ok_or_else(unrequested)?;
        let expected = match comparison {
            Comparison::Shapes if (self.instrument.kind().varies)(&sent.message) => {
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

    fn unanswered(&self, place: &str, sent: &PendingMessage) -> Result<(), ReplayError> {
        match sent.reply {
            None => Ok(()),
            Some(_) => Err(self.differs(place, sent.line, sent, "nothing".to_owned())),
        }
    }

    fn differs(
        &self,
        place: &str,
        line: usize,
        sent: &PendingMessage,
        recorded: String,
    ) -> ReplayError {
        let simulated = sent.reply.as_ref();
        ReplayError::Differs {
            place: place.to_owned(),
            line,
            instrument: self.instrument,
            message: sent.message.clone(),
            recorded,
            simulated: simulated.map_or_else(|| "nothing".to_owned(), |text| format!("'{text}'")),
        }
    }
}
