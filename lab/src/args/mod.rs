//! The command line as data.

mod calibrate;
mod learning;
mod numbers;
mod reconstruct;
mod scene;
mod solve;
mod study;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use imaging::{DepthArguments, PresetName};
use outfile::{Existing, GrowingFolder, OutFolder, OutPath};
use studies::evaluation::test_set::TestSetName;

pub(crate) use calibrate::CalibrateOptions;
pub(crate) use learning::{
    DataOptions, DeepOptions, LinearOptions, Network, Profile, TrainOptions,
};
pub(crate) use reconstruct::ReconstructOptions;
pub(crate) use scene::{ExplainOptions, RunOptions, SceneCommand, SessionOptions};
pub(crate) use solve::{ForwardOptions, JacobianOptions, Of, SheetOptions, TransferOptions};
pub(crate) use study::{
    AdviseOptions, DataSetShards, HonestyOptions, MonthsOptions, PaperOptions, StabilityOptions,
    StudyShards, TradeoffOptions,
};

/// Meshes, forward solutions, sensitivities, training and reconstruction, offline.
#[derive(Debug, Parser)]
#[command(name = "tactus-lab", version)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Whether existing files are replaced.
#[derive(Debug, Clone, Copy, Default, Args)]
pub(crate) struct Replacing {
    /// Replace files that exist; recorded sessions are never replaced
    #[arg(long)]
    pub(crate) force: bool,
}

impl Replacing {
    /// The rule for existing files, for the crate `outfile`.
    pub(crate) fn existing(self) -> Existing {
        Existing::forced(self.force)
    }
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Make a case folder from a preset geometry, and print the quality of its mesh
    Mesh(MeshOptions),
    /// Fit conductance and contact impedances of the sheet to its baseline, and write them as a case folder for reconstruction
    Sheet(SheetOptions),
    /// Solve the forward model: readings of a case for one conductance or many
    Forward(ForwardOptions),
    /// Compute the sensitivity of a case's readings to conductances or contacts: one row per reading
    Jacobian(JacobianOptions),
    /// Compute the transfer matrices of a case's electrodes: admittance Y and impedance Z (paper, Eq. 2)
    Transfer(TransferOptions),
    /// Make a training set, or a shard of it, in files; an interrupted run is continued
    Dataset(DatasetOptions),
    /// Train a network and write its model file
    Train {
        #[command(subcommand)]
        network: Network,
    },
    /// Make a test set: a case folder with frames of the simulated sheet on a finer, different mesh, and the truth
    Judge(TestSetOptions),
    /// Explain, check, run and list scenes
    Scene {
        #[command(subcommand)]
        command: SceneCommand,
    },
    /// Compare methods and models on test sets: errors, similarity, GREIT's figures, time
    Evaluate(EvaluateOptions),
    /// Repeat every experiment, figure and claim of the paper from seeds, and write a page with the results
    Paper(PaperOptions),
    /// Measure accuracy against time: eight diagrams and a page
    Tradeoff(TradeoffOptions),
    /// Choose settings of the rig for a given accuracy and frame time, from the table of `tradeoff`
    Advise(AdviseOptions),
    /// Fit a calibration from relative loss to kPa to presses of known mass and area
    Calibrate(CalibrateOptions),
    /// Compute figures of merit of raster images
    Merit(MeritOptions),
    /// Reconstruct maps of recorded frames
    Reconstruct(ReconstructOptions),
    /// Run the numerically hard cases with naive code and with this code, and compare each error with a bound
    Stability(StabilityOptions),
    /// Test the quality check of maps on healthy frames and on frames with faults of the rig
    Honesty(HonestyOptions),
    /// Measure where presses are found over months of drift, with the baseline of day 0 and with a tracked one
    Months(MonthsOptions),
    /// Print the completion script of a shell
    Completions {
        /// Shell
        shell: clap_complete::Shell,
    },
}

#[derive(Debug, Args)]
pub(crate) struct MeshOptions {
    /// Preset
    #[arg(long, value_enum)]
    pub(crate) preset: PresetName,
    /// Change a parameter of the preset, e.g. radius_mm=115, electrodes=16, fineness=1.5 (repeatable)
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) set: Vec<String>,
    #[command(flatten)]
    pub(crate) depth: DepthArguments,
    /// Current of every reading in protocol.csv, mA
    #[arg(long, value_name = "mA", default_value_t = 1.0)]
    pub(crate) current_ma: f64,
    /// Folder to write, new or empty
    #[arg(long, value_name = "DIR")]
    pub(crate) out: OutFolder,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print the quality as one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct TestSetOptions {
    /// Kind of loads
    #[arg(long, value_enum)]
    pub(crate) set: TestSetName,
    /// White noise of one reading on baseline and frames, V; 0 for none
    #[arg(long, value_name = "SD", default_value_t = 2e-6)]
    pub(crate) noise_v: f64,
    /// Random seed; training uses other streams
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Frames [default: 32 presses, 100 polygon cases; 16, 9, 28 and 24 of the other sets]
    #[arg(long, value_name = "N")]
    pub(crate) count: Option<usize>,
    /// Standard deviation of the logarithm of an unevenly sprayed sheet's conductance, a number, e.g. 0.1 [default: an even sheet]
    #[arg(long, value_name = "SD")]
    pub(crate) spray: Option<f64>,
    /// Seed of the spraying: sets with the same number have the same sheet [default: that of --seed]
    #[arg(long, value_name = "SEED", requires = "spray")]
    pub(crate) spray_seed: Option<u64>,
    /// Change a parameter of the sheet, as `mesh --set` does (repeatable)
    #[arg(long = "measure", value_name = "KEY=VALUE")]
    pub(crate) measures: Vec<String>,
    /// Case folder of the paper's sheet to reconstruct on [default: the preset at 1 mA]
    #[arg(long, value_name = "DIR")]
    pub(crate) case: Option<PathBuf>,
    /// Folder to write, new or empty
    #[arg(long, value_name = "DIR", required_unless_present_any = ["shard", "missing"], conflicts_with_all = ["shard", "missing"])]
    pub(crate) out: Option<OutFolder>,
    #[command(flatten)]
    pub(crate) shards: StudyShards,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
}

