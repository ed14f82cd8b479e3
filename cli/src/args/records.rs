//! Options of the commands that read recorded sessions.

use std::path::PathBuf;
use std::time::Duration;

use chrono::{DateTime, Utc};
use clap::{Args, Subcommand};
use imaging::quantities::Quantity;
use outfile::{OutFolder, OutPath};

use super::{Replacing, span};
use crate::options::choices::{
    BaselineRule, Format, GeometryChoice, MethodArguments, Scale, TrackedArguments,
};
use crate::options::instant::Instant;
use crate::options::moment::{Moment, wall_time};
use crate::options::numbers::{FILM_SPEED, PIXELS};

/// Options of `log`.
#[derive(Debug, Clone, Default, Args)]
pub struct Log {
    /// Only events within this time before now: 2h, 1d [default: all]
    #[arg(long, value_name = "SPAN", value_parser = span)]
    pub since: Option<Duration>,
    /// Only events of this session: an id, the beginning of one, or `last`
    #[arg(long, value_name = "ID")]
    pub session: Option<String>,
    /// Only events of this kind: frame-failed, trouble, daily ...
    #[arg(long, value_name = "KIND")]
    pub kind: Option<String>,
    /// Continue with new events; needs the daemon
    #[arg(long)]
    pub follow: bool,
}

/// Options of `sessions`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct Sessions {
    /// Check, repair or prune them.
    #[command(subcommand)]
    pub what: Option<SessionsCommand>,
    /// Only sessions that had not ended by this time ('2026-11-22 14:00' local, 2026-11-22T14:00:00Z), or this long before now (7d) [default: all]
    #[arg(long, value_name = "TIME", value_parser = wall_time)]
    pub from: Option<DateTime<Utc>>,
    /// Only sessions that had begun before this time, or this long before now [default: all]
    #[arg(long, value_name = "TIME", value_parser = wall_time)]
    pub to: Option<DateTime<Utc>>,
    /// List the sessions of the archive instead; other commands take one as `archive:SITE/DAQ/SESSION`
    #[cfg(feature = "archive")]
    #[arg(long)]
    pub archive: bool,
    /// Only sessions of this site of the archive [default: all sites that the role may see]
    #[cfg(feature = "archive")]
    #[arg(long, value_name = "NAME", requires = "archive")]
    pub site: Option<String>,
    /// Only sessions of this machine of the archive [default: all]
    #[cfg(feature = "archive")]
    #[arg(long, value_name = "NAME", requires = "archive")]
    pub daq: Option<String>,
}

