//! The instruments and the sheet of one rig, with their interactions. Single instruments are in `instrument`,
//! connections of clients in `transport`.

mod faults;
#[cfg(test)]
mod tests;

use std::collections::{BTreeSet, VecDeque};
use std::time::Duration;

use gpio_mux::Poles;
use keithley_6221::Load;
use keysight_34980a::{Alternating, MeterRequest, Wires};
use phantom::Phantom;
use rig::transcript::TranscriptWriter;
use scpi::Response;
use survey::{Amps, Electrode, Ohms, Relay, Volts};
use tokio::time::Instant;

use crate::circuit::sheet::Sheet;
use crate::circuit::terminals::Fixture;
use crate::instrument::fault::TimedFault;
use crate::instrument::simulated::{CurrentSource, ExternalCircuit, SimulatedInstrument};
use crate::instrument::{Instrument, Pace, Profile};

/// The instruments of one rig, connected to one sheet.
#[derive(Debug)]
pub(crate) struct SimulatedInstruments {
    /// In the order in which they perform due actions: switches before sources.
    places: Vec<RoleEntry>,
    pub(crate) sheet: Sheet,
    pace: Pace,
    start: Instant,
    /// In instant time: the time that the instruments would have needed so far. Otherwise the time skipped.
    elapsed: Duration,
    pub(crate) transcript: Option<Vec<TranscriptLine>>,
    /// Writer of all messages and replies.
    pub(crate) recorder: Option<TranscriptWriter>,
    /// Future faults, earliest first.
    time_line: VecDeque<TimedFault>,
    /// The last error that an instrument queued, for the status.
    pub(crate) last_error: Option<String>,
}

/// An instrument in its role.
#[derive(Debug)]
struct RoleEntry {
    role: Instrument,
    instrument: Box<dyn SimulatedInstrument>,
    messages: Messages,
    identity: String,
    /// Position in the transcript at which its reply is pending.
    unanswered: Option<usize>,
}

/// The instruments of a profile with their roles, in the order in which they perform due actions.
fn of_profile(
    profile: &Profile,
    electrodes: usize,
) -> Vec<(Instrument, Box<dyn SimulatedInstrument>)> {
    let all = Instrument::ALL.into_iter();
    let mut all: Vec<_> = all
        .map(|role| (role, (role.kind().build)(profile, electrodes)))
        .collect();
    // Stable: switches before sources, otherwise in the order of the table.
    all.sort_by_key(|(_, instrument)| instrument.current_source().is_some());
    all
}

/// Counters of an instrument's messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Messages {
    /// Messages received.
    pub received: u64,
    /// Replies sent.
    pub answered: u64,
    /// Messages that made the voltmeter take readings.
    pub reading: u64,
    /// Readings that the voltmeter took.
    pub readings: u64,
}

/// A line of a transcript.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TranscriptLine {
    /// The instruments' time.
    pub at: Duration,
    /// The instrument that received the message.
    pub instrument: Instrument,
    /// The message.
    pub received: String,
    /// The reply.
    pub answered: Option<String>,
}

/// Outcome of a message; without a reply by default.
#[derive(Debug, Default)]
pub(crate) struct MessageOutcome {
    pub(crate) text: Option<String>,
    /// Time until the reply, in real time.
    pub(crate) wait: Duration,
    /// Whether the reply must be fetched after that time.
    pub(crate) later: bool,
    /// Whether the numbers of the reply are readings, not settings.
    pub(crate) measured: bool,
    /// The error queued by the message, if any.
    pub(crate) refused: Option<String>,
}

/// When to compute a reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ReplyTiming {
    /// Immediately, whatever time it takes by the instrument's clock.
    AtOnce,
    /// In time: readings are taken at their own times, and [`SimulatedInstruments::fetch`] returns the reply.
    InTime,
}

impl SimulatedInstruments {
    /// Instruments after power on.
    pub(crate) fn new(profile: &Profile, phantom: Phantom, mut time_line: Vec<TimedFault>) -> Self {
        let electrodes = phantom.electrodes();
        time_line.sort_by_key(|timed| timed.at);
        let places = of_profile(profile, electrodes).into_iter();
        let places = places.map(|(role, instrument)| RoleEntry {
            role,
            instrument,
            messages: Messages::default(),
            identity: String::new(),
            unanswered: None,
        });
        let mut new = Self {
            places: places.collect(),
            time_line: time_line.into(),
            last_error: None,
            sheet: Sheet::new(
                phantom,
                Fixture::new(&profile.slots, electrodes),
                &profile.load,
                profile.line_hz,
            ),
            pace: profile.pace,
            start: Instant::now(),
            elapsed: Duration::ZERO,
            transcript: None,
            recorder: None,
        };
        for role in Instrument::ALL {
            let reply = new.receive(role, 0, "*IDN?", ReplyTiming::AtOnce);
            new.place_mut(role).identity = reply.text.unwrap_or_default();
        }
        // Before the first client message and without elapsed time.
        for place in &mut new.places {
            place.messages = Messages::default();
        }
        new.elapsed = Duration::ZERO;
        new
    }

