//! How large each kind of change of a sheet is.

/// Standard deviations of the kinds of change.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Sizes {
    /// ln gain.
    pub gain: f64,
    /// ln contact impedance of each electrode.
    pub contact: f64,
    /// A field of 80 mm in ln conductance.
    pub field: f64,
    /// Change of 8 mm in ln conductance.
    pub local: f64,
}

impl Sizes {
    /// Of months, as far as they are no load: for methods that are trained for one drift.
    pub const MONTHS: Self = Self {
        gain: 0.05,
        contact: 0.14,
        field: 3e-3,
        local: 0.0,
    };

    /// Each of them times a factor.
    pub(crate) fn scaled(self, by: f64) -> Self {
        Self {
            gain: self.gain * by,
            contact: self.contact * by,
            field: self.field * by,
            local: self.local * by,
        }
    }
}
