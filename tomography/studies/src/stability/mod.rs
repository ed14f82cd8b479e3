//! The hard cases of the fact sheet (`tactus-lab stability`): the error of a naive implementation if there is one, the
//! error of this project's implementation ("ours"), and a bound.
//!
//! A case is a function that returns its results. The case numbers are those of the fact sheet
//! `physics-and-hard-cases.md`, section 4. A naive implementation violates the bound; if there is none, the case states
//! why.

mod cases;
mod outcome;
mod plots;
mod solvers;

use std::path::Path;

use outfile::Existing;
use shards::{Division, StopRequest, Study};

use crate::build;
use crate::failure::{Failure, write_tables};
use crate::progress;
use cases::{
    contacts, contrast, creep, inverse, layers, loads, meshes, order, radial, readings, tracked,
};
use outcome::{Case, Check, Naive, Outcome, Side};
pub(crate) use solvers::bordered::Number;

/// All cases, in the order of the fact sheet.
const CASES: &[Case] = &[
    case(1, "conductivity exactly 0", contrast::no_conductance),
    case(2, "insulating contrast", contrast::insulator),
    case(3, "conductive contrast", contrast::metal),
    case(4, "f32 solve", contrast::single_precision),
    case(5, "contact z -> 0", contacts::vanishing_contact),
    case(6, "contact z -> infinity", contacts::open_contact),
    case(7, "floating potential", contacts::floating),
    case(8, "units", contacts::units),
    case(9, "slivers, tiny angles", meshes::sliver),
    case(10, "narrow electrode", contacts::narrow_electrode),
    case(11, "electrode-edge singularity", contacts::singular_ends),
    case(12, "absolute and difference mesh error", meshes::mesh_error),
    case(13, "sensitivity", meshes::sensitivity),
    case(14, "rank-deficient sensitivity", inverse::without_rank),
    case(15, "lambda -> 0, infinity", inverse::ends_of_lambda),
    case(16, "total variation, beta -> 0", inverse::total_variation),
    case(17, "TV on unequal triangles", inverse::unequal_triangles),
    case(18, "step too long", inverse::long_step),
    case(19, "RBF flat limit", radial::flat_limit),
    case(20, "duplicate centres, empty clusters", radial::duplicates),
    case(21, "spread ruled by heavy tails", radial::heavy_tails),
    case(22, "pairwise distances", radial::many_pairs),
    case(23, "near duplicates", radial::near_duplicates),
    case(24, "exp underflow", radial::far_input),
    case(25, "constant channel", layers::constant_channel),
    case(26, "relative scales 2100 : 1", layers::scales),
    case(27, "dead and saturated neurons", layers::saturation),
    case(28, "training divergence", layers::divergence),
    case(29, "f32, f16, int8 inference", layers::precision),
    case(30, "NaN, infinity, 9.9e37", readings::no_reading),
    case(31, "electrode open", tracked::open_electrode),
    case(32, "tiny v0", readings::tiny_baseline),
    case(33, "sign of v0", readings::reversed_leads),
    case(34, "one bad channel", readings::one_spike),
    case(35, "summation order, threads", order::threads),
    case(36, "hotspot segmentation", loads::hot_spots),
    case(37, "dose over months", loads::dose),
    case(38, "degenerate polygons", order::polygons),
    case(39, "baseline equals load", tracked::loaded_baseline),
    case(40, "viscoelastic step", creep::any_step),
];

const fn case(number: u8, name: &'static str, run: fn() -> Result<Outcome, Failure>) -> Case {
    Case { number, name, run }
}