    fn place(&self, role: Instrument) -> &RoleEntry {
        let place = self.places.iter().find(|place| place.role == role);
        place.expect("every role has its instrument")
    }

    fn place_mut(&mut self, role: Instrument) -> &mut RoleEntry {
        let place = self.places.iter_mut().find(|place| place.role == role);
        place.expect("every role has its instrument")
    }

    /// Lets an instrument act on the sheet and the other instruments; returns its result and the number of readings
    /// taken.
    fn act<T>(
        &mut self,
        role: Instrument,
        act: impl FnOnce(&mut dyn SimulatedInstrument, &mut dyn ExternalCircuit) -> T,
    ) -> (T, u64) {
        let index = self.places.iter().position(|place| place.role == role);
        let (before, rest) = self
            .places
            .split_at_mut(index.expect("every role has its instrument"));
        let (place, after) = rest
            .split_first_mut()
            .expect("the index is that of a place");
        let mut outside = SharedCircuit {
            others: [before, after],
            sheet: &mut self.sheet,
            readings: 0,
        };
        let result = act(&mut *place.instrument, &mut outside);
        let readings = outside.readings;
        place.messages.readings += readings;
        (result, readings)
    }

    /// The current source.
    pub(crate) fn source(&self) -> &dyn CurrentSource {
        let source = self.place(Instrument::Source).instrument.current_source();
        source.expect("the instrument in the source's role is a source")
    }

    /// The reply to `*IDN?`.
    pub(crate) fn identity(&self, instrument: Instrument) -> &str {
        &self.place(instrument).identity
    }

    /// The instruments' clock.
    pub(crate) fn now(&self) -> Duration {
        let passed = self.start.elapsed();
        self.elapsed
            + match self.pace {
                Pace::Real => passed,
                Pace::Scaled(speed) => survey::duration(passed.as_secs_f64() * speed),
                Pace::Instant => Duration::ZERO,
            }
    }

    /// Advances the instruments' time.
    pub(crate) fn advance(&mut self, by: Duration) {
        self.elapsed += by;
    }

    pub(crate) fn messages(&self, instrument: Instrument) -> Messages {
        self.place(instrument).messages
    }

    /// Performs what was due since the last message: the board's watchdog may have opened its poles, or a load of the
    /// scene may have changed the source's load.
    pub(crate) fn catch_up(&mut self) {
        let at = self.now();
        let roles: Vec<Instrument> = self.places.iter().map(|place| place.role).collect();
        for role in roles {
            self.act(role, |instrument, outside| instrument.pass(at, outside));
        }
    }

    /// Passes a message to an instrument.
    pub(crate) fn receive(
        &mut self,
        instrument: Instrument,
        session: u32,
        line: &str,
        timing: ReplyTiming,
    ) -> MessageOutcome {
        self.catch_up();
        let at = self.now();
        let errors = self.place(instrument).instrument.latest_error().0;
        let in_time = timing == ReplyTiming::InTime && self.pace != Pace::Instant;
        let (reply, readings) = self.act(instrument, |instrument, outside| match in_time {
            true => instrument.begin(session, line, at, outside),
            false => (instrument.receive(session, line, at, outside), false),
        });
        let (Response { text, busy }, later) = reply;
        let count = &mut self.place_mut(instrument).messages;
        count.received += 1;
        count.answered += u64::from(text.is_some());
        count.reading += u64::from(later || readings > 0);
        if let Some(transcript) = &mut self.transcript {
            transcript.push(TranscriptLine {
                at,
                instrument,
                received: line.to_owned(),
                answered: text.clone(),
            });
            let position = transcript.len() - 1;
            if later {
                self.place_mut(instrument).unanswered = Some(position);
            }
        }
        let wait = match self.pace {
            Pace::Real => busy,
            Pace::Scaled(speed) => survey::duration(busy.as_secs_f64() / speed),
            Pace::Instant => {
                self.elapsed += busy;
                Duration::ZERO
            }
        };
        let receiver = &self.place(instrument).instrument;
        let refused = match receiver.latest_error() {
            (added, Some(latest)) if added != errors => Some(latest.to_string()),
            _ => None,
        };
        let measured = receiver.asks_for_readings(line);
        MessageOutcome {
            text,
            wait,
            later,
            refused,
            measured,
        }
    }

