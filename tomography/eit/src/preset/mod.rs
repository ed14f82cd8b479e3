//! Ready-made geometries: the paper's sheet and a disc tank. Their dimensions are configuration keys with units.

mod disc;
mod sheet;

use std::fmt::Display;

pub use disc::DiscTank;
pub use sheet::{PaperSheet, SheetElectrode};

use serde::{Deserialize, Serialize};

use crate::{Mesh, MeshError};

/// A ready-made geometry, chosen by name: `kind = "paper-sheet"` or `kind = "disc-tank"`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Preset {
    /// The rectangular foam sheet of the paper.
    PaperSheet(PaperSheet),
    /// A round tank.
    DiscTank(DiscTank),
}

impl Default for Preset {
    fn default() -> Self {
        Self::PaperSheet(PaperSheet::default())
    }
}

impl Preset {
    /// The mesh; equal dimensions give equal bits.
    ///
    /// # Errors
    /// Inconsistent dimensions.
    pub fn mesh(&self) -> Result<Mesh, MeshError> {
        match self {
            Self::PaperSheet(sheet) => sheet.mesh(),
            Self::DiscTank(tank) => tank.mesh(),
        }
    }

    /// The same geometry with edges `fineness` times shorter and a different seeding of points.
    pub fn remeshed(self, fineness: f64, seeding: u32) -> Self {
        match self {
            Self::PaperSheet(sheet) => Self::PaperSheet(PaperSheet {
                fineness: sheet.fineness * fineness,
                seeding: sheet.seeding.wrapping_add(seeding),
                ..sheet
            }),
            Self::DiscTank(tank) => Self::DiscTank(DiscTank {
                fineness: tank.fineness * fineness,
                seeding: tank.seeding.wrapping_add(seeding),
                ..tank
            }),
        }
    }

    /// Number of electrodes.
    pub fn electrodes(&self) -> usize {
        match self {
            Self::PaperSheet(sheet) => sheet.electrodes(),
            Self::DiscTank(tank) => tank.electrodes,
        }
    }

    /// Contact impedance of each electrode, ohm m: contact resistance times the electrode's length.
    pub fn contact_ohm_m(&self) -> Vec<f64> {
        match self {
            Self::PaperSheet(sheet) => sheet.contact_ohm_m(),
            Self::DiscTank(tank) => tank.contact_ohm_m(),
        }
    }

    /// Sheet conductance of the unloaded sheet, siemens per square.
    pub fn conductance(&self) -> f64 {
        match self {
            Self::PaperSheet(sheet) => sheet.conductance(),
            Self::DiscTank(tank) => tank.conductance(),
        }
    }
}

/// Range of the fineness of every preset.
const FINENESS: [f64; 2] = [0.25, 8.0];

fn refused(preset: &'static str, fault: String) -> MeshError {
    MeshError::Preset { preset, fault }
}

/// Refuses a dimension that is not a positive number.
fn positive(preset: &'static str, measures: &[(&str, f64)]) -> Result<(), MeshError> {
    match measures
        .iter()
        .find(|(_, value)| !(*value > 0.0 && value.is_finite()))
    {
        Some((key, value)) => {
            let fault = format!("{key} is {value}, it must be a positive number");
            Err(refused(preset, fault))
        }
        None => Ok(()),
    }
}

/// Refuses a value out of its range: electrodes would have no nodes, or the mesh would be too large.
fn within<T: PartialOrd + Display + Copy>(
    preset: &'static str,
    key: &str,
    value: T,
    [least, most]: [T; 2],
) -> Result<(), MeshError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    let fault = format!("{key} is {value}, it must be {least} to {most}");
    Err(refused(preset, fault))
}
