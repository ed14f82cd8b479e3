//! `tactus-lab scene run`: simulated frames of a scene in a case folder, in the format of `judge`.
//!
//! The readings come directly from the phantom, in virtual time. `tactus-sim` and the daemon's simulated rig simulate
//! the same scenes with instruments and their commands.

use eit::{Preset, frames_text, matrix_text};
use nalgebra::DMatrix;
use outfile::{Existing, OutFile};
use phantom::{Load, Phantom, Preview};
use survey::printable;

use super::record::Session;
use crate::args::RunOptions;
use crate::daemon_config;
use crate::geometry;
use crate::output::print_line;
use studies::evaluation::test_set;
use studies::{Failure, progress, write};

/// Simulates the frames and writes each when it is complete.
pub(crate) fn run(options: &RunOptions) -> Result<(), Failure> {
    let scene = super::open(&options.scene)?;
    let scan = super::scan(&scene, &options.session)?;
    let sheet = preset(&scene.sheet);
    let case = geometry::case(&sheet, scan.current)?;
    let name = scene.name.clone();
    let seed = scene.seed;
    let failed = |fault| Failure::of(&format!("scene {name}"), &fault);
    let noise = Preview::new(&scene, scan.clone()).map_err(failed)?.noise();
    let mut phantom = Phantom::new(scene).map_err(failed)?;
    if phantom.mesh().hash() == case.mesh.hash() {
        return Err(Failure::because(
            "the scene has the same mesh as the reconstruction, which would make the maps too good: give the scene's [mesh] another fineness or seeding",
        ));
    }
    let existing = options.replacing.existing();
    let config_toml = match &options.config {
        None => String::new(),
        Some(path) => toml::to_string(&daemon_config::read(path)?)
            .map_err(|cause| Failure::of("the configuration cannot be written as TOML", &cause))?,
    };
    let mut folder = match &options.out {
        None => None,
        Some(out) => {
            outfile::make_folder(out, Existing::Replace)
                .map_err(|fault| Failure::of("cannot write the case", &fault))?;
            let [frames, truth] =
                ["frames.csv", "truth.csv"].map(|name| OutFile::create(&out.join(name), existing));
            Some((frames?, truth?))
        }
    };
    let mut session = match &options.logbook {
        None => None,
        Some(shelf) => Some(Session::create(shelf, phantom.scene(), &scan, config_toml)?),
    };
    // the truth is computed when the loads change, and reused until then
    let mut known: Option<(Vec<Load>, String)> = None;
    let bar = progress::bar(scan.frames, "frames");
    for frame in 0..scan.frames {
        let begin = scan.begin(frame);
        let middle = begin + scan.frame_time() / 2;
        let loads: Vec<Load> = phantom.loads(middle).collect();
        if frame == 0 && !loads.is_empty() {
            bar.suspend(|| {
                eprintln!(
                    "tactus-lab: the baseline is loaded: {} is on the sheet in the first frame",
                    printable(&loads[0].name)
                );
            });
        }
        let readings = scan.frame(&mut phantom, begin).map_err(failed)?;
        if let Some(session) = &mut session {
            session.put(begin, &readings)?;
        }
        if let Some((frames, truth)) = &mut folder {
            let readings = readings.iter().map(|volts| Some(volts.0)).collect();
            let text = frames_text(&[readings]);
            let row = text.split_once('\n').map_or("", |(_, row)| row);
            let rows = if frame == 0 { &text } else { row };
            frames.put(rows.as_bytes())?;
            if frame > 0 {
                let row = match &known {
                    Some((same, row)) if *same == loads => row,
                    _ => {
                        let changes = test_set::true_map(&case.mesh, &loads)?;
                        let row = matrix_text(&DMatrix::from_row_slice(1, changes.len(), &changes));
                        &known.insert((loads, row)).1
                    }
                };
                truth.put(row.as_bytes())?;
            }
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let words = format!(
        "baseline and {} frames of {}; {}",
        scan.frames - 1,
        printable(&name),
        super::in_words(&scan)
    );
    if let (Some((frames, truth)), Some(out)) = (folder, &options.out) {
        // not before all frames are simulated: an interrupted run must not mix this case with earlier frames
        case.write(out, existing)
            .map_err(|fault| Failure::of("cannot write the case", &fault))?;
        // an existing presses file belongs to the replaced set and not to this scene
        outfile::remove(&out.join(test_set::PRESSES), existing)?;
        frames.finish()?;
        truth.finish()?;
        let description = serde_json::json!({
            "set": name,
            "noise_v": noise,
            "seed": seed,
            "frames": scan.frames - 1,
            "every_s": scan.begin(1).as_secs_f64(),
        });
        write(
            &out.join(test_set::DESCRIPTION),
            existing,
            format!("{description}\n"),
        )?;
        print_line!("{}: {words}", out.display());
    }
    if let Some(session) = session {
        print_line!("{}: {words}", session.end()?);
    }
    Ok(())
}

/// The preset of the sheet with the mesh for the reconstruction, which always differs from the phantom's mesh.
fn preset(sheet: &Preset) -> Preset {
    match sheet.clone() {
        Preset::PaperSheet(sheet) => Preset::PaperSheet(eit::PaperSheet {
            fineness: 1.0,
            seeding: 0,
            ..sheet
        }),
        Preset::DiscTank(tank) => Preset::DiscTank(eit::DiscTank {
            fineness: 1.0,
            seeding: 0,
            ..tank
        }),
    }
}
