//! The command line as written: every command, its options, and what each says in `--help`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand};
use outfile::{Existing, GrowingFolder, OutFolder, OutPath};

use crate::options::about::About;
use crate::options::choices::{BaselineRule, Format, GeometryChoice, MethodArguments, Scale};
use crate::options::duration::{SpanError, parse_span};
use crate::options::measuring::Measuring;
use crate::options::moment::Moment;
use crate::options::numbers::{pixels, speed};
use crate::output::Colour;

fn span(text: &str) -> Result<Duration, SpanError> {
    parse_span(text)
}

/// Everything a person may say to `tactus`.
#[derive(Debug, Parser)]
#[command(
    name = "tactus",
    version,
    about = "Pressure maps of a conductive sheet: talk to the daemon, read what it has recorded",
    long_about = "Controls a running tactusd over D-Bus (status, baseline, start, stop, watch, plan) and reads what was \
                  recorded without one (sessions, export, replay). A research instrument, not a medical device.",
    after_help = "Exit codes: 0 done, 1 failed, 2 usage, 3 no daemon, no such session or baseline, 4 not authorised, \
                  5 instrument fault, 6 timeout, 75 busy (try again later), 78 configuration.\n\
                  With --json every command that prints data prints one object a line; docs/reference/json.md documents the fields.",
    propagate_version = true,
    infer_subcommands = false
)]
pub struct Arguments {
    #[command(flatten)]
    pub global: Global,
    #[command(subcommand)]
    pub command: Command,
}

/// Options that every command takes.
#[derive(Debug, Clone, Args)]
pub struct Global {
    /// Where the daemon is: system, session, or unix:PATH (default: TACTUS_BUS, else the peer sockets, then the session bus, then the system bus)
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
    /// Print one JSON object a line instead of text
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
    /// Give up when the daemon has not answered one call for this long
    #[arg(long, global = true, value_name = "SPAN", value_parser = span, default_value = "30s", help_heading = "Global options")]
    pub timeout: Duration,
}

/// What is asked.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Show what the daemon is doing
    Status,
    /// List the instruments and whether they answer; test them, look for others, open their relays
    Instruments {
        #[command(subcommand)]
        what: Option<InstrumentsCommand>,
    },
    /// Record or show the baseline of the unloaded sheet
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
    /// List recorded sessions, from the running daemon's directory and the usual ones; check, repair, prune them
    Sessions {
        #[command(subcommand)]
        what: Option<SessionsCommand>,
    },
    /// Show what happened to a session and its rig: frames that failed, instruments lost and found again
    Events {
        /// Session: an id, the beginning of one, `last`, or a session file
        session: String,
    },
    /// Show what happened to the daemon and to all its sessions
    Log(Log),
    /// Whether people are told of troubles by the command of [notify]
    Notify {
        #[command(subcommand)]
        what: NotifyCommand,
    },
    /// Look at the machine that the daemon runs on: permissions, devices, buses, clock, disk; says what to do (1 if something is bad)
    Doctor(Doctor),
    /// Write a session's frames as CSV, or a frame's map as PNG or SVG
    Export(Export),
    /// Reconstruct a recording offline: a case folder, or a session
    Replay(Box<Replay>),
    /// Show the steps, count, duration and limits of a frame without moving anything (before there is a daemon: tactusd --plan)
    Plan(Plan),
    /// Read the daemon's configuration again; a bad one changes nothing (78) and its problems are told
    Reload,
    /// Print what was said over the wires for the last frames, as lines of JSON that tactus-sim replay plays
    Transcript(Transcript),
    /// Print the completion script of a shell
    Completions {
        /// Which shell
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
    /// As the writing of files takes it.
    pub fn existing(self) -> Existing {
        Existing::forced(self.force)
    }
}

/// What is asked of the instruments.
#[derive(Debug, Subcommand)]
pub enum InstrumentsCommand {
    /// Switch the source off and open every relay, verify both; lifts the refusal of relays found closed at the start
    OpenAll,
    /// Agree to the instruments or modules that were found in place of the known ones
    Accept,
    /// Test every relay against the sheet, every contact, reciprocity and noise; the source is off afterwards (5 if something is found)
    Test {
        /// List what is in order, too
        #[arg(long)]
        all: bool,
    },
    /// Show how often each relay has closed, and how long that may go on
    Relays,
    /// Look for instruments and propose lines of configuration; none is used (before there is a daemon: tactusd --discover)
    Discover(Discover),
}

