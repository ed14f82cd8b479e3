//! The instruments that a search found.

use serde::Serialize;

use super::nonempty;
use crate::SeenInstrument;

/// A line of `tactus instruments discover --json`, and of `tactusd --discover --json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum DiscoverLine {
    /// An instrument, with the fields of [`SeenInstrument`].
    Instrument {
        /// In the form of the configuration.
        address: Option<String>,
        /// The reply to `*IDN?`.
        identity: Option<String>,
        /// The methods that found it.
        found_by: String,
        /// The announced name.
        name: Option<String>,
        /// Whether the running configuration uses it.
        in_use: bool,
        /// Proposed lines for a configuration.
        proposal: Option<String>,
        /// Why there is no identity or no proposal.
        remark: Option<String>,
    },
    /// A method that could not be used, and why.
    Note {
        /// For people.
        text: String,
    },
}

impl From<SeenInstrument> for DiscoverLine {
    fn from(seen: SeenInstrument) -> Self {
        Self::Instrument {
            address: nonempty(seen.address),
            identity: nonempty(seen.identity),
            found_by: seen.found_by,
            name: nonempty(seen.name),
            in_use: seen.in_use,
            proposal: nonempty(seen.proposal),
            remark: nonempty(seen.remark),
        }
    }
}