/// Results of the cases.
#[derive(Debug)]
pub struct Table(Vec<(&'static Case, Outcome)>);

/// Runs the cases with these numbers, 1 to 40, or all cases if the list is empty. Each case is an item of work in
/// shards.
///
/// # Errors
/// A case that cannot be computed, or shards that cannot be used. A violated bound is not an error, see
/// [`Table::broken`].
pub fn run(
    only: &[u8],
    division: &Division,
    stop: &StopRequest,
) -> Result<shards::Outcome<Table>, Failure> {
    let wanted: Vec<&Case> = CASES
        .iter()
        .filter(|case| only.is_empty() || only.contains(&case.number))
        .collect();
    let study = Study {
        name: "stability",
        settings: build(),
        items: wanted
            .iter()
            .map(|case| format!("{} {}", case.number, case.name))
            .collect(),
    };
    let bar = progress::bar(wanted.len(), "hard cases");
    let outcome = study.perform(division, stop, &mut |item| {
        let outcome = (wanted[item].run)();
        bar.inc(1);
        outcome
    })?;
    bar.finish_and_clear();
    outcome.then(|outcomes: Vec<Outcome>| Ok(Table(wanted.iter().copied().zip(outcomes).collect())))
}

impl Table {
    /// Writes the table (`table.txt`, `table.json`) and the plots of contrast, contact impedance and sliver angle.
    ///
    /// # Errors
    /// Files that exist and may not be replaced, or that cannot be written.
    pub fn write(&self, folder: &Path, existing: Existing) -> Result<(), Failure> {
        write_tables(folder, "table", existing, self.text(), self.lines())?;
        plots::draw(folder, existing)
    }

    /// Numbers of the cases with a violated bound, or a naive implementation that does not behave as stated.
    pub fn broken(&self) -> Vec<u8> {
        self.0
            .iter()
            .filter(|(_, outcome)| !sound(outcome))
            .map(|(case, _)| case.number)
            .collect()
    }

    /// The table as text.
    pub fn text(&self) -> String {
        let mut text = String::from(
            "case  name                               what is measured                                               naive      ours       bound  verdict\n",
        );
        let mut notes = String::new();
        for (case, outcome) in &self.0 {
            for (row, check) in outcome.checks.iter().enumerate() {
                let (number, name) = match row {
                    0 => (case.number.to_string(), case.name),
                    _ => (String::new(), ""),
                };
                let naive = match &check.naive {
                    Naive::Error(error) => figure(*error),
                    Naive::Fails(..) => "fails".to_owned(),
                    Naive::Absent(_) => "-".to_owned(),
                };
                let side = match check.side {
                    Side::AtMost => "<=",
                    Side::AtLeast => ">=",
                };
                text += &format!(
                    "{number:>4}  {name:<34} {:<58} {naive:>9} {:>9} {:>11}  {}\n",
                    check.what,
                    figure(check.ours),
                    format!("{side} {}", figure(check.bound)),
                    verdict(check)
                );
            }
            for check in &outcome.checks {
                match &check.naive {
                    Naive::Fails(_, instead) => {
                        notes += &format!("{:>4}  naive: {instead}\n", case.number);
                    }
                    Naive::Absent(why) => {
                        let note = format!("{:>4}  no naive form: {why}\n", case.number);
                        if !notes.contains(&note) {
                            notes += &note;
                        }
                    }
                    Naive::Error(_) => {}
                }
            }
            if !outcome.note.is_empty() {
                notes += &format!("{:>4}  {}\n", case.number, outcome.note);
            }
        }
        if !notes.is_empty() {
            text += &format!("\n{notes}");
        }
        text
    }

    /// The table as JSON, one object per check.
    pub fn lines(&self) -> Vec<serde_json::Value> {
        let mut lines = Vec::new();
        for (case, outcome) in &self.0 {
            for check in &outcome.checks {
                let (naive, breaks) = match &check.naive {
                    Naive::Error(error) => (serde_json::json!(error), Some(true)),
                    Naive::Fails(_, instead) => (serde_json::json!(instead), Some(true)),
                    Naive::Absent(why) => (serde_json::json!(why), None),
                };
                lines.push(serde_json::json!({
                    "case": case.number,
                    "name": case.name,
                    "measured": check.what,
                    "naive": naive,
                    "naive_breaks": breaks,
                    "ours": check.ours,
                    "side": match check.side { Side::AtMost => "at most", Side::AtLeast => "at least" },
                    "bound": check.bound,
                    "verdict": verdict(check),
                    "note": outcome.note,
                }));
            }
        }
        lines
    }
}

fn sound(outcome: &Outcome) -> bool {
    let checks = &outcome.checks;
    checks
        .iter()
        .all(|check| check.holds() && check.naive_is_as_expected())
}

fn verdict(check: &Check) -> &'static str {
    match (check.holds(), check.naive_is_as_expected()) {
        (true, true) => "holds",
        (false, _) => "BROKEN",
        (true, false) => "NAIVE HOLDS",
    }
}

fn figure(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 || (0.01..1e4).contains(&size) {
        let text = format!("{value:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        format!("{value:.1e}")
    }
}
