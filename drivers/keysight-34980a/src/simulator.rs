//! The mainframe as a state machine: relays, scan list, voltmeter, memory, status, error queue.
//!
//! No I/O, no clock, no physics: lines and time come in as arguments, relays and voltages go out through [`Wires`].
//! What the fact sheet leaves open is decided so: a command error ends its message, an error of execution does not; a
//! measurement started by INIT is reckoned at once, and commands that would disturb it wait for its end; `TRIG:COUN INF`
//! and a READ? of more than the memory holds are refused.

mod meter;
mod relays;
mod trouble;

use std::collections::BTreeSet;
use std::time::Duration;

use scpi::{Common, ErrorQueue, ParseError, StatusModel, StatusRegister, quote};
use survey::{Relay, Volts};

use crate::command::{Command, StatusGroup};
use crate::modules::Module;
use meter::{Meter, Sweep};
use relays::Relays;
use trouble::Trouble;

/// What the mainframe's relays and its voltmeter are joined to. The bench implements it.
pub trait Wires {
    /// Told which relays are closed now, whenever that changes; during a scan for every channel of it.
    fn relays(&mut self, closed: &BTreeSet<Relay>, at: Duration);

    /// Asked for the voltage between the voltmeter's terminals, before its range is looked at.
    fn measure(&mut self, at: Duration, request: MeterRequest) -> Volts;
}

/// How a voltage is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeterRequest {
    /// The scanned channel; `None`: what analogue bus 1 is joined to.
    pub channel: Option<Relay>,
    /// The range.
    pub range: Volts,
    /// Integration, power-line cycles.
    pub nplc: f64,
}

/// What a simulated mainframe is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings34980a {
    /// First field of `*IDN?`.
    pub vendor: String,
    /// Third field of `*IDN?`.
    pub serial: String,
    /// The modules of slots 1 to 8.
    pub slots: [Option<Module>; 8],
    /// Mains frequency, Hz.
    pub line_hz: f64,
    /// Time to take a message in, whatever it says.
    pub message_time: Duration,
    /// Time that a measurement setting costs for each channel it is for.
    pub setting_time: Duration,
}

impl Default for Settings34980a {
    /// Empty slots, 50 Hz, no time lost over messages.
    fn default() -> Self {
        Self {
            vendor: "Agilent Technologies".to_owned(),
            serial: "MY44000001".to_owned(),
            slots: [None; 8],
            line_hz: 50.0,
            message_time: Duration::ZERO,
            setting_time: Duration::ZERO,
        }
    }
}

/// An answer, and how long the instrument needs for it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Response {
    /// The replies of a message's queries joined by `;`, without line end; `None` when nothing is answered.
    pub text: Option<String>,
    /// Time from the message's end until the instrument has done what it says.
    pub busy: Duration,
}

/// Entries of the error queue (section 7).
const ERRORS: usize = 20;

/// Questionable event bits (section 7).
const VOLTAGE_OVERLOAD: u8 = 0;
/// Operation condition bits (section 7).
const MEASURING: u8 = 4;
const WAITING_FOR_TRIGGER: u8 = 5;

/// A simulated mainframe.
#[derive(Debug)]
pub struct Simulator34980a {
    settings: Settings34980a,
    relays: Relays,
    meter: Meter,
    status: StatusModel,
    errors: ErrorQueue,
    /// `*OPC` waits for the end of a measurement.
    completion_awaited: bool,
}

/// What became of one command.
#[derive(Debug, Default)]
struct Done {
    text: Option<String>,
    took: Duration,
}

impl Done {
    fn said(text: impl Into<String>) -> Self {
        Self {
            text: Some(text.into()),
            took: Duration::ZERO,
        }
    }

    fn took(took: Duration) -> Self {
        Self { text: None, took }
    }
}

impl Simulator34980a {
    /// A mainframe just switched on, all relays open.
    pub fn new(settings: Settings34980a) -> Self {
        Self {
            relays: Relays::new(settings.slots),
            meter: Meter::new(settings.line_hz),
            status: StatusModel::new(),
            errors: ErrorQueue::new(ERRORS),
            completion_awaited: false,
            settings,
        }
    }

