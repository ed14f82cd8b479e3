//! The interface of the daemon itself.

use serde::{Deserialize, Serialize};
use zbus::{OwnedObjectPath, Type, as_variant};

use crate::dictionaries::replies;
use crate::{
    BaselineDetails, EventDetails, Fault, GeometryDetails, Health, NotifyResult, PlanDetails,
    Recovery, SessionDetails, Status, TestDetails,
};

/// `org.tactus.Tactus1.Manager1` on the root object.
#[zbus::proxy(
    interface = "org.tactus.Tactus1.Manager1",
    default_service = "org.tactus.Tactus1",
    default_path = "/org/tactus/Tactus1"
)]
pub trait Manager1 {
    /// Starts a measurement (options: [`crate::SessionOptions`]) and returns its object at once.
    fn start_session<O>(&self, options: &O) -> Result<OwnedObjectPath, Fault>
    where
        O: Sync;

    /// Records a baseline (options: [`crate::SessionOptions`]) and returns its session at once; it ends by itself and
    /// is then the current baseline.
    fn record_baseline<O>(&self, options: &O) -> Result<OwnedObjectPath, Fault>
    where
        O: Sync;

    /// The sessions in the logbook, newest first, at most 1000 (options: [`crate::ListOptions`]).
    fn list_sessions<O>(&self, options: &O) -> Result<Vec<SessionSummary>, Fault>
    where
        O: Sync;

    /// The plan of a frame of the running session, otherwise of the configured one. Moves nothing.
    fn plan(&self) -> Result<PlanReport, Fault>;

    /// The plan of a frame of a session with these [`crate::MEASURING_OPTIONS`]. Moves nothing.
    fn plan_with<O>(&self, options: &O) -> Result<PlanReport, Fault>
    where
        O: Sync;

    /// The region of interest, for drawing maps.
    fn geometry(&self) -> Result<Geometry, Fault>;

    /// Tests the rig and waits for the end: every relay against the sheet's own resistances, contacts, reciprocity,
    /// noise. An error while a session is running; afterwards the source is off, verified.
    fn test_instruments<O>(&self, options: &O) -> Result<TestReport, Fault>
    where
        O: Sync;

    /// Closures of each relay so far, and its remaining life. An error while a session is running.
    fn relays<O>(&self, options: &O) -> Result<Vec<RelayWear>, Fault>
    where
        O: Sync;

    /// Searches for instruments: mDNS, VXI-11 broadcast, and these addresses (`tcp:HOST:PORT`). Sends them only `*IDN?`
    /// and uses none of them. Options: [`crate::DiscoverOptions`].
    fn discover<O>(&self, addresses: &[&str], options: &O) -> Result<Discovery, Fault>
    where
        O: Sync;

    /// Progress of a self-test: steps done, number of steps, the present step.
    #[zbus(signal)]
    fn test_progress(&self, done: u64, total: u64, what: &str) -> Result<(), Fault>;

    /// The current baseline.
    fn baseline(&self) -> Result<BaselineReport, Fault>;

    /// Remarks to read before this kept baseline is used, a sentence each.
    fn baseline_remarks(&self, id: &str) -> Result<Vec<String>, Fault>;

    /// Makes an earlier baseline the current one until another is recorded or the daemon ends; returns its id.
    fn use_baseline(&self, id: &str) -> Result<String, Fault>;

    /// Overrules the tracked baseline of the running session (`empty-now`, `loaded-now`, `forget-anchor`); returns the number of
    /// the first frame that the order is for.
    fn override_tracking(&self, order: &str) -> Result<u64, Fault>;

    /// Switches the source off and opens every relay, verifies both, and returns a report.
    fn open_all(&self) -> Result<String, Fault>;

    /// Accepts the instruments or modules that were found in place of the known ones.
    fn accept_instruments(&self) -> Result<String, Fault>;

    /// Reloads the configuration; an invalid one changes nothing.
    fn reload(&self) -> Result<String, Fault>;

    /// Messages sent to and received from the instruments during the last frames, a line of JSON each (options:
    /// [`crate::TranscriptOptions`]).
    fn transcript<O>(&self, options: &O) -> Result<String, Fault>
    where
        O: Sync;

    /// The daemon's health in one reply; unknown values are left out.
    fn health(&self) -> Result<Health, Fault>;

    /// The daemon, its session and its health in one reply.
    fn status(&self) -> Result<Status, Fault>;

    /// Runs the command of `[notify]` once and returns its result.
    fn notify_test(&self) -> Result<NotifyResult, Fault>;

