//! Quantities over time: dose and unrelieved time of each triangle, and the path of the centre of pressure.

mod state;

use std::collections::VecDeque;

use super::quantity::{Quantity, Values};
use super::surface::Surface;
pub(super) use state::CourseState;

/// Number of parts of the window over which the unrelieved area is counted.
const PARTS: f64 = 48.0;
/// Least share of the window's known time for which an unrelieved triangle is loaded.
const SHARE: f64 = 0.95;
/// Least share of the window that must be known for an unrelieved area.
const KNOWN: f64 = 0.95;

/// Settings of quantities over time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CourseSettings {
    /// Least value of a loaded triangle.
    pub(super) threshold: f64,
    /// A triangle is relieved after this time below the threshold, s.
    pub(super) relief_s: f64,
    /// Time over which the unrelieved area is counted, s.
    pub(super) window_s: f64,
    /// Longest time for which a frame's values hold, s; a longer interval to the next known frame counts as unknown.
    pub(super) hold_s: f64,
}

/// The loads over time, updated frame by frame.
#[derive(Debug, Clone)]
pub(super) struct Course {
    settings: CourseSettings,
    /// Time and loads of the last known frame.
    last: Option<(f64, Vec<f64>)>,
    dose: Vec<f64>,
    /// Excess of each dose by rounding (see [`add_compensated`]): months of frames are added one by one.
    dose_excess: Vec<f64>,
    unrelieved: Vec<f64>,
    /// Time since each triangle fell below the threshold.
    relieved: Vec<f64>,
    parts: VecDeque<Part>,
    /// For each region: the path of the centre of pressure (last centre in mm and its time in s, speed in mm/s, length
    /// in mm).
    paths: Vec<Path>,
}

/// A part of the window.
#[derive(Debug, Clone)]
struct Part {
    index: i64,
    known_s: f64,
    loaded_s: Vec<f64>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Path {
    last: Option<(f64, [f64; 2])>,
    speed: Option<f64>,
    length: f64,
}

/// Centroids of the triangles with the largest values over a region, m; `None` without a value above zero.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct CoursePlaces {
    pub(super) dose: Option<[f64; 2]>,
    pub(super) unrelieved: Option<[f64; 2]>,
}

/// Adds `part` to a sum of many small parts (Kahan's compensated summation). `excess` begins at 0 and keeps the amount
/// by which rounding made the sum too large.
pub fn add_compensated(sum: &mut f64, excess: &mut f64, part: f64) {
    let part = part - *excess;
    let next = *sum + part;
    *excess = (next - *sum) - part;
    *sum = next;
}

impl Course {
    pub(super) fn new(settings: CourseSettings, triangles: usize, regions: usize) -> Self {
        Self {
            settings,
            last: None,
            dose: vec![0.0; triangles],
            dose_excess: vec![0.0; triangles],
            unrelieved: vec![0.0; triangles],
            relieved: vec![0.0; triangles],
            parts: VecDeque::new(),
            paths: vec![Path::default(); regions],
        }
    }

    /// Integral over time of the value above the threshold, for each triangle.
    pub(super) fn dose(&self) -> &[f64] {
        &self.dose
    }

    /// Unrelieved time of each triangle, s.
    pub(super) fn unrelieved(&self) -> &[f64] {
        &self.unrelieved
    }

    /// Adds the next frame, whose values hold until the frame after it.
    pub(super) fn take(&mut self, at_s: f64, loads: &[f64], of_regions: &[Values]) {
        let CourseSettings {
            threshold,
            relief_s,
            hold_s,
            ..
        } = self.settings;
        if let Some((before_s, before)) = self.last.take() {
            let step = at_s - before_s;
            if step > 0.0 && step <= hold_s {
                for (triangle, value) in before.iter().enumerate() {
                    let part = (value - threshold).max(0.0) * step;
                    let excess = &mut self.dose_excess[triangle];
                    add_compensated(&mut self.dose[triangle], excess, part);
                    if *value >= threshold {
                        self.unrelieved[triangle] += step;
                        self.relieved[triangle] = 0.0;
                    } else {
                        self.relieved[triangle] += step;
                        if self.relieved[triangle] >= relief_s {
                            self.unrelieved[triangle] = 0.0;
                        }
                    }
                }
                self.count(before_s, step, &before);
            }
        }
        self.last = Some((at_s, loads.to_vec()));
        for (path, values) in self.paths.iter_mut().zip(of_regions) {
            path.take(at_s, values, hold_s);
        }
    }

