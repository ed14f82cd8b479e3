//! The state of a [`Course`], stored so that a resumed session computes the same bits as an uninterrupted one.

use drift::bits;
use serde::{Deserialize, Serialize};

use super::{Course, CourseSettings, Part, Path};

/// Everything except the surface that later values depend on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CourseState {
    /// Settings for which the state holds.
    #[serde(with = "bits")]
    settings: Vec<f64>,
    triangles: usize,
    #[serde(with = "bits::option")]
    last_s: Option<f64>,
    /// Loads of the last frame at or above the threshold; smaller ones have no effect.
    last: Sparse,
    dose: Sparse,
    dose_excess: Sparse,
    unrelieved: Sparse,
    /// Only for triangles with an unrelieved time; for the others it has no effect.
    relieved: Sparse,
    parts: Vec<PartState>,
    paths: Vec<PathState>,
}

/// Values other than zero.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sparse {
    at: Vec<usize>,
    #[serde(with = "bits")]
    values: Vec<f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PartState {
    index: i64,
    #[serde(with = "bits::number")]
    known_s: f64,
    loaded_s: Sparse,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PathState {
    /// Time, x and y of the last centre; empty if there is none.
    #[serde(with = "bits")]
    last: Vec<f64>,
    #[serde(with = "bits::option")]
    speed: Option<f64>,
    #[serde(with = "bits::number")]
    length: f64,
}

impl Sparse {
    fn of(values: &[f64], keeps: impl Fn(usize, f64) -> bool) -> Self {
        let kept = |(triangle, value): &(usize, &f64)| keeps(*triangle, **value);
        let (at, values) = values.iter().enumerate().filter(kept).unzip();
        Self { at, values }
    }

    /// One value for each triangle, `elsewhere` for those that are not listed; `None` if the list does not fit that
    /// many triangles.
    fn values(&self, triangles: usize, elsewhere: f64) -> Option<Vec<f64>> {
        let mut values = vec![elsewhere; triangles];
        if self.at.len() != self.values.len() {
            return None;
        }
        for (triangle, value) in self.at.iter().zip(&self.values) {
            *values.get_mut(*triangle)? = *value;
        }
        Some(values)
    }
}

impl CourseSettings {
    fn numbers(&self) -> Vec<f64> {
        vec![self.threshold, self.relief_s, self.window_s, self.hold_s]
    }
}

impl Course {
    pub(crate) fn state(&self) -> CourseState {
        let some = |_: usize, value: f64| value != 0.0;
        let part = |part: &Part| PartState {
            index: part.index,
            known_s: part.known_s,
            loaded_s: Sparse::of(&part.loaded_s, some),
        };
        let path = |path: &Path| PathState {
            last: path
                .last
                .map_or(Vec::new(), |(at_s, [x, y])| vec![at_s, x, y]),
            speed: path.speed,
            length: path.length,
        };
        let loads = self.last.as_ref().map_or(&[][..], |(_, loads)| loads);
        CourseState {
            settings: self.settings.numbers(),
            triangles: self.dose.len(),
            last_s: self.last.as_ref().map(|(at_s, _)| *at_s),
            last: Sparse::of(loads, |_, load| load >= self.settings.threshold),
            dose: Sparse::of(&self.dose, some),
            dose_excess: Sparse::of(&self.dose_excess, some),
            unrelieved: Sparse::of(&self.unrelieved, some),
            relieved: Sparse::of(&self.relieved, |triangle, _| {
                self.unrelieved[triangle] > 0.0
            }),
            parts: self.parts.iter().map(part).collect(),
            paths: self.paths.iter().map(path).collect(),
        }
    }

    /// A course with this surface and a stored state; `None` if the state has other settings, regions or triangles.
    pub(crate) fn restored(&self, state: &CourseState) -> Option<Self> {
        let triangles = self.dose.len();
        let same_bits = |a: &[f64], b: &[f64]| {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
        };
        if !same_bits(&state.settings, &self.settings.numbers())
            || state.triangles != triangles
            || state.paths.len() != self.paths.len()
        {
            return None;
        }
        let zeros = |sparse: &Sparse| sparse.values(triangles, 0.0);
        // minus infinity is below any threshold
        let loads = state.last.values(triangles, f64::NEG_INFINITY)?;
        let part = |part: &PartState| {
            Some(Part {
                index: part.index,
                known_s: part.known_s,
                loaded_s: zeros(&part.loaded_s)?,
            })
        };
        let path = |path: &PathState| {
            let last = match path.last[..] {
                [] => None,
                [at_s, x, y] => Some((at_s, [x, y])),
                _ => return None,
            };
            Some(Path {
                last,
                speed: path.speed,
                length: path.length,
            })
        };
        Some(Self {
            settings: self.settings,
            last: state.last_s.map(|at_s| (at_s, loads)),
            dose: zeros(&state.dose)?,
            dose_excess: zeros(&state.dose_excess)?,
            unrelieved: zeros(&state.unrelieved)?,
            relieved: zeros(&state.relieved)?,
            parts: state.parts.iter().map(part).collect::<Option<_>>()?,
            paths: state.paths.iter().map(path).collect::<Option<_>>()?,
        })
    }
}
