//! The kinds of events: one table for journal level, record and reference page.

/// The level in the journal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Severity {
    /// Normal operation.
    Info,
    Warn,
    Error,
}

impl Severity {
    const fn word(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warn => "warning",
            Self::Error => "error",
        }
    }
}

/// Where events of a kind are stored, besides the journal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kept {
    Session,
    DaemonLog,
    /// In the active session, else in the daemon log.
    Either,
    /// In the journal only; no signal on the bus.
    Journal,
}

impl Kept {
    const fn word(self) -> &'static str {
        match self {
            Self::Session => "session",
            Self::DaemonLog => "daemon log",
            Self::Either => "session or daemon log",
            Self::Journal => "",
        }
    }
}

macro_rules! kinds {
    ($($kind:ident $name:expr, $severity:ident, $kept:ident, $meaning:literal, $action:literal;)*) => {
        /// The kind of an event.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
        pub(crate) enum EventKind {
            $(#[doc = $meaning] $kind),*
        }

        impl EventKind {
            /// Every kind, in the order of the reference page.
            pub(crate) const ALL: &[Self] = &[$(Self::$kind),*];

            /// The level in the journal.
            pub(crate) const fn severity(self) -> Severity {
                match self {
                    $(Self::$kind => Severity::$severity),*
                }
            }

            /// Its row of the table.
            const fn row(self) -> EventRow {
                match self {
                    $(Self::$kind => EventRow {
                        name: $name,
                        level: Severity::$severity.word(),
                        kept: Kept::$kept.word(),
                        meaning: $meaning,
                        action: $action,
                    }),*
                }
            }
        }
    };
}

kinds! {
    Started "started", Info, DaemonLog, "The daemon has started", "Nothing";
    Stopped "stopped", Info, DaemonLog, "The daemon was stopped", "Nothing";
    Daily "daily", Info, DaemonLog, "The summary of a day: frames, failures, disk, relays", "Nothing";
    Trouble "trouble", Warn, DaemonLog, "A problem has begun, and people are notified of it", "`tactus status` names it and the remedy";
    TroubleOver "trouble-over", Info, DaemonLog, "That problem has ended", "Nothing";
    AlarmActive "alarm-active", Warn, Either, "The alarm of a rule has become active: value and limit", "Look at its guidance: `tactus alarms`";
    AlarmOver "alarm-over", Info, Either, "That alarm has ended", "Acknowledge it: `tactus alarms ack`";
    AlarmHeld "alarm-held", Info, Either, "The condition of a latched alarm is gone; the alarm stays active", "`tactus alarms reset`";
    AlarmInvalid "alarm-invalid", Warn, Either, "An alarm cannot be judged: it is not known whether its condition holds", "Remove the cause that the text names";
    AlarmJudged "alarm-judged", Info, Either, "That alarm is judged again", "Nothing";
    AlarmHandled "alarm-handled", Info, Either, "A person acknowledged, shelved or reset an alarm or changed whether it is in service, or the time of shelving is over", "Nothing";
    NotifyFailed "notify-failed", Warn, DaemonLog, "The command of `[notify]` failed, or could not be started in time", "Run `tactus notify test`";
    Reloaded "reloaded", Warn, DaemonLog, "The configuration was read again", "Nothing";
    ReloadRefused "reload-refused", Warn, DaemonLog, "The new configuration has problems, or the present rig cannot be switched off; the configuration in force stays, and one that waits for the end of a session is discarded", "Run `tactusd --check`, correct the file or connect the rig, reload";
    Alarm "alarm", Error, Either, "The sheet may be live, or frames may be lost", "Do what the text says, at once";
    Fault "fault", Warn, Either, "A fault ended a session, or the rig cannot be used", "Remove the cause that the text names; `tactus doctor` helps";
    SourceUnknown "source-unknown", Error, Either, "The state of the source cannot be read; the injecting relays are open", "Switch the source off by hand";
    SourceOff "source-off", Warn, Either, "The source replies again and is off, verified", "Nothing";
    RelaysOpen "relays-open", Warn, Either, "The switch replies again and its relays are open, verified", "Nothing";
    RelaysClosed "relays-closed", Error, DaemonLog, "Relays were closed at the start; nothing is measured", "Find out who closed them, then `tactus instruments open-all`";
    Opened "opened", Warn, DaemonLog, "The source was switched off and every relay opened, verified", "Nothing";
    OthersFound "others-found", Error, Either, "Instruments other than the known ones reply", "Connect the known ones, or `tactus instruments accept`";
    Accepted "accepted", Warn, DaemonLog, "A person accepted other instruments", "Record a new baseline";
    FrameFailed "frame-failed", Error, Session, "A frame failed and is not in the record", "If it recurs, read the text and the transcript";
    Transcript "transcript", Warn, Session, "The file with the messages of a failed frame", "Read the file to find the cause";
    Suspended "suspended", Warn, Session, "The session waits for the rig; the source is off if it can be reached", "Check the cables and the power of the instruments";
    Reconnecting "reconnecting", Warn, Either, "An attempt to reconnect the rig has failed", "Check the instrument that the text names";
    Reconnected "reconnected", Warn, Either, "The same instruments are back", "Nothing";
    SettingsVerified "settings-verified", Warn, Session, "The settings were applied again and read back", "Nothing";
    Resumed "resumed", Warn, Session, "The suspended session continues", "Nothing";
    Restarted logbook::RESUMED, Warn, Session, "An interrupted session continues in its file", "Nothing";
    ShutDown "shut-down", Warn, Session, "The daemon was stopped; its next start resumes the session", "Nothing";
    ResumeWaits "resume-waits", Warn, DaemonLog, "An interrupted session continues as soon as rig and disk can be used", "Remove the cause that the text names";
    NotResumed "not-resumed", Warn, DaemonLog, "An interrupted session does not continue", "Start a new one";
    NotClosed "not-closed", Warn, DaemonLog, "A session has ended, but its file could not be closed", "Repair the disk; the next start closes the file";
    Paused "paused", Warn, Session, "No frames were taken for a while, on request or because the disk was slow", "If the disk was slow, look at `tactus status`";
    FramesMissed "frames-missed", Warn, Session, "Frames were due and could not be taken in time", "Lengthen the period";
    Baseline "baseline", Warn, Session, "The frames of a baseline could not be averaged", "Record it again";
    Zero "zero", Warn, Session, "A frame at zero current was taken; it is subtracted from those after it", "Nothing";
    Ranges "ranges", Warn, Session, "Overloaded readings have a larger range from the next frame on", "Nothing";
    ClockMoved "clock-moved", Warn, Session, "The wall clock was set, or the machine slept", "Nothing: frames have both times";
    Plausible "plausible", Warn, Session, "The first frame after a gap agrees with the last one before it", "Nothing";
    Implausible "implausible", Warn, Session, "The first frame after a gap differs from the last one before it", "Check sheet and contacts; record a new baseline";
    MethodSuspended "method-suspended", Error, Session, "Reconstruction failed; frames are recorded without maps", "Report it; `tactus replay` makes the maps later";
    MapsMissed "maps-missed", Warn, Session, "Maps were not ready in time; their frames are in the record", "Choose a faster method, or a map for every n-th frame";
    Tracking "tracking", Warn, Session, "The tracked baseline: an electrode is excluded or used again, maps are no longer or again known to be true, or the baseline cannot be tracked", "Read the text: it states the remedy";
    Quantities "quantities", Warn, Session, "Dose, unrelieved time and hot spots begin again or omit frames after a crash, or quantities cannot be stored", "`tactus quantities --recompute` computes them from the frames";
    TrackingOrdered imaging::tracking::ORDERED, Info, Session, "A person overruled the tracked baseline: the order, and the first frame for which it is valid", "Nothing";
    DiskLow "disk-low", Warn, Session, "Little space is left for the record", "Free space";
    DiskEnough "disk-enough", Warn, Session, "There is enough space again", "Nothing";
    DiskFull "disk-full", Warn, Session, "The disk is full: acquisition waits, the source is off", "Free space; the session then continues";
    DiskSpace "disk-room", Warn, Session, "There is space again, acquisition continues", "Nothing";
    RecordLocked "record-locked", Warn, Session, "Another program locks the session file; acquisition waits", "Close that program";
    RecordUnlocked "record-unlocked", Warn, Session, "The session file can be written again", "Nothing";
    SessionDeleted "session-deleted", Warn, Session, "The oldest session was deleted to free space, as configured", "Nothing";
    SessionNotDeleted "session-not-deleted", Warn, Session, "An old session could not be deleted to free space; younger ones are deleted instead", "Remove the cause that the text names";
    PartRefused "part-refused", Warn, Session, "The next part of the session could not be created; the present one continues", "Check the disk that the text names";
    PartCreated "part-created", Warn, Session, "The next part of the session was created after earlier attempts had failed", "Nothing";
    ContainedPanic "contained-panic", Error, Journal, "The daemon's own code failed while it replied to one client", "Report it with the text";
    Metrics "metrics", Warn, Journal, "The address of `[metrics]` cannot be listened on", "Choose another address, reload";
    CallsLost "calls-lost", Warn, Journal, "Calls of a client that requested no reply were discarded", "Find the client that sends too many";
    PeerSocket "peer-socket", Warn, Journal, "The peer socket could not accept a connection", "Check the limit of open files";
    PeerUnauthorised "peer-unauthorised", Warn, Journal, "A user without permission was refused at the peer socket", "Add the user to the group `tactus` if access is intended";
    PeersRefused "peers-refused", Warn, Journal, "A user has too many connections to the peer socket", "Close some of them";
    PeerAuthenticationFailed "peer-authentication-failed", Warn, Journal, "A client of the peer socket did not authenticate as D-Bus requires", "Check that client";
}

impl EventKind {
    /// The machine-readable name, such as `frame-failed`.
    pub(crate) const fn as_str(self) -> &'static str {
        self.row().name
    }
}

/// A kind of event, as the reference page shows it.
#[derive(Debug, Clone, Copy)]
pub struct EventRow {
    /// The machine-readable name, such as `frame-failed`.
    pub name: &'static str,
    /// Level in the journal; empty if events of this kind are only written to session files.
    pub level: &'static str,
    /// Where it is stored, besides the journal.
    pub kept: &'static str,
    /// What has happened.
    pub meaning: &'static str,
    /// What the operator should do.
    pub action: &'static str,
}

/// Every kind of event that the daemon reports, or finds in session files.
pub fn event_kinds() -> Vec<EventRow> {
    let file = |name, meaning| EventRow {
        name,
        level: "",
        kept: "session",
        meaning,
        action: "Nothing",
    };
    let mut rows: Vec<EventRow> = EventKind::ALL.iter().map(|kind| kind.row()).collect();
    rows.push(file(
        logbook::CONTINUED,
        "A part of a session begins, after the part that its text names",
    ));
    rows.push(file(
        logbook::CUT,
        "`tactus sessions repair` removed the frames that its text names",
    ));
    rows
}
