//! Ranges of the parameters of effects, and how parameters that are numbers are declared: each once.

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

/// The parameters of an effect.
pub(crate) trait Parameters {
    /// The error for the first parameter outside its physical range.
    fn check(&self) -> Result<(), Fault>;
}

/// Declares the parameters of an effect that are all numbers: for each key its documentation, its default, its range
/// and the unit of an error message, nothing for a ratio. They are checked in this order.
macro_rules! parameters {
    ($(#[$meta:meta])* $settings:ident {
        $($(#[$doc:meta])* $key:ident = $default:expr, in $range:expr $(, $unit:literal)?;)+
    }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct $settings {
            $($(#[$doc])* pub $key: f64,)+
        }

        impl Default for $settings {
            fn default() -> Self {
                Self { $($key: $default),+ }
            }
        }

        impl $crate::effects::bounds::Parameters for $settings {
            fn check(&self) -> Result<(), $crate::effects::bounds::Fault> {
                $crate::effects::bounds::Bounds::new()
                    $(.within(stringify!($key), self.$key, $range, concat!($($unit)?)))+
                    .end()
            }
        }
    };
}

pub(super) use parameters;
