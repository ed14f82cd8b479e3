//! Options of the commands for instruments, notifications and the machine.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};
use outfile::OutPath;

use super::{Replacing, span};

/// Commands of `instruments`.
#[derive(Debug, Subcommand)]
pub enum InstrumentsCommand {
    /// Switch the source off, open every relay and verify both; if relays were found closed at the start, this allows measuring again
    OpenAll,
    /// Accept the instruments or modules that were found in place of the expected ones
    Accept,
    /// Test every relay against the sheet, every contact, reciprocity and noise; the source is off afterwards (exit code 5 if a fault is found)
    Test {
        /// List passed checks too
        #[arg(long)]
        all: bool,
    },
    /// Show the closures of each relay and its remaining life
    Relays,
    /// Search for instruments and propose lines of configuration; changes neither instruments nor configuration (without a daemon: tactusd --discover)
    Discover(Discover),
}

/// Commands of `notify`.
#[derive(Debug, Subcommand)]
pub enum NotifyCommand {
    /// Run the command once and print its result
    Test,
}

/// `alarms`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct AlarmsCommand {
    /// List every alarm, also those without a problem
    #[arg(long)]
    pub all: bool,
    #[command(subcommand)]
    pub order: Option<AlarmOrder>,
}

/// An alarm, and why.
#[derive(Debug, Args)]
pub struct NamedAlarm {
    /// Name of the alarm
    pub name: String,
    /// Why; stored with the event
    #[arg(long, value_name = "TEXT")]
    pub comment: Option<String>,
}

/// Commands of `alarms`.
#[derive(Debug, Subcommand)]
pub enum AlarmOrder {
    /// Acknowledge an alarm: somebody has seen it
    Ack(NamedAlarm),
    /// Shelve an alarm: it sends no notifications for a time; it is still evaluated and recorded
    Shelve {
        #[command(flatten)]
        alarm: NamedAlarm,
        /// For this long, 24h at most (default: until the alarm ends)
        #[arg(long = "for", value_name = "SPAN", value_parser = span)]
        span: Option<Duration>,
    },
    /// Unshelve an alarm: it sends notifications again
    Unshelve(NamedAlarm),
    /// End a latched alarm whose condition is gone
    Reset(NamedAlarm),
    /// Take an alarm out of service: it sends no notifications until it is in service again
    OutOfService(NamedAlarm),
    /// Set an alarm in service again
    InService(NamedAlarm),
}

impl AlarmOrder {
    fn alarm(&self) -> &NamedAlarm {
        match self {
            Self::Ack(alarm)
            | Self::Shelve { alarm, .. }
            | Self::Unshelve(alarm)
            | Self::Reset(alarm)
            | Self::OutOfService(alarm)
            | Self::InService(alarm) => alarm,
        }
    }

    /// Name of the alarm.
    pub fn name(&self) -> &str {
        &self.alarm().name
    }

    /// Why.
    pub fn comment(&self) -> Option<&str> {
        self.alarm().comment.as_deref()
    }
}

/// Options of `doctor`.
#[derive(Debug, Args)]
pub struct Doctor {
    /// The daemon's configuration (default: /etc/tactus/config.toml, else ./config.toml)
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// Options of `instruments discover`.
#[derive(Debug, Args)]
pub struct Discover {
    /// Further addresses to query: tcp:HOST:PORT or serial:PATH@BAUD
    pub addresses: Vec<String>,
    /// Time to listen
    #[arg(long, value_name = "SPAN", value_parser = span, default_value = "3s")]
    pub within: Duration,
    /// Don't listen for announcements (mDNS)
    #[arg(long)]
    pub no_mdns: bool,
    /// Don't send a VXI-11 broadcast
    #[arg(long)]
    pub no_broadcast: bool,
}

/// Options of `transcript`.
#[derive(Debug, Args)]
pub struct Transcript {
    /// Number of last frames; the daemon keeps record.transcripts of them (8 by default)
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub frames: u32,
    /// File to write [default: standard output]
    #[arg(long, value_name = "FILE")]
    pub out: Option<OutPath>,
    #[command(flatten)]
    pub replacing: Replacing,
}
