//! The D-Bus interface of the daemon itself.

use std::sync::Arc;

use dbus::{
    BaselineReport, EventDetails, Fault, Health, ListOptions, NotifyResult, Options, PlanReport,
    ROOT_PATH, Recovery, RelayWear, SeenInstrument, SessionSummary, Status, TestReport,
    TranscriptOptions,
};
use zbus::message::Header;
use zbus::object_server::{ObjectServer, SignalEmitter};
use zbus::{Connection, ObjectPath, interface};

use crate::recording::session_status::SessionStatus;
use crate::service::gate::Gate;
use crate::service::objects::report;
use crate::service::objects::session1::Session1;
use crate::service::read_pool::read;
use crate::session::controller::{Controller, no_baseline, no_plan};
use crate::session::option_values;

/// Maximum number of sessions in one reply: some 300 kB. For more, clients request the sessions listed after the last
/// one.
const MOST_LISTED: u64 = 1000;

/// The manager on one connection, and the gate of the connection.
pub(crate) struct Manager1(pub(crate) Arc<Controller>, pub(crate) Arc<Gate>);

/// The daemon itself.
#[interface(name = "org.tactus.Tactus1.Manager1")]
impl Manager1 {
    /// Starts a measurement and returns its session object at once. Options: `every_s` (d, period from start to start
    /// of frames; 0: back to back), `count` (t, number of frames), `for_s` (d, duration), `baseline` (s, id; default:
    /// the current one), `model` (s, absolute path, or `one-step`), `speed` (d, for recordings: 1 is the recorded rate,
    /// 0 as fast as possible), `step` (b, a frame is taken only on a call of Session1.Step), `note` (s). Measuring
    /// options, by default as configured, have the names and ranges of the keys of `[survey]` in the configuration; the
    /// error for an unknown option lists them. The baseline must have been measured with the same settings.
    #[zbus(out_args("session"))]
    async fn start_session(
        &self,
        options: Options,
        #[zbus(object_server)] server: &ObjectServer,
    ) -> Result<ObjectPath<'static>, Fault> {
        let status = self.0.start_session(&options).await?;
        registered_path(server, &status, &self.1).await
    }

    /// Records a baseline and returns its session object at once. When the session has ended, it is the current
    /// baseline. Options: `frames` (t, default 10), `note` (s), and the measuring options of StartSession.
    #[zbus(out_args("session"))]
    async fn record_baseline(
        &self,
        options: Options,
        #[zbus(object_server)] server: &ObjectServer,
    ) -> Result<ObjectPath<'static>, Fault> {
        let status = self.0.record_baseline(&options).await?;
        registered_path(server, &status, &self.1).await
    }

    /// The sessions of the logbook, newest first, at most 1000 per reply: id, kind, state (`open`, `closed`,
    /// `interrupted`), start in ns since 1970 UTC, number of frames, whether simulated, file, and `note`, `reason`,
    /// `ended_ns` if present. Options: `count` (t, maximum number); `before` (s, an id: only the sessions after it in
    /// the list).
    #[zbus(out_args("sessions"))]
    async fn list_sessions(&self, options: Options) -> Result<Vec<SessionSummary>, Fault> {
        let options: ListOptions = option_values::read(&options, |key| {
            (key == "count").then_some(option_values::LISTED)
        })?;
        let count = options.count.unwrap_or(MOST_LISTED).min(MOST_LISTED);
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        let before = options.before;
        let controller = Arc::clone(&self.0);
        let listed = read(move || controller.records.listed(count, before.as_deref())).await??;
        let active = self.0.active().map(|status| status.facts.id.clone());
        let each = listed.iter();
        Ok(each
            .map(|summary| report::session(summary, active.as_deref()))
            .collect())
    }

    /// The plan of a frame. Moves nothing. The keys of the plan are documented in dbus/src/manager1.rs.
    #[zbus(out_args("plan"))]
    async fn plan(&self) -> Result<PlanReport, Fault> {
        let plan = self.0.plan().ok_or_else(no_plan)?;
        Ok(report::plan(&plan))
    }

    /// The plan of a frame of a session with these measuring options of StartSession, as in Plan. Moves nothing.
    #[zbus(out_args("plan"))]
    async fn plan_with(&self, options: Options) -> Result<PlanReport, Fault> {
        let controller = Arc::clone(&self.0);
        let plan = read(move || controller.plan_with(&options)).await??;
        Ok(report::plan(&plan))
    }

    /// The data for drawing a map, in metres: `mesh_hash` (s), `nodes` (ad, corners x, y, ...), `triangles` (au, of the
    /// region in the order of a map's values, three indices of corners each), `outline` (ad, boundary loops one after the
    /// other, x, y, ...), `outline_lengths` (au, points of each loop), `electrodes` (ad, centres x, y, ...), `name` (s),
    /// `regions` (s, JSON).
    #[zbus(out_args("geometry"))]
    async fn geometry(&self) -> Result<dbus::Geometry, Fault> {
        let runtime = self.0.runtime();
        let setup = &runtime.setup;
        let drawn = || report::geometry(&setup.geometry, &setup.config.region);
        Ok(runtime.drawn.get_or_init(drawn).clone())
    }

    /// Tests the rig and returns at the end of the test: every relay against the sheet's own resistances, the contact
    /// of every electrode, reciprocity, noise. Refused while a session runs; afterwards the source is off, verified.
    /// Returns `passed` (b, whether nothing has to be repaired), `findings` (as, what has to be repaired), `lines`
    /// (a(sssddss), the table: subject, check, `ok`, `failed` or `not-judged`, measured and expected value or NaN, unit,
    /// text), and results for the whole rig, whose keys are documented in dbus/src/dictionaries/mod.rs. No options.
    #[zbus(out_args("report"))]
    async fn test_instruments(&self, options: Options) -> Result<TestReport, Fault> {
        options.only(&[])?;
        Ok(report::test(self.0.test_instruments().await?))
    }

    /// The wear of every relay: number, purpose, closures so far, rated closures (0 for a switch without moving parts),
    /// used fraction of the rating, remaining seconds of measuring. Refused while a session runs. No options.
    #[zbus(out_args("relays"))]
    async fn relays(&self, options: Options) -> Result<Vec<RelayWear>, Fault> {
        options.only(&[])?;
        let relays = self.0.relay_wear().await?;
        Ok(relays.into_iter().map(report::wear).collect())
    }

    /// Searches for instruments: mDNS, VXI-11 broadcast, and these addresses. Sends them only `*IDN?` and uses none of
    /// them. Options: `within_s` (d, default 3), `mdns` (b), `broadcast` (b). Returns for each instrument its address
    /// (empty if the daemon cannot connect to it), identity, the methods that found it, its announced name, whether the
    /// configuration uses it, proposed lines of configuration, a remark; and notes on methods that could not be used.
    #[zbus(out_args("seen", "notes"))]
    async fn discover(
        &self,
        addresses: Vec<String>,
        options: Options,
    ) -> Result<(Vec<SeenInstrument>, Vec<String>), Fault> {
        let found = self.0.discover(&addresses, &options).await?;
        Ok((found.seen, found.notes))
    }

    /// Progress of a self-test: steps done, number of steps, the present step.
    #[zbus(signal)]
    pub(crate) async fn test_progress(
        emitter: &SignalEmitter<'_>,
        done: u64,
        total: u64,
        what: &str,
    ) -> zbus::Result<()>;

    /// The current baseline: `id` (s), `wall_ns` (x, time of its last frame), `frames` (t, number averaged), `volts` (ad,
    /// means; NaN where the flag is not 0), `flags` (ay), `deviation` (ad, standard deviations; NaN if unknown),
    /// `simulated` (b), and settings, whose keys are documented in dbus/src/dictionaries/mod.rs.
    #[zbus(out_args("baseline"))]
    async fn baseline(&self) -> Result<BaselineReport, Fault> {
        let baseline = self.0.baseline().ok_or_else(no_baseline)?;
        let remarks = self.0.baseline_remarks(&baseline).await;
        let tracked = self.0.baseline_tracking(&baseline).await;
        Ok(report::baseline(&baseline, remarks, tracked))
    }

    /// Remarks to read before this kept baseline is used, a sentence each: noise that contradicts the configuration, a load on
    /// the sheet. None if there is nothing to remark.
    #[zbus(out_args("remarks"))]
    async fn baseline_remarks(&self, id: &str) -> Result<Vec<String>, Fault> {
        let (controller, id) = (Arc::clone(&self.0), id.to_owned());
        let chosen = read(move || controller.chosen_baseline(Some(&id))).await??;
        Ok(self.0.baseline_remarks(&chosen).await)
    }

    /// Makes an earlier baseline the current one for later sessions, until another is recorded or the daemon ends;
    /// returns its id. It must have been measured with the settings of such a session.
    #[zbus(out_args("baseline"))]
    async fn use_baseline(&self, id: &str) -> Result<String, Fault> {
        self.0.use_baseline(id)
    }

    /// Overrules the tracked baseline of the running session, and returns the number of the first frame that the order applies to.
    /// Orders: `empty-now` (the sheet is empty: that frame becomes the tracked baseline), `loaded-now` (a load is on the sheet: the
    /// tracked baseline is not updated until `empty-now`), `forget-anchor` (slow changes so far are ageing: past baselines are
    /// discarded). Each order is an event of the session, and replay applies it at the same frame.
    #[zbus(out_args("from_frame"))]
    async fn override_tracking(
        &self,
        order: &str,
        #[zbus(connection)] connection: &Connection,
        #[zbus(header)] header: Header<'_>,
    ) -> Result<u64, Fault> {
        let by = self.1.caller_words(connection, &header).await?;
        self.0.override_tracking(order, by).await
    }

    /// Switches the source off and opens every relay, verifies both, and returns a report. Lifts the refusal to measure
    /// after relays were found closed at the start. Refused while a session runs.
    #[zbus(out_args("done"))]
    async fn open_all(&self) -> Result<String, Fault> {
        self.0.open_all().await
    }

    /// Accepts the instruments or modules that were found in place of the expected ones, and returns which.
    #[zbus(out_args("done"))]
    async fn accept_instruments(&self) -> Result<String, Fault> {
        self.0.accept().await
    }

    /// Reloads the configuration. An invalid one changes nothing; the error has a line for each problem. The
    /// configuration in force also stays if the present rig cannot be switched off. During a session the new
    /// configuration is applied at the session's end, unless an invalid one is reloaded before.
    #[zbus(out_args("done"))]
    async fn reload(&self) -> Result<String, Fault> {
        self.0.reload().await
    }

    /// The messages exchanged with the instruments: those that opened the connection, then those of the last frames. A
    /// line of JSON each. Option: `frames` (t, default 1).
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

    /// The daemon's health in one reply: whether all is well, active alarms, last frame, frames waiting for the disk,
    /// gaps, instruments, age of the baseline, days until the disk is full, remaining life of the most worn relay. The
    /// keys are documented in dbus/src/dictionaries/mod.rs; unknown values are left out.
    #[zbus(out_args("health"))]
    async fn health(&self) -> Result<Health, Fault> {
        let health = self.0.health().await;
        Ok(health.report(&self.0.runtime().setup.config.notify))
    }

    /// The daemon, its health, and the running session with its last map, read at one moment. The keys are documented
    /// in dbus/src/dictionaries/mod.rs.
    #[zbus(out_args("status"))]
    async fn status(&self) -> Result<Status, Fault> {
        // first, because it may wait for the disk: everything else is read together after it
        let health = self.health().await?;
        let active = self.0.active();
        Ok(Status {
            state: Some(self.state().to_owned()),
            simulated: Some(self.simulated()),
            source: Some(self.source().to_owned()),
            method: Some(self.method()),
            baseline_id: Some(self.baseline_id()),
            baseline_remarks: self.0.known_remarks(),
            source_state: Some(self.source_state().to_owned()),
            record_directory: Some(self.record_directory()),
            last_error: Some(self.last_error()),
            version: Some(self.version().to_owned()),
            session: active.map(|session| Session1(session).report()),
            recovery: Some(self.recovery()),
            health: Some(health),
        })
    }

    /// Runs the notification command once and returns its result: `done` (b), `stderr` (s), `took_s` (d), and `code`
    /// (x) or `trouble` (s, why there is no exit code).
    #[zbus(out_args("fared"))]
    async fn notify_test(&self) -> Result<NotifyResult, Fault> {
        Ok(self.0.notify_test().await)
    }

    /// An event of the rig or of a session; events of a session are in its record too. The kinds, such as `frame-failed`, are listed in
    /// `docs/reference/events.md`. Details: `session` (s).
    #[zbus(signal)]
    async fn happened(
        emitter: &SignalEmitter<'_>,
        wall_ns: i64,
        kind: &str,
        text: &str,
        details: EventDetails,
    ) -> zbus::Result<()>;

    /// State of the source: `off` (verified), `in use`, `unknown`.
    #[zbus(property)]
    fn source_state(&self) -> &str {
        self.0.source_state()
    }

    /// Reconnection of a lost rig; empty if none is lost. `what` (s, what was lost), `tries` (t, attempts so far),
    /// `next_s` (d, time until the next attempt; absent during one), `since_ns` (x), `person` (b, whether the operator
    /// must act first).
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

    /// The objects of the instruments.
    #[zbus(property)]
    fn instruments(&self) -> Vec<ObjectPath<'static>> {
        let instruments = self.0.identities().instruments;
        instruments
            .iter()
            .map(|found| crate::service::objects::instrument1::path(found.role))
            .collect()
    }

    /// The running session, otherwise an interrupted one that cannot be resumed yet; `/` if there is none.
    #[zbus(property)]
    fn active_session(&self) -> ObjectPath<'static> {
        self.0
            .to_stop()
            .and_then(|status| dbus::session_path(&status.facts.id).ok())
            .unwrap_or_else(|| ObjectPath::from_static_str_unchecked("/"))
    }

    /// Id of the current baseline, empty if there is none.
    #[zbus(property)]
    fn baseline_id(&self) -> String {
        self.0
            .baseline()
            .map(|baseline| baseline.id.clone())
            .unwrap_or_default()
    }

    /// Description of the configured method.
    #[zbus(property)]
    fn method(&self) -> String {
        let runtime = self.0.runtime();
        runtime.setup.model.reconstructor.method().to_owned()
    }

    /// Directory of the session files.
    #[zbus(property(emits_changed_signal = "const"))]
    fn record_directory(&self) -> String {
        self.0
            .runtime()
            .setup
            .record_directory
            .display()
            .to_string()
    }

    /// Why the daemon is faulted, empty if it is not.
    #[zbus(property)]
    fn last_error(&self) -> String {
        match self.0.state() {
            crate::session::state::State::Faulted(why) => why,
            _ => String::new(),
        }
    }
}

/// The path of the session's object, which is registered on the caller's connection before the caller receives the
/// path.
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
