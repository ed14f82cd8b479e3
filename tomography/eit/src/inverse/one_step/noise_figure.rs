//! The noise figure of a linear map, and the hyper-parameter that gives a requested noise figure.

use nalgebra::{DMatrix, DVector};

use crate::Mesh;
use crate::inverse::error::OneStepError;
use crate::inverse::prior::shown_or_all;
use crate::inverse::reciprocity::Fold;

/// Diameter of the load for which a noise figure is computed, as a share of the square root of the region's area.
pub(super) const LOAD: f64 = 0.0543;

/// The noise figure of the linear map M (A. Adler, R. Guardo, IEEE Trans. Med. Imaging 15 (1996) 170): mean |y| over
/// the noise of a reading, divided by mean |a M y| over the root mean square of its noise, with a the areas and y the
/// readings of a small disc in the middle of the unknowns that are shown. The means of maps are over these unknowns
/// (`None`: all).
pub(super) fn of(
    mesh: &Mesh,
    fold: &Fold,
    sensitivity: &DMatrix<f64>,
    map: &DMatrix<f64>,
    shown: Option<&[usize]>,
) -> f64 {
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    let shown = shown_or_all(shown, areas.len());
    let area: f64 = shown.iter().map(|&unknown| areas[unknown]).sum();
    let middle = [0, 1].map(|axis| {
        let moments = shown
            .iter()
            .map(|&unknown| centroids[unknown][axis] * areas[unknown]);
        moments.sum::<f64>() / area
    });
    let away = |at: &[f64; 2]| (at[0] - middle[0]).hypot(at[1] - middle[1]);
    let radius =
        (0.5 * LOAD * area.sqrt()).max(centroids.iter().map(away).fold(f64::INFINITY, f64::min));
    let load = DVector::from_iterator(
        centroids.len(),
        centroids
            .iter()
            .map(|at| f64::from(u8::from(away(at) <= radius))),
    );
    let seen = sensitivity * load;
    let answer = map * &seen;
    let mut noise = vec![0.0; areas.len()];
    for column in map.column_iter() {
        for (sum, value) in noise.iter_mut().zip(&column) {
            *sum += value * value;
        }
    }
    let seen = fold.readings_of(&seen);
    let readings = seen.iter().map(|y| y.abs()).sum::<f64>() / seen.len() as f64;
    let signal = shown
        .iter()
        .map(|&unknown| (answer[unknown] * areas[unknown]).abs())
        .sum::<f64>()
        / shown.len() as f64;
    let spread = shown
        .iter()
        .map(|&unknown| noise[unknown] * areas[unknown].powi(2))
        .sum::<f64>()
        / shown.len() as f64;
    readings * spread.sqrt() / signal
}

/// The lambda with the noise figure `wanted`: the figure falls as lambda grows. Searched between 1e-5 and 1e2 of
/// `size`, to a thousandth.
pub(super) fn lambda(
    wanted: f64,
    size: f64,
    at: impl Fn(f64) -> Result<f64, OneStepError>,
) -> Result<f64, OneStepError> {
    OneStepError::positive("noise figure", wanted)?;
    let (mut low, mut high) = ((1e-5 * size).ln(), (1e2 * size).ln());
    let (most, least) = (at(low.exp())?, at(high.exp())?);
    if !(least..=most).contains(&wanted) {
        return Err(OneStepError::NoiseFigure {
            wanted,
            least,
            most,
        });
    }
    while high - low > 1e-3 {
        let middle = 0.5 * (low + high);
        if at(middle.exp())? > wanted {
            low = middle;
        } else {
            high = middle;
        }
    }
    Ok((0.5 * (low + high)).exp())
}
