//! Commands of the studies: convert options to settings of `studies`, and print results.

mod advise;
mod chosen;
mod division;
mod evaluate;

use clap::ValueEnum;
use studies::honesty::{MapMethod, TargetKind};
use studies::months::{Family, LongScene, MapSettings};
use studies::paper::Made;
use studies::{
    Failure, honesty as honest_maps, months as long_maps, paper as paper_study,
    stability as hard_cases, tradeoff as diagrams,
};

use crate::args::{HonestyOptions, MonthsOptions, PaperOptions, StabilityOptions, TradeoffOptions};
use crate::output::{print_line, print_text};
use crate::program::TactusLab;
pub(crate) use advise::advise;
use division::{divided, report_of};
pub(crate) use evaluate::{evaluate, judge};

/// `tactus-lab paper`.
pub(crate) fn paper(options: &PaperOptions) -> Result<(), Failure> {
    if let Some(file) = &options.resident {
        if let Some(bytes) = paper_study::resident_growth(file)? {
            print_line!("{bytes}");
        }
        return Ok(());
    }
    let settings = paper_study::Settings {
        full: options.full,
        figure: options.figure,
        seed: options.seed,
        folder: options.out.as_ref().map(|folder| folder.to_path_buf()),
        existing: options.replacing.existing(),
    };
    let (division, stop) = divided(&options.shards)?;
    let outcome = paper_study::run(&settings, &TactusLab, &division, &stop)?;
    let Some(made) = report_of(outcome) else {
        return Ok(());
    };
    match made {
        Made::Figure(files) => files
            .iter()
            .for_each(|file| print_line!("{}", file.display())),
        Made::Page { path, claims } => {
            for claim in &claims {
                if options.json {
                    print_line!("{}", claim.described());
                } else {
                    print_line!("{}", claim.line());
                }
            }
            if !options.json {
                print_line!("{}", path.display());
            }
        }
    }
    Ok(())
}

/// `tactus-lab tradeoff`.
pub(crate) fn tradeoff(options: &TradeoffOptions) -> Result<(), Failure> {
    let settings = diagrams::Settings {
        full: options.full,
        only: options.only.clone(),
        seed: options.seed,
        folder: options.out.as_ref().map(|folder| folder.to_path_buf()),
        existing: options.replacing.existing(),
    };
    let (division, stop) = divided(&options.shards)?;
    let outcome = diagrams::run(&settings, &TactusLab, &division, &stop, &mut |panel| {
        for line in panel.lines(options.json) {
            print_line!("{line}");
        }
    })?;
    if let (Some(Some(path)), false) = (report_of(outcome), options.json) {
        print_line!("{}", path.display());
    }
    Ok(())
}

/// `tactus-lab stability`: a violated bound is an error.
pub(crate) fn stability(options: &StabilityOptions) -> Result<(), Failure> {
    let (division, stop) = divided(&options.shards)?;
    let Some(table) = report_of(hard_cases::run(&options.only, &division, &stop)?) else {
        return Ok(());
    };
    print_tables(options.json, || table.lines(), || table.text());
    if let Some(folder) = &options.out {
        table.write(folder, options.replacing.existing())?;
    }
    let broken: Vec<String> = table.broken().iter().map(u8::to_string).collect();
    if broken.is_empty() {
        Ok(())
    } else {
        Err(Failure::because(format!(
            "the bound of case {} does not hold",
            broken.join(", ")
        )))
    }
}

/// `tactus-lab honesty`.
pub(crate) fn honesty(options: &HonestyOptions) -> Result<(), Failure> {
    let noises_uv = chosen_or(&options.noise_uv, &[2.0, 20.0]);
    let report = honest_maps::run(&honest_maps::Settings {
        seed: options.seed,
        healthy: options.count,
        faulty: options.faults,
        noises_uv,
        maps: options.maps.map(|count| honest_maps::MapSettings {
            count,
            kinds: chosen_or(&options.load, TargetKind::value_variants()),
            methods: chosen_or(&options.method, MapMethod::value_variants()),
            unstated: options.unstated,
        }),
    })?;
    print_tables(options.json, || report.lines(), || report.text());
    match &options.out {
        Some(folder) => report.write(folder, options.replacing.existing()),
        None => Ok(()),
    }
}

