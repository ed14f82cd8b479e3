//! All experiments, figures and claims of the paper, repeated from seeds, on one HTML page (`tactus-lab paper`).
//!
//! The output folder contains `models`, `sets`, figures (PNG and SVG), `results.json`, `claims.json`, `settings.json`,
//! `index.html`. Models and sets are made by commands of `tactus-lab`, whose arguments are stored in a file `.command`
//! for each. An interrupted run resumes with what is missing; outputs of commands with other arguments are made again.

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

/// Options of the study.
#[derive(Debug)]
pub struct Settings {
    /// The paper's sizes instead of small ones.
    pub full: bool,
    /// Only this figure of the paper, 3 to 7.
    pub figure: Option<u8>,
    /// Equal seeds give equal numbers, except times.
    pub seed: u64,
    /// Folder of the page, its figures and tables; default `paper-quick` or `paper-full`.
    pub folder: Option<PathBuf>,
    /// Whether a folder made by another command may be replaced.
    pub existing: Existing,
}

/// Output of the study.
#[derive(Debug)]
pub enum Made {
    /// One figure of the paper: its files.
    Figure(Vec<PathBuf>),
    /// The page, and the paper's claims with the results.
    Page {
        /// The page.
        path: PathBuf,
        /// The claims.
        claims: Vec<Claim>,
    },
}

/// Makes missing parts, draws figures, writes the page.
///
/// # Errors
/// A folder that belongs to another command, damaged files, or a command that fails.
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
