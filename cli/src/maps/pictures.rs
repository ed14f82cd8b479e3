//! The maps of a recording as pictures: scale, position found, hot spots with their numbers.

use imaging::TrackedArguments;
use imaging::quantities::{FrameQuantities, JudgedMap, Quantifier, Quantity, SpotTrack};
use imaging::recorded::{RecordedFrame, Recording};
use render::{SpotMark, Style};
use survey::Map;

use crate::failure::Failure;
use crate::maps::drawing;
use crate::maps::frame_maps::{FrameMap, FrameMaps};
use crate::maps::reconstruction::Reconstruction;
use crate::options::choices::Scale;
use crate::output::time::local;

/// Makes the maps of pictures, frame after frame.
pub(crate) struct Pictures<'a> {
    recording: &'a Recording,
    reconstruction: &'a Reconstruction,
    maps: FrameMaps<'a>,
    quantifier: Quantifier,
}

/// A map with everything that a picture shows of it.
pub(crate) struct PictureMap {
    /// The map, and its pressures if there is a calibration.
    pub(crate) made: FrameMap,
    /// Position of the load, m.
    pub(crate) found: Option<[f64; 2]>,
    /// Its quantities, with hot spots.
    pub(crate) quantities: FrameQuantities,
    /// The map in the unit that is drawn.
    pub(crate) shown: Map,
}

impl<'a> Pictures<'a> {
    /// # Errors
    /// The baseline is to be tracked and the frames have no times; a region of the session is outside of the maps.
    pub(crate) fn new(
        reconstruction: &'a Reconstruction,
        tracked: &TrackedArguments,
        recording: &'a Recording,
    ) -> Result<Self, Failure> {
        Ok(Self {
            recording,
            reconstruction,
            maps: FrameMaps::new(reconstruction, tracked, recording)?,
            quantifier: reconstruction.quantifier(recording)?,
        })
    }

    /// Tracks a frame without a picture.
    ///
    /// # Errors
    /// The frame cannot be tracked.
    pub(crate) fn pass(&mut self, frame: &RecordedFrame) -> Result<(), Failure> {
        self.maps.pass(frame)
    }

    /// The map of a frame.
    ///
    /// # Errors
    /// The frame has no map, or cannot be tracked.
    pub(crate) fn map(&mut self, frame: &RecordedFrame) -> Result<PictureMap, Failure> {
        let made = self.maps.map(frame)?;
        let noise = self.reconstruction.noise;
        let judged = JudgedMap {
            map: &made.map,
            pressure: made.pressure.as_ref(),
            noise,
            tracked: made.tracked.as_ref(),
            compared: None,
        };
        let quantities = self.quantifier.take(frame.time_s(None), Some(&judged));
        let calibrated = made
            .pressure
            .as_ref()
            .map(|pressure| pressure.map(&made.map));
        Ok(PictureMap {
            found: self.reconstruction.field.found(&made.map, noise),
            shown: calibrated.unwrap_or_else(|| made.map.clone()),
            quantities,
            made,
        })
    }

    /// The map of a frame that is shown with others on one scale, or why it has none in the common unit.
    ///
    /// # Errors
    /// An error that every other frame would have too.
    pub(crate) fn attempt(
        &mut self,
        frame: &RecordedFrame,
    ) -> Result<Result<PictureMap, String>, Failure> {
        match self.map(frame) {
            Ok(picture) if picture.shown.unit == self.reconstruction.unit() => Ok(Ok(picture)),
            Ok(_) => Ok(Err("the calibration does not belong to this map".to_owned())),
            Err(Failure::Failed(why)) => Ok(Err(why)),
            Err(other) => Err(other),
        }
    }

    /// The map of one frame of the recording, after tracking the frames before it, with the texts and marks of its
    /// picture.
    ///
    /// # Errors
    /// As [`Pictures::map`] and [`Pictures::style`].
    pub(crate) fn only(
        mut self,
        frame: &RecordedFrame,
        scale: Scale,
    ) -> Result<(PictureMap, Style), Failure> {
        self.maps.pass_before(frame.sequence)?;
        let picture = self.map(frame)?;
        let style = self.style(frame, &picture, scale)?;
        Ok((picture, style))
    }

    /// Title, scale and marks of a picture.
    ///
    /// # Errors
    /// A scale in another unit.
    pub(crate) fn style(
        &self,
        frame: &RecordedFrame,
        picture: &PictureMap,
        scale: Scale,
    ) -> Result<Style, Failure> {
        let title = drawing::title(self.title(frame), picture.made.tracked.as_ref());
        let style = drawing::style(
            title,
            (scale, picture.shown.unit),
            self.recording.simulated == Some(true),
            picture.found,
            &picture.made.map,
            self.reconstruction.noise,
        )?;
        // a map without quantities would show the hot spots of an earlier map
        let sheet = picture.quantities.regions.first();
        let counted = sheet.and_then(|sheet| sheet.values.get(Quantity::HotSpots));
        let spots = match counted {
            Some(_) => picture.quantities.spots.iter().map(mark).collect(),
            None => Vec::new(),
        };
        Ok(Style {
            hot_spots: Some(spots),
            ..style
        })
    }

    /// Session, number and time of a frame.
    pub(crate) fn title(&self, frame: &RecordedFrame) -> String {
        let time = frame
            .wall
            .map_or_else(String::new, |wall| format!(", {}", local(wall)));
        format!("{}, frame {}{time}", self.recording.name, frame.label)
    }
}

fn mark(spot: &SpotTrack) -> SpotMark {
    SpotMark {
        number: spot.number,
        centre: spot.centre_mm.map(|millimetres| 1e-3 * millimetres),
        area: 1e-6 * spot.area_mm2,
    }
}