    /// The relays closed now.
    pub fn closed(&self) -> &BTreeSet<Relay> {
        self.relays.closed()
    }

    /// How many errors wait to be read; never more than 20.
    pub fn errors_waiting(&self) -> usize {
        self.errors.len()
    }

    /// Switches power off and on: latching relays keep their state, everything else is as new (section 3).
    pub fn power_cycle(&mut self, at: Duration, wires: &mut dyn Wires) {
        self.relays.lose_power();
        self.meter = Meter::new(self.settings.line_hz);
        self.status = StatusModel::new();
        self.errors.clear();
        self.completion_awaited = false;
        wires.relays(self.relays.closed(), at);
    }

    /// Hears one message (a line without its end) and answers it.
    pub fn hear(&mut self, line: &str, at: Duration, wires: &mut dyn Wires) -> Response {
        let mut now = at + self.settings.message_time;
        let mut replies = Vec::new();
        for call in scpi::parse_message(line) {
            self.notice(now);
            let command = match call.and_then(|call| Command::of(&call)) {
                Ok(command) => command,
                Err(refusal) => {
                    self.fail(refusal.into());
                    // What follows a command error is not understood any more, what follows a bad value is.
                    if refusal.code() > -200 {
                        break;
                    }
                    continue;
                }
            };
            match self.obey(command, now, !replies.is_empty(), wires) {
                Ok(done) => {
                    now += done.took;
                    replies.extend(done.text);
                }
                Err(trouble) => self.fail(trouble),
            }
        }
        self.notice(now);
        Response {
            text: (!replies.is_empty()).then(|| replies.join(";")),
            busy: now - at,
        }
    }

    fn fail(&mut self, trouble: Trouble) {
        self.status.raise_error(trouble.code);
        self.errors.push(trouble.code, trouble.text);
    }

    /// Brings the registers up to the time.
    fn notice(&mut self, now: Duration) {
        let measuring = self.meter.is_measuring(now);
        self.status.operation.set(MEASURING, measuring);
        let waiting = self.meter.is_waiting();
        self.status.operation.set(WAITING_FOR_TRIGGER, waiting);
        if self.completion_awaited && !measuring {
            self.completion_awaited = false;
            self.status.raise(scpi::StandardEvent::OperationComplete);
        }
    }

