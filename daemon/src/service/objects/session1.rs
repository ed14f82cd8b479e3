//! The D-Bus interface of a session: a baseline being recorded, or a measurement.

use std::sync::Arc;

use dbus::{
    Fault, FrameSummary, LatestFrame, LatestMap, LatestPressure, LatestQuantities, MapDetails,
    Options, StreamOptions,
};
use zbus::object_server::SignalEmitter;
use zbus::{OwnedFd, interface};

use crate::locked::locked;
use crate::recording::session_status::SessionStatus;
use crate::recording::stream::Wanted;
use crate::recording::stream_sink::volts;
use crate::service::limit::{STREAMS, User};
use crate::session::option_values;
use crate::session::option_values::checked;
use survey::nanoseconds;

/// Default number of records held for a slow reader.
const RING: u64 = 64;

/// The object of one session.
pub(crate) struct Session1(pub(crate) Arc<SessionStatus>);

/// A session: a baseline being recorded, or a measurement. The object outlives its session for a while.
#[interface(name = "org.tactus.Tactus1.Session1")]
impl Session1 {
    /// Ends the session and returns when its record is closed and the source is off.
    async fn stop(&self) -> Result<(), Fault> {
        self.0.end_for_good("stopped on request");
        let end = self.0.ended().await;
        if end.faulted {
            return Err(Fault::Failed(end.reason));
        }
        if self.0.is_resumed_by_next_daemon() {
            return Err(Fault::Failed(
                "the daemon is already stopping and will resume this session at its next start; stop the session then".into(),
            ));
        }
        Ok(())
    }

    /// Suspends acquisition between frames; the source is off.
    async fn suspend(&self) -> Result<(), Fault> {
        self.running()?;
        self.0.suspend(true);
        Ok(())
    }

    /// Continues after Suspend.
    async fn resume(&self) -> Result<(), Fault> {
        self.running()?;
        self.0.suspend(false);
        Ok(())
    }

    /// Takes this number of frames now, in a session started with `step`. Returns the sequence of the last durable
    /// frame when all are taken, or when a recording ends earlier.
    async fn step(&self, frames: u64) -> Result<u64, Fault> {
        self.running()?;
        checked("frames", frames as f64, config::numbers::COUNT)?;
        let upto = self.0.grant(frames).ok_or_else(|| {
            Fault::Unsupported(
                "this session takes its frames by a schedule; start a session with the option 'step' to take single frames".into(),
            )
        })?;
        let mut durable = self.0.follow_durable();
        tokio::select! {
            _ = durable.wait_for(|durable| *durable >= upto) => {}
            end = self.0.ended() => {
                if end.faulted {
                    return Err(Fault::Failed(end.reason));
                }
            }
        }
        Ok(self.0.durable())
    }

    /// Waits until the session has ended and returns the reason.
    async fn wait(&self) -> Result<String, Fault> {
        let end = self.0.ended().await;
        if end.faulted {
            return Err(Fault::Failed(end.reason));
        }
        Ok(end.reason)
    }

    /// The last durable frame: `sequence` (t), `wall_ns` (x), `volts` (ad), `flags` (ay), `unit` (s), `simulated` (b),
    /// `quality` (a{sv}). Voltages are NaN where the flag is not 0: 0 ok, 1 overload, 3 not measured.
    #[zbus(out_args("frame"))]
    async fn latest_frame(&self) -> Result<LatestFrame, Fault> {
        let latest = self
            .0
            .latest_frame()
            .ok_or_else(|| Fault::NoFrame("the session has no frame yet".into()))?;
        let frame = &latest.frame;
        let flags = frame.readings.iter().map(|reading| reading.flag());
        Ok(LatestFrame {
            sequence: frame.sequence,
            wall_ns: nanoseconds(frame.wall),
            volts: volts(&frame.readings),
            flags: flags.collect(),
            unit: "V".to_owned(),
            simulated: frame.simulated,
            quality: latest.quality_details(),
        })
    }

