//! Accuracy against computing or measuring time, as eight diagrams and one page (`tactus-lab tradeoff`).
//!
//! Every diagram is a table of points (`NAME.json`) with its settings and seed, drawn as PNG and SVG. A table with the
//! same settings is reused, so an interrupted run computes only what is missing. Times depend on the machine; errors
//! depend on the seed only.

mod advise;
mod measuring;
mod methods;
mod modelling;
mod page;
mod panel;
mod trained;

use std::path::PathBuf;
use std::time::Instant;

use clap::ValueEnum;
use outfile::Existing;
use shards::{Division, Outcome, StopRequest, Study};

use crate::artifact_cache::{ArtifactCache, Program};
use crate::failure::{Failure, write};
pub use advise::{Request, advise};
pub use measuring::acquisition::ring;
use measuring::{acquisition, months};
use methods::{precision, reconstruction, training, uncertainty};
use modelling::{forward, solver};
pub use panel::{Panel, Point};

/// One diagram of error against time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PanelName {
    /// Voltages of a sheet against the size of the mesh
    Forward,
    /// Ways to solve the same system
    Solver,
    /// Methods that make maps
    Reconstruction,
    /// Measuring settings: location error against the time of a frame
    Acquisition,
    /// Width and number format of a deep network
    Precision,
    /// Cases and epochs of a training
    Training,
    /// Stated probability of regions against the share that contains the truth
    Uncertainty,
    /// Errors over months without tracking, by projection, by evidence, and tracked
    Months,
}

impl PanelName {
    /// Name on the command line and of its files.
    pub fn name(self) -> String {
        self.to_possible_value()
            .map_or_else(String::new, |value| value.get_name().to_owned())
    }
}

/// Options of the study.
#[derive(Debug)]
pub struct Settings {
    /// Whether to use the sizes of the results stored in `docs`, instead of small ones.
    pub full: bool,
    /// Only these diagrams; all if empty.
    pub only: Vec<PanelName>,
    /// Seed of the study; equal seeds give equal numbers, except times.
    pub seed: u64,
    /// Folder of the page, its figures and tables; default `tradeoff-quick` or `tradeoff-full`.
    pub folder: Option<PathBuf>,
    /// Whether a folder made by another command may be replaced.
    pub existing: Existing,
}

/// Extent of a run.
pub(crate) struct Effort {
    pub(crate) full: bool,
    pub(crate) seed: u64,
}

impl Effort {
    /// Number of repetitions for the median of a time.
    pub(crate) const RUNS: usize = 20;
    /// Number of draws of noise or meshes for an error bar.
    pub(crate) const SEEDS: u64 = 5;

    /// The value for this run.
    pub(crate) fn of<T>(&self, quick: T, full: T) -> T {
        if self.full { full } else { quick }
    }

    fn name(&self) -> &'static str {
        self.of("quick", "full")
    }

    /// The settings, stored with every table.
    pub(crate) fn described(&self) -> serde_json::Value {
        serde_json::json!({
            "run": self.name(),
            "seed": self.seed,
            "version": env!("CARGO_PKG_VERSION"),
            "build": if cfg!(debug_assertions) { "development" } else { "release" },
            "threads": rayon::current_num_threads(),
            "machine": format!("{} {}", std::env::consts::ARCH, std::env::consts::OS),
        })
    }
}

/// Computes missing diagrams, draws them and writes the page; returns the path of the page if it contains all diagrams.
/// Calls `done` with each diagram. Each diagram is an item of work in shards; its models and test sets are created
/// once, in the folder that all shards use.
///
/// # Errors
/// A folder that belongs to another command, a damaged table, shards that cannot be used, or a study that fails.
pub fn run(
    settings: &Settings,
    program: &dyn Program,
    division: &Division,
    stop: &StopRequest,
    done: &mut dyn FnMut(&Panel),
) -> Result<Outcome<Option<PathBuf>>, Failure> {
    let effort = Effort {
        full: settings.full,
        seed: settings.seed,
    };
    let folder = match &settings.folder {
        Some(folder) => folder.clone(),
        None => PathBuf::from(format!("tradeoff-{}", effort.name())),
    };
    let wanted = |name: &PanelName| settings.only.is_empty() || settings.only.contains(name);
    let names: Vec<PanelName> = PanelName::value_variants()
        .iter()
        .copied()
        .filter(wanted)
        .collect();
    let mut described = effort.described();
    if let Some(fields) = described.as_object_mut() {
        // the number of threads changes times, but not errors
        fields.remove("threads");
    }
    let study = Study {
        name: "tradeoff",
        settings: described,
        items: names.iter().map(|name| name.name()).collect(),
    };
    let place = match division {
        Division::Missing(..) => None,
        _ => Some(ArtifactCache::new(
            folder,
            "tradeoff",
            settings.existing,
            program,
        )?),
    };
    let place = place.as_ref();
    let whole = *division == Division::Whole;
    let outcome = study.perform(division, stop, &mut |item| {
        let place = place.expect("a list of missing shards computes nothing");
        let panel = made(names[item], &effort, place)?;
        if whole {
            panel.draw(place)?;
            done(&panel);
        }
        Ok::<_, Failure>((panel, effort.described()))
    })?;
    outcome.then(|panels: Vec<(Panel, serde_json::Value)>| {
        let place = place.expect("a list of missing shards has no results");
        if !whole {
            for (name, (panel, made_with)) in names.iter().zip(&panels) {
                let mut table = panel.described(&effort);
                table["settings"] = made_with.clone();
                place.write(&format!("{}.json", name.name()), &table)?;
                panel.draw(place)?;
                done(panel);
            }
        }
        if !settings.only.is_empty() {
            return Ok(None);
        }
        let path = place.path("index.html");
        let panels: Vec<Panel> = panels.into_iter().map(|(panel, _)| panel).collect();
        write(&path, Existing::Replace, page::page(&effort, &panels))?;
        Ok(Some(path))
    })
}

/// Reads the diagram from its table if that has the same settings, otherwise computes it.
fn made(name: PanelName, effort: &Effort, place: &ArtifactCache<'_>) -> Result<Panel, Failure> {
    let file = format!("{}.json", name.name());
    if let Some(panel) = Panel::read(&place.path(&file), effort)? {
        return Ok(panel);
    }
    let start = Instant::now();
    let panel = match name {
        PanelName::Forward => forward::panel(effort)?,
        PanelName::Solver => solver::panel(effort)?,
        PanelName::Reconstruction => reconstruction::panel(effort, place)?,
        PanelName::Acquisition => acquisition::panel(effort)?,
        PanelName::Precision => precision::panel(effort, place)?,
        PanelName::Training => training::panel(effort, place)?,
        PanelName::Uncertainty => uncertainty::panel(effort)?,
        PanelName::Months => months::panel(effort)?,
    }
    .with_front();
    eprintln!("{}: {:.0} s", name.name(), start.elapsed().as_secs_f64());
    place.write(&file, &panel.described(effort))?;
    Ok(panel)
}
