//! What the rig asks of an instrument, and what an instrument meets outside of its terminals.

use std::fmt;
use std::time::Duration;

use gpio_mux::Poles;
use keithley_6221::{Load, Simulator6221};
use keysight_34980a::Wires;
use scpi::{ErrorEntry, ParseError};

use crate::fault::Fault;

/// The world outside of an instrument's terminals: what a source drives current through, what relays and poles lead to,
/// and what a voltmeter measures. An instrument uses the part that it has terminals for.
pub(crate) trait Outside: Load + Wires + Poles {}

impl<T: Load + Wires + Poles> Outside for T {}

/// What an instrument makes of a message.
#[derive(Debug, Default)]
pub(crate) struct Reply {
    /// The reply without its line end; none where the message has none.
    pub(crate) text: Option<String>,
    /// How long the instrument is busy with it, by its own clock.
    pub(crate) busy: Duration,
    /// Whether [`SimulatedInstrument::fetch`] gives the reply when that time is over.
    pub(crate) later: bool,
}

/// An instrument of the simulated rig. It receives text and gives text; times are those of its own clock, since power on.
pub(crate) trait SimulatedInstrument: fmt::Debug + Send {
    /// Receives one message of a client's session and gives the reply, whatever time that takes.
    fn receive(
        &mut self,
        session: u32,
        line: &str,
        at: Duration,
        outside: &mut dyn Outside,
    ) -> Reply;

    /// As [`SimulatedInstrument::receive`], but readings are taken at their own instants: the reply may come later.
    fn begin(
        &mut self,
        session: u32,
        line: &str,
        at: Duration,
        outside: &mut dyn Outside,
    ) -> Reply {
        self.receive(session, line, at, outside)
    }

    /// The reply that was to come later.
    fn fetch(
        &mut self,
        _session: u32,
        _at: Duration,
        _outside: &mut dyn Outside,
    ) -> Option<String> {
        None
    }

    /// The next instant at which it does something by itself.
    fn due(&self) -> Option<Duration> {
        None
    }

    /// Does what was due until now.
    fn pass(&mut self, at: Duration, outside: &mut dyn Outside);

    /// Another instrument has moved what leads to the terminals.
    fn load_changed(&mut self, _at: Duration, _load: &mut dyn Load) {}

    /// The current source in it, if it is one.
    fn current_source(&self) -> Option<&Simulator6221> {
        None
    }

    /// How many errors it ever queued, and the last of them.
    fn latest_error(&self) -> (u64, Option<&ErrorEntry>);

    /// Queues an error that arose outside of any message; gives a reply where the instrument replies even so.
    fn refuse(
        &mut self,
        session: u32,
        refusal: ParseError,
        at: Duration,
        outside: &mut dyn Outside,
    ) -> Option<String>;

    /// A client has connected: what the instrument calls it.
    fn name_session(&mut self, _session: u32, _name: &str) {}

    /// A client has left.
    fn end_session(&mut self, _session: u32) {}

    /// A device clear of a client.
    fn clear_session(&mut self, _session: u32, _at: Duration, _outside: &mut dyn Outside) {}

    /// The status byte of a serial poll, without message available.
    fn status_byte(&self) -> u8 {
        0
    }

    /// Switches it off and on; gives what it then sends unasked.
    fn power_cycle(&mut self, at: Duration, outside: &mut dyn Outside) -> Option<String>;

    /// Fills the error queue until it overflows; false where only messages can do that.
    fn overflow_errors(&mut self) -> bool {
        false
    }

    /// A fault inside the rig; the instrument takes what concerns it. [`Fault::None`] ends them all.
    fn fault(&mut self, _fault: &Fault, _at: Duration, _outside: &mut dyn Outside) {}

    /// Whether a part of it has been taken out.
    fn is_opened_up(&self) -> bool {
        false
    }
}
