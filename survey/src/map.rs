//! The answer as a picture wants it: one value for each triangle of the region of interest.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// What the values of a map mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MapUnit {
    /// Relative change of sheet conductance, dsigma / sigma0: 0 untouched, -1 all conductance lost.
    RelativeConductance,
    /// Change of sheet conductance, siemens per square.
    Conductance,
    /// Pressure, kPa: what a calibration makes of a relative change.
    Pressure,
}

impl MapUnit {
    /// What the values are, as a program reads them: losses are negative changes.
    pub fn label(self) -> &'static str {
        match self {
            Self::RelativeConductance => "relative change of conductance",
            Self::Conductance => "change of conductance",
            Self::Pressure => "kPa",
        }
    }

    /// What stands beside a scale, for a person: of the values as [`MapUnit::shown`] turns them.
    pub fn caption(self) -> &'static str {
        match self {
            Self::RelativeConductance => "relative loss of conductance",
            Self::Conductance => "change of conductance",
            Self::Pressure => "pressure",
        }
    }

    /// What a value is multiplied with before it is shown to a person, and the unit of the result.
    pub fn shown(self) -> (f64, &'static str) {
        match self {
            Self::RelativeConductance => (-1e2, "%"),
            Self::Conductance => (1e6, "\u{b5}S per square"),
            Self::Pressure => (1.0, "kPa"),
        }
    }

    /// How much load a value tells of, in its own unit: lost conductance, or pressure.
    pub fn load(self, value: f64) -> f64 {
        match self {
            Self::RelativeConductance | Self::Conductance => -value,
            Self::Pressure => value,
        }
    }
}

/// Values per triangle of the region of interest of one mesh, in the mesh's order of that region.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Map {
    /// Hash of the mesh whose region this is.
    pub mesh_hash: String,
    /// One value a triangle of the region.
    pub values: Vec<f64>,
    /// Their meaning.
    pub unit: MapUnit,
    /// Which method made it, as a person would name it.
    pub method: String,
    /// Readings left out because they were not valid.
    pub masked: usize,
}

impl Map {
    /// SHA-256 of the values' bits and the mesh hash, hex: recomputing on the same build gives the same.
    pub fn hash(&self) -> String {
        let mut hasher = Sha256::new();
        hasher.update(self.mesh_hash.as_bytes());
        for value in &self.values {
            hasher.update(value.to_bits().to_le_bytes());
        }
        crate::pattern::hex(&hasher.finalize())
    }

    /// The largest loss (of a map of pressure: the largest pressure), as a positive number, and its index; `None` where
    /// nothing is lost.
    pub fn largest_loss(&self) -> Option<(usize, f64)> {
        self.values
            .iter()
            .enumerate()
            .map(|(triangle, value)| (triangle, self.unit.load(*value)))
            .filter(|(_, loss)| *loss > 0.0)
            .max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Whether the map shows more than noise, which alone makes this largest loss of an untouched sheet; `None` where the
    /// noise is not known.
    pub fn is_significant(&self, noise: Option<f64>) -> Option<bool> {
        let largest = self.largest_loss().map_or(0.0, |(_, loss)| loss);
        noise.map(|noise| largest > noise)
    }

    /// [`Map::found`] of a map whose noise alone makes this largest loss; `None` also where nothing is above it.
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

    /// The loss-weighted centroid of the triangles at or above half the largest loss, in the units of `centroids`
    /// (one point a triangle of the region), weighted by loss times `areas`. `None` where nothing is lost.
    ///
    /// This is our reading of "found" in the paper, whose text gives no rule.
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
        Map {
            mesh_hash: "m".into(),
            values,
            unit: MapUnit::RelativeConductance,
            method: "test".into(),
            masked: 0,
        }
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
    fn a_hash_sees_every_bit() {
        assert_ne!(map(vec![0.0]).hash(), map(vec![-0.0]).hash());
        assert_eq!(map(vec![0.1]).hash(), map(vec![0.1]).hash());
    }
}
