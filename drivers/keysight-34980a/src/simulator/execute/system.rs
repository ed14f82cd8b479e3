//! Execution of the commands of the mainframe and its status (sections 1, 3 and 7).

use scpi::{StatusRegister, quote};

use crate::command::{StatusGroup, System};
use crate::simulator::Simulator34980a;
use crate::simulator::execute::{Execution, Reply, join, yes_no};

impl Simulator34980a {
    pub(crate) fn execute_system(
        &mut self,
        system: System,
        execution: &mut Execution<'_>,
    ) -> Reply {
        let now = execution.now;
        match system {
            System::CardType(slot) => return Ok(Some(self.card_type(slot))),
            System::TerminalType(slot) => return self.relays.terminal_type(slot).map(Some),
            System::SetProtection(slot, protection) => self.relays.protect(slot, protection)?,
            System::Protection(slot) => {
                return Ok(Some(self.relays.protection(slot)?.word()));
            }
            System::RelayCycles(list) => {
                let relays = self.relays.expand_some(&list)?;
                let counts = relays.iter().map(|relay| self.relays.cycles(*relay));
                return Ok(Some(join(counts.map(|count| format!("{count:+}")))));
            }
            System::ClearRelayCycles(list) => {
                let relays = self.relays.expand_some(&list)?;
                self.relays.clear_cycles(&relays);
            }
            System::VoltmeterInstalled => return yes_no(self.meter.is_installed()),
            System::SetVoltmeter(on) => {
                self.wait_for_measurement(execution)?;
                self.meter.enable(on);
            }
            System::Voltmeter => return yes_no(self.meter.is_enabled()),
            System::MemoryValid(place) => {
                return yes_no(self.kept[usize::from(place)].is_some());
            }
            System::MemoryDelete(place) => self.kept[usize::from(place)] = None,
            System::Memories => return Ok(Some(format!("{:+}", self.kept.len()))),
            System::SetRecallAtPowerOn(on) => self.recall_at_power_on = on,
            System::RecallAtPowerOn => return yes_no(self.recall_at_power_on),
            System::SelectRecalled(place) => self.recalled = place,
            System::Recalled => return Ok(Some(self.recalled.to_string())),
            System::MacAddress => return Ok(Some(quote("00-30-D3-00-00-01"))),
            System::NextError => {
                let entry = self.errors.pop();
                return Ok(Some(format!("{:+},{}", entry.code, quote(&entry.message))));
            }
            System::Version => return Ok(Some("1999.0".to_owned())),
            System::SetDate(year, month, day) => self.calendar.set_date(year, month, day, now),
            System::Date => return Ok(Some(self.calendar.date(now))),
            System::SetTime(hour, minute, second) => {
                self.calendar.set_time(hour, minute, second, now);
            }
            System::Time => return Ok(Some(self.calendar.time(now))),
            System::ScanTime => return Ok(Some(self.calendar.stamp(self.meter.began()))),
            System::RequestLock => {
                let granted = self.sessions.request_lock(execution.session);
                return Ok(Some(format!("{:+}", u8::from(granted))));
            }
            System::ReleaseLock => self.sessions.release_lock(execution.session),
            System::LockName => return Ok(Some(self.sessions.name(execution.session))),
            System::LockOwner => return Ok(Some(self.sessions.owner())),
            System::Delay(time) => execution.now += survey::duration(time),
            System::SetDisplay(text) => self.display = text,
            System::Display => return Ok(Some(quote(&self.display))),
            System::ClearDisplay => self.display.clear(),
            System::SetDisplayOn(on) => self.display_on = on,
            System::DisplayOn => return yes_no(self.display_on),
            System::LineFrequency => return Ok(Some(format!("{:+}", self.settings.line_hz))),
            System::Beep => {}
            System::Preset => {
                let computations = self.meter.computations();
                self.reset(execution);
                self.meter.take_computations(computations);
            }
            System::Save(place) => {
                self.kept[usize::from(place)] = Some(self.meter.settings.clone())
            }
            System::Recall(place) => {
                let kept = self.stored(place)?;
                self.wait_for_measurement(execution)?;
                self.meter.take_settings(kept, &self.relays);
            }
            System::Events(group) => {
                return Ok(Some(format!("{:+}", self.register(group).take_event())));
            }
            System::Conditions(group) => {
                return Ok(Some(format!("{:+}", self.register(group).condition())));
            }
            System::SetEnable(group, mask) => self.register(group).set_enable(mask),
            System::Enable(group) => {
                return Ok(Some(format!("{:+}", self.register(group).enable())));
            }
            System::PresetStatus => self.status.preset(),
        }
        Ok(None)
    }

    fn register(&mut self, group: StatusGroup) -> &mut StatusRegister {
        match group {
            StatusGroup::Operation => &mut self.status.operation,
            StatusGroup::Questionable => &mut self.status.questionable,
            StatusGroup::Alarm => &mut self.status.alarm,
        }
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
}
