//! The command line of `tactusd`.

use std::path::PathBuf;

use clap::Parser;

const EXIT_CODES: &str = "Exit codes: 0 done or stopped cleanly, 1 failed, 2 usage, 5 --safe-off: an instrument does \
                          not answer or could not be made safe, 78 configuration";

/// Owns the instruments, records and reconstructs frames, and publishes them on D-Bus.
#[derive(Debug, Parser)]
#[command(name = "tactusd", version, max_term_width = 100, after_help = EXIT_CODES)]
pub(crate) struct Args {
    /// The configuration; relative paths in it are relative to its folder.
    #[arg(long, value_name = "FILE", default_value = "/etc/tactus/config.toml")]
    pub config: PathBuf,
    /// Report every problem of the configuration as file:line:column, and exit (code 78 if there is one).
    #[arg(long, group = "mode")]
    pub check: bool,
    /// Print the configuration with all defaults and resolved paths, and exit.
    #[arg(long, group = "mode")]
    pub print_config: bool,
    /// Print the plan of a frame (steps, counts, duration, limits), and exit; moves nothing.
    #[arg(long, group = "mode")]
    pub plan: bool,
    /// Switch the source off and open the relays, verify both, and exit (code 5 if an instrument does not reply).
    #[arg(long, group = "mode")]
    pub safe_off: bool,
    /// Search for instruments (mDNS, VXI-11 broadcast, these addresses), propose lines of configuration, and exit; needs
    /// no configuration and sends only *IDN?.
    #[arg(long, group = "mode", value_name = "ADDRESS", num_args = 0..)]
    pub discover: Option<Vec<String>>,
    /// Write the manual pages tactusd(8) and tactus.toml(5) into a folder, and exit.
    #[arg(long, group = "mode", value_name = "FOLDER", hide = true)]
    pub man: Option<PathBuf>,
    /// With --plan: print one JSON object; with --discover: one per line.
    #[arg(long)]
    pub json: bool,
}