/// Commands of `sessions`.
#[derive(Debug, Subcommand)]
pub enum SessionsCommand {
    /// Show the details of a session: settings, sheet, operator, method, calibration, baseline, size, duration
    Show {
        /// Session: an id, the beginning of one, `last`, or a session file
        session: String,
    },
    /// Verify records: checksums, sequence, parts, an event for every gap (exit code 1 if there is a defect)
    Verify(Verify),
    /// Copy the readable frames of a damaged session file to a new file and report what was lost; the old file is not changed
    Repair(Repair),
    /// Remove old sessions. Open sessions and the newest baseline are kept
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
    /// The new file, NAME.tactus (default: SESSION_repaired.tactus next to the old one)
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Options of `sessions prune`.
#[derive(Debug, Args)]
#[group(id = "rule", required = true, multiple = true)]
pub struct Prune {
    /// Remove sessions whose last frame is older than this, e.g. 90d [default: any age]
    #[arg(long, value_name = "SPAN", value_parser = span, group = "rule")]
    pub older_than: Option<Duration>,
    /// Remove the oldest sessions of each directory until the others take at most this many bytes, e.g. 20GB [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = crate::records::maintenance::parse_size, group = "rule")]
    pub keep_bytes: Option<u64>,
    /// Remove only sessions that `tactus export` has exported completely, as csv, nc or parquet; without another rule: all of them
    #[arg(long, group = "rule")]
    pub exported_only: bool,
    /// Remove only sessions that the archive holds as they are now, with a receipt of `tactus-archive`; without another rule: all of them
    #[arg(long, group = "rule")]
    pub archived_only: bool,
    /// Only list what would be removed
    #[arg(long)]
    pub dry_run: bool,
}

/// Options of `export`.
#[derive(Debug, Args)]
pub struct Export {
    /// Session: an id, the beginning of one, `last`, or a session file
    pub session: String,
    /// Format of the output
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub format: Format,
    /// File to write (csv: also the baseline as NAME.baseline.csv, and for replay and tactus-lab a case folder NAME.case/ with mesh, protocol, frames, baseline and provenance)
    #[arg(long, short, value_name = "PATH")]
    pub out: OutPath,
    #[command(flatten)]
    pub replacing: Replacing,
    /// Write the map of each frame and its mesh into the netCDF file
    #[arg(long)]
    pub maps: bool,
    /// With --maps: also the standard deviation of each triangle's change of ln conductance, nan for triangles that the frame does not
    /// determine; always from the linear model with noise and drift of the frame
    #[arg(long, requires = "maps")]
    pub sd: bool,
    /// Sequence number of the frame whose map is drawn (default: the last one)
    #[arg(long, value_name = "SEQUENCE")]
    pub frame: Option<u64>,
    /// Instant of the picture: a frame's number, a time since the first frame (10m), a time ('2026-11-22 14:00' local,
    /// 2026-11-22T14:00:00Z), or an event: the first of a kind (alarm-active), the second of a kind (alarm-active:2), or its number
    /// in `tactus events` (event:7). The last frame that had begun by then is drawn
    #[arg(
        long,
        value_name = "TIME|EVENT",
        conflicts_with = "frame",
        allow_hyphen_values = true
    )]
    pub at: Option<Instant>,
    /// Time between two pictures of a film: 10s, 2m [default: a 600th of the session, but not less than the time between two frames]
    #[arg(long, value_name = "SPAN", value_parser = span)]
    pub every: Option<Duration>,
    /// How many times faster than the session the film runs [default: 10 pictures a second]
    #[arg(long, value_name = "TIMES", value_parser = FILM_SPEED.parser())]
    pub speed: Option<f64>,
    /// Pixels along each side of a raster [default: 32]
    #[arg(long, value_name = "N", value_parser = PIXELS.counter())]
    pub raster: Option<usize>,
    /// Scale of the map: `own`, or LOW,HIGH as the axis shows it: 0,50 (% of conductance lost) or 0,20kPa (with a calibration)
    #[arg(
        long,
        value_name = "SCALE",
        default_value = "own",
        allow_hyphen_values = true
    )]
    pub scale: Scale,
    #[command(flatten)]
    pub asked: MapOptions,
}

/// How `export`, `replay`, `report` and `quantities` make their maps.
#[derive(Debug, Default, PartialEq, Args)]
pub struct MapOptions {
    /// A calibration of this mesh and method (`tactus-lab calibrate`): pressures and loads in kPa and newtons [default: the
    /// session's, unless another method is named]
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    #[command(flatten)]
    pub method: MethodArguments,
    #[command(flatten)]
    pub tracked: TrackedArguments,
    #[command(flatten)]
    pub geometry: GeometryChoice,
}

impl MapOptions {
    /// Whether maps are asked for other than those that the session was recorded with.
    pub(crate) fn differ(&self) -> bool {
        *self != Self::default()
    }
}

/// What `replay` and `quantities` read.
#[derive(Debug, Args)]
pub struct RecordingSource {
    /// A case folder with protocol.csv (and a mesh if it has one), a session file, or a session's id, the beginning of one, or `last`
    pub source: String,
    /// Frames of a case folder, a row (or column) a frame; a bare name is searched in the folder first, then in the current
    /// directory [default: frames.csv in the folder]
    #[arg(long, value_name = "FILE")]
    pub frames: Option<PathBuf>,
    /// What to subtract: FILE (its frames' mean) or first:N (mean of the first N frames) [default: a session's own; of a folder its
    /// baseline.csv, else the first frame]
    #[arg(long, value_name = "FILE|first:N")]
    pub baseline: Option<BaselineRule>,
    /// Negate all readings, for an instrument that returns magnitudes
    #[arg(long)]
    pub negate: bool,
    /// Begin with this frame: its number, a time since the first frame (10m), or a time ('2026-11-22 14:00' local, 2026-11-22T14:00:00Z) [default: the first]
    #[arg(long, value_name = "PLACE", allow_hyphen_values = true)]
    pub from: Option<Moment>,
    /// End with this frame, in the form of --from [default: the last]
    #[arg(long, value_name = "PLACE", allow_hyphen_values = true)]
    pub to: Option<Moment>,
}

