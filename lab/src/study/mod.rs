//! Commands of the studies: convert options to settings of `studies`, print results.

mod evaluate;

use studies::paper::Made;
use studies::tradeoff::Point;
use studies::{Failure, paper as paper_study, stability as hard_cases, tradeoff as diagrams};

use crate::args::{AdviseOptions, PaperOptions, StabilityOptions, TradeoffOptions};
use crate::program::TactusLab;
pub(crate) use evaluate::{evaluate, judge};

/// `tactus-lab paper`.
pub(crate) fn paper(options: &PaperOptions) -> Result<(), Failure> {
    if let Some(file) = &options.resident {
        if let Some(bytes) = paper_study::resident_growth(file)? {
            println!("{bytes}");
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
    match paper_study::run(&settings, &TactusLab)? {
        Made::Figure(files) => files.iter().for_each(|file| println!("{}", file.display())),
        Made::Page { path, claims } => {
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
    let page = diagrams::run(&settings, &TactusLab, &mut |panel| {
        for line in panel.lines(options.json) {
            println!("{line}");
        }
    })?;
    if let (Some(path), false) = (page, options.json) {
        println!("{}", path.display());
    }
    Ok(())
}

/// `tactus-lab advise`.
pub(crate) fn advise(options: &AdviseOptions) -> Result<(), Failure> {
    let request = diagrams::Request {
        error_mm: options.error_mm,
        max_seconds: options.max_seconds,
        electrodes: options.electrodes,
        module: options.module.clone(),
        current_ma: options.current_ma,
        table: options.table.clone(),
    };
    show(&diagrams::advise(&request)?, options.json);
    Ok(())
}

fn show(point: &Point, json: bool) {
    if json {
        println!("{}", serde_json::to_value(point).expect("plain data"));
        return;
    }
    let also = |name: &str| point.also.get(name).copied().unwrap_or(f64::NAN);
    println!(
        "{}, {}\n  a frame          {:.2} s ({:.0} an hour)\n  location error   {:.2} mm +- {:.2} (a 10 mm press that takes \
         half the conductance; bound {:.3} mm)\n  noise            {:.2} uV rms a reading\nIn config.toml: [survey] electrodes = \
         {}, nplc = {}, averages = {}, half = {}, skip = {}, current_ua = {:.0}, ranges = \"planned\"\nThis is simulated: noise of the \
         voltmeter's table, no drift.",
        point.line,
        point.setting,
        point.time,
        3600.0 / point.time,
        point.error,
        point.spread,
        also("bound, mm"),
        also("noise, uV rms"),
        also("electrodes"),
        also("NPLC"),
        also("averages"),
        also("half") > 0.5,
        also("skip"),
        1e3 * also("current, mA"),
    );
}

/// `tactus-lab stability`: a violated bound is an error.
pub(crate) fn stability(options: &StabilityOptions) -> Result<(), Failure> {
    let table = hard_cases::run(&options.only)?;
    if options.json {
        for line in table.lines() {
            println!("{line}");
        }
    } else {
        print!("{}", table.text());
    }
    if let Some(folder) = &options.out {
        table.write(folder, options.replacing.existing())?;
    }
    let broken: Vec<String> = table.broken().iter().map(u8::to_string).collect();
    if broken.is_empty() {
        Ok(())
    } else {
        Err(Failure::because(format!(
            "the bound of case {} is broken",
            broken.join(", ")
        )))
    }
}
