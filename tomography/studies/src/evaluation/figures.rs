//! Figures of merit of a method's maps, for each frame and as means over a set.

use eit::metrics::likeness;
use serde::{Deserialize, Serialize};
use shards::any_f64;

use super::maps::{Frame, Judged};
use super::raster::Raster;
use super::statistics::{average, average_of_known};
use crate::failure::Failure;
use eit::metrics::median;

/// Figures of merit of one map.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct OfFrame {
    /// Distance from the true to the found position, if the load is one disc and the method finds one.
    pub error_mm: Option<f64>,
    /// Correlation of the map with the truth, weighted by area; NaN for a truth without a load.
    #[serde(with = "any_f64")]
    pub correlation: f64,
    /// Norm of the difference from the truth over the norm of the truth; NaN for a truth without a load.
    #[serde(with = "any_f64")]
    pub relative_error: f64,
    /// Dice coefficient of the parts at or above half of the largest loss; NaN for a truth without a load.
    #[serde(with = "any_f64")]
    pub dice: f64,
    /// Structural similarity of the rasters.
    #[serde(with = "any_f64")]
    pub ssim: f64,
    /// Amplitude, position error, resolution, shape deformation, ringing (GREIT); `None` if the map shows no loss.
    pub greit: Option<[f64; 5]>,
    /// The largest loss of the map, relative.
    #[serde(with = "any_f64")]
    pub peak: f64,
}

/// Means over the frames of one set, for one method. Correlation, relative error and Dice coefficient are means over the
/// frames with a true load, NaN if there are none.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Figures {
    /// Name and noise of the set.
    pub set: String,
    /// The method.
    pub method: String,
    /// Number of frames.
    pub frames: usize,
    /// Mean location error, mm.
    #[serde(with = "any_f64")]
    pub error_mm: f64,
    /// Largest location error, mm.
    #[serde(with = "any_f64")]
    pub worst_mm: f64,
    /// Correlation of the map with the truth, weighted by area.
    #[serde(with = "any_f64")]
    pub correlation: f64,
    /// Norm of the difference from the truth over the norm of the truth.
    #[serde(with = "any_f64")]
    pub relative_error: f64,
    /// Dice coefficient of the parts at or above half of the largest loss.
    #[serde(with = "any_f64")]
    pub dice: f64,
    /// Structural similarity of the rasters.
    #[serde(with = "any_f64")]
    pub ssim: f64,
    /// Figures of GREIT, as in [`OfFrame::greit`]; NaN if no map shows a loss.
    #[serde(with = "five")]
    pub greit: [f64; 5],
    /// Median time per frame, ms.
    #[serde(with = "any_f64")]
    pub ms: f64,
}

/// Five numbers that may be NaN.
mod five {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Serialize, Deserialize)]
    struct Number(#[serde(with = "shards::any_f64")] f64);

    pub(super) fn serialize<S: Serializer>(values: &[f64; 5], to: S) -> Result<S::Ok, S::Error> {
        values.map(Number).serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 5], D::Error> {
        Ok(<[Number; 5]>::deserialize(from)?.map(|Number(value)| value))
    }
}

/// The figures of every frame.
///
/// # Errors
/// A raster without a pixel.
pub fn of_frames(judged: &Judged) -> Result<Vec<OfFrame>, Failure> {
    let raster = Raster::new(&judged.case);
    let mesh = &judged.case.mesh;
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    judged
        .frames
        .iter()
        .map(
            |Frame {
                 map, truth, place, ..
             }| {
                let like = likeness(&map.values, &truth.values, &areas);
                let found = map.found(&centroids, &areas);
                let at = place.or_else(|| truth.found(&centroids, &areas));
                let image = raster.image(&map.values)?;
                let wanted = raster.image(&truth.values)?;
                let greit = at.and_then(|at| image.greit(raster.place(at)).ok());
                Ok(OfFrame {
                    error_mm: place
                        .zip(found)
                        .map(|(at, found)| 1e3 * (found[0] - at[0]).hypot(found[1] - at[1])),
                    correlation: like.correlation,
                    relative_error: like.relative_error,
                    dice: like.dice,
                    ssim: image.ssim(&wanted, 1.0).unwrap_or(0.0),
                    greit: greit.map(|g| {
                        [
                            g.amplitude,
                            g.position_error,
                            g.resolution,
                            g.shape_deformation,
                            g.ringing,
                        ]
                    }),
                    peak: map.largest_loss().map_or(0.0, |(_, loss)| loss),
                })
            },
        )
        .collect()
}

/// Means of the figures over all frames.
pub fn figures(name: &str, judged: &Judged, frames: &[OfFrame]) -> Figures {
    let mean_of_known = |value: fn(&OfFrame) -> f64| average_of_known(frames.iter().map(value));
    let errors = || frames.iter().filter_map(|frame| frame.error_mm);
    let greit = |k: usize| {
        average(
            frames
                .iter()
                .filter_map(|frame| frame.greit.map(|greit| greit[k])),
        )
    };
    let mut times: Vec<f64> = judged.frames.iter().map(|frame| frame.ms).collect();
    Figures {
        set: judged.set.clone(),
        method: name.to_owned(),
        frames: frames.len(),
        error_mm: average(errors()),
        worst_mm: errors().reduce(f64::max).unwrap_or(f64::NAN),
        correlation: mean_of_known(|frame| frame.correlation),
        relative_error: mean_of_known(|frame| frame.relative_error),
        dice: mean_of_known(|frame| frame.dice),
        ssim: average(frames.iter().map(|frame| frame.ssim)),
        greit: [0, 1, 2, 3, 4].map(greit),
        ms: median(&mut times),
    }
}
