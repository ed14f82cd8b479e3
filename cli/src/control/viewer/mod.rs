//! Displays the records of a session's stream for `tactus watch`.

mod lines;

use std::cell::Cell;
use std::io::Write;
use std::time::Duration;

use chrono::{DateTime, SecondsFormat};
use dbus::Session1Proxy;
use dbus::stream::{Body, Decoder, Record};
use imaging::Tracked;
use imaging::quantities::FrameQuantities;
use imaging::tracking::AfterInjection;
use serde::de::DeserializeOwned;
use survey::{Map, MapQuality, MapUnit, Reason, Verdict};
use tokio::io::AsyncReadExt;
use tokio::signal::unix::{SignalKind, signal};
use tokio::time::Instant;

use crate::args::Watch;
use crate::connection::Daemon;
use crate::control::session;
use crate::control::viewer::lines::{DeviationLine, FrameLine, InjectionLine, WatchLine, sentence};
use crate::failure::Failure;
use crate::maps::drawing;
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

/// What belongs to the frame with this sequence number.
type OfFrame<T> = (u64, T);

/// Takes what was kept, if it belongs to this frame.
fn of_frame<T>(kept: &mut Option<OfFrame<T>>, sequence: u64) -> Option<T> {
    let (of, value) = kept.take()?;
    (of == sequence).then_some(value)
}

/// What a record or a report has of a frame as JSON; `None` where a newer daemon has words that this program does not know.
fn parsed<T: DeserializeOwned>(sequence: u64, json: &str) -> Option<OfFrame<T>> {
    Some((sequence, serde_json::from_str(json).ok()?))
}

/// A displayed frame, for redrawing when the terminal's size changes.
struct Picture {
    sentence: String,
    map: Map,
    style: render::Style,
}

