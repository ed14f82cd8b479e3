//! What a parameter of an effect may be.

/// A parameter outside of its physical range: its key within the effect, and what is allowed.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// The key, without the effect's name.
    pub key: &'static str,
    /// What it is and what it must be.
    pub why: String,
}

impl Fault {
    /// An electrode, from 1, that a sheet of so many does not have.
    pub(super) fn beyond(key: &'static str, number: usize, electrodes: usize) -> Result<(), Self> {
        if number <= electrodes {
            return Ok(());
        }
        let why = format!("names electrode {number}, the sheet has {electrodes}");
        Err(Self { key, why })
    }
}

/// Checks parameters one after the other.
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
