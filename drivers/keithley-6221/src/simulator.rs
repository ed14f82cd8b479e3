//! The simulated 6221: settings, output, error queue and status registers, without I/O and without physics.
//!
//! An ideal instrument: the current is exactly the level until the voltage limit holds it back. Sweeps, waves and delta
//! modes are not there and answer -113.

use std::time::Duration;

use scpi::{Common, ErrorQueue, ParseError, StandardEvent, StatusModel, StatusRegister};
use scpi::{format_nr3, parse_message};
use survey::{Amps, Volts};

use crate::Load;
use crate::command::{Ask, COMPLIANCE_BIT, Command, INTERLOCK_BIT, Shield, Speed, StatusGroup};
use crate::range::{LARGEST_CURRENT, LARGEST_LIMIT, LIMIT_STEP, RANGES, Range, SMALLEST_LIMIT};

/// Entries of the error queue (fact sheet, section 6).
const QUEUE_DEPTH: usize = 10;
/// Decimals of a number read back: `1.000000E-06` (fact sheet, section 3).
const DECIMALS: usize = 6;

/// What the manual leaves open or the maker stamps on each unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings6221 {
    /// Serial number in `*IDN?`.
    pub serial: String,
    /// Firmware in `*IDN?`.
    pub firmware: String,
    /// Time a message takes (fact sheet, section 7: assumed).
    pub command_time: Duration,
    /// Time a change of range takes (fact sheet, section 7: assumed).
    pub range_time: Duration,
}

impl Default for Settings6221 {
    fn default() -> Self {
        Self {
            serial: "1234567".to_owned(),
            firmware: "D04".to_owned(),
            command_time: Duration::from_millis(5),
            range_time: Duration::from_millis(10),
        }
    }
}

/// What the instrument does about a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Response {
    /// The reply without its terminator; `None` when nothing was asked, or nothing that has an answer.
    pub text: Option<String>,
    /// How long the instrument needs.
    pub busy: Duration,
}

/// What `*RST` sets (fact sheet, section 4; range and autorange assumed).
#[derive(Debug, Clone, Copy, PartialEq)]
struct Panel {
    level: Amps,
    range: Range,
    autorange: bool,
    compliance: Volts,
    filter: bool,
    output: bool,
    shield: Shield,
    low_to_earth: bool,
    speed: Speed,
}

const RESET: Panel = Panel {
    level: Amps(0.0),
    range: RANGES[RANGES.len() - 1],
    autorange: false,
    compliance: Volts(10.0),
    filter: false,
    output: false,
    shield: Shield::OutputLow,
    low_to_earth: false,
    speed: Speed::Fast,
};

/// A 6221 that hears lines and gives replies. It knows nothing of connections: output and settings outlive them.
#[derive(Debug, Clone)]
pub struct Simulator6221 {
    settings: Settings6221,
    panel: Panel,
    flowing: Amps,
    interlock_closed: bool,
    errors: ErrorQueue,
    status: StatusModel,
}

impl Simulator6221 {
    /// As after power on, interlock closed.
    pub fn new(settings: Settings6221) -> Self {
        Self {
            settings,
            panel: RESET,
            flowing: Amps(0.0),
            interlock_closed: true,
            errors: ErrorQueue::new(QUEUE_DEPTH),
            status: StatusModel::new(),
        }
    }

    /// Hears one line (without its terminator) at a time since power on. A unit that is refused goes to the error queue
    /// and gets no reply; those after it are carried out.
    pub fn hear(&mut self, line: &str, at: Duration, load: &mut dyn Load) -> Response {
        let mut replies: Vec<String> = Vec::new();
        let mut busy = self.settings.command_time;
        for call in parse_message(line) {
            let range = self.panel.range;
            match call.and_then(|call| Command::of(&call)) {
                Ok(command) => match self.carry_out(command, !replies.is_empty()) {
                    Ok(reply) => replies.extend(reply),
                    Err(refusal) => self.refuse(refusal),
                },
                Err(refusal) => self.refuse(refusal),
            }
            if self.panel.range != range {
                busy += self.settings.range_time;
            }
            self.flow(at, load, self.panel.range != range);
        }
        Response {
            text: (!replies.is_empty()).then(|| replies.join(";")),
            busy,
        }
    }

