//! What turns voltages into a map here, without a daemon: a trained model file, or the one-step method on a geometry.

use std::path::Path;
use std::sync::Arc;

use eit::inverse::learned::network::{is_onnx, load_onnx};
use eit::{
    DiscTank, Forward, Hyper, LossOnly, Mesh, OneStep, OneStepOptions, PaperSheet, Preset,
    Reconstructor, Tv, TvOptions,
};
use survey::{Amps, Map, Protocol, Reading};

use crate::failure::Failure;
use crate::maps::drawing::Field;
use crate::maps::recording::Home;
use crate::maps::settings::Recipe;
use crate::options::choices::{Geometry, Method, MethodChoice, PresetName, Prior};

/// A reconstructor with what a person should know about it.
pub(crate) struct Eye {
    reconstructor: Box<dyn Reconstructor>,
    /// What its maps cover.
    pub(crate) field: Field,
    /// What was assumed or derived on the way, a sentence each.
    pub(crate) remarks: Vec<String>,
}

/// A mesh with the contact impedance of each electrode, ohm m, and its unloaded conductance where that is known.
pub(crate) struct Ground {
    pub(crate) mesh: Arc<Mesh>,
    pub(crate) contact_ohm_m: Vec<f64>,
    /// S per square, one a triangle.
    pub(crate) sigma: Option<Vec<f64>>,
    pub(crate) remarks: Vec<String>,
}

/// What is known of the record before anything is reconstructed.
pub(crate) struct Scene<'a> {
    pub(crate) protocol: &'a Protocol,
    pub(crate) baseline: &'a [Reading],
    /// Standard deviation of one reading, V, measured on the baseline's frames.
    pub(crate) noise: Option<f64>,
    pub(crate) current: Amps,
}

/// Noise assumed where nobody says it and the baseline is a single frame: a thousandth of the readings' rms, the
/// order of what a laboratory instrument repeats to.
const ASSUMED_NOISE: f64 = 1e-3;
/// What rounding alone leaves of a mean, as a share of the readings' rms; below it there is no noise to speak of.
const SMALLEST_NOISE: f64 = 1e-12;

impl Eye {
    /// Loads the model, or builds the one-step method on the geometry that options, folder or session name.
    ///
    /// # Errors
    /// A model or geometry that does not fit the record, naming both.
    pub(crate) fn open(
        method: &MethodChoice,
        geometry: &Geometry,
        home: &Home,
        scene: &Scene<'_>,
    ) -> Result<Self, Failure> {
        let recipe = Recipe::choose(method, home)?;
        match &recipe.model {
            Some(model) if is_onnx(model) => {
                // such a file brings no mesh
                let mesh = ground(geometry, home, scene.protocol)?.mesh;
                let network = load_onnx(model, mesh, scene.protocol).map_err(|error| {
                    Failure::configuration("the network cannot be used", &error)
                })?;
                Ok(Self::trained(network, recipe.loss_only))
            }
            Some(model) => Self::from_model(model, recipe.loss_only, scene.protocol),
            None => Self::one_step(recipe, ground(geometry, home, scene.protocol)?, scene),
        }
    }

    fn trained(network: Box<dyn Reconstructor>, loss_only: bool) -> Self {
        let network = match loss_only {
            true => Box::new(LossOnly::new(network)),
            false => network,
        };
        Self::new(network, Vec::new())
    }

    fn from_model(file: &Path, loss_only: bool, protocol: &Protocol) -> Result<Self, Failure> {
        let reconstructor = eit::load_reconstructor(file)
            .map_err(|error| Failure::failed(&file.display().to_string(), &error))?;
        let asked = reconstructor.protocol();
        if asked != protocol {
            return Err(Failure::Configuration(format!(
                "model {} was trained for {} readings of {} electrodes (protocol {}), the record has {} readings of {} \
                 electrodes (protocol {}); use a model of this protocol, or --method one-step",
                file.display(),
                asked.len(),
                asked.electrodes(),
                short(&asked.hash()),
                protocol.len(),
                protocol.electrodes(),
                short(&protocol.hash()),
            )));
        }
        Ok(Self::trained(reconstructor, loss_only))
    }

