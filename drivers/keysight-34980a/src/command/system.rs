//! Modules, errors, clock, lock, display and status: fact sheet sections 1, 3 and 7.

use std::fmt;

use chrono::{Datelike, NaiveDate};
use scpi::{Call, ChannelList, Unit, quote};

use super::grammar::{Table, list, numbered};
use super::{OnOff, word};

/// A group of status registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum StatusGroup {
    /// Measuring, waiting for a trigger, locked, running a sequence.
    Operation,
    /// Overload, memory.
    Questionable,
    /// Alarms, and their queue (help: STATus:ALARm).
    Alarm,
}

/// Row protection of a 34934A. Its effect on currents is computed by the simulated rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Protection {
    /// 100 ohm in the row while a relay moves and afterwards.
    #[default]
    Auto100,
    /// 100 ohm in the row while a relay moves.
    Auto0,
    /// 100 ohm always.
    Fix,
    /// The rows are disconnected while a relay moves.
    Iso,
}

/// Number of memories for settings (from the similar 34970A; the fact sheet has none).
pub(crate) const MEMORIES: i64 = 6;

/// Modules, errors, clock, lock, status.
#[derive(Debug, Clone, PartialEq)]
pub enum System {
    /// Read the module type of a slot.
    CardType(u32),
    /// Read the terminal block of a slot.
    TerminalType(u32),
    /// Set the row protection of a slot.
    SetProtection(u32, Protection),
    /// Read the row protection of a slot.
    Protection(u32),
    /// Read the number of closures of relays.
    RelayCycles(ChannelList),
    /// Reset the number of closures of relays to 0.
    ClearRelayCycles(ChannelList),
    /// Read whether the voltmeter is installed.
    VoltmeterInstalled,
    /// Enable or disable the voltmeter (help: INSTrument:DMM\[:STATe\]).
    SetVoltmeter(bool),
    /// Read whether the voltmeter is enabled.
    Voltmeter,
    /// Read whether a memory holds settings (34970A manual p. 263).
    MemoryValid(u8),
    /// Clear a memory (same page).
    MemoryDelete(u8),
    /// Read the number of memories (same page).
    Memories,
    /// Enable or disable the recall of a memory at power on (help: MEMory:STATe:RECall:AUTO).
    SetRecallAtPowerOn(bool),
    /// Read whether the recall at power on is enabled.
    RecallAtPowerOn,
    /// Select the memory that is recalled at power on (help: MEMory:STATe:RECall:SELect).
    SelectRecalled(u8),
    /// Read which memory is recalled at power on.
    Recalled,
    /// Read the MAC address of the network port (help: SYSTem:COMMunicate:LAN:MAC).
    MacAddress,
    /// Read the oldest error and remove it.
    NextError,
    /// Read the version (year) of the SCPI standard.
    Version,
    /// Set the calendar: year, month, day.
    SetDate(i32, u32, u32),
    /// Read the calendar.
    Date,
    /// Set the clock: hour, minute, second.
    SetTime(u32, u32, f64),
    /// Read the clock.
    Time,
    /// Read when the last scan began.
    ScanTime,
    /// Request the exclusive lock for changes; the reply is whether it was granted.
    RequestLock,
    /// Release one request of the lock.
    ReleaseLock,
    /// Read the name of this session's connection.
    LockName,
    /// Read the owner of the lock.
    LockOwner,
    /// Wait, s.
    Delay(f64),
    /// Show a text.
    SetDisplay(String),
    /// Read the displayed text.
    Display,
    /// Restore the normal display.
    ClearDisplay,
    /// Light the display, or switch it off (34970A manual p. 270).
    SetDisplayOn(bool),
    /// Read whether the display is on.
    DisplayOn,
    /// Read the mains frequency, Hz (corrections of 2026-11-22).
    LineFrequency,
    /// Sound the beeper.
    Beep,
    /// Preset the instrument: as `*RST`, except scaling, limits and alarm assignments.
    Preset,
    /// Save the voltmeter's settings in one of the memories 1 to 5; memory 0 is for the power-down state.
    Save(u8),
    /// Recall the settings from a memory.
    Recall(u8),
    /// Read a group's events and clear them.
    Events(StatusGroup),
    /// Read a group's conditions.
    Conditions(StatusGroup),
    /// Set the enable mask of a group's events.
    SetEnable(StatusGroup, u16),
    /// Read the enable mask of a group's events.
    Enable(StatusGroup),
    /// Clear the enable masks of the groups.
    PresetStatus,
}

