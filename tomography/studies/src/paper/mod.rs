//! Every experiment, figure and claim of the paper, run again from seeds, as one page to read (`tactus-lab paper`).
//!
//! A folder grows: `models`, `sets`, figures (PNG and SVG), `results.json`, `claims.json`, `settings.json`, `index.html`. What
//! a command of `tactus-lab` makes is made by that command, and its words lie beside it in a file `.command`: who was
//! stopped goes on with what is missing, and what was made by other words is made again.

mod claims;
mod experiments;
mod figures;
mod page;
mod plan;
mod resident;
mod sweeps;

use std::path::PathBuf;

use outfile::Existing;

use crate::artifact_cache::{ArtifactCache, Program};
use crate::failure::{Failure, write};
pub use claims::{Claim, Verdict};
use experiments::Experiments;
use plan::Plan;
pub use resident::resident_growth;

/// What is to be made.
#[derive(Debug)]
pub struct Settings {
    /// The paper's own sizes in place of small ones.
    pub full: bool,
    /// Only this figure of the paper, 3 to 7.
    pub figure: Option<u8>,
    /// The same seed gives the same numbers, times apart.
    pub seed: u64,
    /// Folder of the page, its figures and tables; default `paper-quick` or `paper-full`.
    pub folder: Option<PathBuf>,
    /// What becomes of a folder that another command has made.
    pub existing: Existing,
}

/// What was made.
#[derive(Debug)]
pub enum Made {
    /// One figure of the paper: its files.
    Figure(Vec<PathBuf>),
    /// The page, and the paper's claims with what was found.
    Page {
        /// The page.
        path: PathBuf,
        /// The claims.
        claims: Vec<Claim>,
    },
}

/// Makes what is missing, draws, writes the page.
///
/// # Errors
/// A folder that belongs to another command, files that are damaged, or a command that fails.
pub fn run(settings: &Settings, program: &dyn Program) -> Result<Made, Failure> {
    let plan = Plan::new(settings.full, settings.seed);
    let folder = match &settings.folder {
        Some(folder) => folder.clone(),
        None => PathBuf::from(format!("paper-{}", plan.name)),
    };
    let place = ArtifactCache::new(folder, "paper", settings.existing, program)?;
    place.write("settings.json", &plan.described())?;
    let case = place.case()?;
    if settings.figure == Some(3) {
        let figure = figures::mesh(&place, &case)?;
        return Ok(Made::Figure(vec![place.path(&figure.file)]));
    }
    let models = plan.models(&place)?;
    let wanted = |figure: u8| settings.figure.is_none_or(|only| only == figure);
    let experiments = Experiments::run(&plan, &place, &models, settings.figure)?;
    let mut drawn = Vec::new();
    if wanted(3) {
        drawn.push(figures::mesh(&place, &case)?);
    }
    drawn.extend(figures::tests(&place, &experiments, &wanted)?);
    if settings.figure.is_some() {
        let files = drawn.iter().map(|figure| place.path(&figure.file));
        return Ok(Made::Figure(files.collect()));
    }
    let sweeps = sweeps::run(&plan, &place, &models)?;
    drawn.extend(figures::sweeps(&place, &sweeps)?);
    let claims = claims::judge(&plan, &models, &experiments)?;
    place.write("results.json", &experiments.table())?;
    place.write(
        "sweeps.json",
        &serde_json::Value::Array(sweeps.iter().map(sweeps::Sweep::described).collect()),
    )?;
    place.write(
        "claims.json",
        &serde_json::Value::Array(claims.iter().map(claims::Claim::described).collect()),
    )?;
    let page = page::page(&plan, &models, &experiments, &claims, &drawn);
    let path = place.path("index.html");
    write(&path, Existing::Replace, page)?;
    Ok(Made::Page { path, claims })
}