    /// Carries one command out. `replied`: whether a reply of this message waits already.
    fn obey(
        &mut self,
        command: Command,
        now: Duration,
        replied: bool,
        wires: &mut dyn Wires,
    ) -> Result<Done, Trouble> {
        let wait = self.meter.time_left(now);
        match command {
            Command::Common(common) => self.obey_common(common, now, replied, wires),
            Command::Close(list) => {
                let relays = self.relays.expand(&list)?;
                let took = self.relays.close(&relays, self.meter.scan_list())?;
                Ok(self.moved(now, wait + took, wires))
            }
            Command::CloseExclusive(list) => {
                let relays = self.relays.expand(&list)?;
                let took = self
                    .relays
                    .close_exclusive(&relays, self.meter.scan_list())?;
                Ok(self.moved(now, wait + took, wires))
            }
            Command::Open(list) => {
                let relays = self.relays.expand_some(&list)?;
                let took = self.relays.open(|relay| relays.contains(&relay));
                Ok(self.moved(now, wait + took, wires))
            }
            Command::OpenAll(slot) => {
                if let Some(slot) = slot {
                    self.relays.module(slot)?;
                }
                let took = self
                    .relays
                    .open(|relay| slot.is_none_or(|slot| relay.0 / 1000 == slot));
                Ok(self.moved(now, wait + took, wires))
            }
            Command::OpenBuses(bus) => {
                let took = self.relays.open_buses(bus);
                Ok(self.moved(now, wait + took, wires))
            }
            Command::Closed(list) => self.states(&list, true),
            Command::Opened(list) => self.states(&list, false),
            Command::RelayCycles(list) => {
                let relays = self.relays.expand_some(&list)?;
                let counts = relays.iter().map(|relay| self.relays.cycles(*relay));
                Ok(Done::said(join(counts.map(|count| format!("{count:+}")))))
            }
            Command::SetScan(list) => {
                let relays = self.relays.expand(&list)?;
                self.meter.set_scan(&self.relays, relays)?;
                Ok(Done::took(wait))
            }
            Command::Scan => {
                let list = scpi::ChannelList::of(self.meter.scan_list().iter().map(|r| r.0));
                let block = scpi::format_block(list.to_string().as_bytes());
                Ok(Done::said(String::from_utf8_lossy(&block)))
            }
            Command::ScanSize => Ok(Done::said(format!("{:+}", self.meter.scan_list().len()))),
            Command::Read(channels) => {
                if self.meter.is_busy(now) {
                    return Err(ParseError::InitIgnored.into());
                }
                let list = match channels {
                    Some(list) => {
                        let relays = self.relays.expand(&list)?;
                        self.meter.sorted(&self.relays, relays)?
                    }
                    None => self.meter.scan_list().to_vec(),
                };
                self.meter.check_read(list.len())?;
                self.meter.clear_memory();
                let took = self.sweep(&list, self.meter.count(), now, wires);
                Ok(Done {
                    text: Some(self.meter.readings()),
                    took,
                })
            }
            Command::Initiate => {
                if self.meter.is_busy(now) {
                    return Err(ParseError::InitIgnored.into());
                }
                let list = self.meter.scan_list().to_vec();
                self.meter.check_memory(list.len())?;
                self.meter.clear_memory();
                if self.meter.awaits_trigger() {
                    self.meter.wait_for_triggers();
                    return Ok(Done::default());
                }
                let took = self.sweep(&list, self.meter.count(), now, wires);
                self.meter.measuring_until(now + took);
                Ok(Done::default())
            }
            Command::Fetch => {
                if !self.meter.has_readings() {
                    return Err(ParseError::DataStale.into());
                }
                Ok(Done {
                    text: Some(self.meter.readings()),
                    took: wait,
                })
            }
            Command::Abort => {
                self.meter.abort(now);
                Ok(Done::default())
            }
            Command::CardType(slot) => Ok(Done::said(self.card_type(slot))),
            Command::NextError => {
                let entry = self.errors.pop();
                Ok(Done::said(format!(
                    "{:+},{}",
                    entry.code,
                    quote(&entry.message)
                )))
            }
            Command::Version => Ok(Done::said("1999.0")),
            Command::Events(group) => {
                let events = self.register(group).take_event();
                Ok(Done::said(format!("{events:+}")))
            }
            Command::Conditions(group) => {
                let conditions = self.register(group).condition();
                Ok(Done::said(format!("{conditions:+}")))
            }
            Command::SetEnable(group, mask) => {
                self.register(group).set_enable(mask);
                Ok(Done::default())
            }
            Command::Enable(group) => {
                let enable = self.register(group).enable();
                Ok(Done::said(format!("{enable:+}")))
            }
            Command::PresetStatus => {
                self.status.preset();
                Ok(Done::default())
            }
            // What remains is the voltmeter's own affair.
            Command::SetChannelDelay(..)
            | Command::ChannelDelay(_)
            | Command::SetChannelDelayAuto(..)
            | Command::ChannelDelayAuto(_)
            | Command::ConfigureVolts { .. }
            | Command::Configuration(_)
            | Command::SetNplc(..)
            | Command::Nplc(_)
            | Command::SetRange(..)
            | Command::Range(_)
            | Command::SetRangeAuto(..)
            | Command::RangeAuto(_)
            | Command::SetAutozero(..)
            | Command::Autozero(_)
            | Command::SetInputAuto(..)
            | Command::InputAuto(_)
            | Command::SetTriggerSource(_)
            | Command::TriggerSource
            | Command::SetTriggerTimer(_)
            | Command::TriggerTimer
            | Command::SetTriggerCount(_)
            | Command::TriggerCount
            | Command::SetField(..)
            | Command::Field(_) => {
                let (text, channels) = self.meter.obey(&self.relays, command)?;
                let each = u32::try_from(channels).unwrap_or(u32::MAX);
                let took = match text {
                    Some(_) => Duration::ZERO,
                    None => wait + self.settings.setting_time * each,
                };
                Ok(Done { text, took })
            }
        }
    }