/// Options of `log`.
#[derive(Debug, Clone, Default, Args)]
pub struct Log {
    /// Only events of this last time: 2h, 1d [default: all]
    #[arg(long, value_name = "SPAN", value_parser = span)]
    pub since: Option<Duration>,
    /// Only of this session: an id, `last`, or the beginning of ids
    #[arg(long, value_name = "ID")]
    pub session: Option<String>,
    /// Only of this kind: frame-failed, trouble, daily ...
    #[arg(long, value_name = "KIND")]
    pub kind: Option<String>,
    /// Go on with what happens from now on; needs the daemon
    #[arg(long)]
    pub follow: bool,
}

/// What is asked of notifications.
#[derive(Debug, Subcommand)]
pub enum NotifyCommand {
    /// Run the command once and say how it fared
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
    /// Addresses to ask beside what is found: tcp:HOST:PORT or serial:PATH@BAUD
    pub addresses: Vec<String>,
    /// How long to listen
    #[arg(long, value_name = "SPAN", value_parser = span, default_value = "3s")]
    pub within: Duration,
    /// Don't listen for announcements (mDNS)
    #[arg(long)]
    pub no_mdns: bool,
    /// Don't ask everybody (VXI-11 broadcast)
    #[arg(long)]
    pub no_broadcast: bool,
}

/// Options of `transcript`.
#[derive(Debug, Args)]
pub struct Transcript {
    /// How many of the last frames; the daemon keeps record.transcripts of them (8 by default)
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub frames: u32,
    /// Write it to a file
    #[arg(long, value_name = "FILE")]
    pub out: Option<OutPath>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub replacing: Replacing,
}

/// What is asked of recorded sessions.
#[derive(Debug, Subcommand)]
pub enum SessionsCommand {
    /// Show with what a session was taken: settings, sheet, operator, method, calibration, baseline, size, duration
    Show {
        /// Session: an id, the beginning of one, `last`, or a session file
        session: String,
    },
    /// Check that records are whole: checksums, sequence, parts, an event for every gap (1 where one is not)
    Verify(Verify),
    /// Write what can be read of a damaged session file into a new one and say what was cut; the old one is not touched
    Repair(Repair),
    /// Remove old sessions, never one that is not closed nor the newest baseline
    Prune(Prune),
}

/// Options of `sessions verify`.
#[derive(Debug, Args)]
pub struct Verify {
    /// Sessions: ids, beginnings of ids, `last`, or session files
    #[arg(required_unless_present = "all")]
    pub sessions: Vec<String>,
    /// Every session that `tactus sessions` lists
    #[arg(long, conflicts_with = "sessions")]
    pub all: bool,
}

/// Options of `sessions repair`.
#[derive(Debug, Args)]
pub struct Repair {
    /// Session: an id, the beginning of one, `last`, or a session file
    pub session: String,
    /// The new file, NAME.tactus (default: SESSION_repaired.tactus beside the old one)
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Options of `sessions prune`.
#[derive(Debug, Args)]
#[group(id = "rule", required = true, multiple = true)]
pub struct Prune {
    /// Sessions whose last frame is older, e.g. 90d [default: of any age]
    #[arg(long, value_name = "SPAN", value_parser = span, group = "rule")]
    pub older_than: Option<Duration>,
    /// The oldest sessions of each directory, until the rest takes no more bytes, e.g. 20GB [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = crate::records::maintenance::parse_size, group = "rule")]
    pub keep_bytes: Option<u64>,
    /// Only what `tactus export --format csv` has written whole; alone: all of that
    #[arg(long, group = "rule")]
    pub exported_only: bool,
    /// Only say what would go
    #[arg(long)]
    pub dry_run: bool,
}

/// What is asked of the baseline.
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
}

/// Options of `baseline record`.
#[derive(Debug, Args)]
pub struct BaselineRecord {
    /// Frames to average
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub frames: u32,
    /// A remark kept with the record
    #[arg(long, value_name = "TEXT")]
    pub note: Option<String>,
    /// Give up after this long, e.g. 10m [default: never]; the recording itself goes on in the daemon
    #[arg(long, value_name = "SPAN", value_parser = span)]
    pub within: Option<Duration>,
    /// Return at once instead of waiting for the last frame
    #[arg(long)]
    pub no_wait: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub about: About,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub measuring: Measuring,
}