    fn one_step(recipe: Recipe, ground: Ground, scene: &Scene<'_>) -> Result<Self, Failure> {
        let Ground {
            mesh,
            contact_ohm_m,
            sigma,
            remarks: of_ground,
        } = ground;
        let mut remarks = recipe.remarks;
        remarks.extend(of_ground);
        let forward =
            Forward::new(Arc::clone(&mesh), &contact_ohm_m).map_err(|error| unsolvable(&error))?;
        let sigma = match sigma {
            Some(sigma) => sigma,
            None => {
                let conductance = uniform_fit(&forward, mesh.triangles().len(), scene)?;
                remarks.push(format!(
                    "uniform conductance fitted to the baseline: {conductance:.4e} S per square"
                ));
                vec![conductance; mesh.triangles().len()]
            }
        };
        // The method scales its model to the baseline; noise is told at that scale, so that the unit does not matter.
        // The daemon tells it at the frames' own current, and a map can only be verified as it was made.
        let current = if recipe.as_the_daemon {
            scene.current.0
        } else {
            gain(&forward, &sigma, scene)?
        };
        // Frames equal to the last bit (instruments without noise) say nothing about noise.
        let measured = scene
            .noise
            .filter(|noise| *noise > SMALLEST_NOISE * rms(scene.baseline));
        let hyper = match (recipe.lambda, recipe.noise_v, measured) {
            (Some(lambda), _, _) => Hyper::Lambda(lambda),
            _ if recipe.noise_figure.is_some() && recipe.method == Method::OneStep => {
                Hyper::NoiseFigure(recipe.noise_figure.unwrap_or_default())
            }
            (None, Some(volts), _) => Hyper::Noise { volts, current },
            (None, None, Some(volts)) => {
                remarks.push(format!(
                    "noise of one reading, measured on the baseline's frames: {volts:.2e} in the readings' unit"
                ));
                Hyper::Noise { volts, current }
            }
            (None, None, None) => {
                let volts = ASSUMED_NOISE * rms(scene.baseline);
                remarks.push(format!(
                    "noise of one reading, assumed to be a thousandth of the readings' rms: {volts:.2e} in their unit; \
                     --noise-v says better"
                ));
                Hyper::Noise { volts, current }
            }
        };
        if recipe.method == Method::Tv {
            let Hyper::Noise { volts, current } = hyper else {
                return Err(Failure::Usage(
                    "--lambda belongs to the one-step method; total variation takes --noise-v"
                        .to_owned(),
                ));
            };
            if recipe.prior_asked {
                return Err(Failure::Usage(
                    "--prior and --exponent belong to the one-step method".to_owned(),
                ));
            }
            let usual = TvOptions::default();
            let options = TvOptions {
                noise_v: volts,
                current_a: current,
                loss_only: recipe.loss_only,
                gap: recipe.gap.unwrap_or(usual.gap),
                ..usual
            };
            let tv = Tv::new(mesh, &contact_ohm_m, &sigma, scene.protocol, options).map_err(
                |error| Failure::configuration("total variation cannot be set up", &error),
            )?;
            return Ok(Self::new(Box::new(tv), remarks));
        }
        let prior = match recipe.prior {
            Some(Prior::Tikhonov) => eit::Prior::Tikhonov,
            Some(Prior::Noser) | None => eit::Prior::noser(recipe.prior.is_some(), recipe.exponent),
            Some(Prior::Laplace) => eit::Prior::Laplace,
            Some(Prior::Gaussian) => eit::Prior::Gaussian {
                length_m: recipe
                    .length_mm
                    .map_or(eit::SMOOTH_LENGTH_M, |mm| 1e-3 * mm),
            },
        };
        let options = OneStepOptions {
            prior,
            hyper,
            loss_only: recipe.loss_only,
            map_error: recipe.map_error,
            ..OneStepOptions::default()
        };
        let reconstructor = OneStep::new(mesh, &contact_ohm_m, &sigma, scene.protocol, options)
            .map_err(|error| {
                Failure::configuration("the one-step method cannot be set up", &error)
            })?;
        Ok(Self::new(Box::new(reconstructor), remarks))
    }

    fn new(reconstructor: Box<dyn Reconstructor>, remarks: Vec<String>) -> Self {
        Self {
            field: Field::from_mesh(reconstructor.mesh()),
            reconstructor,
            remarks,
        }
    }

    /// The map of one frame.
    ///
    /// # Errors
    /// Too many missing readings, or readings the method cannot use.
    pub(crate) fn look(&self, baseline: &[Reading], frame: &[Reading]) -> Result<Map, Failure> {
        self.reconstructor
            .reconstruct(baseline, frame)
            .map_err(|error| Failure::failed("no map can be made", &error))
    }

    pub(crate) fn method(&self) -> &str {
        self.reconstructor.method()
    }
}

/// The mesh that options, folder or session name, in this order.
pub(crate) fn ground(
    geometry: &Geometry,
    home: &Home,
    protocol: &Protocol,
) -> Result<Ground, Failure> {
    let ground = if let Some(preset) = geometry.preset {
        from_preset(preset, geometry, protocol)?
    } else if let Some(folder) = &geometry.case {
        case_ground(folder)?
    } else {
        match home {
            Home::Folder(folder) if folder.join("nodes.csv").exists() => case_ground(folder)?,
            Home::Folder(folder) => {
                return Err(Failure::Usage(format!(
                    "{} holds no mesh (no nodes.csv); say --preset disc-tank or paper-sheet, or --case DIR with a mesh",
                    folder.display()
                )));
            }
            Home::Session(header) => crate::records::directory::ground(header)?,
        }
    };
    let (mesh, wants) = (ground.mesh.electrodes(), protocol.electrodes());
    if mesh != wants {
        return Err(Failure::Configuration(format!(
            "the mesh has {mesh} electrodes, the protocol asks for {wants}"
        )));
    }
    Ok(ground)
}

