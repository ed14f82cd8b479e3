//! Computations on one reading: scaling and limits (help pages CALCulate:SCALe, CALCulate:LIMit).

use crate::command::{LARGEST, Limit};

/// The unit of a reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Mark {
    /// The unit of the function.
    Function(&'static str),
    /// A custom unit of at most three ASCII characters, padded with blanks.
    Custom([u8; 3]),
}

impl Mark {
    /// The custom unit of this text; `None` for a blank one.
    pub(crate) fn custom(text: &str) -> Option<Self> {
        let mut unit = [b' '; 3];
        for (place, byte) in unit.iter_mut().zip(text.bytes()) {
            *place = byte;
        }
        (unit != [b' '; 3]).then_some(Self::Custom(unit))
    }

    pub(crate) fn text(&self) -> &str {
        match self {
            Self::Function(mark) => mark,
            Self::Custom(unit) => std::str::from_utf8(unit).unwrap_or_default().trim_end(),
        }
    }
}

/// Scaling of one channel, or of the bare voltmeter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Scale {
    pub(crate) on: bool,
    pub(crate) gain: f64,
    pub(crate) offset: f64,
    pub(crate) unit: Option<Mark>,
}

impl Default for Scale {
    fn default() -> Self {
        Self {
            on: false,
            gain: 1.0,
            offset: 0.0,
            unit: None,
        }
    }
}

impl Scale {
    /// The scaled reading with its unit. An overload stays an overload.
    pub(crate) fn applied(&self, value: f64, mark: Mark) -> (f64, Mark) {
        match self.on {
            true if value.is_finite() => {
                (self.gain * value + self.offset, self.unit.unwrap_or(mark))
            }
            true => (value, self.unit.unwrap_or(mark)),
            false => (value, mark),
        }
    }
}

/// The limits of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Limits {
    lower: f64,
    upper: f64,
    on: [bool; 2],
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            lower: -LARGEST,
            upper: LARGEST,
            on: [false; 2],
        }
    }
}

impl Limits {
    pub(crate) fn get(&self, limit: Limit) -> f64 {
        match limit {
            Limit::Lower => self.lower,
            Limit::Upper => self.upper,
        }
    }

    /// The same limits with another value; `None` if the lower one were above the upper one.
    pub(crate) fn with(self, limit: Limit, value: f64) -> Option<Self> {
        let changed = match limit {
            Limit::Lower => Self {
                lower: value,
                ..self
            },
            Limit::Upper => Self {
                upper: value,
                ..self
            },
        };
        (changed.lower <= changed.upper).then_some(changed)
    }

    pub(crate) fn is_on(&self, limit: Limit) -> bool {
        self.on[limit as usize]
    }

    pub(crate) fn switch(&mut self, limit: Limit, on: bool) {
        self.on[limit as usize] = on;
    }

    /// The limit that a reading exceeds, if any.
    pub(crate) fn exceeded(&self, value: f64) -> Option<Limit> {
        if self.is_on(Limit::Lower) && value < self.lower {
            Some(Limit::Lower)
        } else if self.is_on(Limit::Upper) && value > self.upper {
            Some(Limit::Upper)
        } else {
            None
        }
    }
}
