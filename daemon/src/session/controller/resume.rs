//! Resumes a session that the daemon did not end: after a crash, a reboot, a power cut. It continues in the same file
//! with the same sequence, an event explains the gap, instruments and settings are verified, and the baseline is
//! checked. A session that cannot be resumed is closed, with the reason.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crate::events::kind::EventKind;
use chrono::{DateTime, TimeDelta, Utc};
use dbus::{Fault, Options};
use logbook::{
    FrameRecord, LogbookError, Resumed, SessionHeader, SessionKind, SessionReader, SessionWriter,
};
use rig::Clock;

use crate::monitoring::disk::free_bytes;
use crate::recording::end_marks::EndMarks;
use crate::session::controller::Controller;
use survey::Protocol;
use survey::error_chain as chain;

/// Free space, bytes, that suffices to open a session.
const SPACE_TO_OPEN: u64 = 1 << 20;
/// Period in which resumptions of a session are counted.
const AN_HOUR: TimeDelta = TimeDelta::try_hours(1).unwrap();
/// Age from which a baseline may have drifted.
const OLD_BASELINE: TimeDelta = TimeDelta::try_days(7).unwrap();

/// An interrupted session, and the writer that continues it.
pub(super) struct Interrupted {
    pub writer: SessionWriter,
    pub resumed: Resumed,
    /// The last frame before the gap.
    pub last: Option<FrameRecord>,
    /// How long it had run when that frame was taken; 0 if its duration has no limit.
    run: Duration,
    /// Whether its daemon was stopped in an orderly way.
    stopped: bool,
}

/// Why an interrupted session is not resumed.
pub(super) enum NotResumed {
    /// Permanently: it is closed with this reason.
    Closed(String),
    /// Not with the present configuration: the session is left unchanged.
    Left(String),
    /// Not yet: the disk must become writable, another process must release the file, or a test of the rig must end.
    Later(String),
}

impl From<LogbookError> for NotResumed {
    fn from(error: LogbookError) -> Self {
        match error.is_disk() || error.is_locked() {
            true => Self::Later(chain(&error)),
            false => Self::Left(chain(&error)),
        }
    }
}

impl From<Fault> for NotResumed {
    fn from(fault: Fault) -> Self {
        match fault {
            // another session that has begun stops the waiting one
            Fault::DiskRefused(text) | Fault::SessionActive(text) => Self::Later(text),
            fault => Self::Left(fault.text()),
        }
    }
}

impl Controller {
    /// Resumes the most recent interrupted session as soon as the rig is ready, and closes the others. Returns whether
    /// there is one.
    pub(crate) async fn resume_interrupted(self: &Arc<Self>) -> bool {
        let runtime = self.runtime();
        if !runtime.setup.config.record.resume || self.is_recording() {
            return false;
        }
        let controller = Arc::clone(self);
        let found = tokio::task::spawn_blocking(move || controller.records.interrupted()).await;
        let found = match found {
            Ok(Ok(found)) => found,
            Ok(Err(error)) => {
                tracing::warn!(
                    "the search for interrupted sessions failed: {}",
                    chain(&error)
                );
                return false;
            }
            Err(_) => return false,
        };
        let mut newest = None;
        let marks = self.with_end_marks(EndMarks::reasons).await;
        let Some(mut ended) = marks else {
            // without the marks, an ended session cannot be distinguished from an interrupted one
            return false;
        };
        for session in found {
            let id = session.session().to_owned();
            let mark = ended.remove(&id);
            let marked = mark.is_some();
            let reason = match (session.kind, mark) {
                (_, Some(reason)) => reason,
                (SessionKind::Baseline, None) => "interrupted before it was complete".to_owned(),
                (SessionKind::Measurement, None) if newest.is_some() => {
                    "interrupted, and a later session was begun".to_owned()
                }
                (SessionKind::Measurement, None) => {
                    newest = Some((session.path, id));
                    continue;
                }
            };
            if self.close_interrupted(&session.path, &reason).await && marked {
                self.with_end_marks(move |ends| ends.clear(&id)).await;
            }
        }
        // the remaining marks are of sessions whose file records the end, or was deleted
        self.with_end_marks(move |ends| {
            for id in ended.keys() {
                ends.clear(id);
            }
        })
        .await;
        let Some((path, id)) = newest else {
            return false;
        };
        if self.rig_fault().is_none() {
            return self.resume_or_wait(&path, id).await;
        }
        let text = format!(
            "{} was interrupted; it continues when the rig can be used",
            path.display()
        );
        self.report(None, EventKind::ResumeWaits, &text).await;
        self.wait_to_go_on(path, id, &text);
        true
    }

