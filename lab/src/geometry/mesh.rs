//! `tactus-lab mesh`: writes a case folder from a preset.

use std::sync::Arc;

use eit::{Case, Preset};
use imaging::{DepthArguments, Geometry, PresetName};
use studies::Failure;
use survey::Amps;

use super::eidors;
use crate::args::MeshOptions;
use crate::output::print_line;

/// Writes the folder and prints the quality of its mesh.
pub(crate) fn mesh(options: &MeshOptions) -> Result<(), Failure> {
    let preset = preset(options.preset, &options.set)?;
    if !(options.current_ma > 0.0 && options.current_ma.is_finite()) {
        return Err(Failure::usage(format!(
            "--current-ma is {}, it must be a positive number",
            options.current_ma
        )));
    }
    let case = case(&preset, Amps(options.current_ma * 1e-3))?;
    let case = with_depth(case, &options.depth)?;
    case.write(&options.out, options.replacing.existing())
        .map_err(|fault| Failure::of("cannot write the case", &fault))?;
    let mesh = &case.mesh;
    let quality = mesh.quality();
    if options.json {
        let line = serde_json::json!({
            "case": options.out.display().to_string(),
            "nodes": mesh.nodes().len(),
            "triangles": mesh.triangles().len(),
            "region_triangles": mesh.region().len(),
            "electrodes": mesh.electrodes(),
            "readings": case.protocol.len(),
            "smallest_angle_deg": quality.smallest_angle,
            "largest_angle_deg": quality.largest_angle,
            "fewest_electrode_edges": quality.fewest_electrode_edges,
            "electrode_edges": mesh.electrode_edges().iter().map(Vec::len).collect::<Vec<_>>(),
            "geometry": mesh.hash(),
        });
        print_line!("{}", survey::printable_json(line.to_string()));
    } else {
        print_line!(
            "{}: {} nodes, {} triangles ({} in the region), {} electrodes, {} readings, angles {:.1} to {:.1} degrees, {} or more edges an electrode",
            options.out.display(),
            mesh.nodes().len(),
            mesh.triangles().len(),
            mesh.region().len(),
            mesh.electrodes(),
            case.protocol.len(),
            quality.smallest_angle,
            quality.largest_angle,
            quality.fewest_electrode_edges
        );
    }
    warn_of_coarse_electrodes(&case);
    Ok(())
}

/// The case of a preset with the Sheffield protocol and the uniform conductance `homog`.
pub(crate) fn case(preset: &Preset, current: Amps) -> Result<Case, Failure> {
    Geometry::from_preset(preset)
        .map_err(|fault| Failure::because(survey::error_chain(&fault)))?
        .case(current)
        .map_err(|fault| Failure::of("a protocol for these electrodes cannot be made", &fault))
}

/// The case as the cross-section of a tank if the options give a depth, otherwise unchanged.
pub(crate) fn with_depth(mut case: Case, options: &DepthArguments) -> Result<Case, Failure> {
    if let Some(settings) = options.settings() {
        let depth = settings
            .depth()
            .map_err(|fault| Failure::usage(fault.to_string()))?;
        case.mesh = Arc::new(case.mesh.with_depth(Some(depth)));
    }
    Ok(case)
}

/// Reads a case folder or a MAT-file, with a warning on standard error if its electrodes are coarse.
pub(crate) fn read(path: &std::path::Path) -> Result<Case, Failure> {
    let case = match eidors::is_mat(path) {
        true => eidors::case(path)?,
        false => Case::read(path).map_err(|fault| Failure::of("cannot read the case", &fault))?,
    };
    warn_of_coarse_electrodes(&case);
    Ok(case)
}

fn warn_of_coarse_electrodes(case: &Case) {
    let coarse = case.coarse_electrodes();
    if !coarse.is_empty() {
        let names: Vec<String> = coarse.iter().map(ToString::to_string).collect();
        eprintln!(
            "tactus-lab: electrode{} {} of {} {} fewer than {} edges: the result is the resistance of the mesh rather \
             than that of the electrode",
            if names.len() == 1 { "" } else { "s" },
            names.join(", "),
            case.mesh.electrodes(),
            if names.len() == 1 { "has" } else { "have" },
            eit::ENOUGH_EDGES
        );
    }
}

/// The preset with its changed dimensions; an unknown key or a value of another type is an error.
pub(crate) fn preset(name: PresetName, set: &[String]) -> Result<Preset, Failure> {
    let kind = match name {
        PresetName::PaperSheet => "paper-sheet",
        PresetName::DiscTank => "disc-tank",
    };
    let mut text = format!("kind = \"{kind}\"\n");
    for change in set {
        if !change.contains('=') {
            return Err(Failure::usage(format!(
                "--set {change}: KEY=VALUE is expected, e.g. --set fineness=1.5"
            )));
        }
        text.push_str(change);
        text.push('\n');
    }
    toml::from_str(&text)
        .map_err(|fault| Failure::usage(format!("--set for preset {kind}: {}", fault.message())))
}
