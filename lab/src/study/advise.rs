//! `tactus-lab advise`: recommends settings from the table of `tradeoff`, starting from an existing configuration.

use std::path::{Path, PathBuf};

use config::{Config, RigKind, WiringKind};
use imaging::PresetName;
use studies::Failure;
use studies::tradeoff as diagrams;
use studies::tradeoff::Point;

use crate::args::AdviseOptions;
use crate::daemon_config;
use crate::output::print_line;

/// The modules in the table: wiring, its name in the configuration, and module.
const MODULES: [(WiringKind, &str, &str); 5] = [
    (WiringKind::Pairs34924a, "pairs-34924a", "34924A"),
    (WiringKind::Pairs34922a, "pairs-34922a", "34922A"),
    (WiringKind::Fast34925a, "fast-34925a", "34925A"),
    (WiringKind::Matrix34932a, "matrix-34932a", "34932A"),
    (WiringKind::Matrix34934a, "matrix-34934a", "34934A"),
];

/// Default number of electrodes, if the configuration does not state it.
const ELECTRODES: usize = 26;

/// Prints the setting, its cost and the configuration lines for it.
pub(crate) fn advise(options: &AdviseOptions) -> Result<(), Failure> {
    let found = read(options)?;
    let config = found.as_ref().map(|(_, config)| config);
    let request = request(options, config)?;
    let point = diagrams::advise(&request)?;
    let lines = lines(&point, config);
    if options.json {
        let mut line = serde_json::to_value(&point).expect("plain data");
        line["config"] = lines.into();
        print_line!("{}", survey::printable_json(line.to_string()));
        return Ok(());
    }
    if let Some((path, _)) = &found {
        print_line!(
            "From {}: {} electrodes, module {}, at most {} mA; --electrodes, --module and --current-ma change that.",
            path.display(),
            request.electrodes.unwrap_or_default(),
            request.module.as_deref().unwrap_or("any"),
            request.current_ma.or(request.most_ma).unwrap_or_default(),
        );
    }
    show(&point, &lines);
    Ok(())
}

/// Reads the configuration that the options name, otherwise that of this folder, otherwise the service's; `None` if
/// there is none.
fn read(options: &AdviseOptions) -> Result<Option<(PathBuf, Config)>, Failure> {
    let usual = ["config.toml", "/etc/tactus/config.toml"].map(Path::new);
    let Some(path) = options
        .config
        .as_deref()
        .or(usual.into_iter().find(|path| path.is_file()))
    else {
        return Ok(None);
    };
    Ok(Some((path.to_owned(), daemon_config::read(path)?)))
}

/// The request: values from the options, otherwise from the configuration.
fn request(options: &AdviseOptions, config: Option<&Config>) -> Result<diagrams::Request, Failure> {
    let module = match (&options.module, config) {
        (Some(module), _) => Some(module.clone()),
        (None, None) => None,
        (None, Some(config)) => {
            let kind = config.wiring.kind;
            let of_table = MODULES.iter().find(|(known, ..)| *known == kind);
            let (.., module) = of_table.ok_or_else(|| {
                Failure::usage(
                    "the table has no rows for the wiring of this configuration (a GPIO board or a wiring file); name a module with --module, e.g. --module 34924A",
                )
            })?;
            Some((*module).to_owned())
        }
    };
    Ok(diagrams::Request {
        error_mm: options.error_mm,
        max_seconds: options.max_seconds,
        electrodes: options
            .electrodes
            .or(config.map(|config| electrodes(config) as u64)),
        module,
        current_ma: options.current_ma,
        most_ma: config
            .filter(|_| options.current_ma.is_none())
            .map(|config| 1e-3 * config.survey.current_ua),
        table: options.table.clone(),
    })
}

fn electrodes(config: &Config) -> usize {
    config
        .survey
        .electrodes
        .or(config.wiring.electrodes)
        .unwrap_or(ELECTRODES)
}

/// The lines of `config.toml` for this setting.
fn lines(point: &Point, config: Option<&Config>) -> String {
    let also = |name: &str| point.also.get(name).copied().unwrap_or(f64::NAN);
    let count = also("electrodes");
    let mut text = format!(
        "[survey]\nelectrodes = {count}\ncurrent_ua = {:.1}\nnplc = {}\naverages = {}\nhalf = {}\nskip = {}\nranges = \"planned\"\n",
        1e3 * also("current, mA"),
        also("NPLC"),
        also("averages"),
        also("half") > 0.5,
        also("skip"),
    );
    let other_count = config.is_some_and(|config| electrodes(config) as f64 != count);
    let mut wiring = String::new();
    let wired = MODULES
        .iter()
        .find(|(.., module)| point.line.contains(module))
        .filter(|(kind, ..)| config.is_none_or(|config| config.wiring.kind != *kind));
    if let Some((_, name, _)) = wired {
        wiring += &format!("kind = \"{name}\"\n");
    }
    if other_count && config.is_some_and(|config| config.wiring.electrodes.is_some()) {
        wiring += &format!("electrodes = {count}\n");
    }
    if !wiring.is_empty() {
        text += &format!("[wiring]\n{wiring}");
    }
    if let Some((_, name, _)) = wired
        && config.is_some_and(|config| config.rig.kind == RigKind::Simulated)
    {
        text += &format!("[rig]\nprofile = \"{name}\"\n");
    }
    if let Some(config) = config.filter(|_| other_count) {
        text += &geometry(config, count);
    }
    text
}

/// The lines of the geometry for another number of electrodes; a TOML comment if no preset with this number is known.
fn geometry(config: &Config, count: f64) -> String {
    let ring = diagrams::ring(count as usize);
    match (&config.geometry.case, config.geometry.preset, ring) {
        (None, Some(PresetName::DiscTank), _) => {
            format!("[geometry.disc-tank]\nelectrodes = {count}\n")
        }
        (None, None | Some(PresetName::PaperSheet), Some([width, height])) => format!(
            "[geometry.paper-sheet]\nelectrodes_per_width = {width}\nelectrodes_per_height = {height}\n"
        ),
        _ => format!("# [geometry] must name a sheet with {count} electrodes\n"),
    }
}

fn show(point: &Point, lines: &str) {
    let result = |name: &str, decimals: usize, unit: &str| match point.also.get(name) {
        Some(value) => format!("{value:.decimals$} {unit}"),
        None => "not known".to_owned(),
    };
    print_line!(
        "{}, {}\n  a frame          {:.2} s ({:.0} an hour)\n  location error   {:.2} mm +- {:.2} (a 10 mm press that takes \
         half the conductance; bound {})\n  noise            {}\nIn config.toml, in place of the same \
         keys:\n\n{lines}\nThis is simulated: noise of the voltmeter's table, no drift.",
        point.line,
        point.setting,
        point.time,
        3600.0 / point.time,
        point.error,
        point.spread,
        result("bound, mm", 3, "mm"),
        result("noise, uV rms", 2, "uV rms a reading"),
    );
}