    /// Resumes a session. Returns whether it is resumed now or will be later.
    async fn resume_or_wait(self: &Arc<Self>, path: &Path, id: String) -> bool {
        match self.resume(path.to_owned()).await {
            Ok(()) => true,
            Err(NotResumed::Later(why)) => {
                let text = format!("{} continues when this is over: {why}", path.display());
                self.report(None, EventKind::ResumeWaits, &text).await;
                self.wait_to_go_on(path.to_owned(), id, &text);
                true
            }
            Err(not_resumed) => {
                self.report_not_resumed(path, not_resumed).await;
                false
            }
        }
    }

    pub(super) async fn report_not_resumed(&self, path: &Path, not_resumed: NotResumed) {
        match not_resumed {
            NotResumed::Left(why) | NotResumed::Later(why) => {
                let text = format!("{} is not resumed: {why}", path.display());
                self.report(None, EventKind::NotResumed, &text).await;
            }
            NotResumed::Closed(why) => {
                let text = format!("{} is not resumed: {why}", path.display());
                self.report(None, EventKind::NotResumed, &text).await;
                self.close_interrupted(path, &format!("interrupted; {why}"))
                    .await;
            }
        }
    }

    pub(super) async fn resume(self: &Arc<Self>, path: PathBuf) -> Result<(), NotResumed> {
        let no_reload = self.without_reload().await;
        let runtime = self.runtime();
        let folder = runtime.setup.record_directory.clone();
        let limited = runtime.setup.schedule.lasts.is_some();
        let opened = tokio::task::spawn_blocking(move || {
            open(&path, limited).map_err(|error| match free_bytes(&folder) {
                // without space for the files of its journal, SQLite reports other errors
                Ok(free) if free < SPACE_TO_OPEN => NotResumed::Later(chain(&error)),
                _ => error.into(),
            })
        })
        .await;
        let (found, baseline) =
            opened.map_err(|_| NotResumed::Left("it could not be read".to_owned()))??;
        let now = runtime.clock.wall();
        let header = &found.resumed.header;
        let last = found.resumed.last.map_or(header.started, |last| last.wall);
        let gap = now.signed_duration_since(last);
        let record = &runtime.setup.config.record;
        if gap.num_seconds() as f64 > record.resume_within_h * 3600.0 {
            return Err(NotResumed::Closed(format!(
                "its last frame is older than record.resume_within_h ({} h)",
                record.resume_within_h
            )));
        }
        let lately = within_an_hour(&found.resumed.before, now);
        if lately >= record.resume_per_hour {
            return Err(NotResumed::Closed(format!(
                "it has been resumed {lately} times within an hour (record.resume_per_hour); see the journal for what ends \
                 the daemon"
            )));
        }
        let options = from_json(&header.asked).ok_or_else(|| {
            NotResumed::Closed("the options that it was started with cannot be read".to_owned())
        })?;
        self.same_rig(header, &self.protocol_for(&options).await?)?;
        let baseline =
            baseline.ok_or_else(|| NotResumed::Closed("it has no baseline".to_owned()))?;
        let age = now.signed_duration_since(baseline.wall);
        let mut order = self.measurement(&options, Some(Arc::new(baseline))).await?;
        if let Some(lasts) = order.schedule.lasts {
            let left = time_left(lasts, &found, now, runtime.clock.monotonic());
            if left.is_zero() {
                return Err(NotResumed::Closed(
                    "the scheduled duration is over".to_owned(),
                ));
            }
            order.schedule.lasts = Some(left);
        }
        let mut text = format!(
            "{}; the last frame before was {} at {}, {} ago; the instruments are the known ones, the source was off, \
             verified, the settings were applied again and read back; the baseline is {} old",
            cause(&found, last, now),
            found.resumed.acknowledged,
            last.format("%Y-%m-%d %H:%M:%S UTC"),
            span(gap),
            span(age),
        );
        if age > OLD_BASELINE {
            text.push_str(": record a new one when the sheet is unloaded");
        }
        order.resumed = Some((Box::new(found), text));
        self.begin(order, no_reload).await?;
        Ok(())
    }

