//! Errors of a wiring.

use super::Relay;
use crate::Dipole;

/// Why a wiring cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum WiringError {
    /// One relay would join a pair to the source and a pair to the voltmeter at once.
    #[error(
        "wiring '{wiring}': relay {relay} joins pair {inject} to the source and pair {measure} to the voltmeter; one relay cannot do both, it would short the source over the voltmeter"
    )]
    Shared {
        /// The wiring's name.
        wiring: String,
        /// The relay named twice.
        relay: Relay,
        /// Its injecting pair.
        inject: Dipole,
        /// Its measuring pair.
        measure: Dipole,
    },
    /// Two different pairs use exactly the same relays, in whatever order.
    #[error(
        "wiring '{wiring}': pairs {first} and {second} are both given relays {relays}; closing one would close the other and short the source"
    )]
    Shorted {
        /// The wiring's name.
        wiring: String,
        /// First pair.
        first: Dipole,
        /// Second pair.
        second: Dipole,
        /// The relays, joined by commas.
        relays: String,
    },
    /// A pair has the same relay twice.
    #[error("wiring '{wiring}': pair {pair} is given relay {relay} twice")]
    Repeated {
        /// The wiring's name.
        wiring: String,
        /// The pair.
        pair: Dipole,
        /// The relay.
        relay: Relay,
    },
    /// A pair joins an electrode to itself.
    #[error("wiring '{wiring}': pair {pair} would short the source")]
    SameElectrode {
        /// The wiring's name.
        wiring: String,
        /// The pair.
        pair: Dipole,
    },
    /// A pair has no relay.
    #[error("wiring '{wiring}': pair {pair} has no relay")]
    NoRelay {
        /// The wiring's name.
        wiring: String,
        /// The pair.
        pair: Dipole,
    },
    /// The wiring is made for another ring.
    #[error("wiring '{wiring}' is for {wired} electrodes, the protocol has {requested}")]
    Electrodes {
        /// The wiring's name.
        wiring: String,
        /// Electrodes of the wiring.
        wired: usize,
        /// Electrodes of the protocol.
        requested: usize,
    },
    /// The module has too few channels.
    #[error("wiring '{wiring}': {electrodes} electrodes are too many, it has room for {most}")]
    TooMany {
        /// The wiring's name.
        wiring: String,
        /// Electrodes requested.
        electrodes: usize,
        /// Electrodes that fit.
        most: usize,
    },
    /// The numbers of injecting and measuring pairs differ.
    #[error(
        "wiring '{wiring}' has {inject} injecting and {measure} measuring pairs; every pair needs both"
    )]
    Uneven {
        /// The wiring's name.
        wiring: String,
        /// Injecting pairs.
        inject: usize,
        /// Measuring pairs.
        measure: usize,
    },
    /// The protocol contains a pair that no relay serves.
    #[error("wiring '{wiring}' cannot join pair {pair} to the {to}")]
    Unserved {
        /// The wiring's name.
        wiring: String,
        /// The requested pair.
        pair: Dipole,
        /// `source` or `voltmeter`.
        to: &'static str,
    },
}
