//! The switch and voltmeter (34980A) of the simulated rig.

use std::collections::BTreeMap;
use std::time::Duration;

use keysight_34980a::{
    Command, Functions, Measure, Module, ModuleError, Session, Settings34980a, Simulator34980a,
    System,
};
use scpi::{ErrorEntry, ParseError, Response, parse_message};
use serde::Deserialize;
use toml::Spanned;
use toml::de::DeValue;

use crate::instrument::fault::Fault;
use crate::instrument::isolated::InstrumentSetup;
use crate::instrument::section::{Section, SectionError, check_command_ms, milliseconds, settings};
use crate::instrument::simulated::{ExternalCircuit, SimulatedInstrument};
use crate::instrument::{Kind, Port, Profile};

/// Its row of the table of instruments.
pub(super) const KIND: Kind = Kind {
    name: "34980a",
    shown: "34980a",
    word: "34980a",
    port: Port::Network,
    has_numbers: true,
    lacking: |_| None,
    sections: &[
        Section {
            name: "mainframe",
            read: |profile, value| {
                profile.mainframe = settings(value)?;
                Ok(())
            },
        },
        Section {
            name: "slots",
            read: |profile, value| {
                profile.slots = slots(value)?;
                Ok(())
            },
        },
    ],
    check: |profile| check_command_ms("mainframe", profile.mainframe.command_ms),
    build: |profile, _| Box::new(SimulatedMainframe::new(of_profile(profile))),
    isolated: |setup| Box::new(SimulatedMainframe::new(of_setup(setup))),
    varies,
};

/// 2000-01-01, seconds since 1970-01-01.
const YEAR_2000: u32 = 946_684_800;

/// Settings of the simulated 34980A.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mainframe {
    /// Serial number in `*IDN?`.
    pub serial: String,
    /// Time a message takes, ms.
    pub command_ms: f64,
    /// Initial time of its clock, seconds since 1970-01-01. Default: the year 2000, or the present time if the program
    /// serves it.
    pub clock_unix_s: Option<u32>,
    /// Which headers it has for autozero and input impedance.
    pub headers: Headers,
}

impl Default for Mainframe {
    fn default() -> Self {
        Self {
            serial: "MY44001234".to_owned(),
            command_ms: 2.0,
            clock_unix_s: None,
            headers: Headers::default(),
        }
    }
}

/// Variants of the headers for autozero and input impedance; the headers of the other variant are undefined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
pub enum Headers {
    /// `VOLT:DC:ZERO:AUTO` and `VOLT:DC:IMP:AUTO`, as documented in its help.
    #[default]
    #[serde(rename = "34980A")]
    Documented,
    /// `ZERO:AUTO` and `INP:IMP:AUTO`, as documented in the 34970A's manual.
    #[serde(rename = "34970A")]
    Of34970A,
}

impl From<Headers> for keysight_34980a::HeaderForm {
    fn from(headers: Headers) -> Self {
        match headers {
            Headers::Documented => Self::Documented,
            Headers::Of34970A => Self::Of34970A,
        }
    }
}

/// The modules of a profile.
fn slots(value: Spanned<DeValue<'_>>) -> Result<[Option<Module>; 8], SectionError> {
    let given: BTreeMap<Spanned<String>, Spanned<String>> = settings(value)?;
    let mut given: Vec<_> = given.into_iter().collect();
    // In the order of the file: the second of two keys is the one that is refused.
    given.sort_by_key(|(number, _)| number.span().start);
    let mut slots = [None; 8];
    for (number, module) in &given {
        let slot: usize = number
            .get_ref()
            .parse()
            .ok()
            .filter(|slot| (1..=8).contains(slot))
            .ok_or_else(|| SectionError {
                at: number.span(),
                what: "slots are 1 to 8".to_owned(),
            })?;
        if slots[slot - 1].is_some() {
            return Err(SectionError {
                at: number.span(),
                what: format!(
                    "the key '{}' gives slot {slot} a second time; delete one of them",
                    number.get_ref()
                ),
            });
        }
        let parsed = module.get_ref().parse();
        slots[slot - 1] = Some(parsed.map_err(|error: ModuleError| SectionError {
            at: module.span(),
            what: error.to_string(),
        })?);
    }
    Ok(slots)
}

fn of_profile(profile: &Profile) -> Settings34980a {
    let clock = profile.mainframe.clock_unix_s.unwrap_or(YEAR_2000);
    Settings34980a {
        serial: profile.mainframe.serial.clone(),
        slots: profile.slots,
        line_hz: profile.line_hz,
        message_time: milliseconds(profile.mainframe.command_ms),
        headers: profile.mainframe.headers.into(),
        clock: Duration::from_secs(u64::from(clock)),
        ..Settings34980a::default()
    }
}

/// A mainframe whose memory holds this number of readings.
#[cfg(test)]
pub(crate) fn of_memory(profile: &Profile, memory: usize) -> Box<dyn SimulatedInstrument> {
    Box::new(SimulatedMainframe::new(Settings34980a {
        memory,
        ..of_profile(profile)
    }))
}

fn of_setup(setup: &InstrumentSetup) -> Settings34980a {
    let mut settings = Settings34980a {
        slots: setup.slots,
        ..Settings34980a::default()
    };
    if let Some(vendor) = &setup.vendor {
        settings.vendor.clone_from(vendor);
    }
    settings
}

