//! Reconstruction without a daemon: builds a model of `imaging` from the options and the record.

use std::path::Path;

use eit::inverse::learned::network::is_onnx;
use eit::{DiscTank, Mesh, PaperSheet, Preset, Pressure};
use imaging::quantities::{Deviation, Quantifier};
use imaging::recorded::{Fitted, Origin, Recording};
use imaging::{
    BuildError, Conditions, DriftRule, Geometry, MethodArguments, Model, ReconstructionSettings,
    TrackedArguments, Tracking, has_mesh, short_hash,
};
use survey::{Map, MapUnit, Protocol, Reading};

use crate::args::MapOptions;
use crate::failure::Failure;
use crate::maps::drawing::Field;
use crate::maps::session_settings;
use crate::maps::settings::ChosenSettings;
use crate::options::choices::{GeometryChoice, PresetName};

/// A reconstructor with remarks for the user.
pub(crate) struct Reconstruction {
    model: Model,
    /// The region of its maps.
    pub(crate) field: Field,
    /// Assumptions and derived values, a sentence each.
    pub(crate) remarks: Vec<String>,
    /// The largest loss by noise alone; `None` if the noise of a reading is unknown.
    pub(crate) noise: Option<f64>,
    /// Standard deviation of one reading, in the unit of the readings; `None` if unknown.
    reading_noise: Option<f64>,
    /// The tracked baseline; `None` if tracking is not requested.
    pub(crate) tracking: Option<Tracking>,
    /// Whether a map that the calibration does not fit is an error, because the options name the calibration.
    must_calibrate: bool,
}

impl Reconstruction {
    /// A recorded session with its own baseline, and the reconstruction of its maps.
    ///
    /// # Errors
    /// A session that cannot be read or has no baseline; as [`Reconstruction::new`].
    pub(crate) fn of_session(
        path: &Path,
        asked: &MapOptions,
    ) -> Result<(Recording, Self), Failure> {
        let recording = Recording::from_session(path, None, false)?;
        let reconstruction = Self::new(asked, &recording)?;
        Ok((recording, reconstruction))
    }

    /// Loads the model, or prepares the method for the geometry given by options, folder or session.
    ///
    /// # Errors
    /// A model or geometry that does not match the record; the error names both.
    pub(crate) fn new(asked: &MapOptions, recording: &Recording) -> Result<Self, Failure> {
        let MapOptions {
            calibration,
            method,
            tracked,
            geometry,
        } = asked;
        let (origin, protocol) = (&recording.origin, &recording.protocol);
        let requested_geometry = geometry;
        let mut chosen = ChosenSettings::new(method, origin)?;
        chosen.settings.tracking = tracked.tracked.or(chosen.settings.tracking);
        let mut model = match chosen.settings.file.clone() {
            Some(file) => {
                let removes = chosen.settings.drift.unwrap_or_default() != DriftRule::Off;
                // an ONNX file contains no mesh, and no model file contains the whole sheet, whose drift is to be
                // removed
                let geometry = match is_onnx(&file) || removes {
                    true => Some(choose_geometry(geometry, origin, protocol)?.0),
                    false => None,
                };
                let loss_only = chosen.settings.loss_only.unwrap_or(false);
                let model = imaging::load(&file, loss_only, protocol, geometry.as_ref());
                let model = model.map_err(not_built)?;
                // maps are judged if the sheet of the model is known
                let sheet = geometry.or_else(|| {
                    let (chosen, _) = choose_geometry(requested_geometry, origin, protocol).ok()?;
                    let own = model.reconstructor.mesh().hash();
                    Some(chosen).filter(|chosen| chosen.mesh.hash() == own)
                });
                let judged = sheet.map(|sheet| {
                    built(&mut chosen, sheet, recording, |settings, conditions| {
                        let model = imaging::with_drift(model.clone(), settings, conditions)?;
                        imaging::judging(model, settings, conditions)
                    })
                });
                match judged {
                    Some(Ok(judged)) => judged,
                    Some(Err(refused)) if removes => return Err(refused),
                    Some(Err(refused)) => {
                        let remark = format!("maps are not judged: {refused}");
                        chosen.remarks.push(remark);
                        model
                    }
                    None => model,
                }
            }
            None => {
                let (geometry, remarks) = choose_geometry(geometry, origin, protocol)?;
                chosen.remarks.extend(remarks);
                let model = built(&mut chosen, geometry, recording, imaging::build)?;
                chosen.remarks.extend(model.notes.iter().cloned());
                model
            }
        };
        if let Some(path) = calibration {
            imaging::calibrate(&mut model, path).map_err(not_built)?;
        } else if let Some(path) = &chosen.calibration
            && let Err(error) = imaging::calibrate(&mut model, path)
        {
            chosen.remarks.push(format!(
                "maps are in relative loss of conductance, because the session's {}; give it with --calibration FILE",
                survey::error_chain(&error)
            ));
        }
        let tracking = wanted_tracking(&mut chosen, requested_geometry, tracked, recording)?;
        let measured = measured_noise(&chosen, recording);
        let unloaded = &recording.unloaded.readings;
        let noise = measured.and_then(|noise| imaging::map_noise(&model, unloaded, noise));
        Ok(Self {
            noise,
            reading_noise: measured,
            tracking,
            must_calibrate: calibration.is_some(),
            field: Field::from_mesh(model.reconstructor.mesh()),
            model,
            remarks: chosen.remarks,
        })
    }

