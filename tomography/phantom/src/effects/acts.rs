//! Traits of effects, one for each quantity that an effect can change.

use std::fmt;
use std::time::Duration;

use eit::Preset;
use nalgebra::DMatrix;
use survey::{Ohms, Relay, Volts};

use super::bounds::Parameters;
use super::{Effect, Effects, Needs, SheetResponse};
use crate::scan::ReadingContext;

/// Acts on the phantom's mesh, once, when the phantom is created.
pub(crate) trait OnMesh: fmt::Debug + Send {
    /// Moves nodes (m) of the mesh of a sheet.
    fn displace(&self, sheet: &Preset, nodes: &mut [[f64; 2]]);
}

/// Positions and areas of the triangles, and the loads on them.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Places<'a> {
    /// m
    pub(crate) centroids: &'a [[f64; 2]],
    /// m2
    pub(crate) areas: &'a [f64],
    /// Log losses caused by the loads alone, before any effect; 0 without a load.
    pub(crate) pressed: &'a [f64],
}

/// Changes the loss that loads cause in each triangle, as its log loss -ln(sigma / sigma_0).
pub(crate) trait OnLoss: fmt::Debug + Send {
    /// Advances the effect by `past` seconds, during which the log losses of the loads changed linearly from those of
    /// the last call to those of this call, and changes `losses`.
    fn follow(&mut self, past: f64, places: &Places<'_>, losses: &mut [f64]);

    /// Interval at which the effect needs an update while the loads do not change; `None` if it needs none.
    fn every(&self) -> Option<Duration> {
        None
    }
}

/// State of a closed relay's path after all effects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelayContact {
    /// Resistance of each pole in addition to that of its module.
    pub ohms: Ohms,
    /// Stuck permanently closed (`Some(true)`) or open (`Some(false)`), whatever the instrument reports.
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
    /// Changes the path of a relay that has closed this many times.
    fn act(&mut self, relay: Relay, closures: u64, at: Duration, contact: &mut RelayContact);

    /// Resistance in the source's loop in addition to the relays.
    fn loop_resistance(&self) -> Ohms {
        Ohms(0.0)
    }
}

/// Acts on the sheet.
pub(crate) trait OnSheet: fmt::Debug + Send {
    /// Changes the conductance of triangles (S per square) whose centroids are `places` (m).
    fn act(&mut self, at: Duration, places: &[[f64; 2]], sigma: &mut [f64]);

    /// A number that changes whenever the result of [`OnSheet::act`] would change.
    fn epoch(&self, at: Duration) -> u64;
}

/// Acts on the contacts.
pub(crate) trait OnContacts: fmt::Debug + Send {
    /// Changes the contact impedances, ohm m, one per electrode.
    fn act(&mut self, at: Duration, contacts: &mut [f64]);

    /// A number that changes whenever the result of [`OnContacts::act`] would change.
    fn epoch(&self, at: Duration) -> u64;
}

/// Acts on the network between the electrodes, outside of the sheet.
pub(crate) trait OnNetwork: fmt::Debug + Send {
    /// Changes the transfer impedance, ohm.
    fn act(&mut self, at: Duration, z: &mut DMatrix<f64>);

    /// A number that changes whenever the result of [`OnNetwork::act`] would change.
    fn epoch(&self, at: Duration) -> u64;
}

/// Acts on a reading.
pub(crate) trait OnReading: fmt::Debug + Send {
    /// The voltage after this effect.
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts;

    /// The values of the context that it uses and that are computed only on demand.
    fn needs(&self) -> Needs {
        Needs::NONE
    }
}

/// An effect that adds a voltage to each reading and has no state.
pub(crate) trait Added: Parameters + Clone + fmt::Debug + Send + 'static {
    /// As [`OnReading::needs`].
    const NEEDS: Needs;

    /// The voltage, V.
    fn added(&self, context: &ReadingContext) -> f64;
}

impl<T: Added> OnReading for T {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        Volts(volts.0 + self.added(context))
    }

    fn needs(&self) -> Needs {
        T::NEEDS
    }
}

impl<T: Added> Effect for T {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| self.added(&sight.context))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(self.clone()));
    }
}
