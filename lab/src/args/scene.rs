//! Options of `tactus-lab scene`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use outfile::{GrowingFolder, OutFolder};

use super::Replacing;

#[derive(Debug, Subcommand)]
pub(crate) enum SceneCommand {
    /// Show the size of every effect, in the scene or not: in volts, relative to the noise and to the load's signal
    Explain(ExplainOptions),
    /// Read and start scenes; errors are printed as file:line:column
    Check {
        /// Scene files, or names of `scene list`
        #[arg(required = true, value_name = "FILE|NAME")]
        scenes: Vec<String>,
    },
    /// Simulate frames of a scene and write a case folder with the truth, or a session; the first frame is the baseline
    Run(RunOptions),
    /// List the scenes of the program
    List {
        /// Print one JSON object per scene
        #[arg(long)]
        json: bool,
    },
}

/// Measuring settings; the defaults are those of the daemon.
#[derive(Debug, Args)]
pub(crate) struct SessionOptions {
    /// Injected current, uA
    #[arg(long, value_name = "uA", default_value_t = 1000.0)]
    pub(crate) current_ua: f64,
    /// Integration, power-line cycles
    #[arg(long, value_name = "N", default_value_t = 1.0)]
    pub(crate) nplc: f64,
    /// Range of the voltmeter, V
    #[arg(long, value_name = "V", default_value_t = 1.0)]
    pub(crate) range_v: f64,
    /// Frequency of the mains, Hz
    #[arg(long, value_name = "HZ", default_value_t = 50.0)]
    pub(crate) line_hz: f64,
    /// Wait after a change of the current, ms
    #[arg(long, value_name = "MS", default_value_t = 2.0)]
    pub(crate) settle_ms: f64,
    /// Period from start to start of frames, s [default: back to back]
    #[arg(long = "every", value_name = "S")]
    pub(crate) every_s: Option<f64>,
    /// Number of frames including the baseline [default: until the end of the scene's last load, at least 2]
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
    /// Folder of sessions for a new session, which `tactus` can read
    #[arg(long, value_name = "DIR")]
    pub(crate) logbook: Option<GrowingFolder>,
    /// With --logbook: store this configuration of a daemon with the session, so that `tactus` makes its maps and quantities as that
    /// daemon would: [geometry], [model], [quantities] and regions
    #[arg(long, value_name = "FILE", requires = "logbook")]
    pub(crate) config: Option<PathBuf>,
}