#[derive(Debug, Args)]
pub(crate) struct DatasetOptions {
    #[command(flatten)]
    pub(crate) shards: DataSetShards,
    /// Make the set of recorded presses instead of simulated cases: a folder with frames.csv and presses.csv (frame, x_m, y_m, diameter_m, or x_mm, y_mm, diameter_mm; mass_kg or loss, or neither), and baseline.csv unless the first frame is the baseline
    #[arg(long, value_name = "DIR", conflicts_with_all = ["shard", "missing", "merge", "cases", "settings"])]
    pub(crate) recorded: Option<PathBuf>,
    /// Frames of the baseline of --recorded: first:N, or a file [default: baseline.csv of the folder, else the first frame]
    #[arg(long, value_name = "FILE|first:N", requires = "recorded")]
    pub(crate) baseline: Option<imaging::recorded::BaselineRule>,
    /// Relative loss of conductance under the largest pressure of --recorded, a number above 0 and at most 1; without masses under every press [default: the column loss of presses.csv, else 0.5]
    #[arg(long, value_name = "X", requires = "recorded", value_parser = numbers::LOSS.parser(), allow_hyphen_values = true)]
    pub(crate) loss: Option<f64>,
    /// Allow a set with fewer recorded presses than a frame has readings
    #[arg(long, requires = "recorded")]
    pub(crate) yes: bool,
    /// Random seed; the set does not depend on the shards [default: 1, or that of the settings]
    #[arg(long, value_name = "S")]
    pub(crate) seed: Option<u64>,
    /// Cases of the whole set [default: 15000, or that of the settings]
    #[arg(long, value_name = "N", value_parser = numbers::CASES.counter())]
    pub(crate) cases: Option<usize>,
    /// TOML file with other parameters of Algorithm 1 and other choices where the paper leaves one open: the training settings that
    /// determine the cases, e.g. polygons = 4, radius_m = 0.07, vertices = 5, [open] size = "diameter"
    #[arg(long, value_name = "FILE")]
    pub(crate) settings: Option<PathBuf>,
    /// Case folder of the geometry [default: the preset of the paper's sheet at 1 mA]
    #[arg(long, value_name = "DIR")]
    pub(crate) case: Option<PathBuf>,
    /// Folder for the shards
    #[arg(long, value_name = "DIR")]
    pub(crate) out: GrowingFolder,
}

#[derive(Debug, Args)]
pub(crate) struct EvaluateOptions {
    /// Folder made by `judge` (repeatable) [default: the four standard sets, newly made]
    #[arg(long, value_name = "DIR")]
    pub(crate) set: Vec<PathBuf>,
    /// Method with its options, e.g. "tv --loss-only" (repeatable) [default: those that need no long training]
    #[arg(long, value_name = "TEXT")]
    pub(crate) method: Vec<String>,
    /// Model file (repeatable)
    #[arg(long, value_name = "FILE")]
    pub(crate) model: Vec<PathBuf>,
    /// The seed of the standard sets, a number
    #[arg(long, value_name = "S", default_value_t = 7, conflicts_with = "set")]
    pub(crate) seed: u64,
    /// Frames of each standard set [default: 32 presses, 100 polygon cases]
    #[arg(long, value_name = "N", conflicts_with = "set")]
    pub(crate) count: Option<usize>,
    /// Draw accuracy against time, PNG
    #[arg(long, value_name = "FILE", conflicts_with_all = ["shard", "missing"])]
    pub(crate) picture: Option<OutPath>,
    #[command(flatten)]
    pub(crate) shards: StudyShards,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print one JSON object per set and method
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct MeritOptions {
    /// Folder of images: CSV, one line per row of pixels, NaN outside; the raster covers the bounding box
    #[arg(long, value_name = "DIR")]
    pub(crate) images: PathBuf,
    /// True places, in units of half the bounding box, x along rows: image,x,y or x,y [default: targets.csv among the images]
    #[arg(long, value_name = "FILE")]
    pub(crate) targets: Option<PathBuf>,
    /// Folder of true images of the same names, for correlation, relative error, SSIM and Dice
    #[arg(long, value_name = "DIR")]
    pub(crate) truth: Option<PathBuf>,
    /// Negate the images: maps of losses are negative
    #[arg(long)]
    pub(crate) negate: bool,
    /// Extent along columns, mm, for the location error [default: no location error]
    #[arg(long, value_name = "MM", requires = "height_mm")]
    pub(crate) width_mm: Option<f64>,
    /// Extent along rows, mm [default: no location error]
    #[arg(long, value_name = "MM", requires = "width_mm")]
    pub(crate) height_mm: Option<f64>,
    /// Print one JSON object per image
    #[arg(long)]
    pub(crate) json: bool,
}
