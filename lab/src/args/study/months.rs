//! Options of `tactus-lab months`.

use clap::Args;
use outfile::OutFolder;
use std::path::PathBuf;

use studies::honesty::MapMethod;
use studies::months::{Family, LongScene};

use crate::args::Replacing;

#[derive(Debug, Args)]
pub(crate) struct MonthsOptions {
    /// Number of sheets of each kind of drift, whose single frames are compared with the baseline of day 0 [default: 5]
    #[arg(long, value_name = "N", value_parser = crate::args::numbers::ANY_COUNT.counter())]
    pub(crate) sheets: Option<usize>,
    /// Presses of each diameter on each of eight days of such a sheet, located by discs and one-step maps; 0 for none [default: 4]
    #[arg(long, value_name = "N", value_parser = crate::args::numbers::ANY_COUNT.counter())]
    pub(crate) presses: Option<usize>,
    /// Loads of each kind (presses of 10 and 30 mm, polygons) on each of these days, as maps with and without the drift of each frame removed; 0 for none
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = crate::args::numbers::ANY_COUNT.counter())]
    pub(crate) maps: usize,
    /// With --maps: methods (repeatable) [default: one-step, tv, best]
    #[arg(long, value_enum, value_name = "METHOD", requires = "maps")]
    pub(crate) method: Vec<MapMethod>,
    /// With --maps: trained models (repeatable)
    #[arg(long, value_name = "FILE", requires = "maps")]
    pub(crate) model: Vec<PathBuf>,
    /// Kinds of drift (repeatable) [default: all]
    #[arg(long, value_enum, value_name = "DRIFT")]
    pub(crate) drift: Vec<Family>,
    /// Virtual days with a tracked baseline, number of days; 0 for none [default: 90]
    #[arg(long, value_name = "N", value_parser = crate::args::numbers::DAYS.parser())]
    pub(crate) days: Option<f64>,
    /// Scenes that are tracked (repeatable) [default: all]
    #[arg(long, value_enum, value_name = "SCENE")]
    pub(crate) scene: Vec<LongScene>,
    /// Also evaluate loads that stay for days or increase slowly: number of days of the run with a load every night; 0: no such run
    #[arg(long, value_name = "N", default_value_t = 0.0, value_parser = crate::args::numbers::DAYS.parser())]
    pub(crate) load_days: f64,
    /// One sheet with one press, and two days, or less of each: a short run
    #[arg(long)]
    pub(crate) quick: bool,
    /// Seed of sheets, places and noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Write the tables (months.txt, months.json)
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<OutFolder>,
    #[command(flatten)]
    pub(crate) replacing: Replacing,
    /// Print one JSON object per row
    #[arg(long)]
    pub(crate) json: bool,
}
