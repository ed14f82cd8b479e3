//! What a lab needs to know later of what it measures: options of `start` and of `baseline record`.

use clap::Args;
use dbus::Options;

/// Free words, kept with the record.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "What is measured (default: as configured in [about])")]
pub struct About {
    /// The sheet
    #[arg(long, value_name = "TEXT")]
    pub sheet: Option<String>,
    /// The foam, with its batch
    #[arg(long, value_name = "TEXT")]
    pub foam: Option<String>,
    /// The ink, with its batch
    #[arg(long, value_name = "TEXT")]
    pub ink: Option<String>,
    /// Who measures
    #[arg(long, value_name = "NAME")]
    pub operator: Option<String>,
}

impl About {
    /// Adds what is said to the options of a session.
    pub(crate) fn with(&self, options: Options) -> Options {
        options
            .with_some("sheet", self.sheet.clone())
            .with_some("foam", self.foam.clone())
            .with_some("ink", self.ink.clone())
            .with_some("operator", self.operator.clone())
    }
}
