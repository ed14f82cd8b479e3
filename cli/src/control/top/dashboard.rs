//! The state of the dashboard, and how keys change it.

use std::sync::Arc;

use imaging::Tracked;
use imaging::quantities::{FrameQuantities, Quantity};
use ratatui::crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use render::TerminalColour;
use serde::de::DeserializeOwned;
use serde_json::Value;
use survey::{Map, MapQuality, MapUnit};
use web::{FrameState, Snapshot, State};

use crate::control::top::history::History;
use crate::maps::drawing::Field;
use crate::options::choices::Scale;

/// The last map with the results of its frame.
pub(crate) struct Picture {
    /// The frame of the map.
    pub(crate) frame: FrameState,
    pub(crate) map: Map,
    pub(crate) tracked: Option<Tracked>,
    pub(crate) quantities: Option<FrameQuantities>,
}

/// The state of the screen.
pub(crate) struct Dashboard {
    pub(crate) colour: TerminalColour,
    pub(crate) scale: Scale,
    /// Whether the list of keys is shown.
    pub(crate) help: bool,
    /// Whether the list of alarms is shown.
    pub(crate) alarms: bool,
    /// Index of the selected alarm in the list.
    pub(crate) chosen: usize,
    /// The alarm whose acknowledgement must be confirmed by `y`.
    pub(crate) asking: Option<String>,
    /// Result of the last acknowledgement, as text.
    pub(crate) answer: Option<String>,
    /// Index of the first quantity shown in the table.
    pub(crate) first_quantity: usize,
    /// Index of the first region shown in the table.
    pub(crate) first_region: usize,
    pub(crate) seen: State,
    geometry: Option<Arc<dbus::Geometry>>,
    /// The geometry for drawing maps, or why they cannot be drawn.
    pub(crate) field: Option<Result<Field, String>>,
    /// The session to which the picture belongs.
    session: Option<String>,
    pub(crate) picture: Option<Picture>,
    pub(crate) history: History,
}

/// What to do after a key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Next {
    /// Draw the changes.
    Stay,
    /// Acknowledge this alarm.
    Acknowledge(String),
    /// Draw every cell again.
    Redraw,
    /// End the program.
    Leave,
}

impl Dashboard {
    pub(crate) fn new(colour: TerminalColour, scale: Scale) -> Self {
        Self {
            colour,
            scale,
            help: false,
            alarms: false,
            chosen: 0,
            asking: None,
            answer: None,
            first_quantity: 0,
            first_region: 0,
            seen: State::default(),
            geometry: None,
            field: None,
            session: None,
            picture: None,
            history: History::default(),
        }
    }

    /// Takes over the state that was read from the daemon.
    pub(crate) fn take(&mut self, snapshot: &Snapshot) {
        self.seen = snapshot.state.clone();
        let known = self.geometry.as_ref().zip(snapshot.geometry.as_ref());
        if !known.is_some_and(|(before, now)| Arc::ptr_eq(before, now)) {
            self.geometry.clone_from(&snapshot.geometry);
            self.field = self
                .geometry
                .as_deref()
                .map(|geometry| Field::from_bus(geometry).map_err(|failure| failure.to_string()));
        }
        // the map of an ended session does not show the present state of the sheet
        let session = self.seen.session.as_ref().map(|session| &session.id);
        if self.session.as_ref() != session {
            self.session = session.cloned();
            self.picture = None;
        }
        let Some(frame) = &self.seen.frame else {
            return;
        };
        let shown = self.picture.as_ref().map(|picture| picture.frame.sequence);
        if !frame.map || session.is_none() || shown == Some(frame.sequence) {
            return;
        }
        if let Some(values) = snapshot.map_values(frame.sequence) {
            self.show(frame.clone(), &values);
        }
    }