/// Displays records as they arrive: a line per frame with its map below; on the alternate screen each replaces the one
/// before.
pub(crate) struct Viewer<'a, W> {
    id: String,
    watch: &'a Watch,
    field: Option<Field>,
    /// The largest loss by noise alone in the session's maps, and whether the daemon has been queried for it.
    noise: (Option<f64>, bool),
    shown: u64,
    /// Sequence number of the frame displayed last.
    last: Option<u64>,
    /// A frame whose map may still arrive, and when to stop waiting for it.
    waiting: Option<(Record, Instant)>,
    /// It arrives before its map, with the sequence of its frame.
    pressure: Option<OfFrame<PressureMap>>,
    /// Likewise.
    quality: Option<OfFrame<MapQuality>>,
    /// Likewise.
    tracked: Option<OfFrame<Tracked>>,
    /// Likewise.
    quantities: Option<OfFrame<FrameQuantities>>,
    screen: Option<&'a Screen>,
    picture: Option<Picture>,
    /// When something was last displayed.
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

    /// Displays the session's latest map, which is not counted: the next one may be minutes away.
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

    /// The last map in words; `None` before the first map.
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
                .map_err(|error| Failure::failed("the stream cannot be understood", &error))?
            {
                // the daemon knows the noise after the first map
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
                        "the daemon went away while session {} was watched; its record is kept: `tactus sessions`",
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
                        // The frame of this map was lost in a gap.
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

    fn print(&mut self, frame: &Record, map: Option<&Map>) -> Result<(), Failure> {
        self.shown_at.set(Instant::now());
        let flags: &[u8] = match &frame.body {
            Body::Frame { flags, .. } => flags,
            _ => &[],
        };
        let count = |wanted: u8| flags.iter().filter(|&&flag| flag == wanted).count();
        let fits = map
            .zip(self.field.as_ref())
            .filter(|(map, field)| field.fits(map));
        let found = fits.and_then(|(map, field)| field.found(map, self.noise.0));
        let converted = of_frame(&mut self.pressure, frame.sequence);
        let pressure = map.zip(converted.as_ref()).map(|(map, converted)| Map {
            values: converted.kpa.clone(),
            unit: MapUnit::Pressure,
            ..map.clone()
        });
        let wall = DateTime::from_timestamp_nanos(frame.wall_ns);
        let tracked = of_frame(&mut self.tracked, frame.sequence).filter(|_| map.is_some());
        let quantities = of_frame(&mut self.quantities, frame.sequence).filter(|_| map.is_some());
        let line = WatchLine::Frame(Box::new(FrameLine {
            session: self.id.clone(),
            sequence: frame.sequence,
            wall: wall.to_rfc3339_opts(SecondsFormat::Nanos, true),
            simulated: frame.simulated,
            gap: frame.gap,
            readings: flags.len(),
            overloads: count(1),
            not_measured: count(3),
            method: map.map(|map| map.method.clone()),
            largest_loss: map.map(|map| map.largest_loss().map_or(0.0, |(_, loss)| loss)),
            significant: map.and_then(|map| map.is_significant(self.noise.0)),
            noise: map.and(self.noise.0),
            found_mm: drawing::millimetres(found),
            unit: map.map(|map| drawing::unit(pressure.as_ref().unwrap_or(map))),
            newtons: converted.as_ref().map(|converted| converted.newtons),
            largest_kpa: pressure
                .as_ref()
                .map(|map| map.largest_loss().map_or(0.0, |(_, kpa)| kpa)),
            quality: map.and_then(|map| map.quality.clone()),
            tracked: tracked.clone(),
            quantities,
        }));
        let picture = match fits.filter(|_| !self.watch.no_map) {
            None => None,
            Some((map, _)) => {
                let title = drawing::title(
                    format!("{}, frame {}", self.id, frame.sequence),
                    tracked.as_ref(),
                );
                let shown = pressure.unwrap_or_else(|| map.clone());
                let scale = (self.watch.scale, shown.unit);
                Some(Picture {
                    sentence: sentence(&line, wall),
                    style: drawing::style(title, scale, frame.simulated, found, map, self.noise.0)?,
                    map: shown,
                })
            }
        };
        self.output(&line, picture, wall)
    }

    /// Displays the load after an injection, with its disc as the map.
    fn show_injection(
        &mut self,
        record: &Record,
        values: Vec<f64>,
        after: AfterInjection,
    ) -> Result<(), Failure> {
        self.shown += 1;
        self.shown_at.set(Instant::now());
        let wall = DateTime::from_timestamp_nanos(record.wall_ns);
        let map = self.field.as_ref().map(|field| field.map(values, "disc"));
        let picture = match map {
            Some(map) if !self.watch.no_map => {
                let [plus, minus] = after.electrodes;
                let known = match (&after.load, after.known) {
                    (_, false) => ", not known",
                    (None, true) => ", nothing above noise and drift",
                    (Some(_), true) => "",
                };
                let title = format!(
                    "{}, frame {}, after {plus}-{minus}{known}",
                    self.id, record.sequence
                );
                let found = after.load.as_ref().filter(|_| after.known);
                let found = found.map(|load| load.centre_mm.map(|mm| 1e-3 * mm));
                let scale = (self.watch.scale, map.unit);
                let style = drawing::style(title, scale, record.simulated, found, &map, None)?;
                Some((map, style))
            }
            _ => None,
        };
        let line = WatchLine::Injection(Box::new(InjectionLine {
            session: self.id.clone(),
            frame: record.sequence,
            wall: wall.to_rfc3339_opts(SecondsFormat::Nanos, true),
            simulated: record.simulated,
            gap: record.gap,
            after,
        }));
        let picture = picture.map(|(map, style)| Picture {
            sentence: sentence(&line, wall),
            map,
            style,
        });
        self.output(&line, picture, wall)
    }

    fn output(
        &mut self,
        line: &WatchLine,
        picture: Option<Picture>,
        wall: DateTime<chrono::Utc>,
    ) -> Result<(), Failure> {
        if self.screen.is_none() || picture.is_none() {
            match self.screen {
                Some(screen) => screen.message(&sentence(line, wall))?,
                None => self.printer.record(line, |line| sentence(line, wall))?,
            }
        }
        if picture.is_some() {
            self.picture = picture;
            self.draw()?;
        }
        Ok(())
    }

    /// Draws the last map as large as the screen allows.
    fn draw(&mut self) -> Result<(), Failure> {
        let (Some(picture), Some(field)) = (&self.picture, &self.field) else {
            return Ok(());
        };
        let mut style = drawing::terminal_style(self.printer, picture.style.clone());
        let Some(screen) = self.screen else {
            let map = drawing::terminal(field, &picture.map, &style)?;
            return self.printer.drawn(&map);
        };
        let (columns, rows) = screen.size();
        let lines: usize = picture
            .sentence
            .lines()
            .map(|line| line.chars().count().div_ceil(columns).max(1))
            .sum();
        style.height = Some(rows.saturating_sub(lines));
        let map = drawing::terminal(field, &picture.map, &style)?;
        screen.draw(&format!("{}\n{map}", picture.sentence))?;
        screen.waiting("")
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

/// As the bus has it: a word, and sentences.
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