/// Options of `replay`.
#[derive(Debug, Args)]
pub struct Replay {
    #[command(flatten)]
    pub from: RecordingSource,
    /// Check maps against the recorded checksums; exit code 1 if they differ
    #[arg(long, conflicts_with_all = ["baseline", "negate", "frames"])]
    pub verify: bool,
    /// Only every Nth frame, from the first selected one
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    pub every: u64,
    /// At most N of these frames [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub count: Option<u64>,
    /// Write the maps as CSV, a row per frame, a column per triangle of the region: relative changes of conductance, losses negative.
    /// NAME.frames.csv next to it has times and positions, NAME.triangles.csv centroids and areas
    #[arg(long, value_name = "FILE")]
    pub out: Option<OutPath>,
    /// Write the standard deviation of each triangle's change of ln conductance to NAME.sd.csv, nan for triangles that the frame
    /// does not determine; always from the linear model with noise and drift of the frame
    #[arg(long, requires = "out")]
    pub sd: bool,
    /// New or empty directory for a picture of each map
    #[arg(long, value_name = "DIR")]
    pub png: Option<OutFolder>,
    #[command(flatten)]
    pub replacing: Replacing,
    /// Scale of the maps: `own`, or LOW,HIGH as the axis shows it: 0,50 (% of conductance lost) or 0,20kPa (with a calibration)
    #[arg(
        long,
        value_name = "SCALE",
        default_value = "own",
        allow_hyphen_values = true
    )]
    pub scale: Scale,
    /// Print one line per frame, without a map
    #[arg(long)]
    pub no_map: bool,
    #[command(flatten)]
    pub asked: MapOptions,
}

/// Options of `report`.
#[derive(Debug, Args)]
pub struct Report {
    /// Session: an id, the beginning of one, `last`, or a session file
    pub session: String,
    /// New or empty directory for the page, index.html
    #[arg(long, short, value_name = "DIR")]
    pub out: OutFolder,
    #[command(flatten)]
    pub asked: MapOptions,
}

/// Options of `quantities`.
#[derive(Debug, Args)]
pub struct Quantities {
    #[command(flatten)]
    pub from: RecordingSource,
    /// Only this region: a name of [[region]] in the session's configuration, or `sheet` [default: all]
    #[arg(long, value_name = "NAME")]
    pub region: Option<String>,
    /// Only this quantity, e.g. load, ppi, unrelieved; may be repeated [default: all]
    #[arg(long = "quantity", value_name = "NAME", value_parser = quantity)]
    pub quantities: Vec<Quantity>,
    /// Length of a span, in whole seconds; the smallest, mean and largest value of the frames in each span are printed [default: 1m; frames without times form one span]
    #[arg(long, value_name = "SPAN", value_parser = whole_seconds)]
    pub every: Option<Duration>,
    /// Print each frame instead, with standard deviations
    #[arg(long, conflicts_with = "every")]
    pub each_frame: bool,
    /// Compute everything from the frames, even if the session has stored a row for each minute
    #[arg(long)]
    pub recompute: bool,
    /// Print CSV with a heading: one line for each span (or frame), region and quantity
    #[arg(long)]
    pub csv: bool,
    /// Pressures in mmHg instead of kPa; needs a calibration
    #[arg(long)]
    pub mmhg: bool,
    #[command(flatten)]
    pub asked: MapOptions,
}

/// A span of whole seconds: rows of quantities begin at whole seconds.
fn whole_seconds(text: &str) -> Result<Duration, String> {
    let length = span(text).map_err(|error| error.to_string())?;
    match length.subsec_nanos() {
        0 => Ok(length),
        _ => Err(format!(
            "'{text}' is not a whole number of seconds; write for example 1s, 90s, 5m"
        )),
    }
}

/// A quantity by its name.
fn quantity(name: &str) -> Result<Quantity, String> {
    Quantity::from_name(name).ok_or_else(|| {
        let known = Quantity::ALL.map(Quantity::name).join(", ");
        format!("there is no quantity '{name}'; known: {known}")
    })
}
