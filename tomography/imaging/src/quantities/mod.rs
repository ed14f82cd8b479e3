//! Quantities of a map and of its course over time: contact area, load, peak pressure index, centre of pressure, dose,
//! hot spots and others, for the whole sheet and for named regions.
//!
//! Lengths in results are mm, areas mm2, pressures kPa, loads N; without a calibration values are relative losses of
//! conductance and a load is their integral, mm2. A gain of conductance counts as no load.
//!
//! Formulas: ISO/TR 16840-9:2015 (contact area, load, mean, dispersion, variation), the BodiTrak manual (peak pressure
//! index over 9 to 10 cm2, threshold of 5 mmHg), Peterson et al., JRRD 50(4), 2013 (unrelieved area); dose is the
//! pressure-time integral above the threshold (Reswick and Rogers, 1976).

mod course;
mod deviation;
mod frame;
mod minutes;
mod quantity;
mod region;
mod stored;
mod surface;
#[cfg(test)]
mod tests;
mod tracks;

use eit::Pressure;
use serde::{Deserialize, Serialize};
use survey::{HotSpot, Map, Verdict};

use crate::model::Model;
use crate::tracking::Tracked;
pub use course::add_compensated;
use course::{Course, CoursePlaces, CourseSettings, CourseState};
pub use deviation::{ComparedReadings, Deviation};
use deviation::{Described, Deviations};
pub use minutes::{QuantityRow, Rows};
pub use quantity::{LoadUnit, Quantity, Values};
pub use region::{RegionError, RegionSettings, RegionShape, SHEET, check_regions, is_name};
pub use stored::{
    KeptCourse, STORED_S, joined, keep_course, keep_newest_unit, kept_course, store, stored,
};
pub use surface::Surface;
use tracks::{STAYS, Tracks, TracksState};
pub use tracks::{SpotChange, SpotTrack, SpotUncertainty};

/// kPa of one mmHg.
pub const KPA_PER_MMHG: f64 = 0.133_322;

/// `[quantities]`: thresholds and windows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct QuantitySettings {
    /// Least pressure of the contact area, kPa.
    pub threshold_kpa: f64,
    /// Least relative loss of conductance of the contact area, %, for a map without calibration.
    pub threshold_percent: f64,
    /// Area of the disc of the peak pressure index, cm2.
    pub window_cm2: f64,
    /// A triangle is relieved after this time below the threshold, s.
    pub relief_s: f64,
    /// Time over which the unrelieved area is counted, h.
    pub unrelieved_h: f64,
    /// Longest time for which the values of a frame hold, s; a longer interval to the next known frame counts as
    /// unknown.
    pub hold_s: f64,
}

impl Default for QuantitySettings {
    fn default() -> Self {
        Self {
            threshold_kpa: 0.667,
            threshold_percent: 5.0,
            window_cm2: 9.5,
            relief_s: 60.0,
            unrelieved_h: 4.0,
            hold_s: 900.0,
        }
    }
}

/// A map and the information on whether it can be relied on.
#[derive(Debug, Clone, Copy)]
pub struct JudgedMap<'a> {
    /// The map, relative.
    pub map: &'a Map,
    /// The map converted to pressure; `None` without a calibration.
    pub pressure: Option<&'a Pressure>,
    /// The largest loss by noise alone; `None` if unknown.
    pub noise: Option<f64>,
    /// Result of the tracked baseline for the frame.
    pub tracked: Option<&'a Tracked>,
    /// Readings from which the map was made, for standard deviations; `None` if these are not needed.
    pub compared: Option<ComparedReadings<'a>>,
}

/// The quantities of a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameQuantities {
    /// Whether the map can be relied on.
    pub known: bool,
    /// Why the map cannot be relied on, as a sentence; `None` if it can.
    pub reason: Option<String>,
    /// Meaning of the map's values.
    pub unit: LoadUnit,
    /// The whole sheet first, then the named regions.
    pub regions: Vec<RegionQuantities>,
    /// Hot spots of the sheet, the highest first; those of the last known frame if this one cannot be relied on.
    pub spots: Vec<SpotTrack>,
    /// Changes of hot spots with this frame.
    pub changes: Vec<SpotChange>,
}