    /// An event of the rig or of a session.
    #[zbus(signal)]
    fn happened(
        &self,
        wall_ns: i64,
        kind: &str,
        text: &str,
        details: EventDetails,
    ) -> Result<(), Fault>;

    /// `off` (verified), `in use`, `unknown`.
    #[zbus(property(emits_changed_signal = "false"))]
    fn source_state(&self) -> Result<String, Fault>;

    /// Reconnection of a lost rig; empty when none is lost.
    #[zbus(property(emits_changed_signal = "false"))]
    fn recovery(&self) -> Result<Recovery, Fault>;

    /// Version of the daemon.
    #[zbus(property(emits_changed_signal = "const"))]
    fn version(&self) -> Result<String, Fault>;

    /// `idle`, `baseline`, `acquiring`, `testing`, `suspended`, `faulted`.
    #[zbus(property(emits_changed_signal = "false"))]
    fn state(&self) -> Result<String, Fault>;

    /// Whether voltages come from a simulated sheet.
    #[zbus(property(emits_changed_signal = "false"))]
    fn simulated(&self) -> Result<bool, Fault>;

    /// `rig` or `recording`.
    #[zbus(property(emits_changed_signal = "false"))]
    fn source(&self) -> Result<String, Fault>;

    /// The objects of the instruments.
    #[zbus(property(emits_changed_signal = "false"))]
    fn instruments(&self) -> Result<Vec<OwnedObjectPath>, Fault>;

    /// The running session, otherwise an interrupted one that cannot be resumed yet; `/` if there is none.
    #[zbus(property(emits_changed_signal = "false"))]
    fn active_session(&self) -> Result<OwnedObjectPath, Fault>;

    /// Id of the current baseline, empty if there is none.
    #[zbus(property(emits_changed_signal = "false"))]
    fn baseline_id(&self) -> Result<String, Fault>;

    /// Description of the configured method.
    #[zbus(property(emits_changed_signal = "false"))]
    fn method(&self) -> Result<String, Fault>;

    /// Directory of the session files.
    #[zbus(property(emits_changed_signal = "const"))]
    fn record_directory(&self) -> Result<String, Fault>;

    /// Why the daemon is faulted, empty if it is not.
    #[zbus(property(emits_changed_signal = "false"))]
    fn last_error(&self) -> Result<String, Fault>;
}

/// One session of the logbook (`(sssxtbsa{sv})`).
#[derive(Debug, Serialize, Deserialize, Type)]
pub struct SessionSummary {
    /// The session's id.
    pub id: String,
    /// `baseline` or `measurement`.
    pub kind: String,
    /// `open`, `closed` or `interrupted` (open on disk, but not running).
    pub state: String,
    /// Wall time of its start, ns since 1970 UTC.
    pub started_ns: i64,
    /// Frames on disk.
    pub frames: u64,
    /// Whether voltages are simulated.
    pub simulated: bool,
    /// The session's file.
    pub path: String,
    /// Optional data.
    pub more: SessionDetails,
}

replies! {
    /// Result of a self-test.
    TestReport {
        /// Whether nothing has to be repaired.
        passed: bool,
        /// Faults to repair, most severe first: `relay 1042 stays closed: ...`, `electrode 17: open ...`.
        findings: Vec<String>,
        /// The rows of the table.
        lines: Vec<TestLine>,
        ;
        /// Results for the rig as a whole.
        more: TestDetails,
    }
}

/// One row of a self-test (`(sssddss)`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Type)]
pub struct TestLine {
    /// `relay 1042`, `electrode 17`, `sheet`, `voltmeter`.
    pub subject: String,
    /// The property that was checked.
    pub check: String,
    /// `ok`, `failed` or `not-judged`.
    pub verdict: String,
    /// The measured value; NaN if there is none.
    pub measured: f64,
    /// The value of a sound rig; NaN if not known.
    pub expected: f64,
    /// Unit of both values.
    pub unit: String,
    /// Description for people.
    pub text: String,
}

/// Result of a search for instruments (`(a(ssssbss)as)`).
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, Type)]
pub struct Discovery {
    /// One entry for each instrument, however many ways it was found.
    pub seen: Vec<SeenInstrument>,
    /// Search methods that could not be used, and why.
    pub notes: Vec<String>,
}

