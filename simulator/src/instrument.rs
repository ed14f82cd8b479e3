//! Names of the instruments in a simulated rig, and the state of the wire to each.

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

    /// The instrument with this name in transcripts and goldens: `6221`, `34980a`, `gpio`.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|instrument| instrument.name().eq_ignore_ascii_case(name))
    }

    /// Name in transcripts and goldens.
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

/// State of the wire to an instrument, set by faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// Connected.
    Sound,
    /// Every connection is closed, and each new one immediately.
    Cut,
    /// Open, but without traffic: the instrument receives nothing and sends nothing.
    Silent,
}

/// State of a wire, and the number of cuts: even a cut of zero duration breaks connections.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WireState {
    pub(crate) wire: Wire,
    pub(crate) cuts: u64,
}
