//! The list of quantities, with names and units.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// A quantity of a map, or of its course over time, for the whole sheet or one region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Area whose value is at least the threshold.
    Contact,
    /// Integral of the values over the area.
    Load,
    /// Mean value over the contact area.
    Mean,
    /// The largest value, of one triangle.
    Peak,
    /// Peak pressure index: the largest mean over a disc (9.5 cm2 unless set otherwise), clipped to the sheet.
    Ppi,
    /// Dispersion index: share of the sheet's load that lies in the region.
    Dispersion,
    /// Coefficient of variation over the contact area.
    Variation,
    /// Centre of pressure, x.
    CentreX,
    /// Centre of pressure, y.
    CentreY,
    /// The largest gradient.
    Gradient,
    /// Number of hot spots.
    HotSpots,
    /// Speed of the centre of pressure.
    Speed,
    /// Length of the path of the centre of pressure since the session's first frame.
    Path,
    /// The largest dose of a triangle: integral over time of the value above the threshold.
    Dose,
    /// The longest time that a triangle is loaded without relief.
    Unrelieved,
    /// Area that was loaded for 95 % of the last window.
    UnrelievedArea,
    /// 1 if the map can be relied on, otherwise 0; its mean over a span is the share of known frames.
    Known,
}

/// Meaning of the values of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LoadUnit {
    /// Relative loss of conductance, 0 to 1: a map without calibration.
    RelativeLoss,
    /// Pressure, kPa.
    Pressure,
}

/// Each quantity with its name and its description, in the order of the declaration.
const TABLE: [(Quantity, &str, &str); 17] = [
    (Quantity::Contact, "contact", "contact area"),
    (Quantity::Load, "load", "load"),
    (Quantity::Mean, "mean", "mean over the contact area"),
    (Quantity::Peak, "peak", "peak of one triangle"),
    (Quantity::Ppi, "ppi", "peak pressure index"),
    (Quantity::Dispersion, "dispersion", "dispersion index"),
    (Quantity::Variation, "variation", "coefficient of variation"),
    (Quantity::CentreX, "centre-x", "centre of pressure, x"),
    (Quantity::CentreY, "centre-y", "centre of pressure, y"),
    (Quantity::Gradient, "gradient", "largest gradient"),
    (Quantity::HotSpots, "hot-spots", "hot spots"),
    (Quantity::Speed, "speed", "speed of the centre of pressure"),
    (Quantity::Path, "path", "path of the centre of pressure"),
    (Quantity::Dose, "dose", "largest dose of a triangle"),
    (
        Quantity::Unrelieved,
        "unrelieved",
        "longest unrelieved time",
    ),
    (
        Quantity::UnrelievedArea,
        "unrelieved-area",
        "unrelieved area",
    ),
    (
        Quantity::Known,
        "known",
        "whether the map is known to be true",
    ),
];

impl Quantity {
    /// All quantities, in the order of tables.
    pub const ALL: [Self; TABLE.len()] = {
        let mut all = [Self::Contact; TABLE.len()];
        let mut place = 0;
        while place < all.len() {
            all[place] = TABLE[place].0;
            place += 1;
        }
        all
    };

    /// The name in configuration, tables and JSON.
    pub fn name(self) -> &'static str {
        TABLE[self as usize].1
    }

    /// The quantity with this name; `None` if there is none.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|known| known.name() == name)
    }

    /// A short description.
    pub fn words(self) -> &'static str {
        TABLE[self as usize].2
    }

    /// The unit of its values. Without calibration, a load is an area times a relative loss.
    pub fn unit(self, of: LoadUnit) -> &'static str {
        let pressure = of == LoadUnit::Pressure;
        match self {
            Self::Contact | Self::UnrelievedArea => "mm2",
            Self::Load if pressure => "N",
            Self::Load => "mm2 lost",
            Self::Mean | Self::Peak | Self::Ppi if pressure => "kPa",
            Self::Mean | Self::Peak | Self::Ppi => "lost share",
            Self::Dispersion | Self::Variation => "%",
            Self::CentreX | Self::CentreY | Self::Path => "mm",
            Self::Gradient if pressure => "kPa/mm",
            Self::Gradient => "lost share/mm",
            Self::HotSpots | Self::Known => "1",
            Self::Speed => "mm/s",
            Self::Dose if pressure => "kPa s",
            Self::Dose => "lost share s",
            Self::Unrelieved => "s",
        }
    }
}

impl LoadUnit {
    /// The unit of a triangle's value.
    pub fn text(self) -> &'static str {
        Quantity::Peak.unit(self)
    }

    /// [`Quantity::Load`] of a value of 1 over 1 m2: 1 kPa over 1 m2 is 1,000 N.
    pub(super) fn load_factor(self) -> f64 {
        match self {
            Self::Pressure => 1e3,
            Self::RelativeLoss => 1e6,
        }
    }
}

/// One number for each [`Quantity`]; `None` if it does not exist or is not known. In JSON an object without the missing
/// ones.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(into = "BTreeMap<Quantity, f64>", from = "BTreeMap<Quantity, f64>")]
pub struct Values([Option<f64>; Quantity::ALL.len()]);

impl Values {
    /// The value of a quantity.
    pub fn get(&self, quantity: Quantity) -> Option<f64> {
        self.0[quantity as usize]
    }

    /// The values converted by a function, without those for which it returns `None`.
    pub fn filter_map(&self, mut convert: impl FnMut(Quantity, f64) -> Option<f64>) -> Self {
        let mut converted = Self::default();
        for quantity in Quantity::ALL {
            let value = self.get(quantity);
            converted.set(quantity, value.and_then(|value| convert(quantity, value)));
        }
        converted
    }

    pub(super) fn set(&mut self, quantity: Quantity, value: Option<f64>) {
        self.0[quantity as usize] = value.filter(|value| value.is_finite());
    }
}

impl From<Values> for BTreeMap<Quantity, f64> {
    fn from(values: Values) -> Self {
        let present = |quantity: Quantity| Some((quantity, values.get(quantity)?));
        Quantity::ALL.into_iter().filter_map(present).collect()
    }
}

impl From<BTreeMap<Quantity, f64>> for Values {
    fn from(present: BTreeMap<Quantity, f64>) -> Self {
        let mut values = Self::default();
        for (quantity, value) in present {
            values.set(quantity, Some(value));
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_positions_are_those_of_the_list() {
        for (position, quantity) in Quantity::ALL.into_iter().enumerate() {
            assert_eq!(quantity as usize, position);
            assert_eq!(Quantity::from_name(quantity.name()), Some(quantity));
            let json = serde_json::to_value(quantity).unwrap();
            assert_eq!(json, quantity.name());
        }
        assert_eq!(Quantity::from_name("pressure"), None);
    }
}
