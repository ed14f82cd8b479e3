//! The interface of a session: a baseline being recorded, or a measurement.

use serde::{Deserialize, Serialize};
use zbus::{OwnedFd, Type, as_variant};

use crate::dictionaries::replies;
use crate::{Fault, FrameQuality, FrameSummary, MapDetails};

/// `org.tactus.Tactus1.Session1`, below `/org/tactus/Tactus1/session/`. The object remains for a while after its
/// session has ended.
#[zbus::proxy(
    interface = "org.tactus.Tactus1.Session1",
    default_service = "org.tactus.Tactus1"
)]
pub trait Session1 {
    /// Ends the session and returns when its record is closed and the source is off.
    fn stop(&self) -> Result<(), Fault>;

    /// Suspends acquisition between frames; the source is off.
    fn suspend(&self) -> Result<(), Fault>;

    /// Continues after `Suspend`.
    fn resume(&self) -> Result<(), Fault>;

    /// Takes this number of frames now, in a session started with `step`; returns the sequence of the last one when it
    /// is durable (of the last available one if a recording ends earlier).
    fn step(&self, frames: u64) -> Result<u64, Fault>;

    /// Waits until the session has ended and returns the reason.
    fn wait(&self) -> Result<String, Fault>;

    /// The last durable frame.
    fn latest_frame(&self) -> Result<LatestFrame, Fault>;

    /// The map of the last durable frame with a map.
    fn latest_map(&self) -> Result<LatestMap, Fault>;

    /// The same map as pressure; an error if the configured method is not calibrated.
    fn latest_pressure(&self) -> Result<LatestPressure, Fault>;

    /// Quantities of the map of the last durable frame that has some.
    fn quantities(&self) -> Result<LatestQuantities, Fault>;

    /// A descriptor for reading every frame and map (format: `dbus::stream`; options: [`crate::StreamOptions`]).
    fn open_stream<O>(&self, options: &O) -> Result<OwnedFd, Fault>
    where
        O: Sync;

    /// At most five signals a second, and one for the last frame.
    #[zbus(signal)]
    fn frame_done(&self, sequence: u64, wall_ns: i64, summary: FrameSummary) -> Result<(), Fault>;

    /// The session's id.
    #[zbus(property(emits_changed_signal = "const"))]
    fn id(&self) -> Result<String, Fault>;

    /// `baseline` or `measurement`.
    #[zbus(property(emits_changed_signal = "const"))]
    fn kind(&self) -> Result<String, Fault>;

    /// `running`, `suspended`, `ended`, `faulted`.
    #[zbus(property(emits_changed_signal = "false"))]
    fn state(&self) -> Result<String, Fault>;

    /// Frames from the rig or recording.
    #[zbus(property(emits_changed_signal = "false"))]
    fn frames_acquired(&self) -> Result<u64, Fault>;

    /// Frames on disk.
    #[zbus(property(emits_changed_signal = "false"))]
    fn frames_durable(&self) -> Result<u64, Fault>;

    /// Scheduled frames that the rig could not measure in time, or that the disk refused.
    #[zbus(property(emits_changed_signal = "false"))]
    fn frames_dropped(&self) -> Result<u64, Fault>;

    /// Frames that failed; the reasons are in the record's events.
    #[zbus(property(emits_changed_signal = "false"))]
    fn frames_failed(&self) -> Result<u64, Fault>;

    /// Why the session is faulted, or why the last frame has no map; empty otherwise.
    #[zbus(property(emits_changed_signal = "false"))]
    fn last_error(&self) -> Result<String, Fault>;

    /// Why the session ended; empty while it is running.
    #[zbus(property(emits_changed_signal = "false"))]
    fn end_reason(&self) -> Result<String, Fault>;

    /// Whether voltages are simulated.
    #[zbus(property(emits_changed_signal = "const"))]
    fn simulated(&self) -> Result<bool, Fault>;

    /// Id of the baseline of a measurement; empty for a baseline session.
    #[zbus(property(emits_changed_signal = "const"))]
    fn baseline_id(&self) -> Result<String, Fault>;

    /// The method of the session's maps; empty for a baseline session.
    #[zbus(property(emits_changed_signal = "const"))]
    fn method(&self) -> Result<String, Fault>;

    /// The file of the session's frames; a long session continues in further files.
    #[zbus(property(emits_changed_signal = "false"))]
    fn path(&self) -> Result<String, Fault>;
}

replies! {
    /// One frame.
    LatestFrame {
        /// Counted from 1 in its session.
        sequence: u64,
        /// Wall time of the first step, ns since 1970 UTC.
        wall_ns: i64,
        /// Voltages in the protocol's order; NaN where the flag is not 0.
        volts: Vec<f64>,
        /// Flags: 0 ok, 1 overload, 3 not measured.
        flags: Vec<u8>,
        /// `V`.
        unit: String,
        /// Whether the voltages are simulated.
        simulated: bool,
        /// Result of the frame's checks.
        quality: FrameQuality,
    }

    /// One map as pressure.
    LatestPressure {
        /// Sequence of the map's frame.
        sequence: u64,
        /// Wall time of that frame, ns since 1970 UTC.
        wall_ns: i64,
        /// Pressure on each triangle of the region, kPa.
        kpa: Vec<f64>,
        /// Total load, N.
        newtons: f64,
        /// Whether the voltages are simulated.
        simulated: bool,
    }

    /// Quantities of one map.
    LatestQuantities {
        /// Sequence of the map's frame.
        sequence: u64,
        /// Wall time of that frame, ns since 1970 UTC.
        wall_ns: i64,
        /// `quantities` of `tactus watch --json`.
        json: String,
        /// Whether the voltages are simulated.
        simulated: bool,
    }

    /// One map.
    LatestMap {
        /// Sequence of the map's frame.
        sequence: u64,
        /// Wall time of that frame, ns since 1970 UTC.
        wall_ns: i64,
        /// One value for each triangle of the region.
        values: Vec<f64>,
        /// What the values mean.
        unit: String,
        /// Hash of the mesh; the same as in `Manager1.Geometry`.
        mesh_hash: String,
        /// The method of the map.
        method: String,
        /// Whether the voltages are simulated.
        simulated: bool,
        ;
        /// Method and results.
        more: MapDetails,
    }
}
