//! The instruments and the sheet on one table: whatever one of them moves, the others feel.

use std::collections::{BTreeSet, VecDeque};
use std::time::Duration;

use gpio_mux::{Poles, SimulatorGpioMux};
use keithley_6221::{Load, Settings6221, Simulator6221};
use keysight_34980a::{
    Alternating, MeterRequest, Module, Session, Settings34980a, Simulator34980a, Wires,
};
use phantom::Phantom;
use rig::transcript::TranscriptWriter;
use scpi::ErrorEntry;
use survey::{Amps, Electrode, Relay, Volts};
use tokio::time::Instant;

use crate::circuit::sheet::{ReadingRequest, Sheet};
use crate::circuit::terminals::Fixture;
use crate::fault::TimedFault;
use crate::profile::{Pace, Profile, milliseconds};
use crate::simulated_rig::{Instrument, Messages, TranscriptLine};

mod faults;

/// 2000-01-01, seconds since 1970-01-01.
const YEAR_2000: u32 = 946_684_800;

#[derive(Debug)]
pub(crate) struct SimulatedInstruments {
    pub(crate) source: Simulator6221,
    source_settings: Settings6221,
    mainframe: Simulator34980a,
    board: SimulatorGpioMux,
    pub(crate) sheet: Sheet,
    pace: Pace,
    start: Instant,
    /// In instant time: what the instruments would have needed so far. Else what was skipped.
    elapsed: Duration,
    messages: [Messages; 3],
    pub(crate) transcript: Option<Vec<TranscriptLine>>,
    /// Where in it a reply is still missing.
    unanswered: Option<usize>,
    /// Where everything said is written.
    pub(crate) recorder: Option<TranscriptWriter>,
    /// What is still to happen, earliest first.
    time_line: VecDeque<TimedFault>,
    /// The last error that an instrument queued, for people.
    pub(crate) last_error: Option<String>,
    /// The profile's modules, and which of them have been taken out.
    slots: [Option<Module>; 8],
    emptied: [bool; 8],
    voltmeter_missing: bool,
    identities: [String; 3],
}

/// What an instrument made of a message.
#[derive(Debug)]
pub(crate) struct MessageOutcome {
    pub(crate) text: Option<String>,
    /// How long that takes by the clock on the wall.
    pub(crate) wait: Duration,
    /// The reply is to be fetched when that is over.
    pub(crate) later: bool,
    /// The error queued on the way, if one was.
    pub(crate) refused: Option<String>,
}

/// ReplyTiming a reply is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ReplyTiming {
    /// At once, whatever time it takes by the instrument's clock.
    AtOnce,
    /// ReplyTiming its time has come: readings are taken at their own instants, and [`SimulatedInstruments::fetch`] gives the reply.
    InTime,
}

impl SimulatedInstruments {
    /// Instruments just switched on.
    pub(crate) fn new(profile: &Profile, phantom: Phantom, mut time_line: Vec<TimedFault>) -> Self {
        let electrodes = phantom.electrodes();
        let board = profile.board.clone().unwrap_or_default();
        let source_settings = Settings6221 {
            serial: profile.source.serial.clone(),
            command_time: milliseconds(profile.source.command_ms),
            ..Settings6221::default()
        };
        time_line.sort_by_key(|timed| timed.at);
        let mut new = Self {
            source: Simulator6221::new(source_settings.clone()),
            source_settings,
            mainframe: Simulator34980a::new(Settings34980a {
                serial: profile.mainframe.serial.clone(),
                slots: profile.slots,
                line_hz: profile.line_hz,
                message_time: milliseconds(profile.mainframe.command_ms),
                clock: Duration::from_secs(u64::from(
                    profile.mainframe.clock_unix_s.unwrap_or(YEAR_2000),
                )),
                ..Settings34980a::default()
            }),
            slots: profile.slots,
            emptied: [false; 8],
            voltmeter_missing: false,
            identities: Default::default(),
            time_line: time_line.into(),
            last_error: None,
            board: SimulatorGpioMux::new(gpio_mux::Settings {
                serial: board.serial,
                electrodes: electrodes.min(32),
                latency: milliseconds(board.command_ms),
                ..gpio_mux::Settings::default()
            }),
            sheet: Sheet::new(
                phantom,
                Fixture::new(&profile.slots, electrodes),
                &profile.load,
                profile.line_hz,
            ),
            pace: profile.pace,
            start: Instant::now(),
            elapsed: Duration::ZERO,
            messages: Default::default(),
            transcript: None,
            unanswered: None,
            recorder: None,
        };
        new.identities = [Instrument::Source, Instrument::Mainframe, Instrument::Board]
            .map(|instrument| new.receive(instrument, 0, "*IDN?", ReplyTiming::AtOnce))
            .map(|received| received.text.unwrap_or_default());
        // No message has been received yet, and no time has passed.
        new.messages = Default::default();
        new.elapsed = Duration::ZERO;
        new
    }

