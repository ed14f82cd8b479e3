//! Options of the commands that control sessions.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};

use super::span;
use crate::options::about::About;
use crate::options::choices::Scale;
use crate::options::measuring::Measuring;
use crate::options::numbers::speed;

/// Commands of `baseline`.
#[derive(Debug, Subcommand)]
pub enum BaselineCommand {
    /// Record a new baseline of the unloaded sheet and wait until it is done
    Record(Box<BaselineRecord>),
    /// Show the baseline in use
    Show,
    /// List the recorded baselines, the oldest first, and mark the one in use
    List,
    /// Make an earlier baseline the current one, until another is recorded or the daemon ends
    Use {
        /// Baseline: an id, the beginning of one, or `last`
        #[arg(value_name = "ID")]
        id: String,
    },
    /// Declare the sheet empty: the running session takes its next frame as the new tracked baseline
    EmptyNow,
    /// Declare a load on the sheet: the running session stops updating its tracked baseline until `empty-now`
    LoadedNow,
    /// Declare all slow changes so far to be ageing of the sheet: the running session discards its past baselines
    ForgetAnchor,
}

/// Options of `baseline record`.
#[derive(Debug, Args)]
pub struct BaselineRecord {
    /// Frames to average
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub frames: u32,
    /// Note to store in the record
    #[arg(long, value_name = "TEXT")]
    pub note: Option<String>,
    /// Longest wait, e.g. 10m [default: no limit]; afterwards the recording continues in the daemon
    #[arg(long, value_name = "SPAN", value_parser = span)]
    pub within: Option<Duration>,
    /// Return at once instead of waiting for the last frame
    #[arg(long)]
    pub no_wait: bool,
    #[command(flatten)]
    pub about: About,
    #[command(flatten)]
    pub measuring: Measuring,
}

/// Options of `start`.
#[derive(Debug, Args)]
pub struct Start {
    /// Period from start to start of frames, e.g. 10s, 5m [default: frames back to back]
    #[arg(long, value_name = "SPAN", value_parser = span)]
    pub every: Option<Duration>,
    /// End after this many frames [default: no limit]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub count: Option<u64>,
    /// End after this long, e.g. 2h [default: no limit]
    #[arg(long = "for", value_name = "SPAN", value_parser = span)]
    pub duration: Option<Duration>,
    /// Model file for the reconstruction, or `one-step` (default: as configured)
    #[arg(long, value_name = "FILE|one-step")]
    pub model: Option<PathBuf>,
    /// Baseline to subtract: an id, the beginning of one, or `last` [default: the current one]
    #[arg(long, value_name = "ID")]
    pub baseline: Option<String>,
    /// For recordings: speed as a multiple of the recorded rate; 0: as fast as possible (default: the recorded rate)
    #[arg(long, value_name = "FACTOR", value_parser = speed, allow_hyphen_values = true, conflicts_with_all = ["every", "step"])]
    pub speed: Option<f64>,
    /// Take frames only on `tactus step`
    #[arg(long, conflicts_with_all = ["every", "wait"])]
    pub step: bool,
    /// Note to store in the record
    #[arg(long, value_name = "TEXT")]
    pub note: Option<String>,
    /// Wait until the session has ended
    #[arg(long)]
    pub wait: bool,
    /// With --wait: longest wait, e.g. 3h [default: no limit]; afterwards the session continues
    #[arg(long, value_name = "SPAN", value_parser = span, requires = "wait")]
    pub within: Option<Duration>,
    #[command(flatten)]
    pub about: About,
    #[command(flatten)]
    pub measuring: Measuring,
}

/// Options of `stop`.
#[derive(Debug, Args)]
pub struct Stop {
    /// Session to stop: an id, the beginning of one, or `last` [default: the running one]
    pub session: Option<String>,
}

/// Options of `step`.
#[derive(Debug, Args)]
pub struct Step {
    /// Number of frames to take
    #[arg(default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: u64,
    /// Session: an id, the beginning of one, or `last` [default: the running one]
    #[arg(long, value_name = "ID")]
    pub session: Option<String>,
}

/// Options of `watch`.
#[derive(Debug, Args)]
pub struct Watch {
    /// Session to follow: an id, the beginning of one, or `last` [default: the running one, or the next to start]
    pub session: Option<String>,
    /// Show the load after every injection of a frame, with its velocity, instead of the frames
    #[arg(long)]
    pub fast: bool,
    /// End after this many frames, or injections with --fast [default: no limit]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub count: Option<u64>,
    /// End after this long, e.g. 2h [default: no limit]
    #[arg(long = "for", value_name = "SPAN", value_parser = span)]
    pub duration: Option<Duration>,
    /// Scale of the map: `own` (each map fills it) or LOW,HIGH as the axis shows it: 0,50 (% of conductance lost) or 0,20kPa (with a
    /// calibration)
    #[arg(
        long,
        value_name = "SCALE",
        default_value = "own",
        allow_hyphen_values = true
    )]
    pub scale: Scale,
    /// Print one line per frame or injection, without a map
    #[arg(long)]
    pub no_map: bool,
    /// Also print the standard deviation of each triangle's change of ln conductance, at most once a second, if the daemon tracks
    /// the baseline: a summary, or with --json each value, null for triangles that the frame does not determine
    #[arg(long, conflicts_with = "fast")]
    pub sd: bool,
}

/// Options of `top`.
#[derive(Debug, Clone, Copy, Args)]
pub struct Top {
    /// Scale of the map: `own` (each map fills it) or LOW,HIGH as the axis shows it: 0,50 (% of conductance lost) or 0,20kPa (with a
    /// calibration)
    #[arg(
        long,
        value_name = "SCALE",
        default_value = "own",
        allow_hyphen_values = true
    )]
    pub scale: Scale,
}

/// Options of `plan`.
#[derive(Debug, Args)]
pub struct Plan {
    /// List every step
    #[arg(long)]
    pub steps: bool,
    /// Measuring settings of the session
    #[command(flatten)]
    pub measuring: Measuring,
}

/// Options of `web`.
#[derive(Debug, Clone, Default, Args)]
pub struct Web {
    /// Address to listen on; may be repeated [default: a free port of 127.0.0.1 and of ::1]
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub listen: Vec<std::net::SocketAddr>,
    /// Allow --listen with an address that other machines can reach; the connection is not encrypted
    #[arg(long)]
    pub beyond_localhost: bool,
    /// Also accept this Host name, of a tunnel or a reverse proxy: NAME or NAME:PORT; may be repeated
    #[arg(long = "name", value_name = "HOST")]
    pub names: Vec<web::HostName>,
    /// File with the token, which only its owner can read [default: a new token]
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<std::path::PathBuf>,
    /// Let the page command the daemon, with your rights: start, stop, baseline, alarms, and presses on a simulated sheet
    #[arg(long)]
    pub control: bool,
    /// Also show all sheets of the archive, and play their sessions: the catalogue is read with the rights of its configuration
    #[cfg(feature = "archive")]
    #[arg(long)]
    pub archive: bool,
    /// Only print the address
    #[arg(long)]
    pub no_browser: bool,
}
