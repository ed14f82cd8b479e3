//! The simulated 6221: settings, output, sweeps, waves, error queue and status registers, without I/O and without
//! physics.
//!
//! An ideal instrument: the current is exactly the requested one until the voltage limit reduces it. Time is passed in
//! with each message; events since the last message are then computed with the present load. No 2182A is connected:
//! delta modes are rejected, and the buffer stays empty. Nothing is connected to the output trigger lines: pulses on
//! them are only counted.

mod level;
mod lists;
mod modes;
mod plan;
mod readings;
mod settings;
mod state;
mod status;
mod sweep;
mod values;
mod wave;

use std::collections::VecDeque;
use std::net::Ipv4Addr;
use std::time::Duration;

use scpi::{Common, ErrorEntry, ErrorQueue, ParseError, StatusModel, parse_message};
use survey::Amps;

pub use scpi::Response;
pub use settings::Settings6221;
pub use sweep::Trigger;

use crate::command::{COMPLIANCE_BIT, Command, Element, error_numbers};
use crate::{Load, Range};
use lists::Lists;
use state::{Mode, Outcome, ResettableSettings};
use values::Values;

/// A 6221 that receives lines and returns replies. Output and settings do not depend on connections.
#[derive(Debug, Clone)]
pub struct Simulator6221 {
    settings: Settings6221,
    now: Duration,
    panel: ResettableSettings,
    values: Values,
    lists: Lists,
    elements: Vec<Element>,
    addresses: [Ipv4Addr; 3],
    /// Stored arbitrary waves.
    waves: [Vec<f64>; 4],
    /// Stored settings.
    memories: [Option<Box<(ResettableSettings, Values)>>; 5],
    mode: Mode,
    outcome: Outcome,
    /// `*OPC` was received and an operation is still pending.
    completion_awaited: bool,
    /// `*OPC?` was received during an operation without foreseeable end; the reply is sent when the operation has
    /// ended.
    answer_awaited: bool,
    flowing: Amps,
    /// Times at which messages changed the current, and the current before each.
    steps: VecDeque<(Duration, Amps)>,
    reported_range: Range,
    interlock_closed: bool,
    /// Time at which the opened interlock switches the output off.
    trips_at: Option<Duration>,
    /// Pulses sent on each line of the trigger link.
    pulses: [u64; 6],
    errors: ErrorQueue,
    /// Numbers of the errors that are queued, as ranges in ascending order.
    queued: Vec<[i32; 2]>,
    /// Texts of the display's two lines.
    texts: [String; 2],
    status: StatusModel,
}

impl Simulator6221 {
    /// An instrument just switched on, with its interlock closed.
    pub fn new(settings: Settings6221) -> Self {
        let mut new = Self {
            errors: ErrorQueue::new(settings.queue_depth),
            settings,
            now: Duration::ZERO,
            panel: state::RESET,
            values: Values::reset(),
            lists: Lists::reset(),
            elements: Element::DEFAULT.to_vec(),
            addresses: [
                Ipv4Addr::new(192, 168, 0, 2),
                Ipv4Addr::new(255, 255, 255, 0),
                Ipv4Addr::new(192, 168, 0, 1),
            ],
            waves: Default::default(),
            memories: Default::default(),
            mode: Mode::Source,
            outcome: Outcome::None,
            completion_awaited: false,
            answer_awaited: false,
            flowing: Amps(0.0),
            steps: VecDeque::new(),
            reported_range: state::RESET.range,
            interlock_closed: true,
            trips_at: None,
            pulses: [0; 6],
            queued: vec![status::ALL_ERRORS],
            texts: Default::default(),
            status: StatusModel::new(),
        };
        new.show();
        // the initial idle condition must not be latched as an event
        new.status.operation.clear();
        new
    }

