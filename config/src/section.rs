//! How a section of the configuration is declared: each key once, with its unit, type, default and bounds.

/// Declares a section: for each key its documentation with the unit, its type, its default (that of the type if none is
/// written) and, for a number, its bounds. `BOUNDS` lists the bounds with the full names of their keys.
macro_rules! section {
    ($(#[$meta:meta])* $section:ident, $path:literal {
        $($(#[$doc:meta])* $key:ident: $type:ty $(= $default:expr)? $(, in $bounds:expr)?;)*
    }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct $section {
            $($(#[$doc])* pub $key: $type,)*
        }

        impl $section {
            pub(crate) const BOUNDS: &[(&str, survey::Bounds)] = &[
                $($((concat!($path, ".", stringify!($key)), $bounds),)?)*
            ];
        }

        impl Default for $section {
            fn default() -> Self {
                Self { $($key: $crate::section::section!(@default $($default)?),)* }
            }
        }
    };
    (@default) => {
        Default::default()
    };
    (@default $default:expr) => {
        $default
    };
}

pub(crate) use section;