fn varies(message: &str) -> bool {
    parse_message(message).into_iter().flatten().any(|call| {
        matches!(
            Command::of(&call),
            Ok(Command::Common(scpi::Common::Identify)
                | Command::Measure(
                    Measure::Read(_)
                        | Measure::Volts { .. }
                        | Measure::Fetch
                        | Measure::ReadAndErase(_)
                        | Measure::Remove(_)
                )
                | Command::Functions(Functions::Measure(..))
                | Command::System(
                    System::CardType(_)
                        | System::Date
                        | System::Time
                        | System::ScanTime
                        | System::RelayCycles(_)
                ))
        )
    })
}

/// A 34980A whose modules can be removed and inserted by faults.
#[derive(Debug)]
struct SimulatedMainframe {
    simulator: Simulator34980a,
    slots: [Option<Module>; 8],
    /// Slots whose module is removed or replaced.
    changed: [bool; 8],
    voltmeter_missing: bool,
}

impl SimulatedMainframe {
    /// A mainframe after power on.
    fn new(settings: Settings34980a) -> Self {
        Self {
            slots: settings.slots,
            changed: [false; 8],
            voltmeter_missing: false,
            simulator: Simulator34980a::new(settings),
        }
    }

    /// The module that the profile has in a slot, 1 to 8.
    fn own(&self, slot: u32) -> Option<Module> {
        self.slots[slot as usize - 1]
    }

    fn set_slot(
        &mut self,
        slot: u32,
        module: Option<Module>,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) {
        self.changed[slot as usize - 1] = module != self.own(slot);
        self.simulator.power_cycle(at, outside);
        self.simulator.set_module(slot, module, at, outside);
    }

    fn set_voltmeter(&mut self, present: bool, at: Duration, outside: &mut dyn ExternalCircuit) {
        self.voltmeter_missing = !present;
        self.simulator.power_cycle(at, outside);
        self.simulator.set_voltmeter(present, at, outside);
    }
}

impl SimulatedInstrument for SimulatedMainframe {
    fn receive(
        &mut self,
        session: u32,
        line: &str,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Response {
        let session = Session(session);
        self.simulator.receive_from(session, line, at, outside)
    }

    fn begin(
        &mut self,
        session: u32,
        line: &str,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> (Response, bool) {
        let session = Session(session);
        self.simulator.begin_from(session, line, at, outside)
    }

    fn fetch(
        &mut self,
        session: u32,
        at: Duration,
        outside: &mut dyn ExternalCircuit,
    ) -> Option<String> {
        self.simulator.fetch(Session(session), at, outside)
    }

    fn has_reply(&self, session: u32) -> bool {
        self.simulator.has_readings_for(Session(session))
    }

    fn asks_for_readings(&self, message: &str) -> bool {
        ["READ?", "FETC?", "MEAS:", "DATA:"]
            .iter()
            .any(|query| message.contains(query))
    }

    fn pass(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) {
        self.simulator.pass(at, outside);
    }

    fn latest_error(&self) -> (u64, Option<&ErrorEntry>) {
        self.simulator.latest_error()
    }

    fn refuse(
        &mut self,
        _: u32,
        refusal: ParseError,
        _: Duration,
        _: &mut dyn ExternalCircuit,
    ) -> Option<String> {
        self.simulator.fault_of_session(refusal);
        None
    }

    fn name_session(&mut self, session: u32, name: &str) {
        self.simulator.name_session(Session(session), name);
    }

    fn end_session(&mut self, session: u32) {
        self.simulator.end_session(Session(session));
    }

    fn clear_session(&mut self, session: u32, at: Duration, outside: &mut dyn ExternalCircuit) {
        self.simulator.clear_session(Session(session), at, outside);
    }

    fn status_byte(&self) -> u8 {
        self.simulator.status_byte()
    }

    fn power_cycle(&mut self, at: Duration, outside: &mut dyn ExternalCircuit) -> Option<String> {
        self.simulator.power_cycle(at, outside);
        None
    }

    fn overflow_errors(&mut self) -> bool {
        self.simulator.overflow_errors();
        true
    }

    fn fault(&mut self, fault: &Fault, at: Duration, outside: &mut dyn ExternalCircuit) {
        match fault {
            Fault::TerminalBlock(slot, shut) => {
                self.simulator.set_interlock(*slot, !shut, at, outside);
            }
            Fault::Pulse(None) => self.simulator.pulse(at, outside),
            Fault::Slot(slot, filled) => {
                let module = self.own(*slot).filter(|_| *filled);
                self.set_slot(*slot, module, at, outside);
            }
            Fault::Module(slot, module) => self.set_slot(*slot, Some(*module), at, outside),
            Fault::Voltmeter(present) => self.set_voltmeter(*present, at, outside),
            Fault::None => {
                for slot in 1..=8 {
                    self.simulator.set_interlock(slot, false, at, outside);
                    if self.changed[slot as usize - 1] {
                        self.set_slot(slot, self.own(slot), at, outside);
                    }
                }
                if self.voltmeter_missing {
                    self.set_voltmeter(true, at, outside);
                }
            }
            _ => {}
        }
    }

    fn has_part_removed(&self) -> bool {
        self.voltmeter_missing || self.changed.contains(&true)
    }
}
