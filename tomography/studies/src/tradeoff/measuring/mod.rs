//! Diagrams of the measurement: settings of the rig, and drift of the baseline. Left to others: the methods that make maps.

pub(super) mod acquisition;
pub(super) mod months;