/// Options of `start`.
#[derive(Debug, Args)]
pub struct Start {
    /// Time from start to start of frames, e.g. 10s, 5m [default: frames without pause]
    #[arg(long, value_name = "SPAN", value_parser = span)]
    pub every: Option<Duration>,
    /// End after this many frames [default: no limit]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub count: Option<u64>,
    /// End after this long, e.g. 2h [default: no limit]
    #[arg(long = "for", value_name = "SPAN", value_parser = span)]
    pub duration: Option<Duration>,
    /// Model file to reconstruct with, or `one-step` (default: what the daemon's configuration says)
    #[arg(long, value_name = "FILE|one-step")]
    pub model: Option<PathBuf>,
    /// Baseline to subtract: an id, the beginning of one, or `last` [default: the current one]
    #[arg(long, value_name = "ID")]
    pub baseline: Option<String>,
    /// Recordings: play so many times faster than it was recorded; 0 as fast as possible (default: its own rate)
    #[arg(long, value_name = "FACTOR", value_parser = speed, allow_hyphen_values = true, conflicts_with_all = ["every", "step"])]
    pub speed: Option<f64>,
    /// Take a frame only when `tactus step` asks for it
    #[arg(long, conflicts_with_all = ["every", "wait"])]
    pub step: bool,
    /// A remark kept with the record
    #[arg(long, value_name = "TEXT")]
    pub note: Option<String>,
    /// Wait until the session has ended
    #[arg(long)]
    pub wait: bool,
    /// With --wait: give up after this long, e.g. 3h [default: never]; the session itself goes on
    #[arg(long, value_name = "SPAN", value_parser = span, requires = "wait")]
    pub within: Option<Duration>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub about: About,
    #[command(flatten)]
    #[allow(missing_docs)]
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
    /// End after this many frames [default: no limit]
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
    /// Print a line a frame but draw no map
    #[arg(long)]
    pub no_map: bool,
}

/// Options of `export`.
#[derive(Debug, Args)]
pub struct Export {
    /// Session: an id, the beginning of one, `last`, or a session file
    pub session: String,
    /// What to write
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub format: Format,
    /// File to write (csv: its baseline goes beside it as NAME.baseline.csv, and a case folder NAME.case/ with mesh, protocol, frames, baseline and provenance, for replay and tactus-lab)
    #[arg(long, short, value_name = "PATH")]
    pub out: OutPath,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub replacing: Replacing,
    /// Which frame's map to draw (default: the last one)
    #[arg(long, value_name = "SEQUENCE")]
    pub frame: Option<u64>,
    /// Pixels along each side of a raster
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = pixels)]
    pub raster: usize,
    /// Scale of the map: `own`, or LOW,HIGH as the axis shows it: 0,50 (% of conductance lost) or 0,20kPa (with a calibration)
    #[arg(
        long,
        value_name = "SCALE",
        default_value = "own",
        allow_hyphen_values = true
    )]
    pub scale: Scale,
    /// A calibration of this mesh and method (`tactus-lab calibrate`): maps in kPa, and each map's load in newtons [default: the
    /// session's, unless another method is named]
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    #[command(flatten)]
    pub method: MethodArguments,
    #[command(flatten)]
    pub geometry: GeometryChoice,
}

/// Options of `replay`.
#[derive(Debug, Args)]
pub struct Replay {
    /// A case folder with protocol.csv (and a mesh if it has one), a session file, or a session's id, the beginning of one, or `last`
    pub source: String,
    /// Frames of a case folder, a row (or column) a frame; a bare name is looked for in the folder first, then in the current
    /// directory [default: frames.csv in the folder]
    #[arg(long, value_name = "FILE")]
    pub frames: Option<PathBuf>,
    /// What to subtract: FILE (its frames' mean) or first:N (mean of the first N frames) [default: a session's own; of a folder its
    /// baseline.csv, else the first frame]
    #[arg(long, value_name = "FILE|first:N")]
    pub baseline: Option<BaselineRule>,
    /// Compare each map with the trace of the one that was recorded (1 where the same build and processor make another)
    #[arg(long, conflicts_with_all = ["baseline", "negate", "frames"])]
    pub verify: bool,
    /// Readings are magnitudes, as an instrument without sign gives them: take them as negative
    #[arg(long)]
    pub negate: bool,
    /// Begin with this frame: its number, a time since the first frame (10m), or a time ('2026-11-22 14:00' local, 2026-11-22T14:00:00Z) [default: the first]
    #[arg(long, value_name = "PLACE", allow_hyphen_values = true)]
    pub from: Option<Moment>,
    /// End with this frame, as --from names it [default: the last]
    #[arg(long, value_name = "PLACE", allow_hyphen_values = true)]
    pub to: Option<Moment>,
    /// Only every Nth frame, from the first one chosen on
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    pub every: u64,
    /// At most N frames of those [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub count: Option<u64>,
    /// Write the maps as CSV, a row a frame, a column a triangle of the region: relative changes of conductance, losses negative.
    /// Beside it times and places as NAME.frames.csv, centroids and areas as NAME.triangles.csv
    #[arg(long, value_name = "FILE")]
    pub out: Option<OutPath>,
    /// Write a picture of each map into this directory, which is new or empty
    #[arg(long, value_name = "DIR")]
    pub png: Option<OutFolder>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub replacing: Replacing,
    /// Scale of the maps: `own`, or LOW,HIGH as the axis shows it: 0,50 (% of conductance lost) or 0,20kPa (with a calibration)
    #[arg(
        long,
        value_name = "SCALE",
        default_value = "own",
        allow_hyphen_values = true
    )]
    pub scale: Scale,
    /// Print a line a frame but draw no map in the terminal
    #[arg(long)]
    pub no_map: bool,
    /// A calibration of this mesh and method (`tactus-lab calibrate`): maps in kPa, and each map's load in newtons [default: the
    /// session's, unless another method is named]
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    #[command(flatten)]
    pub method: MethodArguments,
    #[command(flatten)]
    pub geometry: GeometryChoice,
}