    /// Looks at the load again: its resistance changed.
    pub fn load_changed(&mut self, at: Duration, load: &mut dyn Load) {
        self.flow(at, load, false);
    }

    /// Queues an error that arose before a line could be heard, such as -363 for one that was too long.
    pub fn refuse(&mut self, refusal: ParseError) {
        let text = match refusal {
            // The maker's wording where it is not the standard's.
            ParseError::OutOfRange => "Parameter data out of range",
            other => other.text(),
        };
        self.status.raise_error(refusal.code());
        self.errors.push(refusal.code(), text);
    }

    /// Closes or opens the interlock. Open, it switches the output off and keeps it so.
    pub fn set_interlock(&mut self, closed: bool, at: Duration, load: &mut dyn Load) {
        self.interlock_closed = closed;
        self.status.measurement.set(INTERLOCK_BIT, !closed);
        if !closed {
            self.panel.output = false;
        }
        self.flow(at, load, false);
    }

    /// Whether the output is on.
    pub fn output(&self) -> bool {
        self.panel.output
    }

    /// The level asked for.
    pub fn level(&self) -> Amps {
        self.panel.level
    }

    /// The current that flows.
    pub fn flowing(&self) -> Amps {
        self.flowing
    }

    /// Full scale of the range.
    pub fn range(&self) -> Amps {
        self.panel.range.full_scale
    }

    /// Whether the voltage limit holds the current back.
    pub fn in_compliance(&self) -> bool {
        self.status.measurement.condition() & 1 << COMPLIANCE_BIT != 0
    }

    /// How many errors wait in the queue.
    pub fn errors(&self) -> usize {
        self.errors.len()
    }

    fn carry_out(
        &mut self,
        command: Command,
        replies_wait: bool,
    ) -> Result<Option<String>, ParseError> {
        let panel = &mut self.panel;
        let bit = |on: bool| Some(u8::from(on).to_string());
        let number = |value: f64| Some(format_nr3(value, DECIMALS));
        Ok(match command {
            Command::Common(common) => return self.carry_out_common(common, replies_wait),
            Command::SetLevel(level) => {
                if panel.autorange {
                    panel.range = Range::holding(level).ok_or(ParseError::OutOfRange)?;
                } else if !panel.range.holds(level) {
                    return Err(ParseError::OutOfRange);
                }
                panel.level = level;
                None
            }
            Command::Level(ask) => {
                let most = LARGEST_CURRENT.0;
                number(answer(ask, panel.level.0, -most, most, RESET.level.0))
            }
            Command::SetRange(level) => {
                let range = Range::holding(level).ok_or(ParseError::OutOfRange)?;
                if !range.holds(panel.level) {
                    return Err(ParseError::SettingsConflict);
                }
                (panel.range, panel.autorange) = (range, false);
                None
            }
            Command::Range(ask) => {
                let [least, .., most] = RANGES.map(|range| range.full_scale.0);
                let now = panel.range.full_scale.0;
                number(answer(ask, now, least, most, RESET.range.full_scale.0))
            }
            Command::SetAutorange(on) => {
                panel.autorange = on;
                if on {
                    // A level that has been accepted lies on some range.
                    panel.range = Range::holding(panel.level).unwrap_or(panel.range);
                }
                None
            }
            Command::Autorange => bit(panel.autorange),
            Command::SetCompliance(limit) => {
                // Divided, not multiplied by 0.01: 10 mV steps read back to the bits of their decimals.
                let steps_per_volt = (1.0 / LIMIT_STEP.0).round();
                panel.compliance = Volts((limit.0 * steps_per_volt).round() / steps_per_volt);
                None
            }
            Command::Compliance(ask) => number(answer(
                ask,
                panel.compliance.0,
                SMALLEST_LIMIT.0,
                LARGEST_LIMIT.0,
                RESET.compliance.0,
            )),
            Command::SetFilter(on) => {
                panel.filter = on;
                None
            }
            Command::Filter => bit(panel.filter),
            Command::ClearSource => {
                (panel.level, panel.output) = (Amps(0.0), false);
                if panel.autorange {
                    panel.range = RANGES[0];
                }
                None
            }
            Command::SetOutput(on) => {
                if on && !self.interlock_closed {
                    return Err(ParseError::SettingsConflict);
                }
                panel.output = on;
                None
            }
            Command::Output => bit(panel.output),
            Command::SetShield(shield) => {
                panel.shield = shield;
                None
            }
            Command::Shield => Some(panel.shield.to_string()),
            Command::SetLowToEarth(on) => {
                panel.low_to_earth = on;
                None
            }
            Command::LowToEarth => bit(panel.low_to_earth),
            Command::SetSpeed(speed) => {
                panel.speed = speed;
                None
            }
            Command::Speed => Some(panel.speed.to_string()),
            Command::Interlock => bit(self.interlock_closed),
            Command::Events(group) => Some(self.group(group).take_event().to_string()),
            Command::Conditions(group) => Some(self.group(group).condition().to_string()),
            Command::SetEnable(group, mask) => {
                self.group(group).set_enable(mask);
                None
            }
            Command::Enable(group) => Some(self.group(group).enable().to_string()),
            Command::PresetStatus => {
                self.status.preset();
                None
            }
            Command::NextError => Some(self.errors.pop().to_string()),
            Command::ClearErrors => {
                self.errors.clear();
                None
            }
            Command::Version => Some("1999.0".to_owned()),
        })
    }

