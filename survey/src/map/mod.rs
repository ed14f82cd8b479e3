//! Maps: one value for each triangle of the region of interest, and a verdict on the reliability of the map. The
//! methods that compute maps are in other crates.

mod hot_spots;
mod quality;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

pub use self::hot_spots::{Adjacency, HotSpot};
pub use self::quality::{Doubt, MapQuality, Reason, Verdict};

/// What the values of a map mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MapUnit {
    /// Relative change of sheet conductance, dsigma / sigma0: 0 untouched, -1 all conductance lost.
    RelativeConductance,
    /// Change of sheet conductance, siemens per square.
    Conductance,
    /// Pressure, kPa: a calibrated relative change.
    Pressure,
}

impl MapUnit {
    /// Name of the quantity in machine-readable output; losses are negative changes.
    pub fn label(self) -> &'static str {
        match self {
            Self::RelativeConductance => "relative change of conductance",
            Self::Conductance => "change of conductance",
            Self::Pressure => "kPa",
        }
    }

    /// Label of a colour scale, for values scaled as [`MapUnit::shown`] returns.
    pub fn caption(self) -> &'static str {
        match self {
            Self::RelativeConductance => "relative loss of conductance",
            Self::Conductance => "change of conductance",
            Self::Pressure => "pressure",
        }
    }

    /// Factor for display, and the unit of the scaled value.
    pub fn shown(self) -> (f64, &'static str) {
        match self {
            Self::RelativeConductance => (-1e2, "%"),
            Self::Conductance => (1e6, "\u{b5}S per square"),
            Self::Pressure => (1.0, "kPa"),
        }
    }

    /// The load that a value indicates, in the value's unit: lost conductance, or pressure.
    pub fn load(self, value: f64) -> f64 {
        match self {
            Self::RelativeConductance | Self::Conductance => -value,
            Self::Pressure => value,
        }
    }
}

/// Why a method that tries several kinds of map chose this one ([`Map::method`] names it), compared with the next
/// best kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Mean squared residual of the map, divided by the largest one that noise and model error explain: at most 1 for
    /// shapes and smooth loads. `None` for total variation, which is fitted until its residual is about that large.
    pub left: Option<f64>,
    /// The next best kind. `None` if no other was tried: a plain disc left a clearly smaller residual than allowed,
    /// or is too small to be distinguished from other shapes.
    pub next: Option<NextKind>,
}

/// A kind of map that a method tried and did not choose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NextKind {
    /// Its name, in the form of [`Map::method`].
    pub method: String,
    /// As [`Evidence::left`].
    pub left: f64,
    /// Logarithm of the odds of the chosen kind against this one; negative if this one is more probable but its
    /// residual is too large. `None` if the chosen map is total variation or a smooth load, which have no number of
    /// parameters.
    pub ln_odds: Option<f64>,
}

/// One value for each triangle of a mesh's region of interest, in the mesh's order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Map {
    /// Hash of the mesh whose region this is.
    pub mesh_hash: String,
    /// One value for each triangle of the region.
    pub values: Vec<f64>,
    /// Their meaning.
    pub unit: MapUnit,
    /// Display name of the method that made it.
    pub method: String,
    /// Invalid readings left out.
    pub masked: usize,
    /// Evidence for the kind of map, if the method chooses between kinds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub evidence: Option<Evidence>,
    /// Reliability of the map; `None` if it was not judged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quality: Option<MapQuality>,
}

impl Map {
    /// A map of relative changes of conductance, without masked readings, evidence or quality.
    pub fn relative(
        mesh_hash: impl Into<String>,
        values: Vec<f64>,
        method: impl Into<String>,
    ) -> Self {
        Self {
            mesh_hash: mesh_hash.into(),
            values,
            unit: MapUnit::RelativeConductance,
            method: method.into(),
            masked: 0,
            evidence: None,
            quality: None,
        }
    }

