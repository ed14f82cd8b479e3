//! The commands of the 6221 as values, and their grammar in both directions. Further SCPI text is only in the table of
//! [`Parameter`]s.
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
    /// Save the settings in one of the memories 0 to 4.
    Save(u8),
    /// Recall the settings from a memory.
    Recall(u8),
    /// Query the installed options.
    Options,

    /// Set the level.
    SetLevel(Amps),
    /// Read the level.
    Level(Ask),
    /// Set the smallest fixed range that holds this current.
    SetRange(Amps),
    /// Read the range.
    Range(Ask),
    /// Switch autorange, in which the range follows the level.
    SetAutorange(bool),
    /// Read whether autorange is on.
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
    /// Connect the inner shield.
    SetShield(Shield),
    /// Read the connection of the inner shield.
    Shield,
    /// Connect output low to earth, or let it float.
    SetLowToEarth(bool),
    /// Read whether output low is connected to earth.
    LowToEarth,
    /// Set the speed of response.
    SetSpeed(Speed),
    /// Read the speed of response.
    Speed,
    /// Read the interlock: 1 closed, 0 open (the name of the header suggests the opposite).
    Interlock,

    /// Set a parameter (see [`crate::Kind`] for how values are represented).
    SetParameter(Parameter, f64),
    /// Read a parameter.
    Parameter(Parameter, Ask),
    /// Set a list.
    SetList(List, Vec<f64>),
    /// Append to a list.
    AppendList(List, Vec<f64>),
    /// Read a list.
    List(List),
    /// Read how many values a list has.
    ListLength(List),

    /// Arm a sweep.
    ArmSweep,
    /// Read whether a sweep is armed.
    SweepArmed,
    /// End a sweep or a delta mode.
    AbortSweep,
    /// Start the armed sweep or delta mode.
    Initiate,
    /// Return the trigger model to idle.
    Abort,
    /// Bypass the event that the arm layer waits for.
    SignalArm,
    /// Bypass the event that the trigger layer waits for.
    SignalTrigger,

    /// Arm a wave.
    ArmWave,
    /// Start a wave.
    StartWave,
    /// End a wave.
    AbortWave,
    /// Copy the arbitrary wave to memory 1 to 4.
    CopyWave(u8),

    /// Read whether a 2182A is connected.
    DeltaPresent(DeltaMode),
    /// Arm a delta mode.
    ArmDelta(DeltaMode),
    /// Read whether a delta mode is armed.
    DeltaArmed(DeltaMode),
    /// Read the last reading of the 2182A.
    LatestReading,
    /// Read the last reading of the 2182A, if it has not been read yet.
    FreshReading,
    /// Read the last reading of the 2182A after mathematics.
    MathReading,
    /// Compute the statistic of the buffer.
    MakeStatistic,
    /// Read the statistic of the buffer.
    StatisticReading,
    /// Read whether the tested output is in compliance.
    LimitFailed,
    /// Send a line to the 2182A.
    SerialSend(String),
    /// Read the reply of the 2182A to that line.
    SerialEnter,

    /// Empty the buffer.
    ClearBuffer,
    /// Read the buffer.
    BufferData,
    /// Read how many readings are in the buffer.
    BufferLength,
    /// Read the free space of the buffer.
    BufferFree,
    /// Read the kind of readings in the buffer.
    BufferType,
    /// Choose the elements of a stored reading.
    SetElements(Vec<Element>),
    /// Read the elements of a stored reading.
    Elements,

    /// Read a group's events and clear them.
    Events(StatusGroup),
    /// Read a group's conditions.
    Conditions(StatusGroup),
    /// Set the enable mask of a group's events.
    SetEnable(StatusGroup, u16),
    /// Read the enable mask of a group's events.
    Enable(StatusGroup),
    /// Clear the enable masks of all groups.
    PresetStatus,
    /// Read the oldest error and remove it.
    NextError,
    /// Clear the error queue.
    ClearErrors,
    /// Queue only errors with these numbers (from, to); public drivers send `STAT:QUE:ENAB (-440:+900)`.
    EnableErrors(Vec<[i32; 2]>),
    /// Do not queue errors with these numbers.
    DisableErrors(Vec<[i32; 2]>),
    /// Read which errors are queued.
    EnabledErrors,
    /// Read which errors are not queued.
    DisabledErrors,

    /// Set the text of a line of the display, upper or lower.
    SetText(Line, String),
    /// Read the text of a line of the display.
    Text(Line),
    /// Read which characters of the line blink.
    TextAttributes(Line),

    /// Read the version (year) of the SCPI standard.
    Version,
    /// Restore the factory default settings.
    Preset,
    /// Unlock the front-panel keys (serial port).
    Local,
    /// Lock the front-panel keys (serial port).
    Remote,
    /// Sound the beeper.
    Beep {
        /// Tone, Hz.
        hertz: f64,
        /// Duration, s.
        seconds: f64,
    },
    /// Set an address of the network port.
    SetAddress(Address, Ipv4Addr),
    /// Read an address of the network port.
    Address(Address),
    /// Apply the addresses that were set.
    SaveAddresses,
    /// Read a board's serial number.
    BoardSerial(Board),
    /// Read a board's revision.
    BoardRevision(Board),
}

/// Bit 3 of the measurement registers: compliance (fact sheet, section 5).
pub(crate) const COMPLIANCE_BIT: u8 = 3;
/// Bit 1 of the measurement registers: open interlock (fact sheet, section 5).
pub(crate) const INTERLOCK_BIT: u8 = 1;

impl Command {
    /// Whether the command has a reply.
    pub fn is_query(&self) -> bool {
        let text = self.to_string();
        let header = text.split(' ').next();
        header.is_some_and(|header| header.ends_with('?'))
    }
}
