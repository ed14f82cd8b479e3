//! A frame with its quality and its map, as every sink gets it.

use std::sync::OnceLock;
use std::time::Duration;

use dbus::{FrameQuality, MapDetails};
use eit::Pressure;
use logbook::MapRecord;
use survey::{Frame, Map, Quality};

/// A frame and what was made of it.
#[derive(Debug, Clone)]
pub(crate) struct Published {
    pub frame: Frame,
    pub quality: Quality,
    pub map: Option<Map>,
    /// Where the load was found, m; `None` where no loss is above the noise.
    pub found: Option<[f64; 2]>,
    /// The largest loss that noise alone makes of the map.
    pub noise: Option<f64>,
    /// The map as pressure, where the method is calibrated.
    pub pressure: Option<Pressure>,
    /// What the map took.
    pub reconstruction: Duration,
    /// How the record says by what the map was made.
    pub record: Option<MapRecord>,
    /// From the last reading until the frame was on disk, the map included; set by the logbook.
    pub durable: OnceLock<Duration>,
}

impl Published {
    /// A frame without a map, and not on disk yet.
    pub(crate) fn new(quality: Quality, frame: Frame) -> Self {
        Self {
            frame,
            quality,
            map: None,
            found: None,
            noise: None,
            pressure: None,
            reconstruction: Duration::ZERO,
            record: None,
            durable: OnceLock::new(),
        }
    }

    /// Counts of readings that are no voltages, and reciprocity.
    pub(crate) fn quality_details(&self) -> FrameQuality {
        let quality = &self.quality;
        FrameQuality {
            overloads: Some(quality.overloads as u64),
            timeouts: Some(quality.timeouts as u64),
            not_measured: Some(quality.not_measured as u64),
            compliance: Some(quality.compliance.len() as u64),
            duration_s: Some(self.frame.duration.as_secs_f64()),
            implausible: Some(quality.implausible as u64),
            flags: Some(quality.words()),
            reciprocity: quality.reciprocity,
            loop_sum: quality.loop_sum,
        }
    }

    /// Where the load was found, and how large it is; empty where there is no map.
    pub(crate) fn map_details(&self) -> MapDetails {
        let Some(map) = &self.map else {
            return MapDetails::default();
        };
        let pressure = self.pressure.as_ref();
        MapDetails {
            masked: Some(map.masked as u64),
            reconstruction_s: Some(self.reconstruction.as_secs_f64()),
            durable_s: self.durable.get().map(Duration::as_secs_f64),
            largest_loss: map.largest_loss().map(|(_, loss)| loss),
            significant: map.is_significant(self.noise),
            noise: self.noise,
            found_x_m: self.found.map(|[x, _]| x),
            found_y_m: self.found.map(|[_, y]| y),
            newtons: pressure.map(|pressure| pressure.newtons),
            largest_kpa: pressure.map(Pressure::largest_kpa),
        }
    }
}
