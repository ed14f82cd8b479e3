//! The geometry of the sheet or tank for the reconstruction: a mesh with contacts, conductance and, for a tank, depth.
//! The methods that use it are in `methods`.

mod depth;
mod ring;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use eit::{Case, CaseError, DiscTank, Mesh, MeshError, PaperSheet, Preset};
use serde::{Deserialize, Serialize};
use survey::{Amps, Protocol, ProtocolError};

#[cfg(feature = "arguments")]
pub use depth::DepthArguments;
pub use depth::{DepthRemark, DepthSettings};

/// Built-in geometries.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "arguments", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum PresetName {
    /// The paper's sheet of 214 mm x 230 mm with 26 void electrodes.
    #[default]
    PaperSheet,
    /// A round tank with electrodes on arcs, electrode 1 on +x, counter-clockwise.
    DiscTank,
}

/// Displayed name of the preset sheet.
const PAPER_SHEET: &str = "preset paper-sheet";

/// The section `[geometry]` of a configuration: a preset or a case folder.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeometrySettings {
    /// Default: the paper's sheet.
    pub preset: Option<PresetName>,
    /// A case folder with a mesh.
    pub case: Option<PathBuf>,
    /// Dimensions of the paper's sheet.
    #[serde(rename = "paper-sheet")]
    pub paper_sheet: Option<PaperSheet>,
    /// Dimensions of the disc tank.
    #[serde(rename = "disc-tank")]
    pub disc_tank: Option<DiscTank>,
    /// Depth of a tank; default: that of the case folder, otherwise a sheet.
    pub depth: Option<DepthSettings>,
}

