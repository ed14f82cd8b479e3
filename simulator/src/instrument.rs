//! The instruments of a simulated rig by name, and the state of the wire to each.

use std::fmt;

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
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Source, Self::Mainframe, Self::Board];

    pub(crate) fn index(self) -> usize {
        self as usize
    }

    /// The instrument that a transcript or a golden calls so: `6221`, `34980a`, `gpio`.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|instrument| instrument.name().eq_ignore_ascii_case(name))
    }

    /// What transcripts and goldens call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Source => "6221",
            Self::Mainframe => "34980a",
            Self::Board => "gpio",
        }
    }
}

impl fmt::Display for Instrument {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Source => "6221",
            Self::Mainframe => "34980a",
            Self::Board => "gpio board",
        })
    }
}

/// The state of the wire to an instrument: a fault that a test or a person may cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// Connected.
    Sound,
    /// Every connection is closed, and a new one at once.
    Cut,
    /// Open, but nothing comes through: the far side receives nothing and says nothing.
    Silent,
}

/// A wire, and how often it was cut: a cut that is mended at once breaks connections all the same.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WireState {
    pub(crate) wire: Wire,
    pub(crate) cuts: u64,
}
