//! The state of the wire to an instrument.

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
