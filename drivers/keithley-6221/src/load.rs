//! The interface of the simulator to the load on its terminals.

use std::time::Duration;

use survey::{Amps, Ohms};

/// The load on the source's terminals.
pub trait Load {
    /// Returns the resistance between the terminals with the present relay states; [`f64::INFINITY`] if open.
    fn resistance(&mut self, at: Duration) -> Ohms;

    /// Called with the present current and its range whenever either changes.
    fn drive(&mut self, flowing: Amps, range: Amps, at: Duration);
}

/// A load of one resistor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resistor {
    /// The resistance; after a change, call [`crate::Simulator6221::load_changed`].
    pub resistance: Ohms,
    /// The current through it.
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

    /// Open terminals: an infinite resistance.
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
