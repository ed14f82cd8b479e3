//! The D-Bus interface of the daemon itself.

use std::sync::Arc;

use dbus::{
    BaselineDetails, EventDetails, Fault, GeometryDetails, Health, ListOptions, NotifyResult,
    Options, PlanDetails, ROOT_PATH, Recovery, RelayWear, SeenInstrument, SessionSummary, Status,
    TestDetails, TestLine, TranscriptOptions,
};
use zbus::object_server::{ObjectServer, SignalEmitter};
use zbus::{ObjectPath, interface};

use crate::recording::session_status::SessionStatus;
use crate::service::gate::Gate;
use crate::service::objects::report;
use crate::service::objects::session1::Session1;
use crate::service::read_pool::read;
use crate::session::controller::{Controller, no_baseline, no_plan};
use crate::session::option_values;

/// Most sessions in one reply: some 300 kB. For more, clients request the sessions before the last one.
const MOST_LISTED: u64 = 1000;

/// The manager on one connection, and the gate through which its callers come.
pub(crate) struct Manager1(pub(crate) Arc<Controller>, pub(crate) Arc<Gate>);

/// The daemon itself.
#[interface(name = "org.tactus.Tactus1.Manager1")]
impl Manager1 {
    /// Starts a measurement and returns its object at once. Options: `every_s` (d, from start to start of frames; 0 back
    /// to back), `count` (t), `for_s` (d), `baseline` (s, id; else the current one), `model` (s, absolute path, or
    /// `one-step`), `speed` (d, recordings: 1 own rate, 0 as fast as possible), `step` (b, a frame only when
    /// Session1.Step asks), `note` (s). How it measures, where not as configured: `nplc` (d), `averages` (t), `autozero`
    /// (b), `settle_ms` (d), `channel_delay_ms` (d), `reversal` (b), `zero_every` (t, 0 never), `ranges` (s, `fixed` or
    /// `planned`), `skip` (t, electrodes between those of a pair), `half` (b, of two reciprocal readings only one); the
    /// baseline must have been measured alike.
    #[zbus(out_args("session"))]
    async fn start_session(
        &self,
        options: Options,
        #[zbus(object_server)] server: &ObjectServer,
    ) -> Result<ObjectPath<'static>, Fault> {
        let status = self.0.start_session(&options).await?;
        registered_path(server, &status, &self.1).await
    }

    /// Records a baseline and returns its session at once; when it has ended it is the current baseline. Options:
    /// `frames` (t, default 10), `note` (s), and those of StartSession that say how it measures.
    #[zbus(out_args("session"))]
    async fn record_baseline(
        &self,
        options: Options,
        #[zbus(object_server)] server: &ObjectServer,
    ) -> Result<ObjectPath<'static>, Fault> {
        let status = self.0.record_baseline(&options).await?;
        registered_path(server, &status, &self.1).await
    }

    /// What the logbook holds, newest first: id, kind, state (`open`, `closed`, `interrupted`), start in ns since 1970
    /// UTC, frames, whether simulated, file, and `note`, `reason`, `ended_ns` where there are any. At most 1000 in one
    /// answer. Options: `count` (t), fewer than that; `before` (s, an id), those that come after it in the list.
    #[zbus(out_args("sessions"))]
    async fn list_sessions(&self, options: Options) -> Result<Vec<SessionSummary>, Fault> {
        let options: ListOptions = option_values::read(&options, |key| {
            (key == "count").then_some(option_values::LISTED)
        })?;
        let count = options.count.unwrap_or(MOST_LISTED).min(MOST_LISTED);
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        let before = options.before;
        let controller = Arc::clone(&self.0);
        let listed = read(move || controller.listed(count, before.as_deref())).await??;
        let active = self.0.active().map(|status| status.facts.id.clone());
        let each = listed.iter();
        Ok(each
            .map(|summary| report::session(summary, active.as_deref()))
            .collect())
    }

    /// The plan of a frame, without moving anything.
    #[allow(clippy::type_complexity)]
    #[zbus(out_args(
        "steps",
        "injections",
        "readings",
        "relay_moves",
        "reading_messages",
        "duration_s",
        "current_a",
        "compliance_v",
        "lines",
        "more"
    ))]
    async fn plan(
        &self,
    ) -> Result<
        (
            u64,
            u64,
            u64,
            u64,
            u64,
            f64,
            f64,
            f64,
            Vec<String>,
            PlanDetails,
        ),
        Fault,
    > {
        let plan = self.0.plan().ok_or_else(no_plan)?;
        Ok(planned(report::plan(&plan)))
    }

    /// The plan of a frame of a session that would be started with these options (those that say how it measures),
    /// without moving anything.
    #[allow(clippy::type_complexity)]
    #[zbus(out_args(
        "steps",
        "injections",
        "readings",
        "relay_moves",
        "reading_messages",
        "duration_s",
        "current_a",
        "compliance_v",
        "lines",
        "more"
    ))]
    async fn plan_with(
        &self,
        options: Options,
    ) -> Result<
        (
            u64,
            u64,
            u64,
            u64,
            u64,
            f64,
            f64,
            f64,
            Vec<String>,
            PlanDetails,
        ),
        Fault,
    > {
        let controller = Arc::clone(&self.0);
        let plan = read(move || controller.plan_with(&options)).await??;
        Ok(planned(report::plan(&plan)))
    }

    /// What is needed to draw a map, in metres: mesh hash, corners (x, y, ...), triangles of the region in the order of a
    /// map's values (three corners each), boundary loops one after the other (x, y, ...) with the points of each,
    /// centres of the electrodes (x, y, ...).
    #[allow(clippy::type_complexity)]
    #[zbus(out_args(
        "mesh_hash",
        "nodes",
        "triangles",
        "outline",
        "outline_lengths",
        "electrodes",
        "more"
    ))]
    async fn geometry(
        &self,
    ) -> Result<
        (
            String,
            Vec<f64>,
            Vec<u32>,
            Vec<f64>,
            Vec<u32>,
            Vec<f64>,
            GeometryDetails,
        ),
        Fault,
    > {
        let runtime = self.0.runtime();
        let drawn = || report::geometry(&runtime.setup.geometry);
        let geometry = runtime.drawn.get_or_init(drawn);
        Ok((
            geometry.mesh_hash.clone(),
            geometry.nodes.clone(),
            geometry.triangles.clone(),
            geometry.outline.clone(),
            geometry.outline_lengths.clone(),
            geometry.electrodes.clone(),
            report::geometry_name(&runtime.setup.geometry),
        ))
    }

    /// Tests the rig and returns when that is done: every relay against the sheet's own resistances, the contact of every
    /// electrode, reciprocity, noise. Refused while a session runs; the source is off and verified afterwards. Answers
    /// whether nothing is to be mended, what is, the table (subject, check, `ok`, `failed` or `not-judged`, measured and
    /// expected with NaN where there is none, unit, text), and what was found of the whole. No options.
    #[allow(clippy::type_complexity)]
    #[zbus(out_args("passed", "findings", "lines", "more"))]
    async fn test_instruments(
        &self,
        options: Options,
    ) -> Result<(bool, Vec<String>, Vec<TestLine>, TestDetails), Fault> {
        options.only(&[])?;
        let report = report::test(self.0.test_instruments().await?);
        Ok((report.passed, report.findings, report.lines, report.more))
    }

    /// How often each relay has closed and how long that may go on: number, purpose, closures, those it is rated for (0
    /// where nothing moves), the part of them, seconds of measuring that are left. Refused while a session runs. No
    /// options.
    #[zbus(out_args("relays"))]
    async fn relays(&self, options: Options) -> Result<Vec<RelayWear>, Fault> {
        options.only(&[])?;
        let relays = self.0.relay_wear().await?;
        Ok(relays.into_iter().map(report::wear).collect())
    }

    /// Looks for instruments: mDNS, VXI-11 broadcast, and these addresses. Nothing but `*IDN?` is said to them, and none is
    /// used. Options: `within_s` (d, default 3), `mdns` (b), `broadcast` (b). Answers address (empty where the daemon
    /// knows no way to it), identity, the ways it was found, the name it is announced under, whether the configuration
    /// uses it, lines that a configuration could have, a remark; and what could not be looked for.
    #[zbus(out_args("seen", "notes"))]
    async fn discover(
        &self,
        addresses: Vec<String>,
        options: Options,
    ) -> Result<(Vec<SeenInstrument>, Vec<String>), Fault> {
        let found = self.0.discover(&addresses, &options).await?;
        let seen = found.seen.into_iter().map(report::found_instrument);
        Ok((seen.collect(), found.notes))
    }

    /// How far a self-test is: steps done, of how many, what is done now.
    #[zbus(signal)]
    pub(crate) async fn test_progress(
        emitter: &SignalEmitter<'_>,
        done: u64,
        total: u64,
        what: &str,
    ) -> zbus::Result<()>;

    /// The current baseline: id, time of its last frame, frames averaged, mean voltages with their flags, standard
    /// deviations (NaN where unknown), whether simulated, settings.
    #[allow(clippy::type_complexity)]
    #[zbus(out_args(
        "id",
        "wall_ns",
        "frames",
        "volts",
        "flags",
        "deviation",
        "simulated",
        "more"
    ))]
    async fn baseline(
        &self,
    ) -> Result<
        (
            String,
            i64,
            u64,
            Vec<f64>,
            Vec<u8>,
            Vec<f64>,
            bool,
            BaselineDetails,
        ),
        Fault,
    > {
        let baseline = self.0.baseline().ok_or_else(no_baseline)?;
        let report = report::baseline(&baseline, self.0.baseline_remarks(&baseline).await);
        Ok((
            report.id,
            report.wall_ns,
            report.frames,
            report.volts,
            report.flags,
            report.deviation,
            report.simulated,
            report.more,
        ))
    }

    /// Makes an earlier baseline the current one, for the sessions to come, until another is recorded or the daemon ends;
    /// returns its id. It must have been measured as a session would be now.
    #[zbus(out_args("baseline"))]
    async fn use_baseline(&self, id: &str) -> Result<String, Fault> {
        self.0.use_baseline(id)
    }

    /// Switches the source off and opens every relay, verifies both, and says so. Lifts the refusal of relays that were
    /// found closed at the start. Refused while a session runs.
    #[zbus(out_args("done"))]
    async fn open_all(&self) -> Result<String, Fault> {
        self.0.open_all().await
    }

    /// Agrees to the instruments or modules that were found in place of the known ones, and says which.
    #[zbus(out_args("done"))]
    async fn accept_instruments(&self) -> Result<String, Fault> {
        self.0.accept().await
    }

    /// Reads the configuration again; one that is bad changes nothing, and the error is a line a problem. During a
    /// session it is taken at its end.
    #[zbus(out_args("done"))]
    async fn reload(&self) -> Result<String, Fault> {
        self.0.reload().await
    }

    /// What was said over the wires for the last frames, behind the opening of the conversation: a line of JSON each.
    /// Option: `frames` (t, default 1).
    #[zbus(out_args("lines"))]
    async fn transcript(&self, options: Options) -> Result<String, Fault> {
        let options: TranscriptOptions = option_values::read(&options, |key| {
            (key == "frames").then_some(option_values::TRANSCRIPT_FRAMES)
        })?;
        let frames = usize::try_from(options.frames.unwrap_or(1)).unwrap_or(usize::MAX);
        let entries = crate::instruments::transcripts::last(&self.0.transcript, frames);
        crate::instruments::transcripts::text(&entries)
            .map_err(|error| Fault::Failed(error.to_string()))
    }

    /// How the daemon is, all at once: whether it is well and what is not, the last frame, what waits for the disk, gaps,
    /// instruments, age of the baseline, days until the disk is full, life left of the relay that will be worn out first.
    /// Keys are documented in dbus/src/dictionaries.rs; what is not known is left out.
    #[zbus(out_args("health"))]
    async fn health(&self) -> Result<Health, Fault> {
        let health = self.0.health().await;
        Ok(health.report(&self.0.runtime().setup.config.notify))
    }

    /// The daemon, its health, and the running session with its last map, at one moment. Keys are documented in
    /// dbus/src/dictionaries.rs.
    #[zbus(out_args("status"))]
    async fn status(&self) -> Result<Status, Fault> {
        // it waits for the disk; everything else is read at one moment after it
        let health = self.health().await?;
        let active = self.0.active();
        Ok(Status {
            state: Some(self.state().to_owned()),
            simulated: Some(self.simulated()),
            source: Some(self.source().to_owned()),
            method: Some(self.method()),
            baseline_id: Some(self.baseline_id()),
            source_state: Some(self.source_state().to_owned()),
            record_directory: Some(self.record_directory()),
            last_error: Some(self.last_error()),
            version: Some(self.version().to_owned()),
            session: active.map(|session| Session1(session).report()),
            recovery: Some(self.recovery()),
            health: Some(health),
        })
    }

    /// Runs the command that tells people of troubles once, and says how it fared: `done` (b), `stderr` (s), `took_s` (d),
    /// and `code` (x) or `trouble` (s, why there is none).
    #[zbus(out_args("fared"))]
    async fn notify_test(&self) -> Result<NotifyResult, Fault> {
        Ok(self.0.notify_test().await.report())
    }

    /// Something happened to the rig, or to a session by it: each is an event of that session's record, too. Kinds:
    /// `frame-failed`, `source-unknown`, `alarm` (neither source nor switch can be made safe), `suspended`,
    /// `reconnecting`, `source-off`, `relays-open`, `others-found`, `accepted`, `reconnected`, `settings-verified`,
    /// `resumed`, `transcript`, `relays-closed`, `opened`, `fault`, `reloaded`, `reload-refused`; of the daemon `started`,
    /// `stopped`, `daily`, `trouble`, `trouble-over`, `notify-failed`. Details: `session` (s).
    #[zbus(signal)]
    async fn happened(
        emitter: &SignalEmitter<'_>,
        wall_ns: i64,
        kind: &str,
        text: &str,
        details: EventDetails,
    ) -> zbus::Result<()>;

    /// What is known of the source: `off` (verified), `in use`, `unknown`.
    #[zbus(property)]
    fn source_state(&self) -> &str {
        self.0.source_state()
    }

    /// A lost rig that is being looked for; empty when none is. `what` (s), `tries` (t), `next_s` (d, until the next try;
    /// absent while one is under way), `since_ns` (x), `person` (b, whether a person must agree first).
    #[zbus(property)]
    fn recovery(&self) -> Recovery {
        report::recovery(self.0.recovery().as_ref())
    }

    /// Version of the daemon.
    #[zbus(property(emits_changed_signal = "const"))]
    fn version(&self) -> &str {
        env!("CARGO_PKG_VERSION")
    }

    /// `idle`, `baseline`, `acquiring`, `testing`, `suspended`, `faulted`.
    #[zbus(property)]
    fn state(&self) -> &str {
        self.0.state().word()
    }

    /// Whether voltages come from a simulated sheet.
    #[zbus(property)]
    fn simulated(&self) -> bool {
        self.0.runtime().simulated
    }

    /// `rig` or `recording`.
    #[zbus(property)]
    fn source(&self) -> &str {
        if self.0.is_recording() {
            "recording"
        } else {
            "rig"
        }
    }

    /// Their objects.
    #[zbus(property)]
    fn instruments(&self) -> Vec<ObjectPath<'static>> {
        let instruments = self.0.identities().instruments;
        instruments
            .iter()
            .map(|found| crate::service::objects::instrument1::path(found.role))
            .collect()
    }

    /// The running session, else an interrupted one that cannot be resumed yet; `/` when there is none.
    #[zbus(property)]
    fn active_session(&self) -> ObjectPath<'static> {
        self.0
            .to_stop()
            .and_then(|status| dbus::session_path(&status.facts.id).ok())
            .unwrap_or_else(|| ObjectPath::from_static_str_unchecked("/"))
    }

    /// Id of the current baseline, empty when there is none.
    #[zbus(property)]
    fn baseline_id(&self) -> String {
        self.0
            .baseline()
            .map(|baseline| baseline.id.clone())
            .unwrap_or_default()
    }

    /// The configured method as a person would name it.
    #[zbus(property)]
    fn method(&self) -> String {
        let runtime = self.0.runtime();
        runtime.setup.model.reconstructor.method().to_owned()
    }

    /// Where session files are written.
    #[zbus(property(emits_changed_signal = "const"))]
    fn record_directory(&self) -> String {
        self.0
            .runtime()
            .setup
            .record_directory
            .display()
            .to_string()
    }

    /// Why the daemon is faulted, empty when it is not.
    #[zbus(property)]
    fn last_error(&self) -> String {
        match self.0.state() {
            crate::session::state::State::Faulted(why) => why,
            _ => String::new(),
        }
    }
}

/// The session's object, there on the caller's own connection before the caller hears of it.
async fn registered_path(
    server: &ObjectServer,
    status: &Arc<SessionStatus>,
    gate: &Arc<Gate>,
) -> Result<ObjectPath<'static>, Fault> {
    crate::service::show(server, status, gate)
        .await
        .map_err(Fault::Connection)?;
    dbus::session_path(&status.facts.id)
        .or_else(|_| ObjectPath::try_from(ROOT_PATH))
        .map_err(|error| Fault::Failed(error.to_string()))
}

/// A plan as its method returns it.
type Planned = (
    u64,
    u64,
    u64,
    u64,
    u64,
    f64,
    f64,
    f64,
    Vec<String>,
    PlanDetails,
);

fn planned(plan: dbus::PlanReport) -> Planned {
    (
        plan.steps,
        plan.injections,
        plan.readings,
        plan.relay_moves,
        plan.reading_messages,
        plan.duration_s,
        plan.current_a,
        plan.compliance_v,
        plan.lines,
        plan.more,
    )
}
