//! Loads outside of the region that maps show.

use nalgebra::DMatrix;
use survey::{Doubt, Electrode};

use super::spectrum::Explained;
use crate::Mesh;
use crate::inverse::reciprocity::Seen;
use crate::linear_algebra::dense;

/// A load outside of the region is reported if more than this share of the explained change comes from outside of the
/// region, and more than this share of the area lost there lies near one electrode and its neighbours.
const MOST: f64 = 0.5;
/// Root mean square of that change, in units of the noise, below which it is attributed to noise.
const ABOVE_NOISE: f64 = 3.0;

/// The sheet outside of the region.
pub(super) struct Outside {
    /// Change of the folded data caused by each of these triangles.
    sensitivity: DMatrix<f64>,
    /// Covariance of the folded data of a white map of these triangles, of size 1, per area.
    gram: DMatrix<f64>,
    /// The electrode nearest to each triangle.
    nearest: Vec<Electrode>,
    electrodes: usize,
}

impl Outside {
    /// `sensitivity`: rows of folded data, columns of all triangles. `None` if the region is the whole sheet.
    pub(super) fn new(mesh: &Mesh, sensitivity: &DMatrix<f64>) -> Option<Self> {
        let mut shown = vec![false; mesh.triangles().len()];
        for &triangle in mesh.region() {
            shown[triangle] = true;
        }
        let triangles: Vec<usize> = (0..shown.len()).filter(|&t| !shown[t]).collect();
        if triangles.is_empty() {
            return None;
        }
        let centres = mesh.electrode_centres();
        let nearest = triangles.iter().map(|&triangle| {
            let at = mesh.centroid(triangle);
            let away = |e: &usize| (centres[*e][0] - at[0]).hypot(centres[*e][1] - at[1]);
            let electrodes = 0..centres.len();
            Electrode(
                electrodes
                    .min_by(|a, b| away(a).total_cmp(&away(b)))
                    .unwrap_or(0),
            )
        });
        let areas: Vec<f64> = triangles.iter().map(|&t| mesh.area(t)).collect();
        let sensitivity = sensitivity.select_columns(&triangles);
        Some(Self {
            nearest: nearest.collect(),
            electrodes: centres.len(),
            gram: dense::gram(&sensitivity, |k| Some(1.0 / areas[k])),
            sensitivity,
        })
    }

    /// Restricts the data to the remaining readings.
    pub(super) fn of(&self, rows: &Seen) -> Self {
        let one_side = rows.rows(&self.gram).transpose();
        Self {
            gram: rows.rows(&one_side).into_owned(),
            sensitivity: rows.rows(&self.sensitivity).into_owned(),
            nearest: self.nearest.clone(),
            electrodes: self.electrodes,
        }
    }

    /// The load outside of the region, if it causes most of the change; `noise`: standard deviation of the data.
    pub(super) fn load(&self, explained: &Explained, noise: f64) -> Option<Doubt> {
        let from_here = &self.gram * &explained.dual;
        let all = explained.data.norm_squared();
        let share = from_here.dot(&explained.data) / all;
        let size = (from_here.norm_squared() / from_here.len() as f64).sqrt();
        if !(share > MOST && size > ABOVE_NOISE * noise) {
            return None;
        }
        // the lost area near each electrode: x = change / area
        let map = self.sensitivity.tr_mul(&explained.dual);
        let mut lost = vec![0.0; self.electrodes];
        for (change, electrode) in map.iter().zip(&self.nearest) {
            lost[electrode.0] -= change;
        }
        let all: f64 = lost.iter().map(|area| area.max(0.0)).sum();
        let (most, _) = lost.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
        // a change along the whole edge is not a load
        let count = self.electrodes;
        let near: f64 = [most + count - 1, most, most + 1]
            .into_iter()
            .map(|electrode| lost[electrode % count].max(0.0))
            .sum();
        (near > MOST * all).then_some(Doubt::OutsideRegion {
            electrode: Electrode(most),
            lost_mm2: 1e6 * near,
        })
    }
}
