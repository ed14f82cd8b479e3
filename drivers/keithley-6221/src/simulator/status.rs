//! Common commands, status registers, memories.

use scpi::{Common, ParseError, StandardEvent, StatusRegister};

use super::Simulator6221;
use super::lists::Lists;
use super::state::{Outcome, RESET, ResettableSettings};
use super::sweep::Trigger;
use super::values::Values;
use crate::Parameter;
use crate::command::{Element, StatusGroup};

// Bits of the operation registers (fact sheet, section 5). Bit 8, the filter of delta readings, and bit 11, a fault of
// the serial port, are never set: the simulator has no such readings and no such port.
pub(super) const SWEEP_DONE: u8 = 1;
pub(super) const SWEEP_ABORTED: u8 = 2;
pub(super) const SWEEPING: u8 = 3;
pub(super) const WAVE_STARTED: u8 = 4;
pub(super) const AWAITING_TRIGGER: u8 = 5;
pub(super) const AWAITING_ARM: u8 = 6;
pub(super) const WAVE_STOPPED: u8 = 7;
pub(super) const IDLE: u8 = 10;

/// The range of all error numbers, as public drivers send it.
pub(super) const ALL_ERRORS: [i32; 2] = [-440, 958];

/// Ranges in ascending order, with adjacent ones merged.
pub(super) fn joined(ranges: &[[i32; 2]]) -> Vec<[i32; 2]> {
    let mut ascending = ranges.to_vec();
    ascending.sort_unstable();
    let mut joined: Vec<[i32; 2]> = Vec::new();
    for [from, to] in ascending {
        match joined.last_mut() {
            Some(last) if from <= last[1].saturating_add(1) => last[1] = last[1].max(to),
            _ => joined.push([from, to]),
        }
    }
    joined
}

/// The difference of two sets of ranges.
fn without(ranges: &[[i32; 2]], others: &[[i32; 2]]) -> Vec<[i32; 2]> {
    let mut left = joined(ranges);
    for [from, to] in others {
        left = left
            .into_iter()
            .flat_map(|[first, last]| {
                [
                    [first, last.min(from.saturating_sub(1))],
                    [first.max(to.saturating_add(1)), last],
                ]
            })
            .filter(|[first, last]| first <= last)
            .collect();
    }
    joined(&left)
}

impl Simulator6221 {
    pub(super) fn execute_common(
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
                self.reset();
                None
            }
            Common::ClearStatus => {
                status.clear();
                self.errors.clear();
                self.completion_awaited = false;
                self.answer_awaited = false;
                None
            }
            Common::SetEventEnable(mask) => {
                status.set_standard_enable(mask);
                None
            }
            Common::EventEnable => {
                let enable = status.standard_enable();
                Some(self.register(enable.into()))
            }
            Common::Events => {
                let events = status.take_standard();
                Some(self.register(events.into()))
            }
            Common::SetServiceEnable(mask) => {
                status.set_service_enable(mask);
                None
            }
            Common::ServiceEnable => {
                let enable = status.service_enable();
                Some(self.register(enable.into()))
            }
            Common::StatusByte => {
                let byte = status.status_byte(!self.errors.is_empty(), replies_wait);
                Some(self.register(byte.into()))
            }
            Common::OperationComplete => {
                if self.remaining().is_some_and(|left| left.is_zero()) {
                    self.status.raise(StandardEvent::OperationComplete);
                } else {
                    self.completion_awaited = true;
                }
                None
            }
            // the awaited operation has ended before `*OPC?` and `*WAI` are executed
            Common::WhenComplete => Some("1".to_owned()),
            Common::Wait => None,
            Common::SelfTest => Some("0".to_owned()),
            Common::Trigger => {
                if !self.receive_trigger(Trigger::Bus) {
                    return Err(ParseError::TriggerIgnored);
                }
                None
            }
        })
    }

    /// A register in the format of `FORM:SREG`.
    pub(super) fn register(&self, value: u16) -> String {
        // In the order of the words.
        match self.values.get(Parameter::RegisterFormat) as u8 {
            1 => format!("#H{value:X}"),
            2 => format!("#Q{value:o}"),
            3 => format!("#B{value:b}"),
            _ => value.to_string(),
        }
    }

    pub(super) fn is_queued(&self, code: i32) -> bool {
        self.queued
            .iter()
            .any(|[from, to]| (*from..=*to).contains(&code))
    }

    /// Numbers of the errors that are not queued.
    pub(super) fn not_queued(&self) -> Vec<[i32; 2]> {
        without(&[ALL_ERRORS], &self.queued)
    }

    pub(super) fn disable_errors(&mut self, numbers: &[[i32; 2]]) {
        self.queued = without(&self.queued, numbers);
    }

    pub(super) fn group(&mut self, group: StatusGroup) -> &mut StatusRegister {
        match group {
            StatusGroup::Measurement => &mut self.status.measurement,
            StatusGroup::Operation => &mut self.status.operation,
            StatusGroup::Questionable => &mut self.status.questionable,
        }
    }

    /// `*RST`: resets everything except registers, memories, stored waves and communication settings.
    fn reset(&mut self) {
        self.take_settings(RESET, &Values::reset());
        self.lists = Lists::reset();
        self.elements = Element::DEFAULT.to_vec();
        self.completion_awaited = false;
        self.answer_awaited = false;
    }

    /// `SYST:PRES`: as `*RST`, except for the byte order of a binary reading.
    pub(super) fn preset(&mut self) {
        self.reset();
        const SWAPPED: f64 = 1.0;
        self.values.set(Parameter::ByteOrder, SWAPPED);
    }

    pub(super) fn save(&mut self, place: u8) {
        let kept = Box::new((self.panel, self.values.clone()));
        self.memories[usize::from(place)] = Some(kept);
    }

    /// Recalls settings from a memory and switches the output off; an unused memory holds the settings of `*RST`
    /// (assumed).
    pub(super) fn recall(&mut self, place: u8) {
        match self.memories[usize::from(place)].clone() {
            Some(kept) => self.take_settings(kept.0, &kept.1),
            None => self.take_settings(RESET, &Values::reset()),
        }
    }

    fn take_settings(&mut self, panel: ResettableSettings, values: &Values) {
        self.stop_mode();
        self.outcome = Outcome::None;
        self.panel = ResettableSettings {
            output: false,
            ..panel
        };
        self.values.copy_settings(values);
    }
}
