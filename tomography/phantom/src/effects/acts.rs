//! What an effect can act on.

use std::fmt;
use std::time::Duration;

use eit::Preset;
use nalgebra::DMatrix;
use survey::{Ohms, Relay, Volts};

use crate::scan::ReadingContext;

/// Acts on the phantom's own mesh, once.
pub(crate) trait OnMesh: fmt::Debug + Send {
    /// Moves nodes (m) of the mesh of a sheet.
    fn displace(&self, sheet: &Preset, nodes: &mut [[f64; 2]]);
}

/// Where the triangles are.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Places<'a> {
    /// m
    pub(crate) centroids: &'a [[f64; 2]],
    /// m2
    pub(crate) areas: &'a [f64],
}

/// Acts on what loads have taken from each triangle: its log loss, -ln(sigma / sigma_0).
pub(crate) trait OnLoss: fmt::Debug + Send {
    /// Follows the log losses on a straight way from the last ones to these, `past` seconds later, and changes them.
    fn follow(&mut self, past: f64, places: &Places<'_>, losses: &mut [f64]);

    /// How often it is to be asked while nothing else changes; `None` for never.
    fn every(&self) -> Option<Duration> {
        None
    }
}

/// What effects make of one closed relay's path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelayContact {
    /// Resistance of each pole beside what its module has.
    pub ohms: Ohms,
    /// Stuck for good: closed (`true`) or open, whatever its instrument believes.
    pub stuck: Option<bool>,
}

impl Default for RelayContact {
    fn default() -> Self {
        Self {
            ohms: Ohms(0.0),
            stuck: None,
        }
    }
}

/// Acts on relays and wires between the instruments and the sheet.
pub(crate) trait OnWires: fmt::Debug + Send {
    /// Changes the path of a relay that has closed so often.
    fn act(&mut self, relay: Relay, closures: u64, at: Duration, contact: &mut RelayContact);

    /// What is in the source's loop beside the relays.
    fn loop_resistance(&self) -> Ohms {
        Ohms(0.0)
    }
}

/// Acts on the sheet.
pub(crate) trait OnSheet: fmt::Debug + Send {
    /// Changes the conductance of triangles (S per square) whose centroids are `places` (m).
    fn act(&mut self, at: Duration, places: &[[f64; 2]], sigma: &mut [f64]);

    /// Changes whenever [`OnSheet::act`] would give something else.
    fn epoch(&self, at: Duration) -> u64;
}

/// Acts on the contacts.
pub(crate) trait OnContacts: fmt::Debug + Send {
    /// Changes the contact impedances, ohm m, one an electrode.
    fn act(&mut self, at: Duration, contacts: &mut [f64]);

    /// Changes whenever [`OnContacts::act`] would give something else.
    fn epoch(&self, at: Duration) -> u64;
}

/// Acts on what lies between the electrodes beside the sheet.
pub(crate) trait OnNetwork: fmt::Debug + Send {
    /// Changes the transfer impedance, ohm.
    fn act(&mut self, at: Duration, z: &mut DMatrix<f64>);

    /// Changes whenever [`OnNetwork::act`] would give something else.
    fn epoch(&self, at: Duration) -> u64;
}

/// Acts on a reading.
pub(crate) trait OnReading: fmt::Debug + Send {
    /// The voltage as it leaves the effect.
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts;

    /// Whether it must be told [`ReadingContext::source_resistance`].
    fn needs_source_resistance(&self) -> bool {
        false
    }

    /// Whether it must be told [`ReadingContext::load_resistance`].
    fn needs_load_resistance(&self) -> bool {
        false
    }
}
