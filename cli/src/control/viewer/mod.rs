//! Displays the records of a session's stream for `tactus watch`.

mod display;
mod lines;

use std::cell::Cell;
use std::io::Write;
use std::time::Duration;

use chrono::{DateTime, SecondsFormat};
use dbus::Session1Proxy;
use dbus::stream::{Body, Decoder, Record};
use imaging::Tracked;
use imaging::quantities::FrameQuantities;
use serde::de::DeserializeOwned;
use survey::{Map, MapQuality, Reason, Verdict};
use tokio::io::AsyncReadExt;
use tokio::signal::unix::{SignalKind, signal};
use tokio::time::Instant;

use crate::args::Watch;
use crate::connection::Daemon;
use crate::control::session;
use crate::control::viewer::lines::{DeviationLine, WatchLine, sentence};
use crate::failure::Failure;
use crate::maps::drawing::Field;
use crate::output::Printer;
use crate::output::screen::Screen;

/// Maximum time to hold a frame for its map, which usually follows immediately.
const MAP_TIMEOUT: Duration = Duration::from_secs(2);

/// A map converted by a calibration.
struct PressureMap {
    kpa: Vec<f64>,
    newtons: f64,
}

/// A value with the sequence number of the frame to which it belongs.
type OfFrame<T> = (u64, T);

/// Takes a kept value if it belongs to this frame; otherwise discards it.
fn of_frame<T>(kept: &mut Option<OfFrame<T>>, sequence: u64) -> Option<T> {
    let (of, value) = kept.take()?;
    (of == sequence).then_some(value)
}

/// Parses JSON about a frame; `None` if a newer daemon sends values that this program does not know.
fn parsed<T: DeserializeOwned>(sequence: u64, json: &str) -> Option<OfFrame<T>> {
    Some((sequence, serde_json::from_str(json).ok()?))
}

/// A displayed frame, for redrawing when the terminal's size changes.
struct Picture {
    sentence: String,
    map: Map,
    style: render::Style,
}

/// Displays records as they arrive: a line per frame with its map below; on the alternate screen each map replaces the
/// previous one.
pub(crate) struct Viewer<'a, W> {
    id: String,
    watch: &'a Watch,
    field: Option<Field>,
    /// The largest loss due to noise alone in the session's maps, and whether the daemon has been queried for it.
    noise: (Option<f64>, bool),
    shown: u64,
    /// Sequence number of the frame displayed last.
    last: Option<u64>,
    /// A frame whose map may still arrive, and when to stop waiting for it.
    waiting: Option<(Record, Instant)>,
    /// Pressures of a frame, which arrive before its map.
    pressure: Option<OfFrame<PressureMap>>,
    /// Quality of a map, which arrives before it.
    quality: Option<OfFrame<MapQuality>>,
    /// Result of the tracked baseline for a frame, which arrives before its map.
    tracked: Option<OfFrame<Tracked>>,
    /// Quantities of a frame, which arrive before its map.
    quantities: Option<OfFrame<FrameQuantities>>,
    screen: Option<&'a Screen>,
    picture: Option<Picture>,
    /// Time of the last display.
    shown_at: &'a Cell<Instant>,
    printer: &'a mut Printer<W>,
}

impl<'a, W: Write> Viewer<'a, W> {
    pub(crate) fn new(
        id: String,
        watch: &'a Watch,
        field: Option<Field>,
        screen: Option<&'a Screen>,
        shown_at: &'a Cell<Instant>,
        printer: &'a mut Printer<W>,
    ) -> Self {
        Self {
            id,
            watch,
            field,
            noise: (None, false),
            shown: 0,
            last: None,
            waiting: None,
            pressure: None,
            quality: None,
            tracked: None,
            quantities: None,
            screen,
            picture: None,
            shown_at,
            printer,
        }
    }

    /// Displays the session's latest map, without counting it, because the next one may be minutes away.
    pub(crate) fn show_latest(
        &mut self,
        latest: dbus::LatestMap,
        pressure: Option<dbus::LatestPressure>,
        noise: Option<f64>,
    ) -> Result<(), Failure> {
        self.noise = (noise, true);
        self.pressure = pressure.map(|pressure| {
            let (kpa, newtons) = (pressure.kpa, pressure.newtons);
            (pressure.sequence, PressureMap { kpa, newtons })
        });
        let map = Map {
            quality: quality(&latest.more),
            ..Map::relative(latest.mesh_hash, latest.values, latest.method)
        };
        let (of, more) = (latest.sequence, latest.more);
        self.tracked = more.tracked.and_then(|json| parsed(of, &json));
        self.quantities = more.quantities.and_then(|json| parsed(of, &json));
        let frame = Record {
            sequence: latest.sequence,
            wall_ns: latest.wall_ns,
            gap: 0,
            simulated: latest.simulated,
            body: Body::Frame {
                volts: Vec::new(),
                flags: Vec::new(),
            },
        };
        self.print(&frame, Some(&map))
    }

    /// The last map as text; `None` before the first map.
    pub(crate) fn last_sentence(&self) -> Option<String> {
        Some(self.picture.as_ref()?.sentence.clone())
    }

