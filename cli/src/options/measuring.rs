//! Measuring settings of a session that differ from the daemon's configuration: options of `start` and of
//! `baseline record`, which must be the same for both.

use std::time::Duration;

use clap::{Args, ValueEnum};
use dbus::SessionOptions;

use crate::options::duration::parse_span as span;

/// Options of `start` and `baseline record`.
#[derive(Debug, Clone, Default, Args)]
#[command(
    next_help_heading = "Measuring settings (default: as configured; the baseline must have the same)"
)]
pub struct Measuring {
    /// Integration in power-line cycles: 0.02, 0.2, 1, 2, 10, 20, 100 or 200 [default: as configured]
    #[arg(long, value_name = "PLC", value_parser = crate::options::numbers::NPLC.parser(), allow_hyphen_values = true)]
    pub nplc: Option<f64>,
    /// Number of readings averaged to one, 1 or more [default: as configured]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub averages: Option<u64>,
    /// Take a zero reading after every reading [default: as configured]
    #[arg(long, value_name = "true|false", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    pub autozero: Option<bool>,
    /// Wait after a change of the current, e.g. 2ms [default: as configured]
    #[arg(long, value_name = "SPAN", value_parser = span)]
    pub settle: Option<Duration>,
    /// Wait before each scanned channel, whole milliseconds, e.g. 1ms [default: as configured]
    #[arg(long, value_name = "SPAN", value_parser = span)]
    pub channel_delay: Option<Duration>,
    /// Inject with both polarities: cancels thermal EMFs and leakage [default: as configured]
    #[arg(long, value_name = "true|false", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    pub reversal: Option<bool>,
    /// Number of frames between frames at 0 A, which are subtracted; 0: none [default: as configured]
    #[arg(long, value_name = "N")]
    pub zero_every: Option<u64>,
    /// Number of electrodes between those of a pair, 0 for neighbours [default: as configured]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(..=254))]
    pub skip: Option<u64>,
    /// Take only one of two reciprocal readings [default: as configured]
    #[arg(long, value_name = "true|false", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    pub half: Option<bool>,
    /// One range for all readings, or a range for each [default: as configured]
    #[arg(long, value_enum)]
    pub ranges: Option<Ranges>,
}

/// Choice of the voltmeter's ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Ranges {
    /// One range for all readings
    Fixed,
    /// A range for each reading, from the baseline; after an overload the next larger one
    Planned,
}

impl Measuring {
    /// Adds the given settings to the options of a session.
    pub(crate) fn with(&self, options: SessionOptions) -> SessionOptions {
        let milliseconds = |span: Duration| 1e3 * span.as_secs_f64();
        let ranges = self.ranges.map(|ranges| match ranges {
            Ranges::Fixed => "fixed".to_owned(),
            Ranges::Planned => "planned".to_owned(),
        });
        SessionOptions {
            nplc: self.nplc,
            averages: self.averages,
            autozero: self.autozero,
            settle_ms: self.settle.map(milliseconds),
            channel_delay_ms: self.channel_delay.map(milliseconds),
            reversal: self.reversal,
            zero_every: self.zero_every,
            ranges,
            skip: self.skip,
            half: self.half,
            ..options
        }
    }
}
