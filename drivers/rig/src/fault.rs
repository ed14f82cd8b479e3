//! Errors of an instrument or its connection. The message names the instrument and the command.

use survey::{Amps, Relay, Volts};

use crate::LinkError;
use crate::found_relay::{FoundRelay, name_relays};

/// An error of an instrument or its connection.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The connection failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The instrument at this address is another one.
    #[error(
        "{instrument}: expected {expected}, but *IDN? answers '{found}'; check the address in the configuration"
    )]
    WrongInstrument {
        /// Name and address.
        instrument: String,
        /// Model expected.
        expected: String,
        /// The reply.
        found: String,
    },
    /// The instrument's error queue was not empty after a command.
    #[error("{instrument} refused '{command}': {code},\"{message}\"")]
    Refused {
        /// Name and address.
        instrument: String,
        /// The command that was sent.
        command: String,
        /// Number of the oldest entry of the queue.
        code: i32,
        /// Text of the oldest entry of the queue.
        message: String,
    },
    /// A reply that does not have the expected form.
    #[error("{instrument} answered '{command}' with '{answer}', {expected} was expected")]
    Garbled {
        /// Name and address.
        instrument: String,
        /// The query.
        command: String,
        /// The reply, shortened.
        answer: String,
        /// The expected form, in words.
        expected: String,
    },
    /// A setting reads back differently from what was set.
    #[error("{instrument}: {setting} was set to {set} but reads back {read}")]
    Mismatch {
        /// Name and address.
        instrument: String,
        /// The setting.
        setting: String,
        /// The value that was set.
        set: String,
        /// The value that was read back.
        read: String,
    },
    /// The source could not be verified off.
    #[error(
        "{instrument}: the source could not be verified off (output {output}, level {level}); treat the sheet as live"
    )]
    NotOff {
        /// Name and address.
        instrument: String,
        /// Output state as read back: `on`, `off`.
        output: String,
        /// Level as read back.
        level: Amps,
    },
    /// The source's interlock is open, or was open since the last query; the output is off.
    #[error(
        "{instrument}: the interlock is open, or was opened meanwhile; it keeps the output off until it is closed"
    )]
    Interlock {
        /// Name and address.
        instrument: String,
    },
    /// Relays read back closed after they were opened.
    #[error("{instrument}: relays {} stay closed", join(.relays))]
    StillClosed {
        /// Name and address.
        instrument: String,
        /// The relays.
        relays: Vec<Relay>,
    },
    /// Injecting relays whose read-back differs from their commanded state.
    #[error("relays are not in the commanded state:{}{}", text(" read open: ", .open), text(" read closed: ", .closed))]
    RelayMismatch {
        /// Relays that read open and should be closed.
        open: Vec<FoundRelay>,
        /// Relays that read closed and should be open.
        closed: Vec<FoundRelay>,
    },
    /// A slot holds another module than the wiring needs, or none.
    #[error("{instrument}: slot {slot} holds {found}, the wiring needs {expected}")]
    WrongModule {
        /// Name and address.
        instrument: String,
        /// The slot.
        slot: u32,
        /// The module found.
        found: String,
        /// The module needed.
        expected: String,
    },
    /// A current beyond the source's limits or its prepared range.
    #[error(
        "{instrument}: a current of {requested} is over its maximum of {most}; set a smaller one"
    )]
    CurrentOutOfRange {
        /// Name and address.
        instrument: String,
        /// Requested.
        requested: Amps,
        /// Largest allowed.
        most: Amps,
    },
    /// A voltage limit or range that the instrument does not have.
    #[error("{instrument}: {requested} cannot be set; possible: {allowed}")]
    VoltageOutOfRange {
        /// Name and address.
        instrument: String,
        /// Requested.
        requested: Volts,
        /// Allowed, in words.
        allowed: String,
    },
    /// The number of readings differs from the number of pairs that were read.
    #[error("the scan returned {came} readings for {expected} scanned pairs")]
    ReadingCount {
        /// Readings that came.
        came: usize,
        /// Pairs read.
        expected: usize,
    },
    /// The instrument does not support the operation, for example a scan on a multiplexer board.
    #[error("{instrument} cannot {what}")]
    Unable {
        /// Name and address.
        instrument: String,
        /// The operation.
        what: String,
    },
}

impl RigError {
    /// Name and address of the instrument concerned, if any.
    pub fn instrument(&self) -> Option<&str> {
        match self {
            Self::Link(
                LinkError::Lost { instrument, .. }
                | LinkError::Timeout { instrument, .. }
                | LinkError::Unsynchronised { instrument }
                | LinkError::Unsolicited { instrument, .. }
                | LinkError::TooLong { instrument, .. }
                | LinkError::NotText { instrument, .. }
                | LinkError::LineEnd { instrument, .. },
            )
            | Self::WrongInstrument { instrument, .. }
            | Self::Refused { instrument, .. }
            | Self::Garbled { instrument, .. }
            | Self::Mismatch { instrument, .. }
            | Self::NotOff { instrument, .. }
            | Self::Interlock { instrument }
            | Self::StillClosed { instrument, .. }
            | Self::WrongModule { instrument, .. }
            | Self::CurrentOutOfRange { instrument, .. }
            | Self::VoltageOutOfRange { instrument, .. }
            | Self::Unable { instrument, .. } => Some(instrument),
            Self::Link(LinkError::Unreachable { .. })
            | Self::RelayMismatch { .. }
            | Self::ReadingCount { .. } => None,
        }
    }
}

fn text(how: &str, relays: &[FoundRelay]) -> String {
    match relays {
        [] => String::new(),
        relays => format!("{how}{}", name_relays(relays)),
    }
}

fn join(relays: &[Relay]) -> String {
    relays
        .iter()
        .map(Relay::to_string)
        .collect::<Vec<_>>()
        .join(", ")
}
