//! The multiplexer board of the simulated rig.

use std::time::Duration;

use gpio_mux::{Command, Settings, SimulatorGpioMux};
use scpi::{ErrorEntry, ParseError, Response};
use serde::Deserialize;

use crate::instrument::section::{Section, check_command_ms, milliseconds, settings};
use crate::instrument::simulated::{ExternalCircuit, SimulatedInstrument};
use crate::instrument::{Kind, Port};

/// Its row of the table of instruments.
pub(super) const KIND: Kind = Kind {
    name: "gpio",
    shown: "gpio board",
    word: "board",
    port: Port::Serial,
    has_numbers: false,
    lacking: |profile| match profile.board {
        Some(_) => None,
        None => Some("there is no multiplexer board"),
    },
    sections: &[Section {
        name: "board",
        read: |profile, value| {
            profile.board = Some(settings(value)?);
            Ok(())
        },
    }],
    check: |profile| match &profile.board {
        Some(board) => check_command_ms("board", board.command_ms),
        None => Ok(()),
    },
    build: |profile, electrodes| {
        let board = profile.board.clone().unwrap_or_default();
        Box::new(SimulatedBoard(SimulatorGpioMux::new(Settings {
            serial: board.serial,
            electrodes: electrodes.min(32),
            latency: milliseconds(board.command_ms),
            ..Settings::default()
        })))
    },
    isolated: |_| Box::new(SimulatedBoard(SimulatorGpioMux::new(Settings::default()))),
    varies: |message| {
        matches!(
            message.parse(),
            Ok(Command::Identify | Command::AskLastEdge)
        )
    },
};

/// Settings of the simulated multiplexer board.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Board {
    /// Serial number in `*IDN?`.
    pub serial: String,
    /// Time a message takes, ms.
    pub command_ms: f64,
}

impl Default for Board {
    fn default() -> Self {
        Self {
            serial: "0001".to_owned(),
            command_ms: 1.5,
        }
    }
}

/// A multiplexer board.
#[derive(Debug)]
struct SimulatedBoard(SimulatorGpioMux);

impl SimulatedInstrument for SimulatedBoard {
    fn receive(
        &mut self,
        _: u32,
        line: &str,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Response {
        self.0.receive(line, at, outside)
    }

    fn pass(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) {
        self.0.pass(at, outside);
    }

    fn latest_error(&self) -> (u64, Option<&ErrorEntry>) {
        self.0.latest_error()
    }

    fn refuse(
        &mut self,
        _: u32,
        _: ParseError,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Option<String> {
        self.0.receive_oversized(at, outside).text
    }

    fn power_cycle(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) -> Option<String> {
        Some(self.0.reset(at, outside))
    }
}