    /// Receives one line (without its terminator) at a time since power on. A rejected unit adds an error to the error
    /// queue and gets no reply; the units after it are executed.
    ///
    /// Units after a `*WAI` or `*OPC?` in the same line are executed at the end of the awaited operation; the wait is
    /// part of [`Response::busy`].
    pub fn receive(&mut self, line: &str, at: Duration, load: &mut dyn Load) -> Response {
        self.pass(at, load);
        let mut replies: Vec<String> = Vec::new();
        let mut busy = self.settings.command_time;
        let mut wait = Duration::ZERO;
        for call in parse_message(line) {
            if !wait.is_zero() {
                busy = busy.saturating_add(wait);
                self.pass(self.now.saturating_add(wait), load);
                wait = Duration::ZERO;
            }
            let range = self.panel.range;
            let command = call.and_then(|call| Command::of(&call));
            let outcome = match &command {
                Ok(Command::Common(Common::Wait)) => {
                    wait = self.remaining().unwrap_or_default();
                    Ok(None)
                }
                Ok(Command::Common(Common::WhenComplete)) => {
                    // The reply for an operation without end is sent when the operation has been ended.
                    let left = self.remaining();
                    self.answer_awaited = left.is_none();
                    wait = left.unwrap_or_default();
                    Ok(left.map(|_| "1".to_owned()))
                }
                Ok(command) => self.execute(command, !replies.is_empty()),
                Err(refusal) => Err(*refusal),
            };
            match outcome {
                Ok(reply) => replies.extend(reply),
                Err(refusal) => self.refuse(refusal),
            }
            if self.panel.range != range {
                busy += self.settings.range_time;
            }
            self.pass(self.now, load);
            let before = self.flowing;
            self.flow(load);
            self.record_step(before);
            if self.answer_awaited
                && let Some(left) = self.remaining()
            {
                // The operation has been aborted, or a trigger has made its end foreseeable.
                self.answer_awaited = false;
                replies.push("1".to_owned());
                wait = left;
            }
        }
        Response {
            text: (!replies.is_empty()).then(|| replies.join(";")),
            busy: busy.saturating_add(wait),
        }
    }

    /// Evaluates the load again after its resistance changed or time advanced.
    pub fn load_changed(&mut self, at: Duration, load: &mut dyn Load) {
        self.pass(at, load);
        self.flow(load);
    }

    /// Receives a trigger that is not a message; returns false if no such trigger is awaited.
    pub fn trigger(&mut self, event: Trigger, at: Duration, load: &mut dyn Load) -> bool {
        self.pass(at, load);
        let received = self.receive_trigger(event);
        self.pass(at, load);
        self.flow(load);
        received
    }

    /// Queues an error that occurred before a line could be received: -363 for a line that was too long, -410 for a
    /// line that arrived before the last reply was read, -420 for a read without a query.
    pub fn refuse(&mut self, refusal: ParseError) {
        let text = match refusal {
            // Keithley's wording where it differs from the standard's.
            ParseError::OutOfRange => "Parameter data out of range",
            other => other.text(),
        };
        self.status.raise_error(refusal.code());
        if !self.is_queued(refusal.code()) {
            return;
        }
        if self.errors.len() >= self.settings.queue_depth {
            // The replaced entry causes an event of its own (section 6).
            self.status.raise_error(ParseError::QueueOverflow.code());
        }
        self.errors.push(refusal.code(), text);
    }

    /// Cancels a pending reply to `*OPC?`: its client has disconnected, or cleared the device.
    pub fn forget_answer(&mut self) {
        self.answer_awaited = false;
    }

    /// Closes or opens the interlock. While it is open the output is off.
    pub fn set_interlock(&mut self, closed: bool, at: Duration, load: &mut dyn Load) {
        self.pass(at, load);
        self.interlock_closed = closed;
        self.status
            .measurement
            .set(crate::command::INTERLOCK_BIT, !closed);
        self.trips_at = (!closed).then(|| self.now.saturating_add(self.settings.interlock_time));
        self.pass(at, load);
        self.flow(load);
    }

    /// The values that the manual leaves open.
    pub fn settings(&self) -> &Settings6221 {
        &self.settings
    }

    /// Whether the output is on.
    pub fn output(&self) -> bool {
        self.panel.output
    }

    /// The requested level; for a running wave its value at the simulator's present time.
    pub fn level(&self) -> Amps {
        self.requested()
    }

    /// The current that flows.
    pub fn flowing(&self) -> Amps {
        self.flowing
    }

