//! The instruments that can be simulated: their table, and the profile of a rig. `simulated_instruments` connects
//! them to the sheet; connections of clients are in `transport`.
//!
//! A further instrument needs a file in this folder, a variant of [`Instrument`] with its row in `Instrument::kind`,
//! and a field of [`Profile`]. Profiles, goldens, replays, faults of its wire and serving use its row. Code for a
//! single instrument outside this folder:
//!
//! - `transport/socket.rs`: a second client of the source, and the time for which its connection stays occupied
//! - `transport/client.rs`: the source's rate of messages and its serial port
//! - `serve.rs`: ports with an option of their own, the source's serial port, fields of [`crate::Ready`] with names
//! - `transport/vxi11.rs`, `telnet.rs` and `web.rs`: further services of the mainframe
//! - `simulated_rig/faults.rs`: `Fault::Serial` of the board; faults of slots and voltmeter switch the mainframe off

mod board;
pub(crate) mod fault;
pub(crate) mod isolated;
mod mainframe;
pub(crate) mod section;
pub(crate) mod simulated;
mod source;
mod wire;

use std::fmt;

use keysight_34980a::Module;

use crate::circuit::load_network::LoadNetwork;
use crate::instrument::fault::TimedFault;
use crate::instrument::isolated::InstrumentSetup;
use crate::instrument::section::{OutOfRange, Section};
use crate::instrument::simulated::SimulatedInstrument;
pub use board::Board;
#[cfg(test)]
pub(crate) use mainframe::of_memory;
pub use mainframe::{Headers, Mainframe};
pub use source::{SecondClient, Source};
pub use wire::Wire;
pub(crate) use wire::WireState;

/// One of the simulated instruments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Instrument {
    /// The current source, a 6221.
    Source,
    /// The switch and voltmeter, a 34980A.
    Mainframe,
    /// The multiplexer board.
    Board,
}

impl Instrument {
    /// All instruments.
    pub const ALL: [Self; 3] = [Self::Source, Self::Mainframe, Self::Board];

    /// Its row of the table of instruments.
    pub(crate) fn kind(self) -> &'static Kind {
        match self {
            Self::Source => &source::KIND,
            Self::Mainframe => &mainframe::KIND,
            Self::Board => &board::KIND,
        }
    }
}

/// The instruments of a simulated rig.
///
/// ```
/// let profile = simulator::Profile::parse("mine.toml", "time = \"instant\"\n[slots]\n1 = \"34924A\"\n")?;
/// assert_eq!(profile.pace, simulator::Pace::Instant);
/// let refusal = simulator::Profile::parse("mine.toml", "time = \"instant\"\n[slotz]\n").unwrap_err();
/// assert!(refusal.to_string().starts_with("mine.toml:2:2: "), "{refusal}");
/// # Ok::<(), simulator::ProfileError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Speed of the instruments' time.
    pub pace: Pace,
    /// Mains frequency, Hz: 50 or 60.
    pub line_hz: f64,
    /// The current source.
    pub source: Source,
    /// The switch and voltmeter.
    pub mainframe: Mainframe,
    /// The modules in slots 1 to 8.
    pub slots: [Option<Module>; 8],
    /// The multiplexer board, if there is one.
    pub board: Option<Board>,
    /// The load on the terminals.
    pub load: LoadNetwork,
    /// Faults with their times.
    pub faults: Vec<TimedFault>,
}

impl Profile {
    /// A profile without a section of any instrument.
    pub(crate) fn without_sections(
        pace: Pace,
        line_hz: f64,
        load: LoadNetwork,
        faults: Vec<TimedFault>,
    ) -> Self {
        Self {
            pace,
            line_hz,
            source: Source::default(),
            mainframe: Mainframe::default(),
            slots: [None; 8],
            board: None,
            load,
            faults,
        }
    }
}

/// Speed of the instruments' time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pace {
    /// Real time.
    Real,
    /// Faster (above 1) or slower (below) by this factor.
    Scaled(f64),
    /// Replies are immediate; the instruments' clock still advances by the time they would have needed.
    Instant,
}

/// A row of the table of instruments: the properties that the rest of the crate uses.
pub(crate) struct Kind {
    /// Name in transcripts and goldens.
    pub(crate) name: &'static str,
    /// Name in messages for people.
    pub(crate) shown: &'static str,
    /// Name in the words of a fault, and of its serial port.
    pub(crate) word: &'static str,
    /// How clients reach it.
    pub(crate) port: Port,
    /// Whether its replies contain numbers that the faults `nan` and `stale` can replace.
    pub(crate) has_numbers: bool,
    /// Reason for refusing a fault of it; `None` if a rig of this profile has the instrument.
    pub(crate) lacking: fn(&Profile) -> Option<&'static str>,
    /// Its sections of a profile.
    pub(crate) sections: &'static [Section],
    /// Checks the numbers of its sections.
    pub(crate) check: fn(&Profile) -> Result<(), OutOfRange>,
    /// The instrument of a profile after power on, for a sheet with this number of electrodes.
    pub(crate) build: fn(&Profile, usize) -> Box<dyn SimulatedInstrument>,
    /// A single instrument after power on, for goldens and transcripts.
    pub(crate) isolated: fn(&InstrumentSetup) -> Box<dyn SimulatedInstrument>,
    /// Whether the reply to a message depends on the individual unit or the time: serial number, clock, age.
    pub(crate) varies: fn(&str) -> bool,
}

/// How clients reach an instrument.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Port {
    /// By TCP. A power cycle breaks its connections.
    Network,
    /// By a serial port, which belongs to the computer and stays open during a power cycle.
    Serial,
}

impl Instrument {
    pub(crate) fn index(self) -> usize {
        self as usize
    }

    /// The instrument with this name in transcripts and goldens: `6221`, `34980a`, `gpio`.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|instrument| instrument.name().eq_ignore_ascii_case(name))
    }

    /// Name in transcripts and goldens.
    pub fn name(self) -> &'static str {
        self.kind().name
    }

    /// All names in a sentence, such as `6221, 34980a and gpio`; `and` is the word before the last.
    pub(crate) fn listed(name: fn(&Kind) -> &'static str, and: &str) -> String {
        let names = Self::ALL.map(|instrument| name(instrument.kind()));
        let (last, others) = names.split_last().expect("there are instruments");
        format!("{} {and} {last}", others.join(", "))
    }
}

impl fmt::Display for Instrument {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.kind().shown)
    }
}