/// Reads the mesh of a case folder.
pub(crate) fn case_ground(folder: &Path) -> Result<Ground, Failure> {
    let case = eit::Case::read(folder)
        .map_err(|error| Failure::failed(&folder.display().to_string(), &error))?;
    Ok(Ground {
        sigma: case.sigma.get("homog").cloned(),
        mesh: case.mesh,
        contact_ohm_m: case.contact_ohm_m,
        remarks: Vec::new(),
    })
}

fn from_preset(
    name: PresetName,
    geometry: &Geometry,
    protocol: &Protocol,
) -> Result<Ground, Failure> {
    let electrodes = geometry.electrodes.unwrap_or(protocol.electrodes());
    let mut remarks = Vec::new();
    let preset = match name {
        PresetName::PaperSheet => {
            if geometry.diameter_mm.is_some()
                || geometry.arc_deg.is_some()
                || geometry.first_deg.is_some()
            {
                return Err(Failure::Usage(
                    "--diameter-mm, --arc-deg and --first-deg belong to --preset disc-tank"
                        .to_owned(),
                ));
            }
            Preset::PaperSheet(PaperSheet::default())
        }
        PresetName::DiscTank => {
            let default = DiscTank::default();
            let tank = DiscTank {
                electrodes,
                radius_mm: geometry
                    .diameter_mm
                    .map_or(default.radius_mm, |diameter| 0.5 * diameter),
                arc_deg: geometry.arc_deg.unwrap_or(default.arc_deg),
                first_deg: geometry.first_deg.unwrap_or(default.first_deg),
                ..default
            };
            remarks.push(format!(
                "disc tank {} mm wide, {electrodes} electrodes of {} degrees ({:.1} mm) each{}, the first at {} degrees",
                2.0 * tank.radius_mm,
                tank.arc_deg,
                tank.radius_mm * tank.arc_deg.to_radians(),
                if geometry.arc_deg.is_none() { " (assumed)" } else { "" },
                tank.first_deg,
            ));
            Preset::DiscTank(tank)
        }
    };
    Ok(Ground {
        remarks,
        ..preset_ground(&preset)?
    })
}

/// Builds a preset's mesh and contacts.
pub(crate) fn preset_ground(preset: &Preset) -> Result<Ground, Failure> {
    let mesh = preset
        .mesh()
        .map_err(|error| Failure::configuration("the preset makes no mesh", &error))?;
    Ok(Ground {
        sigma: Some(vec![preset.conductance(); mesh.triangles().len()]),
        contact_ohm_m: preset.contact_ohm_m(),
        mesh: Arc::new(mesh),
        remarks: Vec::new(),
    })
}

/// By how much the baseline exceeds the geometry's own readings at 1 A: the current, where conductance and unit are
/// known; else the factor that joins the record's unit to the model's.
fn gain(forward: &Forward, sigma: &[f64], scene: &Scene<'_>) -> Result<f64, Failure> {
    let model = forward
        .readings(sigma, scene.protocol)
        .map_err(|error| unsolvable(&error))?;
    let (mut both, mut own) = (0.0, 0.0);
    for (reading, &ohms) in scene.baseline.iter().zip(model.iter()) {
        if let Some(volts) = reading.volts() {
            both += ohms * volts.0;
            own += ohms * ohms;
        }
    }
    let gain = both / own;
    if gain > 0.0 && gain.is_finite() {
        return Ok(gain);
    }
    Err(Failure::Configuration(
        "the baseline does not look like this geometry: its readings have the opposite sign of the model's, or none is \
         valid; if they are magnitudes, say --negate"
            .to_owned(),
    ))
}

/// The uniform sheet conductance, S per square, whose readings are nearest to the baseline in the least squares.
fn uniform_fit(forward: &Forward, triangles: usize, scene: &Scene<'_>) -> Result<f64, Failure> {
    let mut conductance = 1e-3;
    // Readings are inversely proportional to the conductance but for the contacts' share: a few rounds settle it.
    for _ in 0..20 {
        let factor = scene.current.0 / gain(forward, &vec![conductance; triangles], scene)?;
        conductance *= factor;
        if (factor - 1.0).abs() < 1e-9 {
            break;
        }
    }
    Ok(conductance)
}

fn unsolvable(error: &dyn std::error::Error) -> Failure {
    Failure::configuration("the geometry cannot be solved", error)
}

fn rms(readings: &[Reading]) -> f64 {
    let (count, squares) = readings
        .iter()
        .filter_map(|reading| reading.volts())
        .fold((0_usize, 0.0), |(count, squares), volts| {
            (count + 1, squares + volts.0 * volts.0)
        });
    (squares / count.max(1) as f64).sqrt()
}

/// The first twelve characters of a hash, enough to tell two apart.
pub(crate) fn short(hash: &str) -> &str {
    hash.get(..12).unwrap_or(hash)
}
