//! The commands of the 6221 as values, and their grammar in both directions. No SCPI text stands anywhere else but in
//! the table of [`Parameter`]s.
//!
//! Chapters as in the fact sheet, section 4.

mod grammar;
mod spelling;
mod vocabulary;

use std::net::Ipv4Addr;

use scpi::Common;
use survey::{Amps, Volts};

#[cfg(feature = "simulator")]
pub(crate) use spelling::error_numbers;
pub use vocabulary::{
    Address, Ask, Board, DeltaMode, Element, Line, List, Shield, Speed, StatusGroup,
};

use crate::Parameter;

/// One command.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// A common command.
    Common(Common),
    /// Keep the settings in one of the memories 0 to 4.
    Save(u8),
    /// Take the settings out of a memory.
    Recall(u8),
    /// Read which options are built in.
    Options,

    /// Set the level.
    SetLevel(Amps),
    /// Read the level.
    Level(Ask),
    /// Set the smallest fixed range that holds this current.
    SetRange(Amps),
    /// Read the range.
    Range(Ask),
    /// Let the range follow the level, or not.
    SetAutorange(bool),
    /// Read whether the range follows the level.
    Autorange,
    /// Set the voltage limit.
    SetCompliance(Volts),
    /// Read the voltage limit.
    Compliance(Ask),
    /// Switch the analogue filter.
    SetFilter(bool),
    /// Read the analogue filter.
    Filter,
    /// Set the level to 0 and the output off.
    ClearSource,
    /// Switch the output.
    SetOutput(bool),
    /// Read the output.
    Output,
    /// Join the inner shield.
    SetShield(Shield),
    /// Read what the inner shield is joined to.
    Shield,
    /// Join output low to earth, or let it float.
    SetLowToEarth(bool),
    /// Read whether output low is joined to earth.
    LowToEarth,
    /// Set the speed of response.
    SetSpeed(Speed),
    /// Read the speed of response.
    Speed,
    /// Read the interlock: 1 closed, 0 open (the header's name says the opposite).
    Interlock,

    /// Set a setting that is one value (see [`crate::Kind`] for how it is told).
    SetParameter(Parameter, f64),
    /// Read such a setting.
    Parameter(Parameter, Ask),
    /// Set a list.
    SetList(List, Vec<f64>),
    /// Add to a list.
    AppendList(List, Vec<f64>),
    /// Read a list.
    List(List),
    /// Read how many values a list has.
    ListLength(List),

    /// Make a sweep ready.
    ArmSweep,
    /// Read whether a sweep is ready.
    SweepArmed,
    /// End a sweep or a delta mode.
    AbortSweep,
    /// Start what is ready.
    Initiate,
    /// Put the trigger model back to idle.
    Abort,
    /// Pass by what the arm layer waits for.
    SignalArm,
    /// Pass by what the trigger layer waits for.
    SignalTrigger,

    /// Make a wave ready.
    ArmWave,
    /// Start a wave.
    StartWave,
    /// End a wave.
    AbortWave,
    /// Keep the arbitrary wave in place 1 to 4.
    CopyWave(u8),

    /// Read whether a 2182A is there.
    DeltaPresent(DeltaMode),
    /// Make a delta mode ready.
    ArmDelta(DeltaMode),
    /// Read whether a delta mode is ready.
    DeltaArmed(DeltaMode),
    /// Read the last reading of the 2182A.
    LatestReading,
    /// Read the last reading of the 2182A, once.
    FreshReading,
    /// Read the last reading of the 2182A after mathematics.
    MathReading,
    /// Make the statistic of the buffer.
    MakeStatistic,
    /// Read the statistic of the buffer.
    StatisticReading,
    /// Send a line to the 2182A.
    SerialSend(String),
    /// Read the line that the 2182A answers.
    SerialEnter,

    /// Empty the buffer.
    ClearBuffer,
    /// Read the buffer.
    BufferData,
    /// Read how many readings are in the buffer.
    BufferLength,
    /// Read how much room is in the buffer.
    BufferFree,
    /// Read what kind of readings are in the buffer.
    BufferType,
    /// Choose what a stored reading is told with.
    SetElements(Vec<Element>),
    /// Read what a stored reading is told with.
    Elements,

    /// Read a group's events and clear them.
    Events(StatusGroup),
    /// Read a group's conditions.
    Conditions(StatusGroup),
    /// Choose which of a group's events are summed up.
    SetEnable(StatusGroup, u16),
    /// Read which of a group's events are summed up.
    Enable(StatusGroup),
    /// Zero the enables of all groups.
    PresetStatus,
    /// Take the oldest error.
    NextError,
    /// Forget all errors.
    ClearErrors,
    /// Queue the errors of these numbers (from, to), and no others; public drivers send `STAT:QUE:ENAB (-440:+900)`.
    EnableErrors(Vec<[i32; 2]>),
    /// Don't queue the errors of these numbers.
    DisableErrors(Vec<[i32; 2]>),
    /// Read which errors are queued.
    EnabledErrors,
    /// Read which errors are not queued.
    DisabledErrors,

    /// Set the text of a line of the display, upper or lower.
    SetText(Line, String),
    /// Read it.
    Text(Line),
    /// Read which of its characters blink.
    TextAttributes(Line),

    /// Read the year of the SCPI standard kept.
    Version,
    /// Settings as the maker presets them.
    Preset,
    /// Give the keys back, on the serial port.
    Local,
    /// Take the keys away, on the serial port.
    Remote,
    /// Sound the beeper.
    Beep {
        /// Tone, Hz.
        hertz: f64,
        /// How long, s.
        seconds: f64,
    },
    /// Set an address of the network port.
    SetAddress(Address, Ipv4Addr),
    /// Read an address of the network port.
    Address(Address),
    /// Take over the addresses that were set.
    SaveAddresses,
    /// Read a board's serial number.
    BoardSerial(Board),
    /// Read a board's revision.
    BoardRevision(Board),
}

/// Compliance in the measurement registers, bit 3 (fact sheet, section 5).
pub(crate) const COMPLIANCE_BIT: u8 = 3;
/// Open interlock in the measurement registers, bit 1.
pub(crate) const INTERLOCK_BIT: u8 = 1;

impl Command {
    /// Whether an answer comes back.
    pub fn is_query(&self) -> bool {
        let text = self.to_string();
        let header = text.split(' ').next();
        header.is_some_and(|header| header.ends_with('?'))
    }
}
