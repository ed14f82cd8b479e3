//! The interface between the rig and its instruments.

use std::fmt;
use std::time::Duration;

use gpio_mux::Poles;
use keithley_6221::Load;
use keysight_34980a::Wires;
use scpi::{ErrorEntry, ParseError, Response};
use survey::Amps;

use crate::instrument::fault::Fault;

/// The circuit outside an instrument's terminals: the load of a source, the connections of relays and poles, and the
/// voltages at a voltmeter. An instrument uses the part that it has terminals for.
pub(crate) trait ExternalCircuit: Load + Wires + Poles {}

impl<T: Load + Wires + Poles> ExternalCircuit for T {}

/// What the rig's status shows of its current source.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SourceState {
    /// Whether the output is on.
    pub(crate) output: bool,
    /// The requested level.
    pub(crate) level: Amps,
    /// Full scale of the range.
    pub(crate) range: Amps,
    /// Whether the voltage limit reduces the current.
    pub(crate) in_compliance: bool,
    /// Pulses sent on each line of the trigger link since power on.
    pub(crate) pulses: [u64; 6],
}

/// A current source, as the circuit and the rig's status see it.
pub(crate) trait CurrentSource {
    fn state(&self) -> SourceState;

    /// Mean current between two instants.
    fn mean_current(&self, from: Duration, to: Duration, load: &mut dyn Load) -> Amps;

    /// R.m.s. and frequency in Hz of the alternating current, if there is one.
    fn alternating(&self, load: &mut dyn Load) -> Option<(Amps, f64)>;

    /// The terminator of a line on its serial port.
    fn serial_terminator(&self) -> &'static str;
}

/// An instrument of the simulated rig. It receives and sends text; times are those of its own clock, since power on.
pub(crate) trait SimulatedInstrument: fmt::Debug + Send {
    /// Receives a message of a client's session and returns the complete reply.
    fn receive(
        &mut self,
        session: u32,
        line: &str,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Response;

    /// As [`SimulatedInstrument::receive`], but readings are taken at their own times; also returns whether the reply
    /// must be fetched by [`SimulatedInstrument::fetch`] after the time that the instrument is busy.
    fn begin(
        &mut self,
        session: u32,
        line: &str,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> (Response, bool) {
        (self.receive(session, line, at, outside), false)
    }

    /// The postponed reply.
    fn fetch(
        &mut self,
        _session: u32,
        _at: Duration,
        _outside: &mut dyn ExternalCircuit,
    ) -> Option<String> {
        None
    }

    /// Whether the postponed reply is there before its time.
    fn has_reply(&self, _session: u32) -> bool {
        false
    }

    /// Whether the numbers in the reply to a message are readings, to which faults of readings apply.
    fn asks_for_readings(&self, _message: &str) -> bool {
        false
    }

    /// Performs the actions that are due, each at its own time, with the state of the source at that time.
    fn pass(&mut self, at: Duration, outside: &mut dyn ExternalCircuit);

    /// Notifies it that another instrument has changed the connections of its terminals.
    fn load_changed(&mut self, _at: Duration, _load: &mut dyn Load) {}

    /// The instrument as a current source, if it is one.
    fn current_source(&self) -> Option<&dyn CurrentSource> {
        None
    }

    /// Number of errors queued since power on, and the last of them.
    fn latest_error(&self) -> (u64, Option<&ErrorEntry>);

    /// Queues an error that does not belong to a message; returns the instrument's reply, if any.
    fn refuse(
        &mut self,
        session: u32,
        refusal: ParseError,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Option<String>;

    /// Registers a client under the name that the instrument uses for it.
    fn name_session(&mut self, _session: u32, _name: &str) {}

    /// Removes a client that has disconnected.
    fn end_session(&mut self, _session: u32) {}

    /// Device clear by a client.
    fn clear_session(&mut self, _session: u32, _at: Duration, _outside: &mut dyn ExternalCircuit) {}

    /// The status byte of a serial poll, without message available.
    fn status_byte(&self) -> u8 {
        0
    }

    /// Power cycle; returns what the instrument then sends without a query.
    fn power_cycle(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) -> Option<String>;

    /// Fills the error queue until it overflows; false if only messages can do that.
    fn overflow_errors(&mut self) -> bool {
        false
    }

    /// Applies a fault inside the rig, if it concerns the instrument. [`Fault::None`] ends them all.
    fn fault(&mut self, _fault: &Fault, _at: Duration, _outside: &mut dyn ExternalCircuit) {}

    /// Whether a part of it is removed.
    fn has_part_removed(&self) -> bool {
        false
    }
}
