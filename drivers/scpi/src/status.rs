//! The status registers of IEEE 488.2 and SCPI-99: condition, event, enable, and the status byte that summarises them.

use std::ops::RangeInclusive;

/// A group of status bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StatusRegister {
    condition: u16,
    event: u16,
    enable: u16,
}

impl StatusRegister {
    /// Sets one condition bit to its present state; a rising edge is latched as an event.
    pub fn set(&mut self, bit: u8, on: bool) {
        let mask = mask(bit);
        if on {
            self.event |= mask & !self.condition;
            self.condition |= mask;
        } else {
            self.condition &= !mask;
        }
    }

    /// Latches an event that has no lasting condition.
    pub fn latch(&mut self, bit: u8) {
        self.event |= mask(bit);
    }

    /// The present conditions.
    pub fn condition(&self) -> u16 {
        self.condition
    }

    /// The latched events, without clearing them.
    pub fn event(&self) -> u16 {
        self.event
    }

    /// Reads the latched events and clears them.
    pub fn take_event(&mut self) -> u16 {
        std::mem::take(&mut self.event)
    }

    /// Clears the events; enables stay.
    pub fn clear(&mut self) {
        self.event = 0;
    }

    /// Enable mask: which events are summarised.
    pub fn enable(&self) -> u16 {
        self.enable
    }

    /// Sets the enable mask. Bit 15 is never used (SCPI-99 volume 1, section 9).
    pub fn set_enable(&mut self, enable: u16) {
        self.enable = enable & 0x7fff;
    }

    /// Whether an enabled event is latched.
    pub fn summary(&self) -> bool {
        self.event & self.enable != 0
    }
}

fn mask(bit: u8) -> u16 {
    1u16.checked_shl(u32::from(bit)).unwrap_or(0)
}

/// Bits of the standard event register (IEEE 488.2 section 11.5.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum StandardEvent {
    /// Bit 0: all pending operations are complete, after `*OPC`.
    OperationComplete = 0,
    /// Bit 2: a reply was lost or not available.
    QueryError = 2,
    /// Bit 3: a fault of the instrument itself.
    DeviceError = 3,
    /// Bit 4: the command was valid, but could not be executed.
    ExecutionError = 4,
    /// Bit 5: the command had a syntax error.
    CommandError = 5,
    /// Bit 6: a key was pressed.
    UserRequest = 6,
    /// Bit 7: power was switched on.
    PowerOn = 7,
}

impl StandardEvent {
    /// The event that an error number belongs to (SCPI-99 volume 2, section 21.8); `None` for 0 and reserved numbers.
    pub fn of_error(code: i32) -> Option<Self> {
        const CLASSES: [(RangeInclusive<i32>, StandardEvent); 5] = [
            (-199..=-100, StandardEvent::CommandError),
            (-299..=-200, StandardEvent::ExecutionError),
            (-399..=-300, StandardEvent::DeviceError),
            (-499..=-400, StandardEvent::QueryError),
            (1..=i32::MAX, StandardEvent::DeviceError),
        ];
        CLASSES
            .into_iter()
            .find(|(codes, _)| codes.contains(&code))
            .map(|(_, event)| event)
    }
}

/// The whole status system: four groups, the standard events, and the status byte. Only Keithley's instruments have the
/// measurement group, only Agilent's the alarm group; a group that an instrument lacks stays unused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StatusModel {
    /// Measurement group, summarised in bit 0 of the status byte.
    pub measurement: StatusRegister,
    /// Alarm group, summarised in bit 1 of the status byte.
    pub alarm: StatusRegister,
    /// Questionable group, summarised in bit 3 of the status byte.
    pub questionable: StatusRegister,
    /// Operation group, summarised in bit 7 of the status byte.
    pub operation: StatusRegister,
    standard: u8,
    standard_enable: u8,
    service_enable: u8,
}

impl StatusModel {
    /// As after power on: the power-on event is latched, nothing is enabled.
    pub fn new() -> Self {
        let mut status = Self::default();
        status.raise(StandardEvent::PowerOn);
        status
    }

    /// Latches a standard event.
    pub fn raise(&mut self, event: StandardEvent) {
        self.standard |= 1 << event as u8;
    }