impl FrameQuantities {
    /// Load, contact area and peak pressure index of the whole sheet as a short text; `None` without a load.
    pub fn summary(&self) -> Option<String> {
        let values = &self.regions.first()?.values;
        let contact = values.get(Quantity::Contact).filter(|area| *area > 0.0);
        contact?;
        let shown = |quantity: Quantity| {
            let value = values.get(quantity)?;
            Some(format!(
                "{} {} {}",
                quantity.name(),
                rounded(value),
                quantity.unit(self.unit)
            ))
        };
        let parts = [Quantity::Load, Quantity::Contact, Quantity::Ppi].map(shown);
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        Some(parts.join(", "))
    }
}

/// The quantities of a region.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RegionQuantities {
    /// Its name; [`SHEET`] for the whole sheet.
    pub name: String,
    /// The values; only [`Quantity::Known`] if the map cannot be relied on.
    pub values: Values,
    /// Standard deviations by noise; see [`Deviation`].
    pub deviations: Values,
    /// Position of the peak, x and y, mm.
    pub peak_mm: Option<[f64; 2]>,
    /// Centre of the disc of the peak pressure index, mm.
    pub ppi_mm: Option<[f64; 2]>,
    /// Position of the largest dose, mm.
    pub dose_mm: Option<[f64; 2]>,
    /// Position of the longest unrelieved time, mm.
    pub unrelieved_mm: Option<[f64; 2]>,
}

/// The state of a [`Quantifier`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuantifierState {
    /// Hash of the mesh of the maps.
    mesh: String,
    unit: LoadUnit,
    regions: Vec<String>,
    course: CourseState,
    tracks: TracksState,
}

/// Computes the quantities of consecutive frames.
#[derive(Clone)]
pub struct Quantifier {
    surface: Surface,
    settings: QuantitySettings,
    unit: LoadUnit,
    course: Course,
    tracks: Tracks,
    deviation: Option<Deviation>,
}

impl Quantifier {
    /// A quantifier for the maps of a model, in kPa if it has a calibration.
    ///
    /// # Errors
    /// A region that is invalid or outside of the map.
    pub fn new(
        model: &Model,
        settings: &QuantitySettings,
        regions: &[RegionSettings],
    ) -> Result<Self, RegionError> {
        check_regions(regions).map_err(|(_, error)| error)?;
        let surface = Surface::new(
            model.reconstructor.mesh(),
            1e-4 * settings.window_cm2,
            regions,
        )?;
        let unit = match model.calibration {
            Some(_) => LoadUnit::Pressure,
            None => LoadUnit::RelativeLoss,
        };
        Ok(Self::of_surface(surface, settings.clone(), unit))
    }

    /// Also computes standard deviations by noise, at the cost of reconstructing each frame 16 times.
    pub fn with_deviation(mut self, deviation: Option<Deviation>) -> Self {
        self.deviation = deviation;
        self
    }

    /// A quantifier for maps on a surface.
    pub fn of_surface(surface: Surface, settings: QuantitySettings, unit: LoadUnit) -> Self {
        let course = CourseSettings {
            threshold: threshold(&settings, unit),
            relief_s: settings.relief_s,
            window_s: 3600.0 * settings.unrelieved_h,
            hold_s: settings.hold_s,
        };
        let triangles = surface.adjacency().areas().len();
        let regions = surface.region_list().len();
        Self {
            course: Course::new(course, triangles, regions),
            surface,
            settings,
            unit,
            tracks: Tracks::default(),
            deviation: None,
        }
    }

    /// Meaning of the values.
    pub fn unit(&self) -> LoadUnit {
        self.unit
    }

    /// Its thresholds and windows.
    pub fn settings(&self) -> &QuantitySettings {
        &self.settings
    }

    /// The surface of the maps.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Dose of each triangle, [`Quantity::Dose`] and its unit.
    pub fn dose(&self) -> &[f64] {
        self.course.dose()
    }

    /// Unrelieved time of each triangle, s; see [`Quantity::Unrelieved`].
    pub fn unrelieved(&self) -> &[f64] {
        self.course.unrelieved()
    }

