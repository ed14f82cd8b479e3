//! One reading of a frame: a voltage, or the reason why there is none.

use serde::{Deserialize, Serialize};

use crate::Volts;

/// A voltage, or the reason why there is none. An overload never becomes a number.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reading {
    /// A valid voltage.
    Ok(Volts),
    /// The voltmeter was over its range, or returned something that is not a number.
    Overload,
    /// The plan was stopped before this reading, or the source was in compliance.
    NotMeasured,
}

impl Reading {
    /// The voltage if the reading is valid.
    pub fn volts(self) -> Option<Volts> {
        match self {
            Self::Ok(volts) => Some(volts),
            Self::Overload | Self::NotMeasured => None,
        }
    }

    /// Valid readings of these voltages, V.
    pub fn of_volts(volts: impl IntoIterator<Item = f64>) -> Vec<Self> {
        let volts = volts.into_iter();
        volts.map(|volts| Self::Ok(Volts(volts))).collect()
    }

    /// Whether there is a voltage.
    pub fn is_ok(self) -> bool {
        matches!(self, Self::Ok(_))
    }

    /// The flag's stable number in messages and files: 0 ok, 1 overload, 3 not measured.
    pub fn flag(self) -> u8 {
        match self {
            Self::Ok(_) => 0,
            Self::Overload => 1,
            Self::NotMeasured => 3,
        }
    }

    /// The reading with a flag and a voltage; `None` for an unknown flag, or for flag 0 with a voltage that is not
    /// finite.
    pub fn from_flag(flag: u8, volts: f64) -> Option<Self> {
        match flag {
            0 if volts.is_finite() => Some(Self::Ok(Volts(volts))),
            1 => Some(Self::Overload),
            3 => Some(Self::NotMeasured),
            _ => None,
        }
    }
}

/// The relative change of each reading that is a voltage in both frames.
pub fn relative_changes(from: &[Reading], to: &[Reading]) -> impl Iterator<Item = f64> {
    from.iter().zip(to).filter_map(|(from, to)| {
        let (from, to) = (from.volts()?.0, to.volts()?.0);
        (from != 0.0).then(|| (to - from) / from)
    })
}
