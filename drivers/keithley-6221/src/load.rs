//! What the simulator needs to know of the world outside its terminals.

use std::time::Duration;

use survey::{Amps, Ohms};

/// What hangs on the source's terminals.
pub trait Load {
    /// Resistance between the terminals with the relays as they are; [`f64::INFINITY`] when open.
    fn resistance(&mut self, at: Duration) -> Ohms;

    /// Takes note of what flows now, and on which range; called whenever either changes.
    fn drive(&mut self, flowing: Amps, range: Amps, at: Duration);
}

/// A load of one resistor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resistor {
    /// Its resistance; change it and tell the simulator by [`crate::Simulator6221::load_changed`].
    pub resistance: Ohms,
    /// What flows through it.
    pub flowing: Amps,
}

impl Resistor {
    /// A resistor without current.
    pub fn new(resistance: Ohms) -> Self {
        Self {
            resistance,
            flowing: Amps(0.0),
        }
    }

    /// Nothing connected.
    pub fn open() -> Self {
        Self::new(Ohms(f64::INFINITY))
    }
}

impl Load for Resistor {
    fn resistance(&mut self, _at: Duration) -> Ohms {
        self.resistance
    }

    fn drive(&mut self, flowing: Amps, _range: Amps, _at: Duration) {
        self.flowing = flowing;
    }
}