    fn carry_out_common(
        &mut self,
        common: Common,
        replies_wait: bool,
    ) -> Result<Option<String>, ParseError> {
        let status = &mut self.status;
        Ok(match common {
            Common::Identify => Some(format!(
                "KEITHLEY INSTRUMENTS INC.,MODEL 6221,{},{}",
                self.settings.serial, self.settings.firmware
            )),
            Common::Reset => {
                self.panel = RESET;
                None
            }
            Common::ClearStatus => {
                status.clear();
                self.errors.clear();
                None
            }
            Common::SetEventEnable(mask) => {
                status.set_standard_enable(mask);
                None
            }
            Common::EventEnable => Some(status.standard_enable().to_string()),
            Common::Events => Some(status.take_standard().to_string()),
            Common::SetServiceEnable(mask) => {
                status.set_service_enable(mask);
                None
            }
            Common::ServiceEnable => Some(status.service_enable().to_string()),
            Common::StatusByte => {
                let byte = status.status_byte(!self.errors.is_empty(), replies_wait);
                Some(byte.to_string())
            }
            // Every command is done when the next is heard.
            Common::OperationComplete => {
                status.raise(StandardEvent::OperationComplete);
                None
            }
            Common::WhenComplete => Some("1".to_owned()),
            Common::Wait => None,
            Common::SelfTest => Some("0".to_owned()),
            Common::Trigger => return Err(ParseError::TriggerIgnored),
        })
    }

    fn group(&mut self, group: StatusGroup) -> &mut StatusRegister {
        match group {
            StatusGroup::Measurement => &mut self.status.measurement,
            StatusGroup::Operation => &mut self.status.operation,
            StatusGroup::Questionable => &mut self.status.questionable,
        }
    }

    /// Works out what flows: the level, or what the voltage limit lets through (fact sheet, section 9).
    fn flow(&mut self, at: Duration, load: &mut dyn Load, range_changed: bool) {
        let Panel { level, .. } = self.panel;
        let (flowing, limited) = if !self.panel.output || level == Amps(0.0) {
            (Amps(0.0), false)
        } else {
            let resistance = load.resistance(at);
            let limit = self.panel.compliance;
            if (level.abs() * resistance) <= limit {
                (level, false)
            } else if resistance.0.is_finite() {
                ((limit / resistance) * level.0.signum(), true)
            } else {
                (Amps(0.0), true)
            }
        };
        self.status.measurement.set(COMPLIANCE_BIT, limited);
        if flowing != self.flowing || range_changed {
            self.flowing = flowing;
            load.drive(flowing, self.panel.range.full_scale, at);
        }
    }
}

fn answer(ask: Ask, now: f64, min: f64, max: f64, def: f64) -> f64 {
    match ask {
        Ask::Now => now,
        Ask::Min => min,
        Ask::Max => max,
        Ask::Def => def,
    }
}