const GROUPS: [(&str, StatusGroup); 3] = [
    ("OPERation", StatusGroup::Operation),
    ("QUEStionable", StatusGroup::Questionable),
    ("ALARm", StatusGroup::Alarm),
];

const PROTECTIONS: [(&str, Protection); 4] = [
    ("AUTO100", Protection::Auto100),
    ("AUTO0", Protection::Auto0),
    ("FIXed", Protection::Fix),
    ("ISOlated", Protection::Iso),
];

pub(super) fn rows(table: &mut Table) {
    use System as S;
    let slot = |call: &Call| {
        let [slot] = call.exactly()?;
        numbered(slot, "SLOT", 8)
    };
    table.plain("SYSTem:ERRor[:NEXT]?", S::NextError);
    table.add("SYSTem:CTYPe?", move |call| slot(call).map(S::CardType));
    table.add("SYSTem:MODule:TERMinal:TYPE?", move |call| {
        slot(call).map(S::TerminalType)
    });
    table.add("SYSTem:MODule:ROW:PROTection", |call| {
        let [slot, protection] = call.exactly()?;
        Ok(S::SetProtection(
            numbered(slot, "SLOT", 8)?,
            protection.choice(&PROTECTIONS)?,
        ))
    });
    table.add("SYSTem:MODule:ROW:PROTection?", move |call| {
        slot(call).map(S::Protection)
    });
    table.add("DIAGnostic:RELay:CYCLes?", |call| {
        list(call).map(S::RelayCycles)
    });
    table.add("DIAGnostic:RELay:CYCLes:CLEar", |call| {
        list(call).map(S::ClearRelayCycles)
    });
    table.plain("INSTrument:DMM:INSTalled?", S::VoltmeterInstalled);
    table.switch("INSTrument:DMM[:STATe]", S::SetVoltmeter);
    table.plain("INSTrument:DMM[:STATe]?", S::Voltmeter);
    table.plain("MEMory:NSTates?", S::Memories);
    table.plain("SYSTem:COMMunicate:LAN:MAC?", S::MacAddress);
    table.plain("SYSTem:VERSion?", S::Version);
    table.add("SYSTem:DATE", |call| {
        let [year, month, day] = call.exactly()?;
        let number = |argument: &scpi::Argument, least, most| argument.integer(least, most);
        let (year, month) = (number(year, 1970, 2099)?, number(month, 1, 12)?);
        let day = number(day, 1, days_in(year, month))?;
        // the limits are within both types
        Ok(S::SetDate(year as i32, month as u32, day as u32))
    });
    table.plain("SYSTem:DATE?", S::Date);
    table.add("SYSTem:TIME", |call| {
        let [hour, minute, second] = call.exactly()?;
        let (hour, minute) = (hour.integer(0, 23)?, minute.integer(0, 59)?);
        // A client that rounds 59.9996 up sends 60.000, the start of the next minute.
        let second = second.number(Unit::Second)?.within(0.0, 60.0, 0.0)?;
        Ok(S::SetTime(hour as u32, minute as u32, second))
    });
    table.plain("SYSTem:TIME?", S::Time);
    table.plain("SYSTem:TIME:SCAN?", S::ScanTime);
    table.plain("SYSTem:LOCK:REQuest?", S::RequestLock);
    table.plain("SYSTem:LOCK:RELease", S::ReleaseLock);
    table.plain("SYSTem:LOCK:NAME?", S::LockName);
    table.plain("SYSTem:LOCK:OWNer?", S::LockOwner);
    table.add("SYSTem:DELay[:IMMediate]", |call| {
        let [time] = call.exactly()?;
        let time = time.number(Unit::Second)?.within(0.0, 60.0, 0.0)?;
        Ok(S::Delay((time * 1e3).round() / 1e3))
    });
    table.switch("DISPlay", S::SetDisplayOn);
    table.plain("DISPlay?", S::DisplayOn);
    table.plain("CALibration:LFRequency?", S::LineFrequency);
    table.add("DISPlay:TEXT", |call| {
        let [text] = call.exactly()?;
        text.string().map(|text| S::SetDisplay(text.to_owned()))
    });
    table.plain("DISPlay:TEXT?", S::Display);
    table.plain("DISPlay:TEXT:CLEar", S::ClearDisplay);
    table.plain("SYSTem:BEEPer[:IMMediate]", S::Beep);
    table.plain("SYSTem:PRESet", S::Preset);
    table.plain("STATus:PRESet", S::PresetStatus);
    let place = |call: &Call, first: i64| {
        let [place] = call.exactly()?;
        // The limits are those of u8.
        place.integer(first, MEMORIES - 1).map(|place| place as u8)
    };
    table.add("MEMory:STATe:VALid?", move |call| {
        place(call, 0).map(S::MemoryValid)
    });
    table.add("MEMory:STATe:DELete", move |call| {
        place(call, 0).map(S::MemoryDelete)
    });
    table.switch("MEMory:STATe:RECall:AUTO", S::SetRecallAtPowerOn);
    table.plain("MEMory:STATe:RECall:AUTO?", S::RecallAtPowerOn);
    table.add("MEMory:STATe:RECall:SELect", move |call| {
        place(call, 0).map(S::SelectRecalled)
    });
    table.plain("MEMory:STATe:RECall:SELect?", S::Recalled);
    table.add("*SAV", move |call| place(call, 1).map(S::Save));
    table.add("*RCL", move |call| place(call, 0).map(S::Recall));
    for (name, group) in GROUPS {
        table.plain(&format!("STATus:{name}[:EVENt]?"), S::Events(group));
        table.plain(&format!("STATus:{name}:CONDition?"), S::Conditions(group));
        table.plain(&format!("STATus:{name}:ENABle?"), S::Enable(group));
        table.add(&format!("STATus:{name}:ENABle"), move |call: &Call| {
            let [mask] = call.exactly()?;
            // The limits are those of u16.
            Ok(S::SetEnable(group, mask.integer(0, 65_535)? as u16))
        });
    }
}