    /// The reply to `*IDN?`.
    pub(crate) fn identity(&self, instrument: Instrument) -> &str {
        &self.identities[instrument.index()]
    }

    /// What the instruments' clock shows.
    pub(crate) fn now(&self) -> Duration {
        let passed = self.start.elapsed();
        self.elapsed
            + match self.pace {
                Pace::Real => passed,
                Pace::Scaled(speed) => survey::duration(passed.as_secs_f64() * speed),
                Pace::Instant => Duration::ZERO,
            }
    }

    /// Lets the instruments' time pass.
    pub(crate) fn advance(&mut self, by: Duration) {
        self.elapsed += by;
    }

    pub(crate) fn messages(&self, instrument: Instrument) -> Messages {
        self.messages[instrument.index()]
    }

    /// What may have happened since the last message: the board's watchdog opened its poles, a load of the scene
    /// changed what the source sees.
    pub(crate) fn catch_up(&mut self) {
        let at = self.now();
        let mut ends = Ends {
            source: &mut self.source,
            sheet: &mut self.sheet,
            readings: 0,
        };
        // Readings and steps that were due take place at their own instants, with the source as it was then.
        while let Some(due) = self.mainframe.due().filter(|due| *due < at) {
            self.mainframe.pass(due, &mut ends);
        }
        self.mainframe.pass(at, &mut ends);
        self.board.pass(at, &mut ends);
        self.messages[Instrument::Mainframe.index()].readings += ends.readings;
        ends.source.load_changed(at, ends.sheet);
    }