/// Errors of geometries.
#[derive(Debug, thiserror::Error)]
pub enum GeometryError {
    /// Both a preset and a case folder.
    #[error("give a preset or a case folder, not both")]
    PresetAndCase,
    /// The case folder cannot be read.
    #[error("{}", .folder.display())]
    Case {
        /// The folder.
        folder: PathBuf,
        /// What is wrong with it.
        #[source]
        cause: CaseError,
    },
    /// The dimensions of the preset are inconsistent.
    #[error("no mesh can be made from the preset")]
    Preset(#[source] MeshError),
    /// The depth is inconsistent.
    #[error("[geometry.depth]")]
    Depth(#[source] MeshError),
}

impl GeometrySettings {
    /// Whether it is the preset sheet, for which the rates of drift of the tracked baseline were measured.
    pub fn is_sheet(&self) -> bool {
        self.case.is_none() && self.preset.unwrap_or_default() == PresetName::PaperSheet
    }

    /// Reads or makes the geometry. `recorded` is a case folder supplied by a recording: it is used if it contains a
    /// mesh and the settings name no other folder.
    ///
    /// # Errors
    /// Settings that contradict each other, or an invalid case folder or preset.
    pub fn geometry(&self, recorded: Option<&Path>) -> Result<Geometry, GeometryError> {
        if self.preset.is_some() && self.case.is_some() {
            return Err(GeometryError::PresetAndCase);
        }
        let recorded = recorded.filter(|folder| self.preset.is_none() && has_mesh(folder));
        let flat = if let Some(folder) = self.case.as_deref().or(recorded) {
            Geometry::from_case(folder)?
        } else {
            Geometry::from_preset(&match self.preset.unwrap_or_default() {
                PresetName::PaperSheet => {
                    Preset::PaperSheet(self.paper_sheet.clone().unwrap_or_default())
                }
                PresetName::DiscTank => {
                    Preset::DiscTank(self.disc_tank.clone().unwrap_or_default())
                }
            })?
        };
        flat.with_depth(self.depth.as_ref())
            .map_err(GeometryError::Depth)
    }
}

/// Whether a case folder contains a mesh.
pub fn has_mesh(folder: &Path) -> bool {
    folder.join("nodes.csv").exists()
}

/// A mesh with its contacts and its unloaded conductance.
#[derive(Debug, Clone)]
pub struct Geometry {
    /// Displayed name: `preset disc-tank`, `case FOLDER`.
    pub name: String,
    /// The mesh with its electrodes and region.
    pub mesh: Arc<Mesh>,
    /// Contact impedance of each electrode, ohm m.
    pub contact_ohm_m: Vec<f64>,
    /// Unloaded conductance of each triangle, S per square.
    pub sigma0: Vec<f64>,
    /// Whether `sigma0` was given; otherwise it is 1 mS per square everywhere.
    pub sigma0_known: bool,
    /// Whether it comes from a case folder, which also gives the currents of the readings.
    pub from_case: bool,
}

impl Geometry {
    /// Reads the mesh of a case folder.
    ///
    /// # Errors
    /// [`GeometryError::Case`].
    pub fn from_case(folder: &Path) -> Result<Self, GeometryError> {
        let case = Case::read(folder).map_err(|cause| GeometryError::Case {
            folder: folder.to_owned(),
            cause,
        })?;
        Ok(Self::of_case(&case, format!("case {}", folder.display())))
    }

    /// The geometry of a case that is already in memory.
    pub fn of_case(case: &Case, name: String) -> Self {
        Self {
            name,
            sigma0_known: case.sigma.contains_key("homog"),
            sigma0: case.unloaded_conductance(),
            mesh: Arc::clone(&case.mesh),
            contact_ohm_m: case.contact_ohm_m.clone(),
            from_case: true,
        }
    }

    /// Whether it is the preset sheet: see [`GeometrySettings::is_sheet`].
    pub fn is_sheet(&self) -> bool {
        self.name == PAPER_SHEET
    }

    /// Makes the mesh of a preset.
    ///
    /// # Errors
    /// [`GeometryError::Preset`].
    pub fn from_preset(preset: &Preset) -> Result<Self, GeometryError> {
        let mesh = preset.mesh().map_err(GeometryError::Preset)?;
        let name = match preset {
            Preset::PaperSheet(_) => PAPER_SHEET,
            Preset::DiscTank(_) => "preset disc-tank",
        };
        Ok(Self {
            name: name.to_owned(),
            sigma0: vec![preset.conductance(); mesh.triangles().len()],
            sigma0_known: true,
            from_case: false,
            contact_ohm_m: preset.contact_ohm_m(),
            mesh: Arc::new(mesh),
        })
    }

    /// The contents of a case folder with the Sheffield protocol, `current` for every reading, and the conductance as
    /// `homog`.
    ///
    /// # Errors
    /// Too few electrodes for the protocol.
    pub fn case(&self, current: Amps) -> Result<Case, ProtocolError> {
        let protocol = Protocol::sheffield(self.electrodes())?;
        let currents = vec![current.0; protocol.len()];
        Ok(self.case_of(protocol, currents))
    }

    /// The contents of a case folder with this protocol, a current (A) for each of its readings, and the conductance as
    /// `homog`.
    pub fn case_of(&self, protocol: Protocol, currents: Vec<f64>) -> Case {
        Case {
            contact_ohm_m: self.contact_ohm_m.clone(),
            currents,
            has_region: self.mesh.region().len() < self.mesh.triangles().len(),
            protocol,
            sigma: BTreeMap::from([("homog".to_owned(), self.sigma0.clone())]),
            mesh: Arc::clone(&self.mesh),
        }
    }

    /// Number of electrodes of the mesh.
    pub fn electrodes(&self) -> usize {
        self.mesh.electrodes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn coarse_tank() -> DiscTank {
        DiscTank {
            fineness: 0.25,
            ..DiscTank::default()
        }
    }

    #[test]
    fn preset_and_case_together_are_refused() {
        let both = GeometrySettings {
            preset: Some(PresetName::DiscTank),
            case: Some("here".into()),
            ..GeometrySettings::default()
        };
        assert!(matches!(
            both.geometry(None),
            Err(GeometryError::PresetAndCase)
        ));
    }

    #[test]
    fn a_recorded_folder_gives_the_mesh_unless_a_preset_is_named() {
        let preset = Geometry::from_preset(&Preset::DiscTank(coarse_tank())).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let protocol = survey::Protocol::sheffield(16).unwrap();
        let case = Case {
            contact_ohm_m: preset.contact_ohm_m.clone(),
            currents: vec![1e-3; protocol.len()],
            has_region: false,
            protocol,
            sigma: Default::default(),
            mesh: Arc::clone(&preset.mesh),
        };
        let path = folder.path().join("case");
        case.write(&path, eit::Existing::Refuse).unwrap();
        let read = GeometrySettings::default().geometry(Some(&path)).unwrap();
        assert_eq!(read.name, format!("case {}", path.display()));
        assert!(!read.sigma0_known);
        assert!(read.sigma0.iter().all(|sigma| *sigma == 1e-3));
        let named = GeometrySettings {
            preset: Some(PresetName::DiscTank),
            disc_tank: Some(coarse_tank()),
            ..GeometrySettings::default()
        };
        let named = named.geometry(Some(&path)).unwrap();
        assert_eq!(named.name, "preset disc-tank");
        assert!(named.sigma0_known);
    }

    #[test]
    fn an_unreadable_case_folder_is_named() {
        let error = Geometry::from_case(Path::new("no-such-folder")).unwrap_err();
        assert_eq!(error.to_string(), "no-such-folder");
    }
}
