//! The panels of the dashboard: each draws its part of the state into its area.

pub(super) mod charts;
pub(super) mod map;
pub(super) mod state;
pub(super) mod tables;
