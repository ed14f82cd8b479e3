//! Faults that a person or a test can cause in the instruments, by command or on a time line. The rig and its
//! instruments apply them.

mod words;

use std::time::Duration;

use keysight_34980a::Module;
use survey::Relay;

use crate::instrument::{Instrument, Wire};
pub(crate) use words::GRAMMAR;

/// Faults of replies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReplyFault {
    /// It is delayed by this time.
    Late(Duration),
    /// It is lost.
    Lost,
    /// It is sent twice.
    Doubled,
    /// It is cut off in the middle, without a line end.
    HalfLine,
    /// It is replaced by a line that no instrument sends, with bytes that are not ASCII.
    Rubbish,
    /// Each of its readings is replaced by the text NAN; replies without readings are skipped.
    NotANumber,
    /// Its readings are those of the previous reply; replies without readings are skipped.
    Stale,
}

impl ReplyFault {
    /// Whether it only affects replies with readings.
    pub(crate) fn is_of_readings(self) -> bool {
        matches!(self, Self::NotANumber | Self::Stale)
    }
}

/// A fault, or the end of one, in the text form of `tactus-sim fault`.
///
/// ```
/// use simulator::{Fault, Instrument, ReplyFault};
/// let fault: Fault = "lost 34980a 3".parse()?;
/// assert_eq!(fault, Fault::Replies(Instrument::Mainframe, ReplyFault::Lost, 3));
/// assert_eq!(fault.to_string(), "lost 34980a 3");
/// assert!("lost 34980b".parse::<Fault>().is_err());
/// # Ok::<(), simulator::FaultError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// Sets the state of the wire to an instrument.
    Wire(Instrument, Wire),
    /// Breaks connections; new ones are accepted immediately.
    Drop(Instrument),
    /// Applies to this number of following replies.
    Replies(Instrument, ReplyFault, u32),
    /// Delays every reply by this time.
    Slow(Instrument, Duration),
    /// Power cycle.
    Reset(Instrument),
    /// Power cycle of all instruments at once; their network connections break.
    PowerCut,
    /// Fills the error queue until it overflows.
    QueueOverflow(Instrument),
    /// The relay is reported as commanded, but stays open.
    StuckOpen(Relay),
    /// The relay is reported as commanded, but stays closed.
    StuckClosed(Relay),
    /// The relay is no longer stuck.
    Free(Relay),
    /// Whether the module is in this slot, 1 to 8.
    Slot(u32, bool),
    /// Another module is in this slot, 1 to 8.
    Module(u32, Module),
    /// Whether the mainframe has its voltmeter.
    Voltmeter(bool),
    /// Whether every reading is over range.
    Overload(bool),
    /// Whether the source's interlock is closed.
    Interlock(bool),
    /// Whether the terminal block of a slot, 1 to 8, is closed.
    TerminalBlock(u32, bool),
    /// A pulse on a line of the source's trigger link (1 to 6), or at the mainframe's external trigger.
    Pulse(Option<u8>),
    /// Whether the board's port exists.
    Serial(bool),
    /// Ends all faults.
    None,
}

/// Why a fault is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FaultError {
    /// Text that is not a fault.
    #[error("'{words}' is not a fault: {why}")]
    Words {
        /// The text.
        words: String,
        /// What is wrong with it.
        why: String,
    },
    /// The rig has no such part.
    #[error("{0}; the profile of this rig has none")]
    NotHere(&'static str),
    /// A relay that neither a module of the profile nor its board has.
    #[error(
        "there is no relay {0} in this rig: relays are slot x 1000 + channel of its modules, or pole x 100 + electrode of its board"
    )]
    NoRelay(Relay),
    /// A relay that is not stuck.
    #[error("relay {0} is not stuck")]
    NotStuck(Relay),
    /// A slot that is empty in the profile.
    #[error("there is no module in slot {0}: the profile of this rig has none there")]
    NoModule(u32),
}

impl Fault {
    /// The fault that ends this one; `None` if it has no duration.
    pub fn ending(&self) -> Option<Self> {
        Some(match self {
            Self::Wire(instrument, Wire::Cut | Wire::Silent) => {
                Self::Wire(*instrument, Wire::Sound)
            }
            Self::Slow(instrument, by) if !by.is_zero() => Self::Slow(*instrument, Duration::ZERO),
            Self::StuckOpen(relay) | Self::StuckClosed(relay) => Self::Free(*relay),
            Self::Slot(slot, false) | Self::Module(slot, _) => Self::Slot(*slot, true),
            Self::Voltmeter(false) => Self::Voltmeter(true),
            Self::Overload(true) => Self::Overload(false),
            Self::Interlock(false) => Self::Interlock(true),
            Self::TerminalBlock(slot, false) => Self::TerminalBlock(*slot, true),
            Self::Serial(false) => Self::Serial(true),
            _ => return None,
        })
    }
}

/// A fault on the time line of the instruments.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TimedFault {
    /// Time on the instruments' clock.
    pub at: Duration,
    /// The fault.
    pub fault: Fault,
}

impl TimedFault {
    /// Reads an entry of a time line: a fault, and the one that ends it after its duration.
    ///
    /// # Errors
    /// Text that is not a fault, or a duration for a fault that has none.
    pub(crate) fn read(
        at: Duration,
        lasts: Option<Duration>,
        what: &str,
    ) -> Result<Vec<Self>, FaultError> {
        let fault: Fault = what.parse()?;
        let mut timed = Vec::new();
        if let Some(lasts) = lasts {
            let words = |why: &str| FaultError::Words {
                words: what.to_owned(),
                why: why.to_owned(),
            };
            let ending = fault
                .ending()
                .ok_or_else(|| words("it ends by itself and takes no for_s"))?;
            let at = at
                .checked_add(lasts)
                .ok_or_else(|| words("it would last too long"))?;
            timed.push(Self { at, fault: ending });
        }
        timed.push(Self { at, fault });
        Ok(timed)
    }
}