/// `tactus-lab months`.
pub(crate) fn months(options: &MonthsOptions) -> Result<(), Failure> {
    let quick = options.quick;
    let sheets = amount("--sheets", options.sheets, 5, quick.then_some(1))?;
    let presses = amount("--presses", options.presses, 4, quick.then_some(1))?;
    let days = amount("--days", options.days, 90.0, quick.then_some(2.0))?;
    check_months(options, sheets, presses, days)?;
    let methods = [MapMethod::OneStep, MapMethod::Tv, MapMethod::Best];
    let report = long_maps::run(&long_maps::Settings {
        seed: options.seed,
        families: chosen_or(&options.drift, Family::value_variants()),
        sheets,
        presses,
        scenes: chosen_or(&options.scene, LongScene::value_variants()),
        days,
        maps: MapSettings {
            loads: options.maps,
            methods: chosen_or(&options.method, &methods),
            models: options.model.clone(),
        },
        load_days: options.load_days,
    })?;
    print_tables(options.json, || report.lines(), || report.text());
    match &options.out {
        Some(folder) => report.write(folder, options.replacing.existing()),
        None => Ok(()),
    }
}

/// Refuses options for a part of the study that is left out.
fn check_months(
    options: &MonthsOptions,
    sheets: usize,
    presses: usize,
    days: f64,
) -> Result<(), Failure> {
    let (no_sheet, no_load) = (sheets == 0, presses == 0 && options.maps == 0);
    let stated = |count: Option<usize>| count.is_some_and(|count| count > 0);
    let left_out = [
        (
            "--presses",
            no_sheet && stated(options.presses),
            "--sheets is 0",
        ),
        ("--maps", no_sheet && options.maps > 0, "--sheets is 0"),
        (
            "--drift",
            no_sheet && !options.drift.is_empty(),
            "--sheets is 0",
        ),
        (
            "--sheets",
            no_load && stated(options.sheets),
            "--presses and --maps are 0",
        ),
        (
            "--drift",
            no_load && !options.drift.is_empty(),
            "--presses and --maps are 0",
        ),
        (
            "--scene",
            days == 0.0 && !options.scene.is_empty(),
            "--days is 0",
        ),
    ];
    match left_out.into_iter().find(|(_, left_out, _)| *left_out) {
        None => Ok(()),
        Some((option, _, why)) => Err(Failure::usage(format!("{option} has no effect: {why}"))),
    }
}

/// The stated amount, otherwise the usual one; in a quick run at most `quick`, which then is also the default.
fn amount<T: Copy + PartialOrd + std::fmt::Display>(
    option: &str,
    stated: Option<T>,
    usual: T,
    quick: Option<T>,
) -> Result<T, Failure> {
    match (stated, quick) {
        (Some(stated), Some(most)) if stated > most => Err(Failure::usage(format!(
            "{option} {stated}: --quick has {most} at most; leave one of them out"
        ))),
        _ => Ok(stated.or(quick).unwrap_or(usual)),
    }
}

/// The chosen values, or the default if none were chosen.
fn chosen_or<T: Clone>(chosen: &[T], default: &[T]) -> Vec<T> {
    match chosen.is_empty() {
        true => default.to_vec(),
        false => chosen.to_vec(),
    }
}

/// Prints the tables of a study; with `json` an object for each row.
fn print_tables(
    json: bool,
    lines: impl FnOnce() -> Vec<serde_json::Value>,
    text: impl FnOnce() -> String,
) {
    if json {
        for line in lines() {
            print_line!("{line}");
        }
    } else {
        print_text!("{}", text());
    }
}