    /// The tracked baseline of a recording, as [`Reconstruction::new`] prepares it with the session's method and
    /// geometry; `None` if the session's baseline is not tracked.
    ///
    /// # Errors
    /// A session with an invalid configuration.
    pub(crate) fn tracking_of(recording: &Recording) -> Result<Option<Tracking>, Failure> {
        let mut chosen = ChosenSettings::new(&MethodArguments::default(), &recording.origin)?;
        let (geometry, tracked) = (GeometryChoice::default(), TrackedArguments::default());
        wanted_tracking(&mut chosen, &geometry, &tracked, recording)
    }

    /// The map of one frame.
    ///
    /// # Errors
    /// Too many missing readings, or readings that the method cannot use.
    pub(crate) fn map(&self, baseline: &[Reading], frame: &[Reading]) -> Result<Map, Failure> {
        self.model
            .reconstruct(baseline, frame)
            .map_err(|error| Failure::failed("no map can be made", &error))
    }

    /// The pressures of a map; `None` without a calibration, and if the session's calibration does not fit the map.
    ///
    /// # Errors
    /// The calibration that the options name does not fit the map.
    pub(crate) fn pressure(&self, map: &Map) -> Result<Option<Pressure>, Failure> {
        let Some(calibration) = &self.model.calibration else {
            return Ok(None);
        };
        match calibration.pressure(self.mesh(), map) {
            Ok(pressure) => Ok(Some(pressure)),
            Err(error) if self.must_calibrate => {
                Err(Failure::failed("the map has no pressure", &error))
            }
            Err(_) => Ok(None),
        }
    }

    /// Whether maps are converted to pressure.
    pub(crate) fn is_calibrated(&self) -> bool {
        self.model.calibration.is_some()
    }

    /// The common unit of its maps. A map that the session's calibration does not fit has another unit.
    pub(crate) fn unit(&self) -> MapUnit {
        match self.is_calibrated() {
            true => MapUnit::Pressure,
            false => MapUnit::RelativeConductance,
        }
    }

    /// Computes quantities of the maps, with the thresholds and regions of the recording.
    ///
    /// # Errors
    /// A session with an invalid configuration, or a region outside of the maps.
    pub(crate) fn quantifier(&self, recording: &Recording) -> Result<Quantifier, Failure> {
        let (settings, regions) = session_settings::of_quantities(&recording.origin)?;
        Quantifier::new(&self.model, &settings, &regions)
            .map_err(|error| Failure::Configuration(error.to_string()))
    }