    /// Reads records until the session ends (returns its reason), or until enough were displayed (`None`).
    pub(crate) async fn follow(
        &mut self,
        mut stream: impl tokio::io::AsyncRead + Unpin,
        deadline: Option<Instant>,
        noise: impl AsyncFn() -> Option<f64>,
    ) -> Result<Option<String>, Failure> {
        let mut decoder = Decoder::new();
        let mut bytes = vec![0; 64 * 1024];
        let mut resized = self
            .screen
            .and_then(|_| signal(SignalKind::window_change()).ok());
        loop {
            while let Some(record) = decoder
                .next_record()
                .map_err(|error| Failure::failed("the stream cannot be decoded", &error))?
            {
                // the daemon knows the noise only after the first map
                if matches!(record.body, Body::Map { .. }) && !self.noise.1 {
                    self.noise = (noise().await, true);
                }
                if let Some(reason) = self.take(record)? {
                    return Ok(Some(reason));
                }
                if self.enough() {
                    return Ok(None);
                }
            }
            let until = match (&self.waiting, deadline) {
                (Some((_, map)), Some(deadline)) => Some(deadline.min(*map)),
                (Some((_, map)), None) => Some(*map),
                (None, deadline) => deadline,
            };
            let late = async {
                match until {
                    Some(until) => tokio::time::sleep_until(until).await,
                    None => std::future::pending().await,
                }
            };
            let size_changed = async {
                match &mut resized {
                    Some(resized) => resized.recv().await,
                    None => std::future::pending().await,
                }
            };
            let read = tokio::select! {
                read = stream.read(&mut bytes) => Some(read),
                () = late => None,
                _ = size_changed => {
                    self.draw()?;
                    continue;
                }
            };
            match read {
                Some(Ok(0)) => {
                    self.flush()?;
                    return Err(Failure::Missing(format!(
                        "the daemon ended while session {} was watched; its record is kept: `tactus sessions`",
                        self.id
                    )));
                }
                Some(Ok(count)) => decoder.push(&bytes[..count]),
                Some(Err(error)) => {
                    return Err(Failure::failed("the stream cannot be read", &error));
                }
                None => {
                    self.flush()?;
                    if self.enough() || deadline.is_some_and(|deadline| Instant::now() >= deadline)
                    {
                        return Ok(None);
                    }
                }
            }
        }
    }

    fn enough(&self) -> bool {
        self.watch.count.is_some_and(|count| self.shown >= count)
    }

    /// Handles one record; returns the reason for the end if it is the last.
    fn take(&mut self, mut record: Record) -> Result<Option<String>, Failure> {
        match &record.body {
            Body::Frame { .. } => {
                self.flush()?;
                if self.field.is_some() && !self.enough() {
                    self.waiting = Some((record, Instant::now() + MAP_TIMEOUT));
                } else {
                    self.show(&record, None)?;
                }
            }
            Body::Map {
                values,
                mesh_hash,
                method,
            } => {
                let map = Map {
                    quality: of_frame(&mut self.quality, record.sequence),
                    ..Map::relative(mesh_hash, values.clone(), method)
                };
                match self.waiting.take() {
                    Some((mut frame, _)) if frame.sequence == record.sequence => {
                        frame.gap += record.gap;
                        self.show(&frame, Some(&map))?;
                    }
                    other if self.last == Some(record.sequence) => self.waiting = other,
                    other => {
                        // the frame of this map was lost in a gap
                        self.waiting = other;
                        self.flush()?;
                        record.body = Body::Frame {
                            volts: Vec::new(),
                            flags: Vec::new(),
                        };
                        self.show(&record, Some(&map))?;
                    }
                }
            }
            Body::Quality { json } => self.quality = parsed(record.sequence, json),
            Body::Tracked { json } => self.tracked = parsed(record.sequence, json),
            Body::Quantities { json } => self.quantities = parsed(record.sequence, json),
            Body::Pressure { kpa, newtons } => {
                let (kpa, newtons) = (kpa.clone(), *newtons);
                self.pressure = Some((record.sequence, PressureMap { kpa, newtons }));
            }
            Body::Injection { values, json } => {
                if let Some((_, after)) = parsed(record.sequence, json) {
                    self.show_injection(&record, values.clone(), after)?;
                }
            }
            Body::Deviation { values, mesh_hash } => {
                let known = |value: &f64| Some(*value).filter(|value| value.is_finite());
                let wall = DateTime::from_timestamp_nanos(record.wall_ns);
                let line = WatchLine::Deviation(Box::new(DeviationLine {
                    session: self.id.clone(),
                    sequence: record.sequence,
                    wall: wall.to_rfc3339_opts(SecondsFormat::Nanos, true),
                    simulated: record.simulated,
                    gap: record.gap,
                    mesh_hash: mesh_hash.clone(),
                    deviations: values.iter().map(known).collect(),
                }));
                self.output(&line, None, wall)?;
            }
            Body::End { reason } => {
                self.flush()?;
                return Ok(Some(reason.clone()));
            }
        }
        Ok(None)
    }

    /// Displays a frame whose map did not arrive.
    fn flush(&mut self) -> Result<(), Failure> {
        match self.waiting.take() {
            Some((frame, _)) => self.show(&frame, None),
            None => Ok(()),
        }
    }

    fn show(&mut self, frame: &Record, map: Option<&Map>) -> Result<(), Failure> {
        if self.enough() {
            return Ok(());
        }
        self.shown += 1;
        self.last = Some(frame.sequence);
        self.print(frame, map)
    }
}

/// Prints how the session ended; a fault is a failure.
pub(crate) async fn end(
    daemon: &Daemon,
    session: &Session1Proxy<'_>,
    id: String,
    reason: String,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let line = WatchLine::Ended {
        session: id,
        reason,
    };
    printer.record(&line, |line| sentence(line, DateTime::UNIX_EPOCH))?;
    session::check_end(daemon, session).await
}

/// The quality of a map on the bus: a verdict, and sentences as reasons.
fn quality(details: &dbus::MapDetails) -> Option<MapQuality> {
    let reason = |text: &str| Reason {
        kind: String::new(),
        electrode: None,
        text: text.to_owned(),
    };
    Some(MapQuality {
        verdict: Verdict::from_word(details.quality.as_deref()?)?,
        reasons: details.doubts.as_deref().map(reason).into_iter().collect(),
    })
}

#[cfg(test)]
mod tests;