/// Options of `plan`.
#[derive(Debug, Args)]
pub struct Plan {
    /// List every step
    #[arg(long)]
    pub steps: bool,
    /// As a session would measure
    #[command(flatten)]
    pub measuring: Measuring,
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::options::choices::PresetName;

    fn parse(words: &[&str]) -> Result<Arguments, clap::Error> {
        Arguments::try_parse_from(std::iter::once("tactus").chain(words.iter().copied()))
    }

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn a_schedule_is_read() {
        let arguments = parse(&[
            "start", "--every", "10s", "--count", "16", "--for", "2h", "--json",
        ])
        .unwrap();
        assert!(arguments.global.json);
        let Command::Start(start) = arguments.command else {
            panic!()
        };
        assert_eq!(start.every, Some(Duration::from_secs(10)));
        assert_eq!(start.count, Some(16));
        assert_eq!(start.duration, Some(Duration::from_secs(7200)));
        assert!(!start.wait);
    }

    #[test]
    fn global_options_stand_before_or_after() {
        for words in [
            ["--bus", "unix:/run/x", "status"],
            ["status", "--bus", "unix:/run/x"],
        ] {
            assert_eq!(
                parse(&words).unwrap().global.bus.as_deref(),
                Some("unix:/run/x")
            );
        }
    }

    #[test]
    fn the_recording_of_the_story_is_read() {
        let arguments = parse(&[
            "replay",
            "data",
            "--frames",
            "replay.csv",
            "--baseline",
            "first:16",
            "--negate",
            "--preset",
            "disc-tank",
        ])
        .unwrap();
        let Command::Replay(replay) = arguments.command else {
            panic!()
        };
        assert_eq!(replay.baseline, Some(BaselineRule::First(16)));
        assert_eq!(replay.geometry.preset, Some(PresetName::DiscTank));
        assert!(replay.negate);
        assert_eq!(replay.method.prior, None);
    }

    #[test]
    fn what_cannot_be_is_refused() {
        for (words, says) in [
            (&["start", "--every", "10"][..], "time unit needed"),
            (&["start", "--count", "0"][..], "0"),
            (&["start", "--within", "5s"][..], "--wait"),
            (&["start", "--speed", "-1"][..], "own rate"),
            (&["replay", "d", "--baseline", "first:0"][..], "first:16"),
            (
                &["replay", "d", "--model", "m", "--lambda", "1"][..],
                "--model",
            ),
            (&["replay", "d", "--noise-v", "-1"][..], "above 0"),
            (&["replay", "d", "--noise-v", "0"][..], "above 0"),
            (&["replay", "d", "--lambda", "-1"][..], "above 0"),
            (&["replay", "d", "--scale", "1,0"][..], "two numbers"),
            (&["export", "s", "--out", "x"][..], "--format"),
            (&["frobnicate"][..], "frobnicate"),
        ] {
            let refusal = parse(words).unwrap_err();
            assert_eq!(refusal.exit_code(), 2, "{words:?}");
            assert!(refusal.to_string().contains(says), "{words:?}: {refusal}");
        }
    }

    #[test]
    fn a_fixed_scale_may_be_negative() {
        let arguments = parse(&["replay", "d", "--scale", "-5,50"]).unwrap();
        let Command::Replay(replay) = arguments.command else {
            panic!()
        };
        assert_eq!(
            replay.scale,
            Scale::Fixed {
                low: -5.0,
                high: 50.0,
                unit: None
            }
        );
    }
}
