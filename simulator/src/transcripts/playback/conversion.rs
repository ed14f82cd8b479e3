//! Converts the part of one instrument in a transcript to a golden.

use std::collections::VecDeque;
use std::time::Duration;

use rig::transcript::{Entry, EntryContent};

use crate::Instrument;
use crate::instrument::isolated::InstrumentSetup;
use crate::transcripts::golden::{Expected, Golden, GoldenLine, Step};
use crate::transcripts::playback::ReplayError;

/// Converts the part of one instrument to a golden. Readings, times, counts and serial numbers are compared by shape
/// only.
///
/// # Errors
/// No message to that instrument; a reply without a message.
pub fn golden_of(
    place: &str,
    entries: &[(usize, Entry)],
    setup: &InstrumentSetup,
    cites: Vec<String>,
) -> Result<Golden, ReplayError> {
    let instrument = setup.instrument;
    let of_it = entries
        .iter()
        .filter(|(_, entry)| Instrument::named(&entry.model()) == Some(instrument));
    let mut steps: Vec<Step> = Vec::new();
    let (mut last, mut began) = (0.0, None);
    // Messages whose reply is pending, by the index of their step: clients may send ahead.
    let mut open: VecDeque<(usize, String)> = VecDeque::new();
    for (line, entry) in of_it {
        match &entry.content {
            EntryContent::Sent(message) => {
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
            EntryContent::Received(text) => {
                let query = open.iter().position(|(_, message)| message.contains('?'));
                let index = query.or(open.len().checked_sub(1));
                let found = index.and_then(|index| open.drain(..=index).next_back());
                let (step, content) = found.ok_or_else(|| ReplayError::Unrequested {
                    place: place.to_owned(),
                    line: *line,
                    text: text.clone(),
                })?;
                steps[step] = Step::Answer(match (instrument.kind().varies)(&content) {
                    true => Expected::Shape(text.clone()),
                    false => Expected::Text(text.clone()),
                });
            }
            EntryContent::Note(_) => {}
        }
    }
    if steps.is_empty() {
        return Err(ReplayError::Nothing {
            place: place.to_owned(),
            instrument,
        });
    }
    let lines = steps.into_iter().map(|step| GoldenLine { number: 0, step });
    Ok(Golden {
        setup: setup_of_transcript(entries, instrument, setup),
        cites,
        lines: lines.collect(),
    })
}

/// Configuration of an instrument, completed by its replies in the transcript.
pub(super) fn setup_of_transcript(
    entries: &[(usize, Entry)],
    instrument: Instrument,
    setup: &InstrumentSetup,
) -> InstrumentSetup {
    let mut setup = InstrumentSetup {
        instrument,
        ..setup.clone()
    };
    if instrument != Instrument::Mainframe {
        return setup;
    }
    let of_it = entries
        .iter()
        .filter(|(_, entry)| Instrument::named(&entry.model()) == Some(instrument));
    let mut query: Option<keysight_34980a::Command> = None;
    for (_, entry) in of_it {
        match &entry.content {
            EntryContent::Sent(message) => query = message.parse().ok(),
            EntryContent::Received(text) => match query.take() {
                Some(keysight_34980a::Command::Common(scpi::Common::Identify)) => {
                    let vendor = text.split(',').next().map(str::to_owned);
                    setup.vendor = setup.vendor.or(vendor);
                }
                Some(keysight_34980a::Command::System(keysight_34980a::System::CardType(slot))) => {
                    let model = text.trim_matches('"').split(',').nth(1).unwrap_or_default();
                    // A 34934A appends its layout.
                    let module = model.replacen('-', ",", 1).parse().ok();
                    if let Some(place) = setup.slots.get_mut(slot as usize - 1) {
                        *place = place.or(module);
                    }
                }
                _ => {}
            },
            EntryContent::Note(_) => {}
        }
    }
    setup
}
