//! Diagrams of the measurement: settings of the rig, and drift of the baseline. Methods are compared in `methods`.

pub(super) mod acquisition;
pub(super) mod months;
