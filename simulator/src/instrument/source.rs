//! The current source (6221) of the simulated rig.

use std::time::Duration;

use keithley_6221::{Command, Load, Settings6221, Simulator6221, Trigger};
use scpi::{ErrorEntry, ParseError, Response, parse_message};
use serde::{Deserialize, Serialize};
use survey::Amps;

use crate::instrument::fault::Fault;
use crate::instrument::section::{OutOfRange, Section, check_command_ms, milliseconds, settings};
use crate::instrument::simulated::{
    CurrentSource, ExternalCircuit, SimulatedInstrument, SourceState,
};
use crate::instrument::{Kind, Port};

/// Its row of the table of instruments.
pub(super) const KIND: Kind = Kind {
    name: "6221",
    shown: "6221",
    word: "6221",
    port: Port::Network,
    has_numbers: true,
    lacking: |_| None,
    sections: &[Section {
        name: "source",
        read: |profile, value| {
            profile.source = settings(value)?;
            Ok(())
        },
    }],
    check: |profile| profile.source.check(),
    build: |profile, _| {
        Box::new(SimulatedSource::new(Settings6221 {
            serial: profile.source.serial.clone(),
            command_time: milliseconds(profile.source.command_ms),
            ..Settings6221::default()
        }))
    },
    isolated: |_| Box::new(SimulatedSource::new(Settings6221::default())),
    varies: |message| {
        parse_message(message).into_iter().flatten().any(|call| {
            matches!(
                Command::of(&call),
                Ok(Command::Common(scpi::Common::Identify)
                    | Command::BoardSerial(_)
                    | Command::BoardRevision(_)
                    | Command::Address(_))
            )
        })
    },
};

/// Treatment of a second client of the 6221 while the first is connected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum SecondClient {
    /// Accepted, but its messages are only received after the first has disconnected.
    #[default]
    Held,
    /// Disconnected immediately.
    Refused,
    /// Served like the first.
    Served,
}

/// Settings of the simulated 6221.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Source {
    /// Serial number in `*IDN?`.
    pub serial: String,
    /// Time a message takes, ms.
    pub command_ms: f64,
    /// Treatment of a second TCP client.
    pub second_client: SecondClient,
    /// How long the only connection stays occupied after a client vanished without closing it, s.
    pub slot_hold_s: f64,
}

impl Default for Source {
    fn default() -> Self {
        Self {
            serial: "1234567".to_owned(),
            command_ms: 5.0,
            second_client: SecondClient::default(),
            slot_hold_s: 0.0,
        }
    }
}

impl Source {
    fn check(&self) -> Result<(), OutOfRange> {
        check_command_ms("source", self.command_ms)?;
        match (0.0..=3600.0).contains(&self.slot_hold_s) {
            true => Ok(()),
            false => Err(OutOfRange {
                section: "source",
                key: "slot_hold_s",
                what: "slot_hold_s is 0 to 3600".to_owned(),
            }),
        }
    }
}

/// A 6221, with the settings that a power cycle restores.
#[derive(Debug)]
struct SimulatedSource {
    simulator: Simulator6221,
    settings: Settings6221,
    /// Outside of the instrument: a power cycle does not close it.
    interlock_closed: bool,
}

impl SimulatedSource {
    /// A source after power on.
    fn new(settings: Settings6221) -> Self {
        Self {
            simulator: Simulator6221::new(settings.clone()),
            settings,
            interlock_closed: true,
        }
    }

    fn set_interlock(&mut self, closed: bool, at: Duration, outside: &mut dyn ExternalCircuit) {
        self.interlock_closed = closed;
        self.simulator.set_interlock(closed, at, outside);
    }
}

impl CurrentSource for Simulator6221 {
    fn state(&self) -> SourceState {
        SourceState {
            output: self.output(),
            level: self.level(),
            range: self.range(),
            in_compliance: self.in_compliance(),
            pulses: self.pulses(),
        }
    }

    fn mean_current(&self, from: Duration, to: Duration, load: &mut dyn Load) -> Amps {
        self.mean_current(from, to, load)
    }

    fn alternating(&self, load: &mut dyn Load) -> Option<(Amps, f64)> {
        self.alternating(load)
    }

    fn serial_terminator(&self) -> &'static str {
        self.serial_terminator()
    }
}

impl SimulatedInstrument for SimulatedSource {
    fn receive(
        &mut self,
        _: u32,
        line: &str,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Response {
        self.simulator.receive(line, at, outside)
    }

    /// The source has no readings: faults of readings apply to its settings.
    fn asks_for_readings(&self, _: &str) -> bool {
        true
    }

    fn pass(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) {
        self.simulator.load_changed(at, outside);
    }

    fn load_changed(&mut self, at: Duration, load: &mut dyn Load) {
        self.simulator.load_changed(at, load);
    }

    fn current_source(&self) -> Option<&dyn CurrentSource> {
        Some(&self.simulator)
    }

    fn latest_error(&self) -> (u64, Option<&ErrorEntry>) {
        self.simulator.latest_error()
    }

    fn refuse(
        &mut self,
        _: u32,
        refusal: ParseError,
        _: Duration,
        _: &mut dyn ExternalCircuit,
    ) -> Option<String> {
        self.simulator.refuse(refusal);
        None
    }

    fn end_session(&mut self, _: u32) {
        self.simulator.forget_answer();
    }

    fn power_cycle(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) -> Option<String> {
        self.simulator = Simulator6221::new(self.settings.clone());
        outside.drive(Amps(0.0), self.simulator.range(), at);
        if !self.interlock_closed {
            self.simulator.set_interlock(false, at, outside);
        }
        None
    }

    fn fault(&mut self, fault: &Fault, at: Duration, outside: &mut dyn ExternalCircuit) {
        match fault {
            Fault::Interlock(closed) => self.set_interlock(*closed, at, outside),
            Fault::Pulse(Some(line)) => {
                self.simulator.trigger(Trigger::Link(*line), at, outside);
            }
            Fault::None => self.set_interlock(true, at, outside),
            _ => {}
        }
    }
}
