//! A recorded frame with the baseline to compare it with: its map and its quantities.

use eit::Pressure;
use imaging::quantities::{ComparedReadings, FrameQuantities, JudgedMap, Quantifier};
use imaging::recorded::{RecordedFrame, Recording};
use imaging::{Tracked, TrackedFrame};
use survey::{Map, Reading};

use crate::failure::Failure;
use crate::maps::reconstruction::Reconstruction;

/// A map, and its pressures if there is a calibration.
pub(crate) type ShownMap = (Map, Option<Pressure>);

/// A frame, its baseline, and the result of tracking for it.
pub(crate) struct Compared<'a> {
    baseline: &'a [Reading],
    /// The first baseline plus the tracked drift alone, constant while a load is on the sheet. Standard deviations count
    /// the drift that it lacks as an error, and one sheet is fitted for all frames of a load.
    tracked_baseline: &'a [Reading],
    readings: &'a [Reading],
    tracked: Option<&'a Tracked>,
}

impl<'a> Compared<'a> {
    /// Compares the frame with the baseline that was tracked to it, or without one with the recording's own baseline.
    pub(crate) fn new(
        recording: &'a Recording,
        recorded: &'a RecordedFrame,
        followed: Option<&'a TrackedFrame>,
    ) -> Self {
        let own = &recording.unloaded.readings;
        let (baseline, tracked_baseline, readings) = match followed {
            Some(frame) => (&frame.baseline, &frame.tracked_baseline, &frame.readings),
            None => (own, own, &recorded.readings),
        };
        Self {
            baseline,
            tracked_baseline,
            readings,
            tracked: followed.map(|frame| &frame.tracked),
        }
    }

    /// The map.
    ///
    /// # Errors
    /// Too many missing readings, or readings that the method cannot use.
    pub(crate) fn map(&self, reconstruction: &Reconstruction) -> Result<Map, Failure> {
        reconstruction.map(self.baseline, self.readings)
    }

    /// Standard deviation of ln conductance of each triangle; NaN if the frame gives no information about it.
    ///
    /// # Errors
    /// The standard deviation is unknown.
    pub(crate) fn deviation(&self, reconstruction: &Reconstruction) -> Result<Vec<f64>, Failure> {
        reconstruction.map_deviation(self.tracked_baseline, self.readings)
    }

    /// The quantities and the map. For a frame without a map, the quantities contain only the reason. `at_s`: time of
    /// the frame, s of the Unix epoch; `None` if unknown.
    ///
    /// # Errors
    /// The calibration that the options name does not fit the map.
    pub(crate) fn quantities(
        &self,
        reconstruction: &Reconstruction,
        quantifier: &mut Quantifier,
        at_s: Option<f64>,
    ) -> Result<(FrameQuantities, Option<ShownMap>), Failure> {
        let map = match self.map(reconstruction) {
            Ok(map) => map,
            Err(refused) => {
                let without = FrameQuantities {
                    reason: Some(refused.to_string()),
                    ..quantifier.take(at_s, None)
                };
                return Ok((without, None));
            }
        };
        let pressure = reconstruction.pressure(&map)?;
        let judged = JudgedMap {
            map: &map,
            pressure: pressure.as_ref(),
            noise: reconstruction.noise,
            tracked: self.tracked,
            compared: Some(ComparedReadings {
                baseline: self.baseline,
                readings: self.readings,
            }),
        };
        let quantities = quantifier.take(at_s, Some(&judged));
        Ok((quantities, Some((map, pressure))))
    }
}
