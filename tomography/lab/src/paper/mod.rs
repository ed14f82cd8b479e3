//! `tactus-lab paper`: every experiment, figure and claim of the paper, run again from seeds, as one page to read.
//!
//! A folder grows: `models`, `sets`, figures (PNG and SVG), `results.json`, `claims.json`, `settings.json`, `index.html`. What
//! a command of `tactus-lab` makes is made by that command, and its words lie beside it in a file `.command`: who was
//! stopped goes on with what is missing, and what was made by other words is made again.

mod claims;
mod experiments;
mod figures;
mod page;
mod plan;
mod sweeps;

use std::path::PathBuf;

use outfile::Existing;

use crate::args::PaperOptions;
use crate::artifact_cache::ArtifactCache;
use crate::failure::{Failure, write};
use experiments::Experiments;
use plan::Plan;

/// Makes what is missing, draws, writes the page.
pub(crate) fn paper(options: &PaperOptions) -> Result<(), Failure> {
    if let Some(file) = &options.resident {
        return plan::print_resident(file);
    }
    let plan = Plan::new(options.full, options.seed);
    let folder = match &options.out {
        Some(folder) => folder.to_path_buf(),
        None => PathBuf::from(format!("paper-{}", plan.name)),
    };
    let place = ArtifactCache::new(folder, "paper", options.replacing.existing())?;
    place.write("settings.json", &plan.described())?;
    let case = place.case()?;
    if options.figure == Some(3) {
        return figures::mesh(&place, &case).map(drop);
    }
    let models = plan.models(&place)?;
    let wanted = |figure: u8| options.figure.is_none_or(|only| only == figure);
    let experiments = Experiments::run(&plan, &place, &models, options.figure)?;
    let mut drawn = Vec::new();
    if wanted(3) {
        drawn.push(figures::mesh(&place, &case)?);
    }
    drawn.extend(figures::tests(&place, &experiments, &wanted)?);
    if options.figure.is_some() {
        for figure in &drawn {
            println!("{}", place.path(&figure.file).display());
        }
        return Ok(());
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
    for claim in &claims {
        if options.json {
            println!("{}", claim.described());
        } else {
            println!("{}", claim.line());
        }
    }
    if !options.json {
        println!("{}", path.display());
    }
    Ok(())
}