    /// Checks that protocol and instruments of the session are those of this daemon.
    fn same_rig(&self, header: &SessionHeader, protocol: &Protocol) -> Result<(), NotResumed> {
        let runtime = self.runtime();
        if header.protocol != *protocol {
            return Err(NotResumed::Closed(
                "the configuration now has another protocol".to_owned(),
            ));
        }
        if header.simulated != runtime.simulated {
            return Err(NotResumed::Closed(
                "its voltages were simulated and the rig's are not, or vice versa".to_owned(),
            ));
        }
        let identities = self.identities();
        for then in &header.instruments {
            if !identities.has_recorded(then) {
                return Err(NotResumed::Closed(format!(
                    "its {} was {} and has changed",
                    then.role, then.identity
                )));
            }
        }
        Ok(())
    }

    pub(super) async fn close_interrupted(&self, path: &Path, reason: &str) -> bool {
        let (at, reason) = (self.runtime().clock.wall(), reason.to_owned());
        let file = path.to_owned();
        let closed = tokio::task::spawn_blocking(move || {
            let (writer, _) = SessionWriter::resume(&file)?;
            writer.close(at, &reason)
        })
        .await;
        match closed {
            Ok(Ok(())) => true,
            Ok(Err(error)) => {
                tracing::warn!("{}", chain(&error));
                false
            }
            Err(_) => false,
        }
    }
}

/// Opens an interrupted session, and reads its baseline. `limited`: whether its duration has a limit even if none was
/// requested.
fn open(
    path: &Path,
    limited: bool,
) -> Result<(Interrupted, Option<survey::Baseline>), LogbookError> {
    let reader = SessionReader::open(path)?;
    let (baseline, last) = (reader.baseline()?, reader.last()?);
    let events = reader.events()?;
    let stopped = events
        .last()
        .is_some_and(|event| event.kind == EventKind::ShutDown.as_str());
    let options = from_json(&reader.header().asked);
    drop(reader);
    let limited = limited || options.is_some_and(|options| options.number("for_s").is_some());
    // reads all parts of the session
    let run = match limited {
        true => logbook::time_run(path)?,
        false => Duration::ZERO,
    };
    let (writer, resumed) = SessionWriter::resume(path)?;
    let found = Interrupted {
        writer,
        resumed,
        last,
        run,
        stopped,
    };
    Ok((found, baseline))
}

/// The number of resumptions less than an hour before or after `now`. Times after `now` count because a machine without
/// a battery-backed clock may fail repeatedly at the same time of its clock. Times more than an hour after `now` are
/// from before the clock was set back.
fn within_an_hour(before: &[DateTime<Utc>], now: DateTime<Utc>) -> u64 {
    let near = |at: &&DateTime<Utc>| now.signed_duration_since(**at).abs() < AN_HOUR;
    before.iter().filter(near).count() as u64
}

/// The rest of the scheduled duration of a session. `up`: how long this daemon has run. The session was interrupted for
/// at least this time, also if the wall clock was set back meanwhile.
fn time_left(lasts: Duration, found: &Interrupted, now: DateTime<Utc>, up: Duration) -> Duration {
    let last = found.resumed.last.map(|last| last.wall);
    let last = last.unwrap_or(found.resumed.header.started);
    let since = now.signed_duration_since(last).to_std();
    let interrupted = since.unwrap_or_default().max(up);
    lasts.saturating_sub(found.run.saturating_add(interrupted))
}

/// The known cause of the interruption.
fn cause(found: &Interrupted, last: DateTime<Utc>, now: DateTime<Utc>) -> String {
    // `/proc` is not used, because it is hidden in the systemd unit
    let up = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    let booted = TimeDelta::try_seconds(up.tv_sec).and_then(|up| now.checked_sub_signed(up));
    let restarted = booted.is_some_and(|booted| booted > last);
    match (found.stopped, restarted) {
        (true, true) => "the daemon was stopped, and the machine restarted".to_owned(),
        (true, false) => "the daemon was stopped and started again".to_owned(),
        (false, true) => {
            "the machine restarted without stopping the daemon: power was lost, or it was reset"
                .to_owned()
        }
        (false, false) => "the daemon was killed, or failed, and was started again".to_owned(),
    }
}

fn span(time: TimeDelta) -> String {
    let seconds = time.num_seconds();
    match seconds {
        ..0 => format!("-{} s (the clock was set back)", -seconds),
        0..120 => format!("{seconds} s"),
        120..7200 => format!("{} min", seconds / 60),
        7200..172_800 => format!("{} h", seconds / 3600),
        _ => format!("{} days", seconds / 86_400),
    }
}

/// Options as stored in a session's file.
pub(super) fn to_json(options: &Options) -> serde_json::Map<String, serde_json::Value> {
    options.read().unwrap_or_default()
}

