//! Options of `tactus-lab scene`.

use clap::{Args, Subcommand};
use outfile::{GrowingFolder, OutFolder};

use super::Replacing;

#[derive(Debug, Subcommand)]
pub(crate) enum SceneCommand {
    /// How large every effect is, named or not: in volts, in units of the noise and of the load's signal
    Explain(ExplainOptions),
    /// Read scenes and start them: faults as file:line:column
    Check {
        /// Scene files, or names of `scene list`
        #[arg(required = true, value_name = "FILE|NAME")]
        scenes: Vec<String>,
    },
    /// Take frames of a scene in virtual time, into a case folder with the truth or a session; the first is the baseline
    Run(RunOptions),
    /// List the scenes that come with the program
    List {
        /// Print one JSON object a scene
        #[arg(long)]
        json: bool,
    },
}

/// How frames are taken; what is not said is as in a session of the daemon.
#[derive(Debug, Args)]
pub(crate) struct SessionOptions {
    /// Injected current, uA
    #[arg(long, value_name = "uA", default_value_t = 1000.0)]
    pub(crate) current_ua: f64,
    /// Integration, power-line cycles
    #[arg(long, value_name = "N", default_value_t = 1.0)]
    pub(crate) nplc: f64,
    /// The voltmeter's range, V
    #[arg(long, value_name = "V", default_value_t = 1.0)]
    pub(crate) range_v: f64,
    /// Frequency of the mains, Hz
    #[arg(long, value_name = "HZ", default_value_t = 50.0)]
    pub(crate) line_hz: f64,
    /// Waited after the current has moved, ms
    #[arg(long, value_name = "MS", default_value_t = 2.0)]
    pub(crate) settle_ms: f64,
    /// From the start of a frame to the start of the next, s [default: one after the other]
    #[arg(long = "every", value_name = "S")]
    pub(crate) every_s: Option<f64>,
    /// Frames, the baseline included [default: until the scene's last load has come and gone, at least 2]
    #[arg(long, value_name = "N")]
    pub(crate) frames: Option<usize>,
}

#[derive(Debug, Args)]
pub(crate) struct ExplainOptions {
    /// A scene file, or a name of `scene list`
    #[arg(value_name = "FILE|NAME")]
    pub(crate) scene: String,
    #[command(flatten)]
    pub(crate) session: SessionOptions,
    /// Print one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct RunOptions {
    /// A scene file, or a name of `scene list`
    #[arg(value_name = "FILE|NAME")]
    pub(crate) scene: String,
    #[command(flatten)]
    pub(crate) session: SessionOptions,
    /// Folder to write: a case with frames.csv, truth.csv and judged.json
    #[arg(long, value_name = "DIR", required_unless_present = "logbook")]
    pub(crate) out: Option<OutFolder>,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Folder of sessions to write one into, which `tactus` reads as the daemon's own
    #[arg(long, value_name = "DIR")]
    pub(crate) logbook: Option<GrowingFolder>,
}
