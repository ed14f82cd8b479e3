//! Argument types of outputs, by which the check of a command line finds them.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

macro_rules! output_path {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Eq)]
        pub struct $name(PathBuf);

        impl From<OsString> for $name {
            fn from(text: OsString) -> Self {
                Self(text.into())
            }
        }

        impl std::ops::Deref for $name {
            type Target = Path;

            fn deref(&self) -> &Path {
                &self.0
            }
        }

        impl AsRef<Path> for $name {
            fn as_ref(&self) -> &Path {
                &self.0
            }
        }
    };
}

output_path!(
    /// A file that a command writes.
    OutPath
);
output_path!(
    /// A folder that a command creates: it must be new or empty, unless the user gives `--force`.
    OutFolder
);
output_path!(
    /// A folder that many commands or many runs add files to. Each command checks the files that it writes there.
    GrowingFolder
);
