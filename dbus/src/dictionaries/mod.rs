//! The dictionaries (`a{sv}`) that the daemon sends, one struct each. Keys of `dictionaries!` are optional: the
//! daemon leaves out unknown values, and a daemon of another version may send fewer or more keys. Keys of `replies!`
//! are always sent.

mod costs;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};
use zbus::{DeserializeDict, SerializeDict, Type, as_variant};

pub use costs::SettingCost;

/// Structs whose fields are the keys of a dictionary.
macro_rules! dictionaries {
    ($($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $key:ident: $type:ty,)* })*) => {$(
        $(#[$meta])*
        #[derive(Debug, Clone, Default, PartialEq, SerializeDict, DeserializeDict, Type)]
        #[zbus(signature = "a{sv}")]
        pub struct $name {
            $($(#[$doc])* pub $key: Option<$type>,)*
        }
    )*};
}

/// Structs whose fields are the required keys of a dictionary. The optional keys, in the struct `more`, are in the
/// same dictionary.
macro_rules! replies {
    ($($(#[$meta:meta])* $name:ident {
        $($(#[$doc:meta])* $key:ident: $type:ty,)*
        $(; $(#[$more:meta])* more: $details:ty,)?
    })*) => {$(
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Type)]
        #[zbus(signature = "a{sv}")]
        pub struct $name {
            $($(#[$doc])* #[serde(with = "as_variant")] pub $key: $type,)*
            $($(#[$more])* #[serde(flatten)] pub more: $details,)?
        }
    )*};
}
pub(crate) use replies;

dictionaries! {
    /// The state of the daemon (`Manager1.Health`).
    Health {
        /// Time of this status, ns since 1970 UTC.
        at_ns: i64,
        /// Whether there is no problem.
        well: bool,
        /// `kind: sentence`, most severe first.
        troubles: Vec<String>,
        /// `idle`, `baseline`, `acquiring`, `testing`, `suspended`, `faulted`.
        state: String,
        /// `off` (verified), `in use`, `unknown`.
        source_state: String,
        /// Whether voltages come from a simulated sheet.
        simulated: bool,
        /// `role: ready` or `role: fault: why`.
        instruments: Vec<String>,
        /// Frames acquired since the daemon started.
        total_frames: u64,
        /// Frames on disk since the daemon started.
        total_durable: u64,
        /// Frames that failed since the daemon started.
        total_failed: u64,
        /// Frames since the daemon started that missed their scheduled time, or that the disk refused.
        total_dropped: u64,
        /// Readings over their range since the daemon started.
        total_overloads: u64,
        /// Id of the running session.
        session: String,
        /// `baseline` or `measurement`.
        session_kind: String,
        /// Frames of the running session from the rig or recording.
        frames_acquired: u64,
        /// Frames of the running session on disk.
        frames_durable: u64,
        /// Frames of the running session that failed.
        frames_failed: u64,
        /// Frames of the running session that missed their scheduled time, or that the disk refused.
        frames_dropped: u64,
        /// Frames waiting to be written to disk.
        backlog: u64,
        /// Time from the start of one frame to the start of the next, s.
        period_s: f64,
        /// Time since a frame was last due, s.
        quiet_s: f64,
        /// Wall time of the last frame, ns since 1970 UTC.
        last_frame_ns: i64,
        /// Time since the last reading of that frame, s.
        last_frame_age_s: f64,
        /// Its sequence.
        last_frame_sequence: u64,
        /// Its session.
        last_frame_session: String,
        /// Time of the last frame that was lost and is not in the record, ns since 1970 UTC.
        last_gap_ns: i64,
        /// Why it is not in the record.
        last_gap: String,
        /// Id of the current baseline.
        baseline: String,
        /// Its age, s.
        baseline_age_s: f64,
        /// Free bytes on the filesystem of the record.
        disk_free_bytes: u64,
        /// Growth of the record, bytes a day.
        disk_bytes_per_day: f64,
        /// Days until the disk is full.
        disk_days: f64,
        /// Number of the relay that will reach its rated life first.
        relay: u32,
        /// Fraction of its rated life that is used.
        relay_used: f64,
        /// Measuring time until it reaches its rated life, s.
        relay_left_s: f64,
        /// Address and port where metrics are served.
        metrics: String,
    }

    /// Wiring, limits, measuring settings and their costs of a plan ([`crate::PlanReport`]).
    PlanDetails {
        /// Name of the wiring.
        wiring: String,
        /// Electrodes of the protocol.
        electrodes: u64,
        /// Readings of a frame that are taken and not stored.
        extra_readings: u64,
        /// Integration time, power-line cycles.
        nplc: f64,
        /// Readings averaged to one.
        averages: u64,
        /// Whether a zero reading follows every reading.
        autozero: bool,
        /// Wait after a change of the current, s.
        settle_s: f64,
        /// Wait before each scanned channel, s.
        channel_delay_s: f64,
        /// Whether every injection is measured with both polarities of the current.
        reversal: bool,
        /// Frames between two frames at 0 A; 0: none.
        zero_every: u64,
        /// The common range, V.
        range_v: f64,
        /// Whether each reading has a range of its own.
        planned_ranges: bool,
        /// Number of commands in a frame that set a range.
        range_changes: u64,
        /// Time that these commands take, s.
        range_time_s: f64,
        /// Noise of a reading in the common range, V.
        noise_fixed_v: f64,
        /// Root mean square of the readings' noise, V.
        noise_v: f64,
        /// Median of the readings' noise, V.
        noise_median_v: f64,
        /// Electrodes between the two of a pair.
        skip: u64,
        /// Whether only one of two reciprocal readings is taken.
        half: bool,
        /// Largest current of the source, A.
        source_current_max_a: f64,
        /// Largest current of the relays, A.
        relay_current_max_a: f64,
        /// Largest voltage of the relays, V.
        relay_voltage_max_v: f64,
        /// Time added to a frame by the integration, s; like all further costs, compared with the plan without the
        /// setting.
        cost_nplc_s: f64,
        /// Noise of a reading without the setting divided by the noise with it; the same for all further gains.
        gain_nplc: f64,
        /// Cost of averaging, s.
        cost_averages_s: f64,
        /// Gain of averaging.
        gain_averages: f64,
        /// Cost of zero readings, s.
        cost_autozero_s: f64,
        /// Gain of zero readings.
        gain_autozero: f64,
        /// Cost of settling, s.
        cost_settle_s: f64,
        /// Gain of settling.
        gain_settle: f64,
        /// Cost of the delay before channels, s.
        cost_channel_delay_s: f64,
        /// Gain of the delay before channels.
        gain_channel_delay: f64,
        /// Cost of both polarities, s.
        cost_reversal_s: f64,
        /// Gain of both polarities.
        gain_reversal: f64,
        /// Cost of frames at 0 A, s.
        cost_zero_every_s: f64,
        /// Gain of frames at 0 A.
        gain_zero_every: f64,
        /// Cost of planned ranges, s.
        cost_ranges_s: f64,
        /// Gain of planned ranges.
        gain_ranges: f64,
        /// Cost of leaving out reciprocal readings, s; negative, because it saves time.
        cost_half_s: f64,
        /// Gain of leaving out reciprocal readings.
        gain_half: f64,
    }

    /// Settings of a baseline ([`crate::BaselineReport`]).
    BaselineDetails {
        /// Injected current, A.
        current_a: f64,
        /// Range of the voltmeter, V.
        range_v: f64,
        /// Integration time, power-line cycles.
        nplc: f64,
        /// Wait after a change of the current, s.
        settle_s: f64,
        /// Name of the wiring.
        wiring: String,
        /// Hash of the protocol.
        protocol_hash: String,
        /// Remarks for people before they use it, a sentence each.
        remarks: Vec<String>,
        /// State of the tracked baseline when it was last stored: `tracked` of `tactus baseline show --json`, as
        /// JSON; absent if the baseline was not tracked.
        tracked: String,
    }

    /// Name of a geometry ([`crate::Geometry`]), and the regions on it.
    GeometryDetails {
        /// The name, for people.
        name: String,
        /// Named regions of the configuration, as JSON: `[{"name": "...", "corners_mm": [[x, y], ...]}, ...]`.
        regions: String,
    }

    /// Results of a self-test for the rig as a whole ([`crate::TestReport`]); values that were not determined are left
    /// out.
    TestDetails {
        /// Time of the self-test, RFC 3339.
        at: String,
        /// Name of the wiring.
        wiring: String,
        /// Whether the rig is simulated.
        simulated: bool,
        /// Injected current, A.
        current_a: f64,
        /// Sheet resistance, ohm.
        sheet_ohm: f64,
        /// Rms difference between the readings and those of a uniform sheet, relative to the rms of the latter.
        misfit: f64,
        /// Sheet resistance by van der Pauw's method, ohm.
        pauw_ohm: f64,
        /// The same without the correction for the electrodes, ohm.
        pauw_raw_ohm: f64,
        /// Rms difference between reciprocal readings, relative to the rms of the readings.
        reciprocity: f64,
        /// Noise of a reading, V.
        noise_v: f64,
        /// Offset of a reading, V.
        offset_v: f64,
    }

    /// Optional data of a session in the logbook ([`crate::SessionSummary`]).
    SessionDetails {
        /// The note given at its start.
        note: String,
        /// Why it ended.
        reason: String,
        /// End of the session, ns since 1970 UTC.
        ended_ns: i64,
    }

    /// Quality of a frame ([`crate::LatestFrame`]).
    FrameQuality {
        /// Readings over their range.
        overloads: u64,
        /// Readings that were not measured.
        not_measured: u64,
        /// Injections at the voltage limit.
        compliance: u64,
        /// Duration of the frame, s.
        duration_s: f64,
        /// Readings that are implausible for any sheet.
        implausible: u64,
        /// Words of `survey::QualityFlag` joined by commas.
        flags: String,
        /// Largest difference between reciprocal readings, relative to the largest reading; absent if there are none.
        reciprocity: f64,
        /// Largest sum of the voltages round the ring at one injection, relative to the largest reading; absent if no
        /// injection was read all the way round.
        loop_sum: f64,
    }

    /// Method and results of a map ([`crate::LatestMap`]).
    MapDetails {
        /// Readings that were left out.
        masked: u64,
        /// Computing time of the map, s.
        reconstruction_s: f64,
        /// Time from the last reading until the frame was on disk, s.
        durable_s: f64,
        /// Evidence for the kind of the map, if the method chooses between kinds: `evidence` of
        /// `tactus replay --json`, as JSON.
        evidence: String,
        /// Largest relative loss of conductance.
        largest_loss: f64,
        /// Whether that is larger than `noise`.
        significant: bool,
        /// The largest loss caused by noise alone; absent if the noise of a reading is not known.
        noise: f64,
        /// Position of the load, m.
        found_x_m: f64,
        /// Position of the load, m.
        found_y_m: f64,
        /// Total load, N; for a calibrated method.
        newtons: f64,
        /// Largest pressure, kPa; for a calibrated method.
        largest_kpa: f64,
        /// Reliability of the map: `sound`, `doubtful`, `unreliable`; absent if the map was not judged.
        quality: String,
        /// Why it is not sound, sentences joined by semicolons.
        doubts: String,
        /// Whether the map can be relied on according to the tracked baseline; absent if the baseline is not tracked.
        known: bool,
        /// Result of the tracked baseline for the frame: `tracked` of `tactus watch --json`, as JSON; absent if the
        /// baseline is not tracked.
        tracked: String,
        /// Load, contact area and others: `quantities` of `tactus watch --json`, as JSON.
        quantities: String,
        /// Standard deviation of the change of ln conductance of each triangle of the region, relative to the sheet
        /// without its load; NaN if the frame does not determine it. Only in `LatestMap`. Absent until a reader of
        /// the stream requests standard deviations; the last values remain after that reader closes the stream.
        deviations: Vec<f64>,
        /// Sequence of the frame to which the standard deviations belong; they are computed at most once a second.
        deviations_sequence: u64,
    }

    /// Additional data of an event signal (`Manager1.Happened`).
    EventDetails {
        /// Id of the event's session.
        session: String,
    }

    /// Reconnection of a lost rig (`Manager1.Recovery`); empty when none is lost.
    Recovery {
        /// The lost instruments.
        what: String,
        /// Attempts so far.
        tries: u64,
        /// Time of the loss, ns since 1970 UTC.
        since_ns: i64,
        /// Whether a user must accept the instruments first.
        person: bool,
        /// Time until the next attempt, s; absent while one is running.
        next_s: f64,
    }

    /// The daemon, its session and its health at one moment (`Manager1.Status`).
    Status {
        /// `idle`, `baseline`, `acquiring`, `testing`, `suspended`, `faulted`.
        state: String,
        /// Whether voltages come from a simulated sheet.
        simulated: bool,
        /// `rig` or `recording`.
        source: String,
        /// Description of the configured method.
        method: String,
        /// Id of the current baseline.
        baseline_id: String,
        /// Warnings about it, a sentence each, such as a load on the sheet; absent until they are known.
        baseline_remarks: Vec<String>,
        /// `off` (verified), `in use`, `unknown`.
        source_state: String,
        /// Directory of the session files.
        record_directory: String,
        /// Why the daemon is faulted.
        last_error: String,
        /// Version of the daemon.
        version: String,
        /// The running session.
        session: SessionStatus,
        /// Reconnection of a lost rig.
        recovery: Recovery,
        /// The daemon's health.
        health: Health,
    }

    /// A running session ([`Status`]).
    SessionStatus {
        /// The session's id.
        id: String,
        /// `baseline` or `measurement`.
        kind: String,
        /// `running`, `suspended`, `ended`, `faulted`.
        state: String,
        /// Frames from the rig or recording.
        frames_acquired: u64,
        /// Frames on disk.
        frames_durable: u64,
        /// Frames that missed their scheduled time.
        frames_dropped: u64,
        /// Frames that failed.
        frames_failed: u64,
        /// Why the session is faulted, or why the last frame has no map.
        last_error: String,
        /// The largest loss in a map caused by noise alone; absent if the noise of a reading is not known.
        map_noise: f64,
        /// Sequence of the last frame that has a map.
        map_sequence: u64,
        /// The map of that frame.
        map: MapDetails,
    }

    /// Result of the command of `[notify]` (`Manager1.NotifyTest`).
    NotifyResult {
        /// Whether the command ended with exit code 0.
        done: bool,
        /// The exit code.
        code: i64,
        /// Why there is no exit code.
        trouble: String,
        /// The beginning of its standard error.
        stderr: String,
        /// Run time of the command, s.
        took_s: f64,
    }
}

/// Quality and map of a frame, and counts of its session (`Session1.FrameDone`).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, Type)]
#[zbus(signature = "a{sv}")]
#[serde(default)]
pub struct FrameSummary {
    /// Frames from the rig or recording.
    #[serde(with = "as_variant::optional", skip_serializing_if = "Option::is_none")]
    pub frames_acquired: Option<u64>,
    /// Frames that missed their scheduled time.
    #[serde(with = "as_variant::optional", skip_serializing_if = "Option::is_none")]
    pub frames_dropped: Option<u64>,
    /// Whether the voltages are simulated.
    #[serde(with = "as_variant::optional", skip_serializing_if = "Option::is_none")]
    pub simulated: Option<bool>,
    /// Quality of the frame.
    #[serde(flatten)]
    pub quality: FrameQuality,
    /// The map, if there is one.
    #[serde(flatten)]
    pub map: MapDetails,
}
