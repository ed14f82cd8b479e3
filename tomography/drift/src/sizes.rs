//! Sizes (standard deviations) of the kinds of change of a sheet.

/// Standard deviations of the kinds of change.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Sizes {
    /// Of ln gain.
    pub gain: f64,
    /// Of the ln contact impedance of each electrode.
    pub contact: f64,
    /// Of the smooth field (correlation length 80 mm) in ln conductance.
    pub field: f64,
    /// Of local change (correlation length 8 mm) in ln conductance.
    pub local: f64,
}

impl Sizes {
    /// Drift over months, without changes that look like loads: for methods trained for one fixed drift.
    pub const MONTHS: Self = Self {
        gain: 0.05,
        contact: 0.14,
        field: 3e-3,
        local: 0.0,
    };

    /// All sizes multiplied by a factor.
    pub(crate) fn scaled(self, by: f64) -> Self {
        Self {
            gain: self.gain * by,
            contact: self.contact * by,
            field: self.field * by,
            local: self.local * by,
        }
    }
}