/// Parses stored options; `None` if invalid.
fn from_json(text: &str) -> Option<Options> {
    let object: serde_json::Map<String, serde_json::Value> = serde_json::from_str(text).ok()?;
    let mut options = Options::new();
    for (key, value) in object {
        options = match value {
            serde_json::Value::Bool(flag) => options.with(&key, flag),
            serde_json::Value::String(text) => options.with(&key, text),
            serde_json::Value::Number(number) => match number.as_u64() {
                Some(whole) => options.with(&key, whole),
                None => options.with(&key, number.as_f64()?),
            },
            _ => return None,
        };
    }
    Some(options)
}

#[cfg(test)]
mod tests {
    use crate::session::controller::resume::*;

    fn hours(count: u64) -> Duration {
        Duration::from_secs(count * 3600)
    }

    /// Records a session of ten hours from 100 h on with a frame an hour, whose daemon had run for 50 h before and was
    /// killed after the fourth frame. The clock was set back by `set_back` before the third frame, with which a part
    /// begins. Returns its last part.
    fn killed(folder: &Path, set_back: Duration) -> PathBuf {
        let protocol = Protocol::sheffield(4).unwrap();
        let started = DateTime::UNIX_EPOCH + hours(100);
        let header = SessionHeader::new("m1", started, protocol.clone());
        let mut writer = SessionWriter::create(folder, &header).unwrap();
        for number in 1..=4 {
            let wall = started + hours(number) - if number > 2 { set_back } else { hours(0) };
            let frame = survey::Frame {
                sequence: number,
                readings: vec![survey::Reading::Ok(survey::Volts(1.0)); protocol.len()],
                monotonic: hours(50 + number),
                wall,
                duration: Duration::from_millis(500),
                settings: survey::Settings {
                    protocol_hash: protocol.hash(),
                    current: survey::Amps(1.0),
                    range: survey::Volts(10.0),
                    nplc: 1.0,
                    settle: Duration::ZERO,
                    wiring: "wiring".to_owned(),
                    precautions: survey::Precautions::default(),
                },
                extra: Vec::new(),
                compliance: Vec::new(),
                simulated: false,
            };
            if number == 3 {
                writer.roll(wall).unwrap();
            }
            writer.append(&frame, None).unwrap();
        }
        writer.path().to_owned()
    }

    #[test]
    fn a_clock_that_is_set_back_does_not_lengthen_a_session() {
        for set_back in [0, 3, 90].map(hours) {
            let folder = tempfile::tempdir().unwrap();
            let (found, _) = open(&killed(folder.path(), set_back), true).unwrap();
            let end = DateTime::UNIX_EPOCH + hours(104) - set_back;
            let left = |now, up| time_left(hours(10), &found, now, hours(up));
            assert_eq!(left(end + hours(1), 0), hours(5), "{set_back:?}");
            assert_eq!(left(end + hours(6), 0), hours(0), "{set_back:?}");
            // set back after the last frame, too
            assert_eq!(left(end - hours(2), 0), hours(6), "{set_back:?}");
            assert_eq!(left(end - hours(2), 1), hours(5), "{set_back:?}");
        }
    }

    #[test]
    fn options_come_back_from_a_file_as_they_were() {
        let options = Options::new()
            .with("every_s", 10.0)
            .with("count", 1000_u64)
            .with("step", true)
            .with("note", "a \"note\"");
        let kept = serde_json::Value::Object(to_json(&options)).to_string();
        let back = from_json(&kept).unwrap();
        let expected = dbus::SessionOptions {
            every_s: Some(10.0),
            count: Some(1000),
            step: Some(true),
            note: Some("a \"note\"".to_owned()),
            ..dbus::SessionOptions::default()
        };
        assert_eq!(back.read::<dbus::SessionOptions>().unwrap(), expected);
        for other in ["", "[]", "{\"count\": null}", "{\"count\": [1]}"] {
            assert!(from_json(other).is_none(), "{other}");
        }
    }

    #[test]
    fn a_clock_that_is_behind_counts_no_old_resumptions() {
        let now = DateTime::UNIX_EPOCH + TimeDelta::try_days(1000).unwrap();
        let at = |minutes| now + TimeDelta::try_minutes(minutes).unwrap();
        let old = [at(-61), at(61), at(10_000)];
        assert_eq!(within_an_hour(&old, now), 0);
        let near = [at(-59), at(0), at(59)];
        assert_eq!(within_an_hour(&near, now), 3);
    }
}
