//! `[[alarm]]`: rules on quantities of maps and on the health of the daemon.

use alarms::{Rule, Severity};
use imaging::quantities::{LoadUnit, Quantity};
use serde::{Deserialize, Serialize};

/// A number of the daemon's health that a rule can watch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HealthValue {
    /// Time since the last frame of the running session.
    FrameAge,
    /// Days until the disk is full.
    DiskDays,
    /// Used part of the life of the most worn relay.
    RelayUsed,
    /// Age of the baseline.
    BaselineAge,
}

impl HealthValue {
    /// All, in the order of the reference.
    pub const ALL: [Self; 4] = [
        Self::FrameAge,
        Self::DiskDays,
        Self::RelayUsed,
        Self::BaselineAge,
    ];

    /// The name in the configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::FrameAge => "frame-age",
            Self::DiskDays => "disk-days",
            Self::RelayUsed => "relay-used",
            Self::BaselineAge => "baseline-age",
        }
    }

    /// The unit of its values.
    pub fn unit(self) -> &'static str {
        match self {
            Self::FrameAge => "s",
            Self::DiskDays | Self::BaselineAge => "d",
            Self::RelayUsed => "%",
        }
    }
}

/// What a rule watches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Watched {
    /// A quantity of the sheet or of a region.
    Quantity(Quantity),
    /// A number of the daemon's health.
    Health(HealthValue),
}

impl Watched {
    /// The name in the configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quantity(quantity) => quantity.name(),
            Self::Health(value) => value.name(),
        }
    }

    /// The units that its values can have: with a calibration, and without.
    pub fn units(self) -> [&'static str; 2] {
        match self {
            Self::Quantity(quantity) => {
                [LoadUnit::Pressure, LoadUnit::RelativeLoss].map(|unit| quantity.unit(unit))
            }
            Self::Health(value) => [value.unit(); 2],
        }
    }

    fn all() -> impl Iterator<Item = Self> {
        let quantities = Quantity::ALL.into_iter().map(Self::Quantity);
        quantities.chain(HealthValue::ALL.into_iter().map(Self::Health))
    }
}

impl From<Watched> for String {
    fn from(watched: Watched) -> Self {
        watched.name().to_owned()
    }
}

impl TryFrom<String> for Watched {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        let found = Self::all().find(|watched| watched.name() == name);
        found.ok_or_else(|| {
            let names: Vec<&str> = Self::all().map(Self::name).collect();
            match survey::nearest(&name, names.iter().copied()) {
                Some(nearest) => format!("unknown quantity '{name}'; did you mean '{nearest}'?"),
                None => format!(
                    "unknown quantity '{name}'; known here: {}",
                    names.join(", ")
                ),
            }
        })
    }
}

/// `[[alarm]]`: a rule.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AlarmSettings {
    /// Its name: letters, digits, `-` and `_`, different from that of any other alarm.
    pub name: String,
    /// What it watches.
    pub quantity: Watched,
    /// A region; the whole sheet by default.
    pub region: Option<String>,
    /// Active above this value.
    pub above: Option<f64>,
    /// Active below this value.
    pub below: Option<f64>,
    /// Unit of the limit; needed where it depends on a calibration.
    pub unit: Option<String>,
    /// Time for which the value must be beyond the limit, and back within it, s.
    #[serde(default = "ten_seconds")]
    pub for_s: f64,
    /// How far the value must return before the alarm ends, in the unit of the limit.
    #[serde(default)]
    pub deadband: f64,
    /// `minor` or `major`.
    #[serde(default)]
    pub severity: Severity,
    /// Whether it stays active until a person resets it.
    #[serde(default)]
    pub latched: bool,
    /// What to do when it is active.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub guidance: String,
}

fn ten_seconds() -> f64 {
    10.0
}

/// The limit of a rule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Limit {
    /// Active above it.
    Above(f64),
    /// Active below it.
    Below(f64),
}

impl Limit {
    /// Whether a value is beyond the limit (`Some(true)`), within it (`Some(false)`), or in the deadband.
    pub fn beyond(self, value: f64, deadband: f64) -> Option<bool> {
        let (excess, deadband) = match self {
            Self::Above(limit) => (value - limit, deadband),
            Self::Below(limit) => (limit - value, deadband),
        };
        match excess {
            excess if excess > 0.0 => Some(true),
            excess if excess <= -deadband => Some(false),
            _ => None,
        }
    }
}

impl AlarmSettings {
    /// The limit; `None` if there is none, or two.
    pub fn limit(&self) -> Option<Limit> {
        match (self.above, self.below) {
            (Some(limit), None) => Some(Limit::Above(limit)),
            (None, Some(limit)) => Some(Limit::Below(limit)),
            _ => None,
        }
    }

    /// When the alarm begins and ends.
    pub fn rule(&self) -> Rule {
        Rule {
            name: self.name.clone(),
            severity: self.severity,
            on_s: self.for_s,
            off_s: self.for_s,
            latched: self.latched,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::alarm::*;

    #[test]
    fn a_value_is_beyond_within_or_in_the_deadband() {
        let above = |value| Limit::Above(8.0).beyond(value, 0.5);
        assert_eq!(
            [8.1, 8.0, 7.6, 7.5].map(above),
            [Some(true), None, None, Some(false)]
        );
        let below = |value| Limit::Below(8.0).beyond(value, 0.5);
        assert_eq!(
            [7.9, 8.0, 8.4, 8.5].map(below),
            [Some(true), None, None, Some(false)]
        );
        assert_eq!(Limit::Above(8.0).beyond(8.0, 0.0), Some(false));
    }

    #[test]
    fn an_unknown_quantity_is_answered_with_the_nearest() {
        let error = Watched::try_from("pii".to_owned()).unwrap_err();
        assert_eq!(error, "unknown quantity 'pii'; did you mean 'ppi'?");
        for watched in Watched::all() {
            assert_eq!(Watched::try_from(watched.name().to_owned()), Ok(watched));
        }
    }
}