    /// SHA-256 of the values' bits and the mesh hash, hex: the same build recomputes the same hash.
    pub fn hash(&self) -> String {
        let mut hasher = Sha256::new();
        hasher.update(self.mesh_hash.as_bytes());
        for value in &self.values {
            hasher.update(value.to_bits().to_le_bytes());
        }
        crate::pattern::hex(&hasher.finalize())
    }

    /// The largest loss (for pressure: the largest pressure) as a positive number, with its index; `None` if nothing is
    /// lost.
    pub fn largest_loss(&self) -> Option<(usize, f64)> {
        self.values
            .iter()
            .enumerate()
            .map(|(triangle, value)| (triangle, self.unit.load(*value)))
            .filter(|(_, loss)| *loss > 0.0)
            .max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Whether the largest loss exceeds `noise`, the largest loss that noise alone causes on an unloaded sheet; `None`
    /// if the noise is unknown.
    pub fn is_significant(&self, noise: Option<f64>) -> Option<bool> {
        let largest = self.largest_loss().map_or(0.0, |(_, loss)| loss);
        noise.map(|noise| largest > noise)
    }

    /// [`Map::found`], but `None` if nothing exceeds `noise`, the largest loss that noise alone causes.
    pub fn found_above(
        &self,
        noise: Option<f64>,
        centroids: &[[f64; 2]],
        areas: &[f64],
    ) -> Option<[f64; 2]> {
        match self.is_significant(noise) {
            Some(false) => None,
            Some(true) | None => self.found(centroids, areas),
        }
    }

    /// The centroid of the triangles at or above half the largest loss, weighted by loss times `areas`, in the units of
    /// `centroids` (one point for each triangle of the region). `None` if nothing is lost.
    ///
    /// This is our interpretation of "found" in the paper, which gives no rule.
    pub fn found(&self, centroids: &[[f64; 2]], areas: &[f64]) -> Option<[f64; 2]> {
        let (_, largest) = self.largest_loss()?;
        let mut weight = 0.0;
        let mut sum = [0.0; 2];
        for ((value, centroid), area) in self.values.iter().zip(centroids).zip(areas) {
            let loss = self.unit.load(*value);
            if loss >= 0.5 * largest {
                weight += loss * area;
                sum[0] += loss * area * centroid[0];
                sum[1] += loss * area * centroid[1];
            }
        }
        Some([sum[0] / weight, sum[1] / weight])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(values: Vec<f64>) -> Map {
        Map::relative("m", values, "test")
    }

    #[test]
    fn found_is_the_centroid_of_the_upper_half() {
        let centroids = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [9.0, 9.0]];
        let found = map(vec![-0.5, -1.0, -0.5, -0.1]).found(&centroids, &[1.0; 4]);
        assert_eq!(found, Some([1.0, 0.0]));
        assert_eq!(map(vec![0.0, 0.2]).found(&centroids, &[1.0; 4]), None);
    }

    #[test]
    fn a_map_is_significant_above_its_noise() {
        let pressed = map(vec![-0.2, 0.1]);
        assert_eq!(pressed.is_significant(Some(0.1)), Some(true));
        assert_eq!(pressed.is_significant(Some(0.2)), Some(false));
        assert_eq!(pressed.is_significant(None), None);
        assert_eq!(map(vec![0.3]).is_significant(Some(0.1)), Some(false));
    }

    #[test]
    fn pressure_is_found_where_it_is_largest() {
        let pressure = Map {
            unit: MapUnit::Pressure,
            ..map(vec![5.0, 10.0, 0.0])
        };
        assert_eq!(pressure.largest_loss(), Some((1, 10.0)));
        let centroids = [[0.0, 0.0], [3.0, 0.0], [9.0, 9.0]];
        assert_eq!(pressure.found(&centroids, &[1.0; 3]), Some([2.0, 0.0]));
    }

    #[test]
    fn a_hash_depends_on_every_bit() {
        assert_ne!(map(vec![0.0]).hash(), map(vec![-0.0]).hash());
        assert_eq!(map(vec![0.1]).hash(), map(vec![0.1]).hash());
    }
}