    /// The map of the last durable frame with a map: `sequence` (t), `wall_ns` (x), `values` (ad, one for each triangle
    /// of the region), `unit` (s), `mesh_hash` (s), `method` (s), `simulated` (b), and results, whose keys are documented
    /// in dbus/src/dictionaries/mod.rs.
    #[zbus(out_args("map"))]
    async fn latest_map(&self) -> Result<LatestMap, Fault> {
        let nothing = || Fault::NoFrame("the session has no map yet".into());
        let latest = self.0.latest_map().ok_or_else(nothing)?;
        let map = latest.map.as_ref().ok_or_else(nothing)?;
        let deviation = locked(&self.0.deviation).clone();
        Ok(LatestMap {
            sequence: latest.frame.sequence,
            wall_ns: nanoseconds(latest.frame.wall),
            values: map.values.clone(),
            unit: map.unit.label().to_owned(),
            mesh_hash: map.mesh_hash.clone(),
            method: map.method.clone(),
            simulated: latest.frame.simulated,
            more: MapDetails {
                deviations_sequence: deviation.as_ref().map(|(sequence, _)| *sequence),
                deviations: deviation.map(|(_, values)| values),
                ..latest.map_details()
            },
        })
    }

    /// The same map as pressure: `sequence` (t), `wall_ns` (x), `kpa` (ad), `newtons` (d, total load), `simulated` (b). An
    /// error if the configured method is not calibrated.
    #[zbus(out_args("pressure"))]
    async fn latest_pressure(&self) -> Result<LatestPressure, Fault> {
        let nothing = || Fault::NoFrame("the session has no map yet".into());
        let latest = self.0.latest_map().ok_or_else(nothing)?;
        let pressure = latest.pressure.as_ref().ok_or_else(|| {
            Fault::Unsupported(
                "no pressure: the method is not calibrated; fit a calibration with tactus-lab calibrate and name its file \
                 in [model] calibration"
                    .into(),
            )
        })?;
        Ok(LatestPressure {
            sequence: latest.frame.sequence,
            wall_ns: nanoseconds(latest.frame.wall),
            kpa: pressure.kpa.clone(),
            newtons: pressure.newtons,
            simulated: latest.frame.simulated,
        })
    }

    /// Load, contact area and other quantities of the map of the last durable frame that has some: `sequence` (t),
    /// `wall_ns` (x), `json` (s), `simulated` (b).
    #[zbus(out_args("quantities"))]
    async fn quantities(&self) -> Result<LatestQuantities, Fault> {
        let nothing = || Fault::NoFrame("the session has no quantities yet".into());
        let latest = self.0.latest_map().ok_or_else(nothing)?;
        let quantities = latest.quantities.as_ref().ok_or_else(nothing)?;
        Ok(LatestQuantities {
            sequence: latest.frame.sequence,
            wall_ns: nanoseconds(latest.frame.wall),
            json: serde_json::json!(quantities).to_string(),
            simulated: latest.frame.simulated,
        })
    }

    /// A descriptor for reading every frame and map. Options: `frames` (b) and `maps` (b), true by default; `pressure`
    /// (b), `quality` (b), `injections` (b) and `deviations` (b), false by default; `ring` (t), records held for a slow reader, 64 by default.
    #[zbus(out_args("stream"))]
    async fn open_stream(&self, options: Options) -> Result<OwnedFd, Fault> {
        let options: StreamOptions = option_values::read(&options, |key| {
            (key == "ring").then_some(option_values::RING)
        })?;
        self.running()?;
        let wanted = Wanted {
            frames: options.frames.unwrap_or(true),
            maps: options.maps.unwrap_or(true),
            pressure: options.pressure.unwrap_or(false),
            quality: options.quality.unwrap_or(false),
            injections: options.injections.unwrap_or(false),
            deviations: options.deviations.unwrap_or(false),
            ring: options.ring.unwrap_or(RING) as usize,
        };
        let permit = STREAMS.take(User::calling())?;
        if wanted.injections {
            let known = tokio::select! {
                known = self.0.injections.wait() => *known,
                end = self.0.ended() => return Err(Fault::Failed(end.reason)),
            };
            known.map_err(|why| {
                Fault::Unsupported(format!(
                    "loads after every injection are not available: {why}"
                ))
            })?;
            self.running()?;
        }
        let descriptor = self
            .0
            .readers
            .add(wanted, permit)
            .map_err(|error| Fault::Failed(format!("no socket for the stream: {error}")))?;
        Ok(descriptor.into())
    }

