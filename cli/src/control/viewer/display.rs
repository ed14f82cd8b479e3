//! Displays a frame or an injection: a line, with the map below it or in place of the previous map.

use std::io::Write;

use chrono::{DateTime, SecondsFormat};
use dbus::stream::{Body, Record};
use imaging::tracking::AfterInjection;
use survey::{Map, MapUnit, printable_lines};
use tokio::time::Instant;

use super::lines::{FrameLine, InjectionLine, WatchLine, sentence};
use super::{Picture, Viewer, of_frame};
use crate::failure::Failure;
use crate::maps::drawing;

impl<W: Write> Viewer<'_, W> {
    pub(super) fn print(&mut self, frame: &Record, map: Option<&Map>) -> Result<(), Failure> {
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
    pub(super) fn show_injection(
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

    pub(super) fn output(
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
    pub(super) fn draw(&mut self) -> Result<(), Failure> {
        let (Some(picture), Some(field)) = (&self.picture, &self.field) else {
            return Ok(());
        };
        let mut style = drawing::terminal_style(self.printer, picture.style.clone());
        let Some(screen) = self.screen else {
            let map = drawing::terminal(field, &picture.map, &style)?;
            return self.printer.drawn(&map);
        };
        let (columns, rows) = screen.size();
        // the screen prints escape sequences as they are, because the map has some
        let sentence = printable_lines(&picture.sentence);
        let lines: usize = sentence
            .lines()
            .map(|line| line.chars().count().div_ceil(columns).max(1))
            .sum();
        style.height = Some(rows.saturating_sub(lines));
        let map = drawing::terminal(field, &picture.map, &style)?;
        screen.draw(&format!("{sentence}\n{map}"))?;
        screen.waiting("")
    }
}