    /// Lets an instrument receive one message.
    pub(crate) fn receive(
        &mut self,
        instrument: Instrument,
        session: u32,
        line: &str,
        timing: ReplyTiming,
    ) -> MessageOutcome {
        self.catch_up();
        let at = self.now();
        let errors = self.latest_error(instrument).0;
        let mut ends = Ends {
            source: &mut self.source,
            sheet: &mut self.sheet,
            readings: 0,
        };
        let mut later = false;
        let (text, busy) = match instrument {
            Instrument::Source => {
                let reply = ends.source.receive(line, at, ends.sheet);
                (reply.text, reply.busy)
            }
            Instrument::Mainframe => {
                let (session, mainframe) = (Session(session), &mut self.mainframe);
                let reply = if timing == ReplyTiming::InTime && self.pace != Pace::Instant {
                    let begun = mainframe.begin_from(session, line, at, &mut ends);
                    later = begun.1;
                    begun.0
                } else {
                    mainframe.receive_from(session, line, at, &mut ends)
                };
                (reply.text, reply.busy)
            }
            Instrument::Board => {
                let reply = self.board.receive(line, at, &mut ends);
                (reply.text, reply.busy)
            }
        };
        let count = &mut self.messages[instrument.index()];
        count.received += 1;
        count.answered += u64::from(text.is_some());
        count.readings += ends.readings;
        count.reading += u64::from(later || ends.readings > 0);
        if let Some(transcript) = &mut self.transcript {
            transcript.push(TranscriptLine {
                at,
                instrument,
                received: line.to_owned(),
                answered: text.clone(),
            });
            if later {
                self.unanswered = Some(transcript.len() - 1);
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
        let refused = match self.latest_error(instrument) {
            (added, Some(latest)) if added != errors => Some(latest.to_string()),
            _ => None,
        };
        MessageOutcome {
            text,
            wait,
            later,
            refused,
        }
    }

    /// The reply that was to be made later, now that its time is over.
    pub(crate) fn fetch(&mut self, session: u32) -> Option<String> {
        self.catch_up();
        let at = self.now();
        let mut text = None;
        self.on_mainframe(|mainframe, ends| text = mainframe.fetch(Session(session), at, ends));
        self.messages[Instrument::Mainframe.index()].answered += u64::from(text.is_some());
        let place = self.unanswered.take();
        if let (Some(transcript), Some(place)) = (&mut self.transcript, place)
            && let Some(said) = transcript.get_mut(place)
        {
            said.answered.clone_from(&text);
        }
        text
    }

    /// How many errors an instrument ever queued, and the last of them.
    fn latest_error(&self, instrument: Instrument) -> (u64, Option<&ErrorEntry>) {
        match instrument {
            Instrument::Source => self.source.latest_error(),
            Instrument::Mainframe => self.mainframe.latest_error(),
            Instrument::Board => self.board.latest_error(),
        }
    }

    /// A client has come: what `SYST:LOCK:NAME?` calls it.
    pub(crate) fn name_session(&mut self, instrument: Instrument, session: u32, name: &str) {
        if instrument == Instrument::Mainframe {
            self.mainframe.name_session(Session(session), name);
        }
    }

    /// A client has left.
    pub(crate) fn forget_session(&mut self, instrument: Instrument, session: u32) {
        match instrument {
            Instrument::Source => self.source.forget_answer(),
            Instrument::Mainframe => self.mainframe.end_session(Session(session)),
            Instrument::Board => {}
        }
    }

    /// A client of the mainframe clears the device.
    pub(crate) fn clear_session(&mut self, session: u32) {
        let at = self.now();
        self.on_mainframe(|mainframe, ends| mainframe.clear_session(Session(session), at, ends));
    }

    /// The mainframe's status byte, without message available.
    pub(crate) fn status_byte(&mut self) -> u8 {
        self.catch_up();
        self.mainframe.status_byte()
    }

    fn on_mainframe(&mut self, act: impl FnOnce(&mut Simulator34980a, &mut Ends<'_>)) {
        let mut ends = Ends {
            source: &mut self.source,
            sheet: &mut self.sheet,
            readings: 0,
        };
        act(&mut self.mainframe, &mut ends);
        self.messages[Instrument::Mainframe.index()].readings += ends.readings;
    }

    /// Switches an instrument off and on.
    pub(crate) fn power_cycle(&mut self, instrument: Instrument) -> Option<String> {
        let at = self.now();
        let mut ends = Ends {
            source: &mut self.source,
            sheet: &mut self.sheet,
            readings: 0,
        };
        match instrument {
            Instrument::Source => {
                *ends.source = Simulator6221::new(self.source_settings.clone());
                ends.sheet.drive(Amps(0.0), ends.source.range(), at);
            }
            Instrument::Mainframe => self.mainframe.power_cycle(at, &mut ends),
            Instrument::Board => return Some(self.board.reset(at, &mut ends)),
        }
        None
    }
}

/// Where the wires of mainframe and board end: whatever they move, the source feels.
struct Ends<'a> {
    source: &'a mut Simulator6221,
    sheet: &'a mut Sheet,
    readings: u64,
}

impl Wires for Ends<'_> {
    fn relays(&mut self, closed: &BTreeSet<Relay>, at: Duration) {
        self.sheet.set_closed(closed, at);
        self.source.load_changed(at, self.sheet);
    }

    fn measure(&mut self, at: Duration, request: MeterRequest) -> Volts {
        self.readings += 1;
        self.sheet.set_scanned(request.channel);
        // The sheet may have been pressed since the relays moved.
        self.source.load_changed(at, self.sheet);
        let reading = ReadingRequest {
            relay: request.channel,
            range: request.range,
            nplc: request.nplc,
            test: request.test_current,
            bus: if request.four_wire { 2 } else { 1 },
        };
        let volts = self.sheet.measured(at, reading);
        self.sheet.set_scanned(None);
        volts
    }

    fn alternating(&mut self, at: Duration, request: MeterRequest) -> Alternating {
        self.readings += 1;
        self.sheet.set_scanned(request.channel);
        self.source.load_changed(at, self.sheet);
        let wave = self.source.alternating(self.sheet);
        let received = match wave {
            Some((rms, hertz)) => Alternating {
                rms: rms * self.sheet.transfer(at).abs(),
                hertz,
            },
            None => Alternating::default(),
        };
        self.sheet.set_scanned(None);
        received
    }
}

impl Poles for Ends<'_> {
    fn poles(&mut self, joined: [Option<Electrode>; 4], at: Duration) {
        self.sheet.set_poles(joined, at);
        self.source.load_changed(at, self.sheet);
    }
}
