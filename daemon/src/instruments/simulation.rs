//! The simulated rig as the daemon uses it: its profile, its scene, loads on its sheet. `without_simulator` replaces
//! this module if the program is built without feature `simulator`.

use rig::BoxStream;
use simulator::{Instrument, Load, Shape};
pub(crate) use simulator::{Profile, Scene, SimulatedRig};

/// Whether this program can simulate instruments; the error names the missing feature.
pub(crate) fn check_built() -> Result<(), String> {
    Ok(())
}

/// Connects to the simulated instrument of this name.
pub(crate) fn connect(rig: &SimulatedRig, name: &str) -> BoxStream {
    // a test of `kinds` checks that every model has a simulator of its name
    rig.connect(Instrument::named(name).expect("every supported model has a simulator"))
}

/// A shipped scene by name, or a scene file by path; by default an unloaded sheet without effects.
pub(crate) fn load_scene(name_or_path: Option<&str>) -> Result<Scene, String> {
    match name_or_path {
        Some(name_or_path) => Scene::open(name_or_path).map_err(|error| error.to_string()),
        None => Ok(Scene::quiet()),
    }
}

/// The seed of its scene.
pub(crate) fn seed(rig: &SimulatedRig) -> u64 {
    rig.with_phantom(|phantom| phantom.scene().seed)
}

/// Places a load, replacing the one placed before. Metres; the loss is a fraction of the conductance.
pub(crate) fn press(
    rig: &SimulatedRig,
    shape: &str,
    centre_m: [f64; 2],
    size_m: f64,
    loss: f64,
) -> Result<(), String> {
    let size_mm = size_m * 1e3;
    let outline = match shape {
        "disc" => Shape::Disc {
            diameter_mm: size_mm,
        },
        "rectangle" => Shape::Rectangle {
            width_mm: size_mm,
            height_mm: size_mm * 0.6,
        },
        "triangle" => Shape::Triangle { side_mm: size_mm },
        "figure-eight" => Shape::FigureEight {
            diameter_mm: size_mm * 50.0 / 95.0,
            distance_mm: size_mm * 45.0 / 95.0,
        },
        other => {
            return Err(format!(
                "there is no shape '{other}'; known are disc, rectangle, triangle, figure-eight"
            ));
        }
    };
    let load = Load {
        name: shape.to_owned(),
        shape: outline,
        centre_mm: centre_m.map(|metres| metres * 1e3),
        turn_deg: 0.0,
        loss,
    };
    rig.with_phantom(|phantom| {
        phantom.release();
        phantom
            .press(load)
            .map_err(|error| survey::error_chain(&error))
    })
}

/// Removes the load placed by `press`.
pub(crate) fn release(rig: &SimulatedRig) {
    rig.with_phantom(|phantom| phantom.release());
}