    /// Whether an instrument's postponed reply is there: its measurement was aborted.
    pub(crate) fn has_reply(&self, instrument: Instrument, session: u32) -> bool {
        self.place(instrument).instrument.has_reply(session)
    }

    /// The postponed reply, after its time.
    pub(crate) fn fetch(&mut self, instrument: Instrument, session: u32) -> Option<String> {
        self.catch_up();
        let at = self.now();
        let (text, _) = self.act(instrument, |instrument, outside| {
            instrument.fetch(session, at, outside)
        });
        let place = self.place_mut(instrument);
        place.messages.answered += u64::from(text.is_some());
        let unanswered = place.unanswered.take();
        if let (Some(transcript), Some(position)) = (&mut self.transcript, unanswered)
            && let Some(message) = transcript.get_mut(position)
        {
            message.answered.clone_from(&text);
        }
        text
    }

    /// Registers a client under the name that the instrument uses for it.
    pub(crate) fn name_session(&mut self, instrument: Instrument, session: u32, name: &str) {
        let place = self.place_mut(instrument);
        place.instrument.name_session(session, name);
    }

    /// Removes a client that has disconnected.
    pub(crate) fn forget_session(&mut self, instrument: Instrument, session: u32) {
        self.place_mut(instrument).instrument.end_session(session);
    }

    /// Device clear by a client.
    pub(crate) fn clear_session(&mut self, instrument: Instrument, session: u32) {
        let at = self.now();
        self.act(instrument, |instrument, outside| {
            instrument.clear_session(session, at, outside);
        });
    }

    /// An instrument's status byte, without message available.
    pub(crate) fn status_byte(&mut self, instrument: Instrument) -> u8 {
        self.catch_up();
        self.place(instrument).instrument.status_byte()
    }

    /// Power cycle; returns what the instrument then sends without a query.
    pub(crate) fn power_cycle(&mut self, instrument: Instrument) -> Option<String> {
        let at = self.now();
        let cycled = self.act(instrument, |instrument, outside| {
            instrument.power_cycle(at, outside)
        });
        cycled.0
    }
}

/// The sheet and the other instruments, for the one that acts: they are notified of every change.
struct SharedCircuit<'a> {
    others: [&'a mut [RoleEntry]; 2],
    sheet: &'a mut Sheet,
    readings: u64,
}

impl SharedCircuit<'_> {
    fn load_changed(&mut self, at: Duration) {
        for place in self.others.iter_mut().flat_map(|places| places.iter_mut()) {
            place.instrument.load_changed(at, self.sheet);
        }
    }
}

impl Load for SharedCircuit<'_> {
    fn resistance(&mut self, at: Duration) -> Ohms {
        self.sheet.resistance(at)
    }

    fn drive(&mut self, flowing: Amps, range: Amps, at: Duration) {
        self.sheet.drive(flowing, range, at);
    }
}

impl Wires for SharedCircuit<'_> {
    fn relays(&mut self, closed: &BTreeSet<Relay>, at: Duration) {
        self.sheet.set_closed(closed, at);
        self.load_changed(at);
    }

    fn skipped(&mut self, relays: &[Relay], times: u32, at: Duration) {
        self.sheet.count(relays.iter().copied(), times, at);
    }

    fn measure(&mut self, at: Duration, request: MeterRequest) -> Volts {
        self.readings += 1;
        self.sheet.set_scanned(request.channel);
        // The loads on the sheet may have changed since the relays switched.
        self.load_changed(at);
        // The reading is the mean over the aperture, which ends now.
        let from = at.saturating_sub(self.sheet.integration(request.nplc));
        let places = self.others.iter().flat_map(|places| places.iter());
        let mut sources = places.filter_map(|place| place.instrument.current_source());
        let mean = sources
            .next()
            .map(|source| source.mean_current(from, at, self.sheet));
        let volts = self.sheet.measured(at, request, mean);
        self.sheet.set_scanned(None);
        volts
    }

    fn alternating(&mut self, at: Duration, request: MeterRequest) -> Alternating {
        self.readings += 1;
        self.sheet.set_scanned(request.channel);
        self.load_changed(at);
        let places = self.others.iter().flat_map(|places| places.iter());
        let mut sources = places.filter_map(|place| place.instrument.current_source());
        let wave = sources.find_map(|source| source.alternating(self.sheet));
        let seen = match wave {
            Some((rms, hertz)) => Alternating {
                rms: rms * self.sheet.transfer(at).abs(),
                hertz,
            },
            None => Alternating::default(),
        };
        self.sheet.set_scanned(None);
        seen
    }
}

impl Poles for SharedCircuit<'_> {
    fn poles(&mut self, joined: [Option<Electrode>; 4], at: Duration) {
        self.sheet.set_poles(joined, at);
        self.load_changed(at);
    }
}
