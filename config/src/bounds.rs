//! Bounds that several keys have in common.

use survey::Bounds::{self, Above, Within};
use survey::LONGEST_S;

pub(crate) const EVERY_S: Bounds = Within(0.0, LONGEST_S);
pub(crate) const FOR_S: Bounds = Above(0.0, LONGEST_S);
/// Number of frames of a session.
pub const COUNT: Bounds = Within(1.0, 1e15);
pub(crate) const SPEED: Bounds = Within(0.0, 1e6);
/// Most electrodes. Their 64,768 readings are more than any switch can scan.
pub(crate) const ELECTRODES: Bounds = Within(1.0, 256.0);
pub(crate) const SLOT: Bounds = Within(1.0, 8.0);
/// One petabyte: in bytes it still fits into 64 bits.
pub(crate) const MEGABYTES: Bounds = Within(0.0, 1e9);
pub(crate) const DAYS: Bounds = Above(0.0, 36_525.0);
