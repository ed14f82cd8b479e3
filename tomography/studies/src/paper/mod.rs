//! All experiments, figures and claims of the paper, reproduced from seeds, on one HTML page (`tactus-lab paper`).
//!
//! The output folder contains `models`, `sets`, figures (PNG and SVG), `results.json`, `claims.json`, `settings.json`,
//! `index.html`. Models and sets are created by commands of `tactus-lab`; the arguments of each command are stored in a
//! file `.command` next to its output. An interrupted run creates what is missing; outputs of commands with other
//! arguments are created again.

mod claims;
mod evaluation;
mod experiments;
mod figures;
mod page;
mod plan;
mod resident;
mod sweeps;

use std::path::PathBuf;

use outfile::Existing;
use serde_json::json;
use shards::{Division, Outcome, StopRequest, Study};

use crate::artifact_cache::{ArtifactCache, Program};
use crate::build;
use crate::failure::{Failure, write};
pub use claims::{Claim, Verdict};
use evaluation::{Evaluated, Evaluations, Job};
use experiments::Experiments;
use plan::{Method, Plan};
pub use resident::resident_growth;

/// Options of the study.
#[derive(Debug)]
pub struct Settings {
    /// Whether to use the paper's sizes instead of small ones.
    pub full: bool,
    /// Only this figure of the paper, 3 to 7.
    pub figure: Option<u8>,
    /// Seed of the study; equal seeds give equal numbers, except times.
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

/// Creates missing parts, draws figures and writes the page. Each method on a test set is an item of work in shards;
/// models and test sets are created once, in the folder that all shards use.
///
/// # Errors
/// A folder that belongs to another command, damaged files, shards that cannot be used, or a command that fails.
pub fn run(
    settings: &Settings,
    program: &dyn Program,
    division: &Division,
    stop: &StopRequest,
) -> Result<Outcome<Made>, Failure> {
    let plan = Plan::new(settings.full, settings.seed);
    let folder = match &settings.folder {
        Some(folder) => folder.clone(),
        None => PathBuf::from(format!("paper-{}", plan.name)),
    };
    let mut methods = plan.methods();
    let jobs = jobs(&plan, &methods, settings.figure)?;
    let study = Study {
        name: "paper",
        settings: json!({
            "build": build(),
            "run": plan.name,
            "seed": plan.seed,
            "figure": settings.figure,
        }),
        items: jobs.iter().map(Job::name).collect(),
    };
    let place = match division {
        Division::Missing(..) => None,
        _ => Some(ArtifactCache::new(
            folder,
            "paper",
            settings.existing,
            program,
        )?),
    };
    let place = || {
        place
            .as_ref()
            .expect("a list of missing shards has no folder")
    };
    if *division == Division::Whole {
        place().write("settings.json", &plan.described())?;
        place().case()?;
        if !jobs.is_empty() {
            plan.load(place(), &mut methods)?;
        }
    }
    let outcome = study.perform(division, stop, &mut |item| jobs[item].run(place()))?;
    outcome.then(|results: Vec<Evaluated>| {
        if *division != Division::Whole {
            place().write("settings.json", &plan.described())?;
        }
        let names = jobs.iter().map(Job::name);
        let evaluations = Evaluations::Known(names.zip(results).collect());
        report(settings, &plan, place(), &evaluations, methods)
    })
}

/// The jobs that a run needs; figure 3 needs none.
fn jobs(plan: &Plan, methods: &[Method], figure: Option<u8>) -> Result<Vec<Job>, Failure> {
    let list = Evaluations::listing();
    if figure != Some(3) {
        Experiments::run(plan, &list, methods, figure)?;
    }
    if figure.is_none() {
        sweeps::run(plan, &list, methods)?;
    }
    Ok(list.jobs())
}

fn report(
    settings: &Settings,
    plan: &Plan,
    place: &ArtifactCache<'_>,
    evaluations: &Evaluations,
    mut methods: Vec<Method>,
) -> Result<Made, Failure> {
    let case = place.case()?;
    if settings.figure == Some(3) {
        let figure = figures::mesh(place, &case)?;
        return Ok(Made::Figure(vec![place.path(&figure.file)]));
    }
    let wanted = |figure: u8| settings.figure.is_none_or(|only| only == figure);
    let experiments = Experiments::run(plan, evaluations, &methods, settings.figure)?;
    let mut drawn = Vec::new();
    if wanted(3) {
        drawn.push(figures::mesh(place, &case)?);
    }
    drawn.extend(figures::tests(place, &case, &experiments, &wanted)?);
    if settings.figure.is_some() {
        let files = drawn.iter().map(|figure| place.path(&figure.file));
        return Ok(Made::Figure(files.collect()));
    }
    plan.load(place, &mut methods)?;
    let sweeps = sweeps::run(plan, evaluations, &methods)?;
    drawn.extend(figures::sweeps(place, &sweeps)?);
    let claims = claims::judge(plan, &methods, &experiments)?;
    place.write("results.json", &experiments.table())?;
    place.write(
        "sweeps.json",
        &serde_json::Value::Array(sweeps.iter().map(sweeps::Sweep::described).collect()),
    )?;
    place.write(
        "claims.json",
        &serde_json::Value::Array(claims.iter().map(claims::Claim::described).collect()),
    )?;
    let page = page::page(plan, &methods, &experiments, &claims, &drawn);
    let path = place.path("index.html");
    write(&path, Existing::Replace, page)?;
    Ok(Made::Page { path, claims })
}
