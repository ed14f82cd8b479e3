//! A session: a baseline being recorded, or a measurement.

use serde::{Deserialize, Serialize};
use zbus::{OwnedFd, Type};

use crate::{Fault, FrameQuality, FrameSummary, MapDetails};

/// `org.tactus.Tactus1.Session1`, below `/org/tactus/Tactus1/session/`. The object outlives its session for a while.
#[zbus::proxy(
    interface = "org.tactus.Tactus1.Session1",
    default_service = "org.tactus.Tactus1"
)]
pub trait Session1 {
    /// Ends the session and returns when its record is closed and the source is off.
    fn stop(&self) -> Result<(), Fault>;

    /// Suspends acquisition between frames; the source is off.
    fn suspend(&self) -> Result<(), Fault>;

    /// Goes on after `Suspend`.
    fn resume(&self) -> Result<(), Fault>;

    /// Takes so many frames now, in a session started with `step`; returns the sequence of the last when it is durable
    /// (of the last there is, when a recording ends before).
    fn step(&self, frames: u64) -> Result<u64, Fault>;

    /// Waits until the session has ended and returns why.
    fn wait(&self) -> Result<String, Fault>;

    /// The last durable frame.
    fn latest_frame(&self) -> Result<LatestFrame, Fault>;

    /// The map of the last durable frame that has one.
    fn latest_map(&self) -> Result<LatestMap, Fault>;

    /// The same map as pressure; an error where the configured method is not calibrated.
    fn latest_pressure(&self) -> Result<LatestPressure, Fault>;

    /// A descriptor from which every frame and map can be read (see `dbus::stream`): see [`crate::StreamOptions`].
    fn open_stream<O>(&self, options: &O) -> Result<OwnedFd, Fault>
    where
        O: Sync;

    /// At most five a second, and one for the last frame.
    #[zbus(signal)]
    fn frame_done(&self, sequence: u64, wall_ns: i64, summary: FrameSummary) -> Result<(), Fault>;

    /// Its id.
    #[zbus(property(emits_changed_signal = "const"))]
    fn id(&self) -> Result<String, Fault>;

    /// `baseline` or `measurement`.
    #[zbus(property(emits_changed_signal = "const"))]
    fn kind(&self) -> Result<String, Fault>;

    /// `running`, `suspended`, `ended`, `faulted`.
    #[zbus(property(emits_changed_signal = "false"))]
    fn state(&self) -> Result<String, Fault>;

    /// Frames that the rig or recording gave.
    #[zbus(property(emits_changed_signal = "false"))]
    fn frames_acquired(&self) -> Result<u64, Fault>;

    /// Frames on disk.
    #[zbus(property(emits_changed_signal = "false"))]
    fn frames_durable(&self) -> Result<u64, Fault>;

    /// Frames that the schedule asked for and the rig could not give in time.
    #[zbus(property(emits_changed_signal = "false"))]
    fn frames_dropped(&self) -> Result<u64, Fault>;

    /// Frames that failed; the record's events say why.
    #[zbus(property(emits_changed_signal = "false"))]
    fn frames_failed(&self) -> Result<u64, Fault>;

    /// Why it is faulted, or why the last frame has no map; empty otherwise.
    #[zbus(property(emits_changed_signal = "false"))]
    fn last_error(&self) -> Result<String, Fault>;

    /// Why it ended, empty while it runs.
    #[zbus(property(emits_changed_signal = "false"))]
    fn end_reason(&self) -> Result<String, Fault>;

    /// Whether voltages are simulated.
    #[zbus(property(emits_changed_signal = "const"))]
    fn simulated(&self) -> Result<bool, Fault>;

    /// Id of the baseline that it measures against, empty for a baseline session.
    #[zbus(property(emits_changed_signal = "const"))]
    fn baseline_id(&self) -> Result<String, Fault>;

    /// The method of its maps, empty for a baseline session.
    #[zbus(property(emits_changed_signal = "const"))]
    fn method(&self) -> Result<String, Fault>;

    /// The file that its frames go to; a session that rolls over goes on in another one.
    #[zbus(property(emits_changed_signal = "false"))]
    fn path(&self) -> Result<String, Fault>;
}

/// One frame (`(txadaysba{sv})`).
#[derive(Debug, Serialize, Deserialize, Type)]
pub struct LatestFrame {
    /// Counted from 1 in its session.
    pub sequence: u64,
    /// Wall time of the first step, ns since 1970 UTC.
    pub wall_ns: i64,
    /// Voltages in the protocol's order; NaN where the flag is not 0.
    pub volts: Vec<f64>,
    /// Flags: 0 ok, 1 overload, 2 timeout, 3 not measured.
    pub flags: Vec<u8>,
    /// `V`.
    pub unit: String,
    /// Whether the voltages are simulated.
    pub simulated: bool,
    /// What its checks found.
    pub quality: FrameQuality,
}

/// One map as pressure (`(txaddb)`).
#[derive(Debug, Serialize, Deserialize, Type)]
pub struct LatestPressure {
    /// Sequence of the frame it is of.
    pub sequence: u64,
    /// Wall time of that frame, ns since 1970 UTC.
    pub wall_ns: i64,
    /// Pressure on each triangle of the region, kPa.
    pub kpa: Vec<f64>,
    /// Total load, N.
    pub newtons: f64,
    /// Whether the voltages are simulated.
    pub simulated: bool,
}

/// One map (`(txadsssba{sv})`).
#[derive(Debug, Serialize, Deserialize, Type)]
pub struct LatestMap {
    /// Sequence of the frame it is of.
    pub sequence: u64,
    /// Wall time of that frame, ns since 1970 UTC.
    pub wall_ns: i64,
    /// A value a triangle of the region.
    pub values: Vec<f64>,
    /// What the values mean.
    pub unit: String,
    /// Hash of the mesh; the same as in `Manager1.Geometry`.
    pub mesh_hash: String,
    /// How it was made.
    pub method: String,
    /// Whether the voltages are simulated.
    pub simulated: bool,
    /// How it was made and what it shows.
    pub more: MapDetails,
}