    /// The state that later quantities depend on, without surface and settings.
    pub fn state(&self) -> QuantifierState {
        QuantifierState {
            mesh: self.surface.mesh().to_owned(),
            unit: self.unit,
            regions: self.surface.regions().map(str::to_owned).collect(),
            course: self.course.state(),
            tracks: self.tracks.state(),
        }
    }

    /// Continues from a stored state: later quantities have the same bits as without the interruption.
    ///
    /// # Errors
    /// The reason, if the state belongs to other maps, regions or settings; nothing is changed then.
    pub fn restore(&mut self, state: &QuantifierState) -> Result<(), &'static str> {
        if state.mesh != self.surface.mesh() || state.unit != self.unit {
            return Err("the maps are on another mesh or in another unit");
        }
        if !state
            .regions
            .iter()
            .map(String::as_str)
            .eq(self.surface.regions())
        {
            return Err("the regions are not the same");
        }
        let course = self.course.restored(&state.course);
        let course = course.ok_or("thresholds or windows are not the same")?;
        let tracks = Tracks::restored(&state.tracks).ok_or("its hot spots are not complete")?;
        (self.course, self.tracks) = (course, tracks);
        Ok(())
    }

    /// The quantities of the next frame; `None` for a frame without a map. `at_s`: its time, s since the Unix epoch;
    /// `None` for a recording without times, whose quantities over time are unknown.
    pub fn take(
        &mut self,
        at_s: impl Into<Option<f64>>,
        judged: Option<&JudgedMap<'_>>,
    ) -> FrameQuantities {
        let at_s = at_s.into();
        let refused = match judged {
            None => Some("the frame has no map".to_owned()),
            Some(judged) => unreliable(judged.map).or(self.without_pressure(judged)),
        };
        let Some(judged) = judged.filter(|_| refused.is_none()) else {
            return self.unknown(at_s, refused);
        };
        let loads = self.loads(judged);
        let mut found = frame::of_map(&self.surface, &loads, self.threshold(), self.unit);
        let values: Vec<Values> = found.iter().map(|found| found.values).collect();
        if let Some(at_s) = at_s {
            self.course.take(at_s, &loads, &values);
        }
        let spots = self.hot_spots(&loads);
        // no time passes between frames without times
        let changes = self
            .tracks
            .take(at_s.unwrap_or_default(), &spots, self.threshold());
        for (region, found) in self.surface.region_list().iter().zip(&mut found) {
            let spots = self.tracks.spots();
            let inside = spots.filter(|spot| region.has(&self.surface, spot.centre));
            let count = inside.count() as f64;
            found.values.set(Quantity::HotSpots, Some(count));
        }
        let doubt = judged.tracked.filter(|tracked| !tracked.known);
        let known = if doubt.is_none() { 1.0 } else { 0.0 };
        let deviations = self.deviations(judged);
        let regions = found
            .iter_mut()
            .zip(deviations.regions)
            .enumerate()
            .map(|(index, (found, deviations))| {
                let places = match at_s {
                    Some(_) => self
                        .course
                        .complete(&self.surface, index, &mut found.values),
                    None => CoursePlaces::default(),
                };
                found.values.set(Quantity::Known, Some(known));
                let millimetres = |place: Option<[f64; 2]>| place.map(|at| at.map(|m| 1e3 * m));
                RegionQuantities {
                    name: self.surface.region_list()[index].name.clone(),
                    values: found.values,
                    deviations,
                    peak_mm: millimetres(found.peak),
                    ppi_mm: millimetres(found.ppi),
                    dose_mm: millimetres(places.dose),
                    unrelieved_mm: millimetres(places.unrelieved),
                }
            })
            .collect();
        FrameQuantities {
            known: doubt.is_none(),
            reason: doubt.map(|tracked| {
                let words = tracked.reason.map_or("not known", |reason| reason.words());
                tracked.text.clone().unwrap_or_else(|| words.to_owned())
            }),
            unit: self.unit,
            regions,
            spots: self.spots(at_s, &deviations.spots),
            changes,
        }
    }

    /// The hot spots of the last frame with a map.
    fn spots(&self, at_s: Option<f64>, uncertain: &[Option<SpotUncertainty>]) -> Vec<SpotTrack> {
        let spots = self.tracks.list(self.unit, uncertain).into_iter();
        spots
            .map(|spot| SpotTrack {
                age_s: spot.age_s.filter(|_| at_s.is_some()),
                ..spot
            })
            .collect()
    }

    fn unknown(&self, at_s: Option<f64>, reason: Option<String>) -> FrameQuantities {
        let mut not_known = Values::default();
        not_known.set(Quantity::Known, Some(0.0));
        let region = |name: &str| RegionQuantities {
            name: name.to_owned(),
            values: not_known,
            deviations: Values::default(),
            peak_mm: None,
            ppi_mm: None,
            dose_mm: None,
            unrelieved_mm: None,
        };
        FrameQuantities {
            known: false,
            reason,
            unit: self.unit,
            regions: self.surface.regions().map(region).collect(),
            spots: self.spots(at_s, &[]),
            changes: Vec::new(),
        }
    }

    /// The reason if quantities are in kPa and the map has no pressure; otherwise `None`.
    fn without_pressure(&self, judged: &JudgedMap<'_>) -> Option<String> {
        (self.unit == LoadUnit::Pressure && judged.pressure.is_none())
            .then(|| "the calibration does not belong to this map".to_owned())
    }

    fn threshold(&self) -> f64 {
        threshold(&self.settings, self.unit)
    }

    /// The hot spots of a map, down to the lower threshold of those that already exist ([`STAYS`]).
    fn hot_spots(&self, loads: &[f64]) -> Vec<HotSpot> {
        let adjacency = self.surface.adjacency();
        adjacency.hot_spots(loads, STAYS * self.threshold())
    }

    /// The load of each triangle; all zero if the map is not significant.
    fn loads(&self, judged: &JudgedMap<'_>) -> Vec<f64> {
        if judged.map.is_significant(judged.noise) == Some(false) {
            return vec![0.0; judged.map.values.len()];
        }
        match (self.unit, judged.pressure) {
            (LoadUnit::Pressure, Some(pressure)) => pressure.kpa.clone(),
            (LoadUnit::Pressure | LoadUnit::RelativeLoss, _) => losses(&judged.map.values),
        }
    }

    fn deviations(&self, judged: &JudgedMap<'_>) -> Deviations {
        let regions = self.surface.region_list().len();
        let significant = judged.map.is_significant(judged.noise) != Some(false);
        let (Some(deviation), Some(frame), true) = (&self.deviation, judged.compared, significant)
        else {
            return Deviations::none(regions);
        };
        let spots: Vec<&HotSpot> = self.tracks.spots().collect();
        let baseline_sd = judged
            .tracked
            .map_or(0.0, |tracked| 1e-6 * tracked.baseline_sd_uv);
        let describe = |map: &Map, pressure: Option<&Pressure>| {
            let loads = pressure.map_or_else(|| losses(&map.values), |p| p.kpa.clone());
            let found = frame::of_map(&self.surface, &loads, self.threshold(), self.unit);
            Described {
                regions: found.into_iter().map(|found| found.values).collect(),
                spots: self.hot_spots(&loads),
            }
        };
        deviation.of(frame, baseline_sd, regions, &spots, self.unit, describe)
    }
}

/// A value as text without an exponent: three significant digits, three decimals below 1, no decimals from 100 on.
pub fn rounded(value: f64) -> String {
    match value.abs() {
        size if size >= 100.0 || size == 0.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        size if size >= 1.0 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

fn threshold(settings: &QuantitySettings, unit: LoadUnit) -> f64 {
    match unit {
        LoadUnit::Pressure => settings.threshold_kpa,
        LoadUnit::RelativeLoss => 1e-2 * settings.threshold_percent,
    }
}

fn losses(values: &[f64]) -> Vec<f64> {
    values.iter().map(|value| (-value).max(0.0)).collect()
}

/// Why the map cannot be relied on; `None` if it can.
fn unreliable(map: &Map) -> Option<String> {
    let quality = map.quality.as_ref()?;
    (quality.verdict == Verdict::Unreliable).then(|| quality.text())
}