    /// Latches the standard event that an error number belongs to.
    pub fn raise_error(&mut self, code: i32) {
        if let Some(event) = StandardEvent::of_error(code) {
            self.raise(event);
        }
    }

    /// Reply to `*ESR?`: the standard events, cleared by reading.
    pub fn take_standard(&mut self) -> u8 {
        std::mem::take(&mut self.standard)
    }

    /// Reply to `*ESE?`.
    pub fn standard_enable(&self) -> u8 {
        self.standard_enable
    }

    /// Executes `*ESE`.
    pub fn set_standard_enable(&mut self, enable: u8) {
        self.standard_enable = enable;
    }

    /// Reply to `*SRE?`.
    pub fn service_enable(&self) -> u8 {
        self.service_enable
    }

    /// Executes `*SRE`. Bit 6 cannot be enabled (IEEE 488.2 section 11.3.2).
    pub fn set_service_enable(&mut self, enable: u8) {
        self.service_enable = enable & !MASTER_SUMMARY;
    }

    /// Reply to `*STB?`. The caller passes whether its queues hold errors and replies.
    pub fn status_byte(&self, errors_wait: bool, message_available: bool) -> u8 {
        let bits = u8::from(self.measurement.summary())
            | u8::from(self.alarm.summary()) << 1
            | u8::from(errors_wait) << 2
            | u8::from(self.questionable.summary()) << 3
            | u8::from(message_available) << 4
            | u8::from(self.standard & self.standard_enable != 0) << 5
            | u8::from(self.operation.summary()) << 7;
        if bits & self.service_enable != 0 {
            bits | MASTER_SUMMARY
        } else {
            bits
        }
    }

    /// Executes `*CLS` on the registers: clears the events and keeps the enable masks.
    pub fn clear(&mut self) {
        self.measurement.clear();
        self.alarm.clear();
        self.questionable.clear();
        self.operation.clear();
        self.standard = 0;
    }

    /// `STAT:PRES`: sets the enable masks of the groups to 0; those of `*ESE` and `*SRE` stay.
    pub fn preset(&mut self) {
        self.measurement.set_enable(0);
        self.alarm.set_enable(0);
        self.questionable.set_enable(0);
        self.operation.set_enable(0);
    }
}

const MASTER_SUMMARY: u8 = 1 << 6;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_is_a_rise_and_stays_until_read() {
        let mut register = StatusRegister::default();
        register.set(3, true);
        register.set(3, false);
        assert_eq!((register.condition(), register.event()), (0, 8));
        assert_eq!(register.take_event(), 8);
        assert_eq!(register.take_event(), 0);
        register.set(3, true);
        register.take_event();
        register.set(3, true);
        assert_eq!((register.condition(), register.event()), (8, 0));
    }

    #[test]
    fn the_status_byte_sums_up_what_is_enabled() {
        let mut status = StatusModel::default();
        status.measurement.set(3, true);
        assert_eq!(status.status_byte(false, false), 0);
        status.measurement.set_enable(8);
        assert_eq!(status.status_byte(false, false), 0b1);
        status.set_service_enable(0xff);
        assert_eq!(status.service_enable(), 0xbf);
        assert_eq!(status.status_byte(true, true), 0b101_0101);
        status.raise_error(-113);
        status.set_standard_enable(32);
        status.questionable.set_enable(0xffff);
        status.questionable.latch(0);
        status.operation.set_enable(16);
        status.operation.set(4, true);
        assert_eq!(status.status_byte(false, false), 0b1110_1001);
        status.clear();
        assert_eq!(status.status_byte(false, false), 0);
        assert_eq!(status.measurement.enable(), 8);
        status.preset();
        assert_eq!(status.measurement.enable(), 0);
        assert_eq!(status.standard_enable(), 32);
    }

    #[test]
    fn errors_belong_to_events_by_their_hundreds() {
        let event = StandardEvent::of_error;
        assert_eq!(event(-113), Some(StandardEvent::CommandError));
        assert_eq!(event(-222), Some(StandardEvent::ExecutionError));
        assert_eq!(event(-350), Some(StandardEvent::DeviceError));
        assert_eq!(event(-420), Some(StandardEvent::QueryError));
        assert_eq!(event(0), None);
        assert_eq!(event(i32::MIN), None);
    }
}