    /// Adds the time for which a frame's values held to the window.
    fn count(&mut self, at_s: f64, step: f64, loads: &[f64]) {
        let index = (at_s * PARTS / self.settings.window_s).floor() as i64;
        let last = self.parts.back().map_or(index, |part| part.index);
        if last > index {
            // the clock was set back: renumber the parts so far to end just before this one, so that they leave the
            // window in order
            for part in &mut self.parts {
                part.index = part.index.saturating_sub(last - index + 1);
            }
        }
        if self.parts.back().is_none_or(|part| part.index != index) {
            self.parts.push_back(Part {
                index,
                known_s: 0.0,
                loaded_s: vec![0.0; loads.len()],
            });
        }
        if let Some(part) = self.parts.back_mut() {
            part.known_s += step;
            for (sum, value) in part.loaded_s.iter_mut().zip(loads) {
                if *value >= self.settings.threshold {
                    *sum += step;
                }
            }
        }
        while self
            .parts
            .front()
            .is_some_and(|part| part.index <= index - PARTS as i64)
        {
            self.parts.pop_front();
        }
    }

    /// Adds the quantities over time of a region (given by its position in the surface) to those of the map.
    pub(super) fn complete(
        &self,
        surface: &Surface,
        region: usize,
        values: &mut Values,
    ) -> CoursePlaces {
        let shares = &surface.region_list()[region].shares;
        let largest = |of: &[f64]| {
            let inside = (0..of.len()).filter(|t| shares[*t] >= 0.5);
            inside.max_by(|a, b| of[*a].total_cmp(&of[*b]))
        };
        let at = |of: &[f64], triangle: usize| {
            Some(surface.adjacency().centroids()[triangle]).filter(|_| of[triangle] > 0.0)
        };
        let (dose, unrelieved) = (largest(&self.dose), largest(&self.unrelieved));
        values.set(Quantity::Dose, dose.map(|t| self.dose[t]));
        values.set(Quantity::Unrelieved, unrelieved.map(|t| self.unrelieved[t]));
        values.set(
            Quantity::UnrelievedArea,
            self.unrelieved_area(surface, shares),
        );
        let path = &self.paths[region];
        values.set(Quantity::Speed, path.speed);
        values.set(Quantity::Path, Some(path.length));
        CoursePlaces {
            dose: dose.and_then(|t| at(&self.dose, t)),
            unrelieved: unrelieved.and_then(|t| at(&self.unrelieved, t)),
        }
    }

    /// Area loaded for 95 % of the known time of the window, mm2; `None` if less than 95 % of the window is known.
    fn unrelieved_area(&self, surface: &Surface, shares: &[f64]) -> Option<f64> {
        let known: f64 = self.parts.iter().map(|part| part.known_s).sum();
        if known < KNOWN * self.settings.window_s {
            return None;
        }
        let areas = surface.adjacency().areas();
        let unrelieved = (0..areas.len()).filter(|t| {
            let loaded: f64 = self.parts.iter().map(|part| part.loaded_s[*t]).sum();
            loaded >= SHARE * known
        });
        Some(1e6 * unrelieved.map(|t| shares[t] * areas[t]).sum::<f64>())
    }
}

impl Path {
    fn take(&mut self, at_s: f64, values: &Values, hold_s: f64) {
        let centre = values
            .get(Quantity::CentreX)
            .zip(values.get(Quantity::CentreY));
        // without contact the centre is that of the noise
        let loaded = values.get(Quantity::Contact).is_some_and(|area| area > 0.0);
        let Some((x, y)) = centre.filter(|_| loaded) else {
            (self.last, self.speed) = (None, None);
            return;
        };
        let moved = self
            .last
            .filter(|(before_s, _)| at_s > *before_s && at_s - before_s <= hold_s);
        self.speed = moved.map(|(before_s, from)| {
            let distance = (x - from[0]).hypot(y - from[1]);
            self.length += distance;
            distance / (at_s - before_s)
        });
        self.last = Some((at_s, [x, y]));
    }
}
