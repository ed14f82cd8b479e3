//! The command line as data.

mod calibrate;
mod honesty;
mod learning;
mod numbers;
mod paper;
mod reconstruct;
mod scene;
mod solve;
mod stability;
mod tradeoff;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use imaging::PresetName;
use outfile::{Existing, GrowingFolder, OutFolder, OutPath};
use studies::evaluation::test_set::TestSetName;

use numbers::cases as set_cases;

pub(crate) use calibrate::CalibrateOptions;
pub(crate) use honesty::HonestyOptions;
pub(crate) use learning::{
    DataOptions, DeepOptions, LinearOptions, Network, Profile, TrainOptions,
};
pub(crate) use paper::PaperOptions;
pub(crate) use reconstruct::ReconstructOptions;
pub(crate) use scene::{ExplainOptions, RunOptions, SceneCommand, SessionOptions};
pub(crate) use solve::{ForwardOptions, JacobianOptions, Of, TransferOptions};
pub(crate) use stability::StabilityOptions;
pub(crate) use tradeoff::{AdviseOptions, TradeoffOptions};

/// Meshes, forward solutions, sensitivities, training and reconstruction, offline.
#[derive(Debug, Parser)]
#[command(name = "tactus-lab", version)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Whether files that exist are replaced.
#[derive(Debug, Clone, Copy, Default, Args)]
pub(crate) struct Replacing {
    /// Replace files that exist; recorded sessions are never replaced
    #[arg(long)]
    pub(crate) force: bool,
}

impl Replacing {
    /// As the writing of files takes it.
    pub(crate) fn existing(self) -> Existing {
        Existing::forced(self.force)
    }
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Make a case folder from a preset geometry, and print the quality of its mesh
    Mesh(MeshOptions),
    /// Solve the forward model: readings of a case for one conductance or many
    Forward(ForwardOptions),
    /// The sensitivity of a case's readings to conductances or contacts: a row a reading
    Jacobian(JacobianOptions),
    /// The transfer matrices of a case's electrodes: admittance Y and impedance Z (paper, Eq. 2)
    Transfer(TransferOptions),
    /// Make a training set, or a shard of it, in files; resumes where it was stopped
    Dataset(DatasetOptions),
    /// Train a network and write its model file
    Train {
        #[command(subcommand)]
        network: Network,
    },
    /// Make judging data: a case folder with frames of the simulated sheet on a finer, different mesh, and the truth
    Judge(TestSetOptions),
    /// Scenes, with only the effects they call for: explain, check, run, list
    Scene {
        #[command(subcommand)]
        command: SceneCommand,
    },
    /// Compare methods and models on judging data: errors, likeness, GREIT's figures, time
    Evaluate(EvaluateOptions),
    /// Every experiment, figure and claim of the paper, run again from seeds: one page to read
    Paper(PaperOptions),
    /// What accuracy costs in time: eight diagrams and one page
    Tradeoff(TradeoffOptions),
    /// A setting of the rig that is accurate and quick enough, from the table of `tradeoff`, and what it costs
    Advise(AdviseOptions),
    /// Fit a calibration: from relative loss to kPa, by presses of known mass and area
    Calibrate(CalibrateOptions),
    /// Figures of merit of raster images
    Merit(MeritOptions),
    /// Make maps of recorded frames
    Reconstruct(ReconstructOptions),
    /// The hard cases: what naive code does, what ours does, and the bound that it keeps
    Stability(StabilityOptions),
    /// Whether maps say what they cannot know: the check of maps on healthy frames and on faults of the rig
    Honesty(HonestyOptions),
    /// Print the completions of a shell
    Completions {
        /// Which shell
        shell: clap_complete::Shell,
    },
}