    /// Standard deviation of ln conductance of each triangle; NaN if the frame gives no information about it. The first
    /// call for a baseline takes a second.
    ///
    /// # Errors
    /// A model without a geometry, or missing readings.
    pub(crate) fn map_deviation(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Vec<f64>, Failure> {
        let found = self.model.deviation(baseline, frame);
        let found =
            found.map_err(|error| Failure::failed("no standard deviation is known", &error))?;
        let found = found.map(|found| found.values());
        found.ok_or_else(|| {
            let text = "no standard deviation is known: the model contains no geometry";
            Failure::Configuration(text.to_owned())
        })
    }

    /// Standard deviations of quantities; `None` if the noise is unknown.
    pub(crate) fn deviation(&self) -> Option<Deviation> {
        Some(Deviation::new(&self.model, self.reading_noise?))
    }

    /// The mesh whose region the maps cover.
    pub(crate) fn mesh(&self) -> &Mesh {
        self.model.reconstructor.mesh()
    }

    pub(crate) fn method(&self) -> &str {
        self.model.reconstructor.method()
    }
}

/// Builds a model in the [conditions](in_conditions) of the frames; adds the derived conditions to the remarks.
fn built(
    chosen: &mut ChosenSettings,
    geometry: Geometry,
    recording: &Recording,
    make: impl FnOnce(&ReconstructionSettings, &Conditions<'_>) -> Result<Model, BuildError>,
) -> Result<Model, Failure> {
    let settings = &chosen.settings;
    let make = |conditions: &Conditions<'_>| make(settings, conditions);
    let (model, notes) = in_conditions(chosen.as_recorded, geometry, recording, make)?;
    chosen.remarks.extend(notes);
    model.map_err(not_built)
}

/// Makes something for the conditions of the frames. For a session these are the recorded ones; for a recording without
/// a configuration, conductance, current and noise that are not given are derived from the baseline and noted.
fn in_conditions<T>(
    as_recorded: bool,
    geometry: Geometry,
    recording: &Recording,
    make: impl FnOnce(&Conditions<'_>) -> T,
) -> Result<(T, Vec<String>), Failure> {
    let protocol = &recording.protocol;
    if as_recorded {
        // the daemon's noise is at the frames' own current, and verification needs the same map
        let conditions = Conditions::live(&geometry, protocol, recording.current);
        return Ok((make(&conditions), Vec::new()));
    }
    let currents = vec![recording.current.0; protocol.len()];
    let fitted =
        Fitted::new(geometry, protocol, &currents, &recording.unloaded).map_err(not_built)?;
    let made = make(&fitted.conditions(protocol));
    Ok((made, fitted.notes.clone()))
}

/// Standard deviation of one reading; `None` if it was only assumed, because an assumption has no significance for a
/// map.
fn measured_noise(chosen: &ChosenSettings, recording: &Recording) -> Option<f64> {
    let stated = chosen.settings.noise_uv.map(|noise_uv| 1e-6 * noise_uv);
    recording.unloaded.known_noise(stated)
}

/// The tracked baseline; `None` if tracking is not requested, or is impossible for the session.
fn wanted_tracking(
    chosen: &mut ChosenSettings,
    geometry: &GeometryChoice,
    tracked: &TrackedArguments,
    recording: &Recording,
) -> Result<Option<Tracking>, Failure> {
    let noise_v = measured_noise(chosen, recording);
    match (tracked.tracked, chosen.settings.tracking) {
        (Some(true), _) => tracking(chosen, geometry, recording, noise_v).map(Some),
        (None, Some(true)) => match tracking(chosen, geometry, recording, noise_v) {
            // the daemon recorded without tracking in this case
            Err(Failure::Failed(why)) => {
                chosen.remarks.push(format!(
                    "maps are compared with the baseline as it was recorded: {why}"
                ));
                Ok(None)
            }
            other => other.map(Some),
        },
        (Some(false), _) | (None, _) => Ok(None),
    }
}

/// The tracked baseline of a recording. `noise_v`: standard deviation of one reading, if it is known.
fn tracking(
    chosen: &ChosenSettings,
    geometry: &GeometryChoice,
    recording: &Recording,
    noise_v: Option<f64>,
) -> Result<Tracking, Failure> {
    let noise_v = TrackedArguments::noise_v(noise_v.or(recording.baseline_noise_v));
    let noise_v = noise_v.map_err(Failure::Usage)?;
    let (geometry, _) = choose_geometry(geometry, &recording.origin, &recording.protocol)?;
    let (unloaded, at_s) = (&recording.unloaded.readings, recording.baseline_s());
    let follow = |conditions: &Conditions<'_>| Tracking::new(conditions, unloaded, noise_v, at_s);
    let (tracking, _) = in_conditions(chosen.as_recorded, geometry, recording, follow)?;
    tracking.map_err(|error| Failure::failed("the baseline cannot be tracked", &error))
}

/// The geometry given by options, folder or session, in this order, and the assumptions about it.
///
/// # Errors
/// No geometry is given, or it does not match the protocol or the session.
pub(crate) fn choose_geometry(
    requested: &GeometryChoice,
    origin: &Origin,
    protocol: &Protocol,
) -> Result<(Geometry, Vec<String>), Failure> {
    let mut remarks = Vec::new();
    let geometry = if let Some(name) = requested.preset {
        from_preset(name, requested, protocol, &mut remarks)?
    } else if let Some(folder) = &requested.case {
        Geometry::from_case(folder)?
    } else {
        match origin {
            Origin::Folder(folder) if has_mesh(folder) => Geometry::from_case(folder)?,
            Origin::Folder(folder) => {
                return Err(Failure::Usage(format!(
                    "{} has no mesh (no nodes.csv); give --preset disc-tank or paper-sheet, or --case DIR with a mesh",
                    folder.display()
                )));
            }
            Origin::Session(header) => session_settings::geometry(header)?,
        }
    };
    let geometry = geometry
        .with_depth(requested.depth.settings().as_ref())
        .map_err(|fault| Failure::Usage(fault.to_string()))?;
    let (mesh, wants) = (geometry.electrodes(), protocol.electrodes());
    if mesh != wants {
        return Err(Failure::Configuration(format!(
            "the mesh has {mesh} electrodes, the protocol needs {wants}"
        )));
    }
    Ok((geometry, remarks))
}

fn from_preset(
    name: PresetName,
    requested: &GeometryChoice,
    protocol: &Protocol,
    remarks: &mut Vec<String>,
) -> Result<Geometry, Failure> {
    let electrodes = requested.electrodes.unwrap_or(protocol.electrodes());
    let preset = match name {
        PresetName::PaperSheet => {
            if requested.diameter_mm.is_some()
                || requested.arc_deg.is_some()
                || requested.first_deg.is_some()
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
                radius_mm: requested
                    .diameter_mm
                    .map_or(default.radius_mm, |diameter| 0.5 * diameter),
                arc_deg: requested.arc_deg.unwrap_or(default.arc_deg),
                first_deg: requested.first_deg.unwrap_or(default.first_deg),
                ..default
            };
            remarks.push(format!(
                "disc tank {} mm wide, {electrodes} electrodes of {} degrees ({:.1} mm) each{}, the first at {} degrees",
                2.0 * tank.radius_mm,
                tank.arc_deg,
                tank.radius_mm * tank.arc_deg.to_radians(),
                if requested.arc_deg.is_none() { " (assumed)" } else { "" },
                tank.first_deg,
            ));
            Preset::DiscTank(tank)
        }
    };
    Ok(Geometry::from_preset(&preset)?)
}

/// Converts the refusal of a model or method to a failure of this command line.
fn not_built(error: BuildError) -> Failure {
    match &error {
        BuildError::File(cause) => Failure::Failed(survey::error_chain(cause)),
        BuildError::Survey {
            model,
            asks,
            model_electrodes,
            model_hash,
            rig,
            rig_electrodes,
            rig_hash,
            ..
        } => Failure::Configuration(format!(
            "model {model} was trained for {asks} readings of {model_electrodes} electrodes (protocol {}), the record has \
             {rig} readings of {rig_electrodes} electrodes (protocol {}); use a model of this protocol, or --method one-step",
            short_hash(model_hash),
            short_hash(rig_hash),
        )),
        BuildError::Onnx(cause) => Failure::configuration("the network cannot be used", cause),
        BuildError::OneStep(cause) => {
            Failure::configuration("the one-step method cannot be set up", cause)
        }
        BuildError::Tv(cause) => Failure::configuration("total variation cannot be set up", cause),
        BuildError::Forward(cause) => {
            Failure::configuration("the geometry cannot be solved", cause)
        }
        BuildError::Unlike => Failure::Configuration(error.to_string()),
        BuildError::Setting(text) => Failure::Usage(text.clone()),
        BuildError::Geometry { .. } | BuildError::Calibration { .. } => {
            Failure::configuration("the reconstruction cannot be set up", &error)
        }
    }
}
