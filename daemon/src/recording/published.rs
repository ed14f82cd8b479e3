//! A frame with its quality and its map, as passed to every sink.

use std::sync::OnceLock;
use std::time::Duration;

use dbus::{FrameQuality, MapDetails};
use eit::Pressure;
use imaging::Tracked;
use imaging::quantities::FrameQuantities;
use logbook::MapRecord;
use serde::Serialize;
use survey::{Frame, Map, MapQuality, Quality};

/// A frame and the results of its processing.
#[derive(Debug, Clone)]
pub(crate) struct Published {
    pub frame: Frame,
    pub quality: Quality,
    pub map: Option<Map>,
    /// Position of the load, m; `None` if no loss is above the noise.
    pub found: Option<[f64; 2]>,
    /// The largest loss that noise alone causes in the map.
    pub noise: Option<f64>,
    /// The map as pressure, if the method is calibrated.
    pub pressure: Option<Pressure>,
    /// The comparison of the frame with the tracked baseline.
    pub tracked: Option<Tracked>,
    /// Quantities of the map.
    pub quantities: Option<FrameQuantities>,
    /// Computing time of the map.
    pub reconstruction: Duration,
    /// The map's entry in the record.
    pub record: Option<MapRecord>,
    /// Time from the last reading until the frame was on disk, including the map; set by the logbook.
    pub durable: OnceLock<Duration>,
}

impl Published {
    /// A frame without a map that is not on disk yet.
    pub(crate) fn new(quality: Quality, frame: Frame) -> Self {
        Self {
            frame,
            quality,
            map: None,
            found: None,
            noise: None,
            pressure: None,
            tracked: None,
            quantities: None,
            reconstruction: Duration::ZERO,
            record: None,
            durable: OnceLock::new(),
        }
    }

    /// Numbers of readings that are not voltages, and reciprocity.
    pub(crate) fn quality_details(&self) -> FrameQuality {
        let quality = &self.quality;
        FrameQuality {
            overloads: Some(quality.overloads as u64),
            not_measured: Some(quality.not_measured as u64),
            compliance: Some(quality.compliance.len() as u64),
            duration_s: Some(self.frame.duration.as_secs_f64()),
            implausible: Some(quality.implausible as u64),
            flags: Some(quality.words()),
            reciprocity: quality.reciprocity,
            loop_sum: quality.loop_sum,
        }
    }

    /// Position and size of the load; empty without a map.
    pub(crate) fn map_details(&self) -> MapDetails {
        let Some(map) = &self.map else {
            return MapDetails::default();
        };
        let pressure = self.pressure.as_ref();
        MapDetails {
            masked: Some(map.masked as u64),
            reconstruction_s: Some(self.reconstruction.as_secs_f64()),
            durable_s: self.durable.get().map(Duration::as_secs_f64),
            evidence: map.evidence.as_ref().map(json),
            largest_loss: map.largest_loss().map(|(_, loss)| loss),
            significant: map.is_significant(self.noise),
            noise: self.noise,
            found_x_m: self.found.map(|[x, _]| x),
            found_y_m: self.found.map(|[_, y]| y),
            newtons: pressure.map(|pressure| pressure.newtons),
            largest_kpa: pressure.map(Pressure::largest_kpa),
            quality: map
                .quality
                .as_ref()
                .map(|found| found.verdict.word().to_owned()),
            doubts: map
                .quality
                .as_ref()
                .filter(|found| !found.is_silent())
                .map(MapQuality::text),
            known: self.tracked.as_ref().map(|tracked| tracked.known),
            tracked: self.tracked.as_ref().map(json),
            quantities: self.quantities.as_ref().map(json),
            // bulk data, which signals must not contain
            deviations: None,
            deviations_sequence: None,
        }
    }
}

/// A part of the details as JSON text.
pub(super) fn json(part: &impl Serialize) -> String {
    serde_json::json!(part).to_string()
}
