//! Options of the commands for instruments, notifications and the machine.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};
use outfile::OutPath;

use super::{Replacing, span};

/// Commands of `instruments`.
#[derive(Debug, Subcommand)]
pub enum InstrumentsCommand {
    /// Switch the source off and open every relay, verify both; then measuring is allowed again if relays were found closed at the start
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
    /// Search for instruments and propose lines of configuration; uses none of them (without a daemon: tactusd --discover)
    Discover(Discover),
}

/// Commands of `notify`.
#[derive(Debug, Subcommand)]
pub enum NotifyCommand {
    /// Run the command once and print its result
    Test,
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
    #[allow(missing_docs)]
    pub replacing: Replacing,
}
