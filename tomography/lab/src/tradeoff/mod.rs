//! `tactus-lab tradeoff`: what accuracy costs in time, as eight diagrams and one page.
//!
//! Every diagram is a table of points (`NAME.json`) with the settings and the seed that made it, drawn as PNG and SVG. A
//! table that lies there and was made by the same settings is not made again: who is stopped goes on. Times are of this
//! machine; errors are the same for the same seed.

mod acquisition;
mod advise;
mod forward;
mod iterative;
mod months;
mod page;
mod panel;
mod precision;
mod reconstruction;
mod solver;
mod system;
mod training;
mod uncertainty;

use std::path::PathBuf;
use std::time::Instant;

use outfile::Existing;

use crate::args::{PanelName, TradeoffOptions};
use crate::artifact_cache::ArtifactCache;
use crate::failure::{Failure, write};
pub(crate) use advise::advise;
use panel::Panel;

/// How much is done.
pub(super) struct Effort {
    pub(super) full: bool,
    pub(super) seed: u64,
}

impl Effort {
    /// One of two sizes.
    pub(super) fn of<T>(&self, quick: T, full: T) -> T {
        if self.full { full } else { quick }
    }

    /// Times that something is run for its median.
    pub(super) fn runs(&self) -> usize {
        20
    }

    /// Draws of noise or meshes behind an error's bar.
    pub(super) fn seeds(&self) -> u64 {
        5
    }

    fn name(&self) -> &'static str {
        self.of("quick", "full")
    }

    /// What was chosen, beside every table.
    pub(super) fn described(&self) -> serde_json::Value {
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

/// Makes what is missing, draws, writes the page.
pub(crate) fn tradeoff(options: &TradeoffOptions) -> Result<(), Failure> {
    let effort = Effort {
        full: options.full,
        seed: options.seed,
    };
    let folder = match &options.out {
        Some(folder) => folder.to_path_buf(),
        None => PathBuf::from(format!("tradeoff-{}", effort.name())),
    };
    let place = ArtifactCache::new(folder, "tradeoff", options.replacing.existing())?;
    let wanted = |name: &PanelName| options.only.is_empty() || options.only.contains(name);
    let mut panels = Vec::new();
    for name in PanelName::ALL.into_iter().filter(wanted) {
        let panel = made(name, &effort, &place)?;
        panel.draw(&place)?;
        for line in panel.lines(options.json) {
            println!("{line}");
        }
        panels.push(panel);
    }
    if options.only.is_empty() {
        let path = place.path("index.html");
        write(&path, Existing::Replace, page::page(&effort, &panels))?;
        if !options.json {
            println!("{}", path.display());
        }
    }
    Ok(())
}

/// The panel from its table where the same settings made it, else new.
fn made(name: PanelName, effort: &Effort, place: &ArtifactCache) -> Result<Panel, Failure> {
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
        PanelName::Uncertainty => uncertainty::panel(),
        PanelName::Months => months::panel(effort)?,
    };
    eprintln!("{}: {:.0} s", name.name(), start.elapsed().as_secs_f64());
    place.write(&file, &panel.described(effort))?;
    Ok(panel)
}
