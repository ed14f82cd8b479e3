//! The maps of a recording's frames, in order, compared with the recorded or the tracked baseline.

use eit::Pressure;
use imaging::recorded::{RecordedFrame, Recording};
use imaging::{Tracked, TrackedArguments};
use survey::Map;

use crate::failure::Failure;
use crate::maps::compared::Compared;
use crate::maps::follower::Follower;
use crate::maps::reconstruction::Reconstruction;
use crate::output::complain;

/// Makes the maps of a recording.
pub(crate) struct FrameMaps<'a> {
    reconstruction: &'a Reconstruction,
    recording: &'a Recording,
    follower: Option<Follower>,
    with_deviation: bool,
}

/// The map of a frame.
pub(crate) struct FrameMap {
    /// Relative change of conductance.
    pub(crate) map: Map,
    /// The pressures of the map; `None` without a calibration.
    pub(crate) pressure: Option<Pressure>,
    /// Result of the tracked baseline for the frame; `None` without one.
    pub(crate) tracked: Option<Tracked>,
    /// Standard deviation of ln conductance of each triangle, NaN if the frame gives no information about it; `None` if
    /// it was not requested.
    pub(crate) deviation: Option<Vec<f64>>,
}

impl<'a> FrameMaps<'a> {
    /// # Errors
    /// The baseline is to be tracked, and the frames have no times.
    pub(crate) fn new(
        reconstruction: &'a Reconstruction,
        tracked: &TrackedArguments,
        recording: &'a Recording,
    ) -> Result<Self, Failure> {
        Ok(Self {
            reconstruction,
            recording,
            follower: Follower::of(reconstruction, tracked, recording)?,
            with_deviation: false,
        })
    }

    /// Adds the standard deviations of each map, if `wanted`.
    pub(crate) fn with_deviation(mut self, wanted: bool) -> Self {
        self.with_deviation = wanted;
        self
    }

    /// The map of a frame, or why it has none, for example because too many readings are missing. Every frame must be
    /// given to this method, to [`FrameMaps::map`] or to [`FrameMaps::pass`], in order.
    ///
    /// # Errors
    /// An error that every other frame would have too.
    pub(crate) fn attempt(
        &mut self,
        frame: &RecordedFrame,
    ) -> Result<Result<FrameMap, String>, Failure> {
        match self.made(frame) {
            Ok(made) => Ok(Ok(made)),
            Err(Failure::Failed(why)) => Ok(Err(why)),
            Err(other) => Err(other),
        }
    }

    /// The map of a frame that must have one.
    ///
    /// # Errors
    /// As [`FrameMaps::attempt`], and a frame without a map.
    pub(crate) fn map(&mut self, frame: &RecordedFrame) -> Result<FrameMap, Failure> {
        self.attempt(frame)?
            .map_err(|why| Failure::Failed(format!("frame {}: {why}", frame.sequence)))
    }

    fn made(&mut self, frame: &RecordedFrame) -> Result<FrameMap, Failure> {
        let followed = self
            .follower
            .as_mut()
            .map(|follower| follower.follow(frame))
            .transpose()?;
        let compared = Compared::new(self.recording, frame, followed.as_ref());
        let map = compared.map(self.reconstruction)?;
        let deviation = match self
            .with_deviation
            .then(|| compared.deviation(self.reconstruction))
        {
            Some(Err(Failure::Failed(why))) => {
                complain(&format!("tactus: frame {}: {why}", frame.sequence));
                Some(vec![f64::NAN; map.values.len()])
            }
            known => known.transpose()?,
        };
        Ok(FrameMap {
            deviation,
            pressure: self.reconstruction.pressure(&map)?,
            map,
            tracked: followed.map(|followed| followed.tracked),
        })
    }

    /// Tracks the frames before this number, if the baseline is tracked.
    ///
    /// # Errors
    /// A frame cannot be tracked.
    pub(crate) fn pass_before(&mut self, sequence: u64) -> Result<(), Failure> {
        match &mut self.follower {
            Some(follower) => follower.pass_before(self.recording, sequence),
            None => Ok(()),
        }
    }

    /// Tracks a frame whose map is not needed.
    ///
    /// # Errors
    /// The frame cannot be tracked.
    pub(crate) fn pass(&mut self, frame: &RecordedFrame) -> Result<(), Failure> {
        match &mut self.follower {
            Some(follower) => follower.pass(frame),
            None => Ok(()),
        }
    }
}
