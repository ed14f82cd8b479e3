//! Common commands, status registers, memories.

use scpi::{Common, ParseError, StandardEvent, StatusRegister};

use super::Simulator6221;
use super::lists::Lists;
use super::state::{Outcome, Panel, RESET};
use super::sweep::Trigger;
use super::values::Values;
use crate::Parameter;
use crate::command::{Element, StatusGroup};

// Bits of the operation registers (fact sheet, section 5). Bit 8, the filter of delta readings, and bit 11, a fault of
// the serial port, never come up: there are no such readings, and the simulator sees no port.
pub(super) const SWEEP_DONE: u8 = 1;
pub(super) const SWEEP_ABORTED: u8 = 2;
pub(super) const SWEEPING: u8 = 3;
pub(super) const WAVE_STARTED: u8 = 4;
pub(super) const AWAITING_TRIGGER: u8 = 5;
pub(super) const AWAITING_ARM: u8 = 6;
pub(super) const WAVE_STOPPED: u8 = 7;
pub(super) const IDLE: u8 = 10;

impl Simulator6221 {
    pub(super) fn carry_out_common(
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
            Common::OperationComplete => {
                if self.remaining().is_some_and(|left| left.is_zero()) {
                    self.status.raise(StandardEvent::OperationComplete);
                } else {
                    self.completion_awaited = true;
                }
                None
            }
            // What is waited for is over when these are carried out.
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

    pub(super) fn group(&mut self, group: StatusGroup) -> &mut StatusRegister {
        match group {
            StatusGroup::Measurement => &mut self.status.measurement,
            StatusGroup::Operation => &mut self.status.operation,
            StatusGroup::Questionable => &mut self.status.questionable,
        }
    }

    /// `*RST`: all but registers, memories, kept waves and communication settings.
    fn reset(&mut self) {
        self.take_settings(RESET, &Values::reset());
        self.lists = Lists::reset();
        self.elements = Element::DEFAULT.to_vec();
        self.completion_awaited = false;
        self.answer_awaited = false;
    }

    /// `SYST:PRES`: as `*RST`, but for the order of a binary reading's bytes.
    pub(super) fn preset(&mut self) {
        self.reset();
        const SWAPPED: f64 = 1.0;
        // Only centre and span are ever refused.
        self.values.set(Parameter::ByteOrder, SWAPPED);
    }

    pub(super) fn save(&mut self, place: u8) {
        let kept = Box::new((self.panel, self.values.clone()));
        self.memories[usize::from(place)] = Some(kept);
    }

    /// Takes settings out of a memory, the output off; one that was never used holds those of `*RST` (assumed).
    pub(super) fn recall(&mut self, place: u8) {
        match self.memories[usize::from(place)].clone() {
            Some(kept) => self.take_settings(kept.0, &kept.1),
            None => self.take_settings(RESET, &Values::reset()),
        }
    }

    fn take_settings(&mut self, panel: Panel, values: &Values) {
        self.stop_mode();
        self.outcome = Outcome::None;
        self.panel = Panel {
            output: false,
            ..panel
        };
        self.values.become_like(values);
    }
}
