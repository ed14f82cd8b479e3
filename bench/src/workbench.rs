//! The instruments and the sheet on one table: whatever one of them moves, the others feel.

use std::collections::BTreeSet;
use std::time::Duration;

use gpio_mux::{Poles, SimulatorGpioMux};
use keithley_6221::{Load, Settings6221, Simulator6221};
use keysight_34980a::{MeterRequest, Settings34980a, Simulator34980a, Wires};
use phantom::{Phantom, ReadingContext};
use survey::{Amps, Electrode, Relay, Volts};
use tokio::time::Instant;

use crate::fixture::Fixture;
use crate::profile::{Pace, Profile, milliseconds};
use crate::sheet::Sheet;
use crate::simulated::{Instrument, Messages, Said};

#[derive(Debug)]
pub(crate) struct Bench {
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
    pub(crate) transcript: Option<Vec<Said>>,
}

impl Bench {
    /// Instruments just switched on.
    pub(crate) fn new(profile: &Profile, phantom: Phantom) -> Self {
        let electrodes = phantom.electrodes();
        let board = profile.board.clone().unwrap_or_default();
        let source_settings = Settings6221 {
            serial: profile.source.serial.clone(),
            command_time: milliseconds(profile.source.command_ms),
            ..Settings6221::default()
        };
        Self {
            source: Simulator6221::new(source_settings.clone()),
            source_settings,
            mainframe: Simulator34980a::new(Settings34980a {
                serial: profile.mainframe.serial.clone(),
                slots: profile.slots,
                line_hz: profile.line_hz,
                message_time: milliseconds(profile.mainframe.command_ms),
                ..Settings34980a::default()
            }),
            board: SimulatorGpioMux::new(gpio_mux::Settings {
                serial: board.serial,
                electrodes: electrodes.min(32),
                latency: milliseconds(board.command_ms),
                ..gpio_mux::Settings::default()
            }),
            sheet: Sheet::new(phantom, Fixture::new(&profile.slots, electrodes)),
            pace: profile.pace,
            start: Instant::now(),
            elapsed: Duration::ZERO,
            messages: Default::default(),
            transcript: None,
        }
    }

    /// What the instruments' clock shows.
    pub(crate) fn now(&self) -> Duration {
        let passed = self.start.elapsed();
        self.elapsed
            + match self.pace {
                Pace::Real => passed,
                Pace::Scaled(speed) => passed.mul_f64(speed),
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
        self.board.pass(at, &mut ends);
        ends.source.load_changed(at, ends.sheet);
    }

    /// Lets an instrument hear one message: what it answers, and how long that takes by the clock on the wall.
    pub(crate) fn hear(
        &mut self,
        instrument: Instrument,
        line: &str,
    ) -> (Option<String>, Duration) {
        self.catch_up();
        let at = self.now();
        let mut ends = Ends {
            source: &mut self.source,
            sheet: &mut self.sheet,
            readings: 0,
        };
        let (text, busy) = match instrument {
            Instrument::Source => {
                let reply = ends.source.hear(line, at, ends.sheet);
                (reply.text, reply.busy)
            }
            Instrument::Mainframe => {
                let reply = self.mainframe.hear(line, at, &mut ends);
                (reply.text, reply.busy)
            }
            Instrument::Board => {
                let reply = self.board.hear(line, at, &mut ends);
                (reply.text, reply.busy)
            }
        };
        let count = &mut self.messages[instrument.index()];
        count.heard += 1;
        count.answered += u64::from(text.is_some());
        count.readings += ends.readings;
        count.reading += u64::from(ends.readings > 0);
        if let Some(transcript) = &mut self.transcript {
            transcript.push(Said {
                at,
                instrument,
                heard: line.to_owned(),
                answered: text.clone(),
            });
        }
        let wait = match self.pace {
            Pace::Real => busy,
            Pace::Scaled(speed) => busy.div_f64(speed),
            Pace::Instant => {
                self.elapsed += busy;
                Duration::ZERO
            }
        };
        (text, wait)
    }

    /// Switches an instrument off and on.
    pub(crate) fn power_cycle(&mut self, instrument: Instrument) {
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
            Instrument::Board => {
                self.board.reset(at, &mut ends);
            }
        }
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
        self.sheet.set_closed(closed);
        self.source.load_changed(at, self.sheet);
    }

    fn measure(&mut self, at: Duration, request: MeterRequest) -> Volts {
        self.readings += 1;
        self.sheet.set_scanned(request.channel);
        // The sheet may have been pressed since the relays moved.
        self.source.load_changed(at, self.sheet);
        let volts = self.sheet.measured(ReadingContext {
            at,
            range: request.range,
            nplc: request.nplc,
            relay: request.channel,
        });
        self.sheet.set_scanned(None);
        volts
    }
}

impl Poles for Ends<'_> {
    fn poles(&mut self, joined: [Option<Electrode>; 4], at: Duration) {
        self.sheet.set_poles(joined);
        self.source.load_changed(at, self.sheet);
    }
}
