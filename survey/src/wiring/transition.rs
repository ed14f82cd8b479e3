//! How the current is switched from one pair of electrodes to the next.

use serde::{Deserialize, Serialize};

/// How the current is switched to the next pair. The wiring determines it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Transition {
    /// Source to 0 A, open the previous pair, close the next, source on.
    Break,
    /// Close the next pair, then open the previous one with the source on: the source is never open-circuit, but
    /// briefly shorted.
    Overlap,
}