/// An instrument that was found (`(ssssbss)`).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Type)]
pub struct SeenInstrument {
    /// In the form of the configuration; empty if the daemon cannot connect to it.
    pub address: String,
    /// The reply to `*IDN?`; empty without a reply.
    pub identity: String,
    /// `mdns`, `vxi-11`, `address`, `configuration`, several joined by `, `.
    pub found_by: String,
    /// The announced name; empty if the instrument is not announced.
    pub name: String,
    /// Whether the running configuration uses it.
    pub in_use: bool,
    /// Proposed lines for a configuration; empty if there are none.
    pub proposal: String,
    /// Why there is no identity or no proposal.
    pub remark: String,
}

/// The wear of one relay (`(usttdd)`).
#[derive(Debug, Serialize, Deserialize, Type)]
pub struct RelayWear {
    /// The relay's number.
    pub relay: u32,
    /// The relay's purpose.
    pub purpose: String,
    /// Closures so far.
    pub cycles: u64,
    /// Rated number of closures; 0 for a switch without moving parts.
    pub rated: u64,
    /// Fraction of the rating that is used; NaN for a switch without moving parts.
    pub used: f64,
    /// Measuring time until the rating is reached, s; NaN if never.
    pub left_s: f64,
}

replies! {
    /// The plan of a frame.
    PlanReport {
        /// Steps.
        steps: u64,
        /// Injections.
        injections: u64,
        /// Readings kept.
        readings: u64,
        /// Relays opened or closed by the plan itself.
        relay_moves: u64,
        /// Messages that query readings.
        reading_messages: u64,
        /// Time that the instruments need, s.
        duration_s: f64,
        /// Injected current, A.
        current_a: f64,
        /// Voltage limit, V.
        compliance_v: f64,
        /// One line for each step.
        lines: Vec<String>,
        ;
        /// Wiring, limits, how each reading is taken, and the cost of each setting.
        more: PlanDetails,
    }

    /// The data for drawing a map. Metres.
    Geometry {
        /// Hash of the mesh, as in every map.
        mesh_hash: String,
        /// Corners: x, y, x, y ...
        nodes: Vec<f64>,
        /// Triangles of the region, in the order of a map's values: three indices into the corners each.
        triangles: Vec<u32>,
        /// Boundary loops of the sheet, one after the other: x, y, x, y ...
        outline: Vec<f64>,
        /// Points of each boundary loop.
        outline_lengths: Vec<u32>,
        /// Centres of the electrodes in their order: x, y, x, y ...
        electrodes: Vec<f64>,
        ;
        /// Optional data.
        more: GeometryDetails,
    }
}

impl Geometry {
    /// The region's triangles as corner coordinates; `None` if an index or a count is out of range.
    pub fn corners(&self) -> Option<Vec<[[f64; 2]; 3]>> {
        let node = |index: u32| {
            let at = 2 * index as usize;
            Some([*self.nodes.get(at)?, *self.nodes.get(at + 1)?])
        };
        if !self.triangles.len().is_multiple_of(3) {
            return None;
        }
        self.triangles
            .chunks_exact(3)
            .map(|t| Some([node(t[0])?, node(t[1])?, node(t[2])?]))
            .collect()
    }

    /// The boundary loops as points; `None` if the counts do not add up.
    pub fn loops(&self) -> Option<Vec<Vec<[f64; 2]>>> {
        let mut points = self.outline.chunks_exact(2).map(|p| [p[0], p[1]]);
        let loops: Vec<Vec<[f64; 2]>> = self
            .outline_lengths
            .iter()
            .map(|length| points.by_ref().take(*length as usize).collect())
            .collect();
        let whole = loops
            .iter()
            .zip(&self.outline_lengths)
            .all(|(points, length)| points.len() == *length as usize);
        (whole && points.next().is_none()).then_some(loops)
    }

    /// Centres of the electrodes as points.
    pub fn electrode_centres(&self) -> Vec<[f64; 2]> {
        self.electrodes
            .chunks_exact(2)
            .map(|p| [p[0], p[1]])
            .collect()
    }
}

replies! {
    /// The current baseline.
    BaselineReport {
        /// The baseline's id, which is the id of its session.
        id: String,
        /// Wall time of the last frame, ns since 1970 UTC.
        wall_ns: i64,
        /// Frames averaged.
        frames: u64,
        /// Mean voltages, V; NaN where the flag is not 0.
        volts: Vec<f64>,
        /// Flags: 0 ok, 1 overload, 3 not measured.
        flags: Vec<u8>,
        /// Standard deviation of one reading, V; NaN with fewer than two valid ones.
        deviation: Vec<f64>,
        /// Whether voltages are simulated.
        simulated: bool,
        ;
        /// Settings.
        more: BaselineDetails,
    }
}