/// Days of a month of the Gregorian calendar.
fn days_in(year: i64, month: i64) -> i64 {
    // the limits of both are within these types
    let first = NaiveDate::from_ymd_opt(year as i32, month as u32, 1);
    first.map_or(0, |first| first.num_days_in_month().into())
}

impl Protection {
    /// The reply to `SYST:MOD:ROW:PROT?`.
    pub fn word(self) -> String {
        word(&PROTECTIONS, self)
    }
}

impl fmt::Display for System {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CardType(slot) => write!(f, "SYST:CTYP? {slot}"),
            Self::TerminalType(slot) => write!(f, "SYST:MOD:TERM:TYPE? {slot}"),
            Self::SetProtection(slot, protection) => {
                write!(f, "SYST:MOD:ROW:PROT {slot},{}", protection.word())
            }
            Self::Protection(slot) => write!(f, "SYST:MOD:ROW:PROT? {slot}"),
            Self::RelayCycles(list) => write!(f, "DIAG:REL:CYCL? {list}"),
            Self::ClearRelayCycles(list) => write!(f, "DIAG:REL:CYCL:CLE {list}"),
            Self::VoltmeterInstalled => f.write_str("INST:DMM:INST?"),
            Self::SetVoltmeter(on) => write!(f, "INST:DMM {}", OnOff(*on)),
            Self::Voltmeter => f.write_str("INST:DMM?"),
            Self::MemoryValid(place) => write!(f, "MEM:STAT:VAL? {place}"),
            Self::MemoryDelete(place) => write!(f, "MEM:STAT:DEL {place}"),
            Self::Memories => f.write_str("MEM:NST?"),
            Self::SetRecallAtPowerOn(on) => write!(f, "MEM:STAT:REC:AUTO {}", OnOff(*on)),
            Self::RecallAtPowerOn => f.write_str("MEM:STAT:REC:AUTO?"),
            Self::SelectRecalled(place) => write!(f, "MEM:STAT:REC:SEL {place}"),
            Self::Recalled => f.write_str("MEM:STAT:REC:SEL?"),
            Self::MacAddress => f.write_str("SYST:COMM:LAN:MAC?"),
            Self::NextError => f.write_str("SYST:ERR?"),
            Self::Version => f.write_str("SYST:VERS?"),
            Self::SetDate(year, month, day) => write!(f, "SYST:DATE {year},{month},{day}"),
            Self::Date => f.write_str("SYST:DATE?"),
            Self::SetTime(hour, minute, second) => write!(f, "SYST:TIME {hour},{minute},{second}"),
            Self::Time => f.write_str("SYST:TIME?"),
            Self::ScanTime => f.write_str("SYST:TIME:SCAN?"),
            Self::RequestLock => f.write_str("SYST:LOCK:REQ?"),
            Self::ReleaseLock => f.write_str("SYST:LOCK:REL"),
            Self::LockName => f.write_str("SYST:LOCK:NAME?"),
            Self::LockOwner => f.write_str("SYST:LOCK:OWN?"),
            Self::Delay(time) => write!(f, "SYST:DEL {time}"),
            Self::SetDisplay(text) => write!(f, "DISP:TEXT {}", quote(text)),
            Self::Display => f.write_str("DISP:TEXT?"),
            Self::ClearDisplay => f.write_str("DISP:TEXT:CLE"),
            Self::SetDisplayOn(on) => write!(f, "DISP {}", OnOff(*on)),
            Self::DisplayOn => f.write_str("DISP?"),
            Self::LineFrequency => f.write_str("CAL:LFR?"),
            Self::Beep => f.write_str("SYST:BEEP"),
            Self::Preset => f.write_str("SYST:PRES"),
            Self::Save(place) => write!(f, "*SAV {place}"),
            Self::Recall(place) => write!(f, "*RCL {place}"),
            Self::Events(group) => write!(f, "STAT:{}?", word(&GROUPS, *group)),
            Self::Conditions(group) => write!(f, "STAT:{}:COND?", word(&GROUPS, *group)),
            Self::SetEnable(group, mask) => {
                write!(f, "STAT:{}:ENAB {mask}", word(&GROUPS, *group))
            }
            Self::Enable(group) => write!(f, "STAT:{}:ENAB?", word(&GROUPS, *group)),
            Self::PresetStatus => f.write_str("STAT:PRES"),
        }
    }
}

#[cfg(test)]
mod tests {
    use scpi::ParseError;

    #[test]
    fn the_calendar_has_months_of_the_right_length() {
        let parsed = |text: &str| text.parse::<super::super::Command>();
        assert!(parsed("SYST:DATE 2024,2,29").is_ok());
        assert_eq!(parsed("SYST:DATE 2025,2,29"), Err(ParseError::OutOfRange));
        assert_eq!(parsed("SYST:DATE 2025,13,1"), Err(ParseError::OutOfRange));
        assert_eq!(parsed("SYST:TIME 24,0,0"), Err(ParseError::OutOfRange));
    }
}