    /// Shows a frame with the values of its map, in the frame's unit.
    pub(crate) fn show(&mut self, frame: FrameState, values: &[f32]) {
        // a newer daemon may send values that this program does not know
        fn parsed<T: DeserializeOwned>(value: Option<&Value>) -> Option<T> {
            serde_json::from_value(value?.clone()).ok()
        }
        let quantities: Option<FrameQuantities> = parsed(frame.quantities.as_ref());
        // losses are shown as positive
        let (unit, sign) = match frame.unit {
            Some("kPa") => (MapUnit::Pressure, 1.0),
            _ => (MapUnit::RelativeConductance, -1.0),
        };
        let values = values.iter().map(|value| sign * f64::from(*value));
        let method = frame.method.clone().unwrap_or_default();
        let map = Map {
            unit,
            quality: parsed::<MapQuality>(frame.quality.as_ref()),
            ..Map::relative("", values.collect(), method)
        };
        self.history.add(frame.wall_ms, quantities.as_ref());
        self.picture = Some(Picture {
            tracked: parsed(frame.tracked.as_ref()),
            frame,
            map,
            quantities,
        });
    }

    /// The quantities of the last map.
    pub(crate) fn quantities(&self) -> Option<&FrameQuantities> {
        self.picture.as_ref()?.quantities.as_ref()
    }

    /// Whether the daemon or the last frame reports simulated voltages.
    pub(crate) fn simulated(&self) -> bool {
        let daemon = self.seen.daemon.as_ref();
        let frame = self.seen.frame.as_ref();
        daemon.is_some_and(|daemon| daemon.simulated) || frame.is_some_and(|frame| frame.simulated)
    }

    /// Handles a key, or a change of the terminal's size.
    pub(crate) fn press(&mut self, event: &Event) -> Next {
        let key = match event {
            Event::Key(KeyEvent {
                kind: KeyEventKind::Release,
                ..
            }) => return Next::Stay,
            Event::Key(key) => key,
            _ => return Next::Stay,
        };
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        if let Some(name) = self.asking.take()
            && !control
        {
            return match key.code {
                KeyCode::Char('y') => Next::Acknowledge(name),
                _ => Next::Stay,
            };
        }
        let regions = self
            .quantities()
            .map_or(0, |quantities| quantities.regions.len());
        let move_by = |position: &mut usize, steps: isize, count: usize| {
            *position = position
                .saturating_add_signed(steps)
                .min(count.saturating_sub(1));
        };
        let (quantities, alarms) = (Quantity::ALL.len(), self.seen.alarms.len());
        match (key.code, control) {
            (KeyCode::Char('c'), true) | (KeyCode::Char('q') | KeyCode::Esc, false) => {
                return Next::Leave;
            }
            (KeyCode::Char('l'), true) => return Next::Redraw,
            (KeyCode::Char('?'), _) => self.help = !self.help,
            (KeyCode::Char('a'), false) => (self.alarms, self.answer) = (!self.alarms, None),
            (KeyCode::Up, _) if self.alarms => move_by(&mut self.chosen, -1, alarms),
            (KeyCode::Down, _) if self.alarms => move_by(&mut self.chosen, 1, alarms),
            (KeyCode::Enter, _) if self.alarms => self.ask(),
            (KeyCode::Up, _) => move_by(&mut self.first_quantity, -1, quantities),
            (KeyCode::Down, _) => move_by(&mut self.first_quantity, 1, quantities),
            (KeyCode::Left, _) => move_by(&mut self.first_region, -1, regions),
            (KeyCode::Right, _) => move_by(&mut self.first_region, 1, regions),
            _ => {}
        }
        Next::Stay
    }

    /// Asks for confirmation that the selected alarm is to be acknowledged, because a single key, which may have been
    /// meant for another window, must not acknowledge it.
    fn ask(&mut self) {
        self.answer = None;
        let alarms = &self.seen.alarms;
        let Some(alarm) = alarms.get(self.chosen).or(alarms.last()) else {
            return;
        };
        match alarm.acknowledged {
            true => self.answer = Some(format!("{} needs no acknowledgement", alarm.name)),
            false => self.asking = Some(alarm.name.clone()),
        }
    }

    /// Stores the result of an acknowledgement.
    pub(crate) fn acknowledged(&mut self, name: &str, done: Result<(), String>) {
        self.answer = Some(match done {
            Ok(()) => format!("{name} is acknowledged"),
            Err(why) => format!("{name}: {why}"),
        });
    }
}
