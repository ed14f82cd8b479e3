//! Diagrams of the measurement: settings of the rig, and drift of the baseline.

pub(super) mod acquisition;
pub(super) mod months;
