//! Descriptions of the experiment: options of `start` and of `baseline record`.

use clap::Args;
use dbus::SessionOptions;

/// Notes about the experiment, stored in the record.
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
    /// Operator
    #[arg(long, value_name = "NAME")]
    pub operator: Option<String>,
}

impl About {
    /// Adds the given descriptions to the options of a session.
    pub(crate) fn with(&self, options: SessionOptions) -> SessionOptions {
        SessionOptions {
            sheet: self.sheet.clone(),
            foam: self.foam.clone(),
            ink: self.ink.clone(),
            operator: self.operator.clone(),
            ..options
        }
    }
}