    /// A durable frame. At most five signals a second, and one for the last frame.
    #[zbus(signal)]
    async fn frame_done(
        emitter: &SignalEmitter<'_>,
        sequence: u64,
        wall_ns: i64,
        summary: &FrameSummary,
    ) -> zbus::Result<()>;

    /// The session's id.
    #[zbus(property(emits_changed_signal = "const"))]
    fn id(&self) -> &str {
        &self.0.facts.id
    }

    /// `baseline` or `measurement`.
    #[zbus(property(emits_changed_signal = "const"))]
    fn kind(&self) -> &str {
        self.0.facts.kind.as_str()
    }

    /// `running`, `suspended`, `ended`, `faulted`.
    #[zbus(property)]
    fn state(&self) -> &str {
        let progress = self.0.progress();
        match progress.ended {
            Some(end) if end.faulted => "faulted",
            Some(_) => "ended",
            None if progress.suspended => "suspended",
            None => "running",
        }
    }

    /// Frames from the rig or recording.
    #[zbus(property(emits_changed_signal = "false"))]
    fn frames_acquired(&self) -> u64 {
        self.0.acquired()
    }

    /// Frames on disk.
    #[zbus(property(emits_changed_signal = "false"))]
    fn frames_durable(&self) -> u64 {
        self.0.durable()
    }

    /// Scheduled frames that the rig could not measure in time, or that the disk refused.
    #[zbus(property(emits_changed_signal = "false"))]
    fn frames_dropped(&self) -> u64 {
        self.0.dropped()
    }

    /// Frames that failed. They are not in the record; its events have the reasons.
    #[zbus(property(emits_changed_signal = "false"))]
    fn frames_failed(&self) -> u64 {
        self.0.failures()
    }

    /// Why the session is faulted, or why the last frame has no map; empty otherwise.
    #[zbus(property)]
    fn last_error(&self) -> String {
        self.0.progress().last_error
    }

    /// Why the session ended; empty while it runs.
    #[zbus(property)]
    fn end_reason(&self) -> String {
        self.0
            .progress()
            .ended
            .map(|end| end.reason)
            .unwrap_or_default()
    }

    /// Whether voltages are simulated.
    #[zbus(property(emits_changed_signal = "const"))]
    fn simulated(&self) -> bool {
        self.0.facts.simulated
    }

    /// Id of the baseline of a measurement; empty for a baseline session.
    #[zbus(property(emits_changed_signal = "const"))]
    fn baseline_id(&self) -> &str {
        &self.0.facts.baseline_id
    }

    /// The method of the session's maps; empty for a baseline session.
    #[zbus(property(emits_changed_signal = "const"))]
    fn method(&self) -> &str {
        &self.0.facts.method
    }

    /// The file of the session's frames; a session that rolls over continues in another file.
    #[zbus(property(emits_changed_signal = "false"))]
    fn path(&self) -> String {
        self.0.path().display().to_string()
    }
}

impl Session1 {
    /// The properties of the session and its last map.
    pub(crate) fn report(&self) -> dbus::SessionStatus {
        let map = self.0.latest_map();
        dbus::SessionStatus {
            id: Some(self.id().to_owned()),
            kind: Some(self.kind().to_owned()),
            state: Some(self.state().to_owned()),
            frames_acquired: Some(self.frames_acquired()),
            frames_durable: Some(self.frames_durable()),
            frames_dropped: Some(self.frames_dropped()),
            frames_failed: Some(self.frames_failed()),
            last_error: Some(self.last_error()),
            map_sequence: map.as_ref().map(|map| map.frame.sequence),
            map_noise: self.0.map_noise.get().copied(),
            map: map.map(|map| map.map_details()),
        }
    }

    fn running(&self) -> Result<(), Fault> {
        match self.0.progress().ended {
            None => Ok(()),
            Some(end) => Err(Fault::NoSession(format!(
                "session {} has ended: {}",
                self.0.facts.id, end.reason
            ))),
        }
    }
}