#[derive(Debug, Args)]
pub(crate) struct MeshOptions {
    /// Which geometry
    #[arg(long, value_enum)]
    pub(crate) preset: PresetName,
    /// Change a measure of the preset, e.g. radius_mm=115, electrodes=16, fineness=1.5 (repeatable)
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) set: Vec<String>,
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
    /// Which loads
    #[arg(long, value_enum)]
    pub(crate) set: TestSetName,
    /// White noise of one reading on baseline and frames, V; 0 for none
    #[arg(long, value_name = "SD", default_value_t = 2e-6)]
    pub(crate) noise_v: f64,
    /// The same seed gives the same folder; training draws from other streams
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Frames [default: 32 presses, 100 polygon cases; 16, 9, 28 and 24 of the other sets]
    #[arg(long, value_name = "N")]
    pub(crate) count: Option<usize>,
    /// Standard deviation of the logarithm of an unevenly sprayed sheet's conductance, a number, e.g. 0.1 [default: an even sheet]
    #[arg(long, value_name = "SD")]
    pub(crate) spray: Option<f64>,
    /// Change a measure of the sheet, as `mesh --set` does (repeatable)
    #[arg(long = "measure", value_name = "KEY=VALUE")]
    pub(crate) measures: Vec<String>,
    /// Case folder of the paper's sheet to reconstruct on [default: the preset at 1 mA]
    #[arg(long, value_name = "DIR")]
    pub(crate) case: Option<PathBuf>,
    /// Folder to write, new or empty
    #[arg(long, value_name = "DIR")]
    pub(crate) out: OutFolder,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
}

#[derive(Debug, Args)]
pub(crate) struct DatasetOptions {
    /// Which part: I/N with I from 0 to N - 1
    #[arg(long, value_name = "I/N", default_value = "0/1")]
    pub(crate) shard: String,
    /// The same seed gives the same set, however it is cut
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Cases of the whole set [default: 15000, or as the settings say]
    #[arg(long, value_name = "N", value_parser = set_cases)]
    pub(crate) cases: Option<usize>,
    /// Algorithm 1 with other parameters, and the paper's open readings: TOML with the keys of the training settings, e.g.
    /// polygons = 4, radius_m = 0.07, vertices = 5, [open] size = "diameter"
    #[arg(long, value_name = "FILE")]
    pub(crate) settings: Option<PathBuf>,
    /// Case folder to make it for; the preset of the paper's sheet at 1 mA if none is given
    #[arg(long, value_name = "DIR")]
    pub(crate) case: Option<PathBuf>,
    /// Folder of the shards
    #[arg(long, value_name = "DIR")]
    pub(crate) out: GrowingFolder,
}

#[derive(Debug, Args)]
pub(crate) struct EvaluateOptions {
    /// A folder that `judge` made (repeatable) [default: the four standard sets, made for the purpose]
    #[arg(long, value_name = "DIR")]
    pub(crate) set: Vec<PathBuf>,
    /// A method with its options, e.g. "tv --loss-only" (repeatable) [default: those that need no long training]
    #[arg(long, value_name = "TEXT")]
    pub(crate) method: Vec<String>,
    /// A model file (repeatable)
    #[arg(long, value_name = "FILE")]
    pub(crate) model: Vec<PathBuf>,
    /// The seed of the standard sets, a number
    #[arg(long, value_name = "S", default_value_t = 7)]
    pub(crate) seed: u64,
    /// Frames of each standard set [default: 32 presses, 100 polygon cases]
    #[arg(long, value_name = "N")]
    pub(crate) count: Option<usize>,
    /// Draw accuracy against time, PNG
    #[arg(long, value_name = "FILE")]
    pub(crate) picture: Option<OutPath>,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print one JSON object a set and method
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct MeritOptions {
    /// Folder of images: CSV, a row of pixels a line, NaN outside; the raster covers the bounding box
    #[arg(long, value_name = "DIR")]
    pub(crate) images: PathBuf,
    /// True places, in units of half the bounding box, x along rows: image,x,y or x,y [default: targets.csv among the images]
    #[arg(long, value_name = "FILE")]
    pub(crate) targets: Option<PathBuf>,
    /// Folder of true images of the same names: correlation, relative error, SSIM and Dice too
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
    /// Print one JSON object an image
    #[arg(long)]
    pub(crate) json: bool,
}