    fn obey_common(
        &mut self,
        common: Common,
        now: Duration,
        replied: bool,
        wires: &mut dyn Wires,
    ) -> Result<Done, Trouble> {
        let signed = |value: u8| Ok(Done::said(format!("{value:+}")));
        match common {
            Common::Identify => Ok(Done::said(format!(
                "{},34980A,{},2.43-2.43-0.00-0.00",
                self.settings.vendor, self.settings.serial
            ))),
            Common::Reset => {
                self.meter = Meter::new(self.settings.line_hz);
                self.completion_awaited = false;
                let took = self.relays.open(|_| true);
                Ok(self.moved(now, took, wires))
            }
            Common::ClearStatus => {
                self.status.clear();
                self.errors.clear();
                self.completion_awaited = false;
                Ok(Done::default())
            }
            Common::SetEventEnable(mask) => {
                self.status.set_standard_enable(mask);
                Ok(Done::default())
            }
            Common::EventEnable => signed(self.status.standard_enable()),
            Common::Events => signed(self.status.take_standard()),
            Common::SetServiceEnable(mask) => {
                self.status.set_service_enable(mask);
                Ok(Done::default())
            }
            Common::ServiceEnable => signed(self.status.service_enable()),
            Common::StatusByte => signed(self.status.status_byte(!self.errors.is_empty(), replied)),
            Common::OperationComplete => {
                self.completion_awaited = true;
                Ok(Done::default())
            }
            Common::WhenComplete => Ok(Done {
                text: Some("1".to_owned()),
                took: self.meter.time_left(now),
            }),
            Common::Wait => Ok(Done::took(self.meter.time_left(now))),
            Common::SelfTest => signed(0),
            Common::Trigger => {
                if self.meter.is_measuring(now) || !self.meter.take_trigger() {
                    return Err(ParseError::TriggerIgnored.into());
                }
                let list = self.meter.scan_list().to_vec();
                let took = self.sweep(&list, 1, now, wires);
                self.meter.measuring_until(now + took);
                Ok(Done::default())
            }
        }
    }

    fn moved(&self, started: Duration, took: Duration, wires: &mut dyn Wires) -> Done {
        wires.relays(self.relays.closed(), started + took);
        Done::took(took)
    }

    fn states(&self, list: &scpi::ChannelList, closed: bool) -> Result<Done, Trouble> {
        let relays = self.relays.expand_some(list)?;
        let is = |relay| self.relays.closed().contains(relay) == closed;
        let states = relays.iter().map(|relay| u8::from(is(relay)).to_string());
        Ok(Done::said(join(states)))
    }

    fn card_type(&self, slot: u32) -> String {
        match self.relays.module(slot) {
            Ok(module) => format!(
                "{},{},MY4490000{slot},1.00",
                self.settings.vendor,
                module.card_type()
            ),
            Err(_) => format!("{},0,0,0", self.settings.vendor),
        }
    }

    fn register(&mut self, group: StatusGroup) -> &mut StatusRegister {
        match group {
            StatusGroup::Operation => &mut self.status.operation,
            StatusGroup::Questionable => &mut self.status.questionable,
        }
    }

    /// Takes so many sweeps into memory and says how long they took.
    fn sweep(
        &mut self,
        list: &[Relay],
        sweeps: u32,
        now: Duration,
        wires: &mut dyn Wires,
    ) -> Duration {
        let sweep = Sweep {
            list,
            sweeps,
            start: now,
        };
        let (took, overload) = self.meter.sweep(&mut self.relays, &sweep, wires);
        if overload {
            self.status.questionable.latch(VOLTAGE_OVERLOAD);
        }
        took
    }
}

fn join(texts: impl Iterator<Item = String>) -> String {
    texts.collect::<Vec<_>>().join(",")
}