    /// Pulses sent on lines 1 to 6 of the trigger link since power on: by the arm and trigger layers while a sweep
    /// runs, and by a wave's phase marker.
    pub fn pulses(&self) -> [u64; 6] {
        self.pulses
    }

    /// The alternating part of the current of a running wave, r.m.s. without its mean, and its frequency, Hz; limited
    /// where the voltage limit reduces it. `None` if no wave is running or the output is off.
    pub fn alternating(&self, load: &mut dyn Load) -> Option<(Amps, f64)> {
        let Mode::Wave(wave) = &self.mode else {
            return None;
        };
        if !self.panel.output || !wave.is_running() {
            return None;
        }
        let most = (self.panel.compliance / load.resistance(self.now)).abs();
        // with a resistance of NaN no current flows
        let most = if most.0.is_nan() { Amps(0.0) } else { most };
        Some((wave.alternating(most), wave.hertz))
    }

    /// Full scale of the range.
    pub fn range(&self) -> Amps {
        self.range_in_use().full_scale
    }

    /// Whether the voltage limit reduces the current.
    pub fn in_compliance(&self) -> bool {
        self.status.measurement.condition() & 1 << COMPLIANCE_BIT != 0
    }

    /// The terminator of a line on the serial port, as set (section 1): the server of the port sends it.
    pub fn serial_terminator(&self) -> &'static str {
        // In the order of the words.
        match self.values.get(crate::Parameter::Terminator) as u8 {
            1 => "\r",
            2 => "\r\n",
            3 => "\n\r",
            _ => "\n",
        }
    }

    /// Number of errors in the queue.
    pub fn errors(&self) -> usize {
        self.errors.len()
    }

    /// Total number of errors queued so far, and the last of them. Reading them leaves the queue as it is.
    pub fn latest_error(&self) -> (u64, Option<&ErrorEntry>) {
        (self.errors.added(), self.errors.latest())
    }

    fn execute(
        &mut self,
        command: &Command,
        replies_wait: bool,
    ) -> Result<Option<String>, ParseError> {
        let bit = |on: bool| Some(u8::from(on).to_string());
        let text = |value: &dyn ToString| Some(value.to_string());
        match command {
            Command::Common(common) => return self.execute_common(*common, replies_wait),
            Command::Save(place) => self.save(*place),
            Command::Recall(place) => self.recall(*place),
            // IEEE 488.2 section 10.20: the reply is 0 if there are no options.
            Command::Options => return Ok(text(&0)),
            Command::SetLevel(level) => self.set_level(*level)?,
            Command::Level(ask) => return Ok(Some(self.panel.read_level(*ask))),
            Command::SetRange(level) => self.set_range(*level)?,
            Command::Range(ask) => return Ok(Some(self.panel.read_range(*ask))),
            Command::SetAutorange(on) => self.set_autorange(*on)?,
            Command::Autorange => return Ok(bit(self.panel.autorange)),
            Command::SetCompliance(limit) => self.set_compliance(*limit)?,
            Command::Compliance(ask) => return Ok(Some(self.panel.read_compliance(*ask))),
            Command::SetFilter(on) => self.panel.filter = *on,
            Command::Filter => return Ok(bit(self.panel.filter)),
            Command::ClearSource => self.clear_source(),
            Command::SetOutput(on) => self.set_output(*on)?,
            Command::Output => return Ok(bit(self.panel.output)),
            Command::SetShield(shield) => self.panel.shield = *shield,
            Command::Shield => return Ok(text(&self.panel.shield)),
            Command::SetLowToEarth(on) => self.panel.low_to_earth = *on,
            Command::LowToEarth => return Ok(bit(self.panel.low_to_earth)),
            Command::SetSpeed(speed) => self.panel.speed = *speed,
            Command::Speed => return Ok(text(&self.panel.speed)),
            Command::Interlock => return Ok(bit(self.interlock_closed)),
            Command::SetParameter(parameter, value) => self.set_parameter(*parameter, *value)?,
            Command::Parameter(parameter, ask) => {
                return Ok(Some(self.values.read(*parameter, *ask)));
            }
            Command::SetList(list, values) => {
                self.is_free_to_change(*list)?;
                self.lists.set(*list, values.clone())?;
            }
            Command::AppendList(list, values) => {
                self.is_free_to_change(*list)?;
                self.lists.append(*list, values.clone())?;
            }
            Command::List(list) => return self.read_list(*list).map(Some),
            Command::ListLength(list) => return Ok(text(&self.lists.get(*list).len())),
            Command::ArmSweep => self.arm_sweep()?,
            Command::SweepArmed => return Ok(bit(matches!(self.mode, Mode::Sweep(_)))),
            Command::AbortSweep => self.abort_sweep(),
            Command::Initiate => self.initiate()?,
            Command::Abort => self.abort_sweep(),
            Command::SignalArm => self.signal_arm()?,
            Command::SignalTrigger => self.signal_trigger()?,
            Command::ArmWave => self.arm_wave()?,
            Command::StartWave => self.start_wave()?,
            Command::AbortWave => self.abort_wave(),
            Command::CopyWave(place) => self.copy_wave(*place)?,
            Command::DeltaPresent(_) | Command::DeltaArmed(_) => return Ok(bit(false)),
            Command::ArmDelta(_) => return Err(ParseError::HardwareMissing),
            Command::LatestReading
            | Command::FreshReading
            | Command::BufferData
            | Command::MathReading
            | Command::MakeStatistic
            | Command::StatisticReading => return Err(ParseError::DataStale),
            Command::LimitFailed => {
                let tested = self.values.is_on(crate::Parameter::LimitTest);
                return Ok(bit(tested && self.in_compliance()));
            }
            Command::EnableErrors(numbers) => self.queued = status::joined(numbers),
            Command::DisableErrors(numbers) => self.disable_errors(numbers),
            Command::EnabledErrors => return Ok(Some(error_numbers(&self.queued))),
            Command::DisabledErrors => return Ok(Some(error_numbers(&self.not_queued()))),
            Command::SetText(line, text) => self.texts[*line as usize].clone_from(text),
            Command::Text(line) => return Ok(Some(scpi::quote(&self.texts[*line as usize]))),
            Command::TextAttributes(line) => {
                let none = "0".repeat(self.texts[*line as usize].chars().count());
                return Ok(Some(scpi::quote(&none)));
            }
            // no instrument is connected to the serial link
            Command::SerialSend(_) => {}
            Command::SerialEnter => return Err(ParseError::HardwareMissing),
            Command::ClearBuffer => {}
            Command::BufferLength => return Ok(text(&0)),
            Command::BufferFree => return Ok(Some(readings::FREE.to_owned())),
            Command::BufferType => return Ok(Some("NONE".to_owned())),
            Command::SetElements(elements) => self.elements.clone_from(elements),
            Command::Elements => return Ok(Some(self.read_elements())),
            Command::Events(group) => {
                let event = self.group(*group).take_event();
                return Ok(Some(self.register(event)));
            }
            Command::Conditions(group) => {
                let condition = self.group(*group).condition();
                return Ok(Some(self.register(condition)));
            }
            Command::SetEnable(group, mask) => self.group(*group).set_enable(*mask),
            Command::Enable(group) => {
                let enable = self.group(*group).enable();
                return Ok(Some(self.register(enable)));
            }
            Command::PresetStatus => self.status.preset(),
            Command::NextError => return Ok(text(&self.errors.pop())),
            Command::ClearErrors => self.errors.clear(),
            Command::Version => return Ok(Some("1999.0".to_owned())),
            Command::Preset => self.preset(),
            Command::Beep { .. } | Command::Local | Command::Remote | Command::SaveAddresses => {}
            Command::SetAddress(address, value) => self.addresses[*address as usize] = *value,
            Command::Address(address) => {
                let value = self.addresses[*address as usize].to_string();
                return Ok(Some(scpi::quote(&value)));
            }
            Command::BoardSerial(_) => return Ok(Some(self.settings.serial.clone())),
            Command::BoardRevision(_) => return Ok(Some(self.settings.firmware.clone())),
        }
        Ok(None)
    }
}
