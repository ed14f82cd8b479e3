//! Ranges of the parameters of effects.

/// A parameter outside its physical range: its key within the effect, and what is allowed.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// The key, without the effect's name.
    pub key: &'static str,
    /// Its value and what is allowed.
    pub why: String,
}

impl Fault {
    /// The error for an electrode number (from 1) above the sheet's number of electrodes.
    pub(super) fn beyond(key: &'static str, number: usize, electrodes: usize) -> Result<(), Self> {
        if number <= electrodes {
            return Ok(());
        }
        let why = format!("names electrode {number}, the sheet has {electrodes}");
        Err(Self { key, why })
    }
}

/// Checks several parameters and keeps the first error.
pub(super) struct Bounds(Result<(), Fault>);

impl Bounds {
    pub(super) fn new() -> Self {
        Self(Ok(()))
    }

    /// From `low` to `high`, both allowed; `unit` follows the numbers.
    pub(super) fn within(
        self,
        key: &'static str,
        value: f64,
        [low, high]: [f64; 2],
        unit: &str,
    ) -> Self {
        let Self(Ok(())) = self else {
            return self;
        };
        if (low..=high).contains(&value) {
            return self;
        }
        let space = if unit.is_empty() { "" } else { " " };
        Self(Err(Fault {
            key,
            why: format!("is {value}{space}{unit}, it must be {low} to {high}{space}{unit}"),
        }))
    }

    pub(super) fn end(self) -> Result<(), Fault> {
        self.0
    }
}
