//! The command line: every command with its options and help texts.

mod records;
mod rig;
mod session;
#[cfg(test)]
mod tests;

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand};
use outfile::{Existing, GrowingFolder};

use crate::options::duration::{SpanError, parse_span};
use crate::output::Colour;
pub use records::{
    Export, Log, MapOptions, Prune, Quantities, RecordingSource, Repair, Replay, Report, Sessions,
    SessionsCommand, Verify,
};
pub use rig::{
    AlarmOrder, AlarmsCommand, Discover, Doctor, InstrumentsCommand, NotifyCommand, Transcript,
};
pub use session::{BaselineCommand, BaselineRecord, Plan, Start, Step, Stop, Top, Watch, Web};

fn span(text: &str) -> Result<Duration, SpanError> {
    parse_span(text)
}

/// The command line of `tactus`.
#[derive(Debug, Parser)]
#[command(
    name = "tactus",
    version,
    about = "Pressure maps of a conductive sheet: control the daemon, read recorded sessions",
    long_about = "Controls a running tactusd over D-Bus (status, baseline, start, stop, watch, plan) and reads recorded \
                  sessions without one (sessions, export, replay). A research instrument, not a medical device.",
    after_help = "Exit codes: 0 done, 1 failed, 2 usage, 3 no daemon, no such session or baseline, 4 not authorised, \
                  5 instrument fault, 6 timeout, 75 busy (try again later), 78 configuration.\n\
                  With --json every command that prints data prints one object per line; docs/reference/json.md documents the fields.",
    propagate_version = true,
    infer_subcommands = false
)]
pub struct Arguments {
    #[command(flatten)]
    pub global: Global,
    #[command(subcommand)]
    pub command: Command,
}

/// Options of every command.
#[derive(Debug, Clone, Args)]
pub struct Global {
    /// Bus of the daemon: system, session, or unix:PATH (default: TACTUS_BUS, else the peer sockets, then the session bus, then the system bus)
    #[arg(
        long,
        global = true,
        value_name = "BUS",
        help_heading = "Global options"
    )]
    pub bus: Option<String>,
    /// Directory of session files, read without a daemon (default: TACTUS_STATE, else all of: the running daemon's, $XDG_STATE_HOME/tactus, ~/.local/state/tactus, /var/lib/tactus)
    #[arg(
        long,
        global = true,
        value_name = "DIR",
        help_heading = "Global options"
    )]
    pub state: Option<PathBuf>,
    /// Configuration with the section [archive], for sessions in the archive (default: TACTUS_ARCHIVE, else /etc/tactus/config.toml)
    #[cfg(feature = "archive")]
    #[arg(
        long,
        global = true,
        value_name = "FILE",
        help_heading = "Global options"
    )]
    pub archive_config: Option<PathBuf>,
    /// Print one JSON object per line instead of text
    #[arg(long, global = true, help_heading = "Global options")]
    pub json: bool,
    /// Colour of maps
    #[arg(
        long,
        global = true,
        value_name = "WHEN",
        default_value = "auto",
        help_heading = "Global options"
    )]
    pub colour: Colour,
    /// Longest wait for the reply to one call
    #[arg(long, global = true, value_name = "SPAN", value_parser = span, default_value = "30s", help_heading = "Global options")]
    pub timeout: Duration,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Show the state of the daemon
    Status,
    /// List the instruments and their states; test them, search for others, open their relays
    Instruments {
        #[command(subcommand)]
        what: Option<InstrumentsCommand>,
    },
    /// Record, show or select the baseline of the unloaded sheet
    Baseline {
        #[command(subcommand)]
        what: BaselineCommand,
    },
    /// Start a measuring session
    Start(Start),
    /// Stop the running session; the source is switched off and verified
    Stop(Stop),
    /// Take frames one by one in a session started with --step
    Step(Step),
    /// Follow frames and draw the map of each in the terminal
    Watch(Watch),
    /// Show the running daemon on a full screen: map, charts of the last ten minutes, quantities, hot spots, health, events
    Top(Top),
    /// Show the running daemon in a browser: map, quantities, state, events. Only this machine's users with the printed address can read it
    Web(Web),
    /// List recorded sessions, from the running daemon's directory and the usual ones; check, repair, prune them
    Sessions(Sessions),
    /// Archive closed parts of sessions, or get sessions back; the same as `tactus-archive`
    #[cfg(feature = "archive")]
    Archive {
        #[command(subcommand)]
        task: archive::Task,
    },
    /// Show the events of a session and its rig: failed frames, lost and reconnected instruments
    Events {
        /// Session: an id, the beginning of one, `last`, or a session file
        session: String,
    },
    /// Show the events of the daemon and of all its sessions
    Log(Log),
    /// List the alarms that are active, not acknowledged or cannot be judged; acknowledge, shelve, reset them (exit code 1 if one is active)
    Alarms(AlarmsCommand),
    /// Test the notification command of [notify]
    Notify {
        #[command(subcommand)]
        what: NotifyCommand,
    },
    /// Check the machine that the daemon runs on: permissions, devices, buses, clock, disk; gives advice (exit code 1 if a check fails)
    Doctor(Doctor),
    /// Write a session's frames (csv, nc, mat, parquet), one frame's map (png, svg, raster) or a film (apng)
    Export(Export),
    /// Write a report of a session as one HTML page for reading and printing: worst moments, curves, alarms, gaps, health
    Report(Box<Report>),
    /// Reconstruct a recording offline: a case folder, or a session
    Replay(Box<Replay>),
    /// Print load, contact area, peak pressure index, centre of pressure, dose and other quantities of a recording
    Quantities(Box<Quantities>),
    /// Show the steps, counts, duration and limits of a frame; moves nothing (without a daemon: tactusd --plan)
    Plan(Plan),
    /// Reload the daemon's configuration; an invalid one changes nothing, and its problems are printed (exit code 78)
    Reload,
    /// Print the messages to and from the instruments for the last frames, as lines of JSON for tactus-sim replay
    Transcript(Transcript),
    /// Print the completion script of a shell
    Completions {
        /// Shell
        shell: clap_complete::Shell,
    },
    /// Write the manual pages into a folder, one for each command
    #[command(hide = true)]
    Man {
        /// An existing folder
        folder: GrowingFolder,
    },
}

/// Whether files that exist are replaced.
#[derive(Debug, Clone, Copy, Args)]
pub struct Replacing {
    /// Replace files that exist; recorded sessions are never replaced
    #[arg(long)]
    pub force: bool,
}

impl Replacing {
    /// As needed for writing files.
    pub fn existing(self) -> Existing {
        Existing::forced(self.force)
    }
}
