//! Execution of scaling, limits, alarms and statistics (corrections of 2026-11-22).

use crate::command::Calculate;
use crate::simulator::Simulator34980a;
use crate::simulator::execute::{Execution, Reply, block};
use crate::simulator::measurement::memory::{ReadingFormat, Stored};

/// Entries of the alarm queue; later alarms are lost (help: SYSTem:ALARm?).
const ALARMS: usize = 20;

/// Bits of the alarm register; alarm n has bit n - 1 (help: STATus:ALARm).
const QUEUE_FILLED: u8 = 4;
const QUEUE_OVERFLOW: u8 = 5;

impl Simulator34980a {
    pub(crate) fn execute_calculate(
        &mut self,
        calculate: Calculate,
        execution: &mut Execution<'_>,
    ) -> Reply {
        match calculate {
            Calculate::SetScaling(scaling, channels) => {
                self.wait_for_measurement(execution)?;
                self.meter.set_scaling(&self.relays, &scaling, &channels)?;
            }
            Calculate::Scaling(quantity, channels) => {
                let answer = self.meter.scaling(&self.relays, quantity, &channels);
                return answer.map(Some);
            }
            Calculate::SetLimit(limit, value, channels) => {
                self.wait_for_measurement(execution)?;
                let meter = &mut self.meter;
                meter.set_limit(&self.relays, limit, value, &channels)?;
            }
            Calculate::Limit(limit, end, channels) => {
                let answer = self.meter.limit(&self.relays, limit, end, &channels);
                return answer.map(Some);
            }
            Calculate::SetLimitState(limit, on, channels) => {
                self.wait_for_measurement(execution)?;
                let meter = &mut self.meter;
                meter.switch_limit(&self.relays, limit, on, &channels)?;
            }
            Calculate::LimitState(limit, channels) => {
                let answer = self.meter.limit_state(&self.relays, limit, &channels);
                return answer.map(Some);
            }
            Calculate::Statistic(statistic, channels) => {
                let now = (&self.calendar, execution.now);
                let meter = &self.meter;
                let answer = meter.statistic(&self.relays, statistic, &channels, now);
                return answer.map(Some);
            }
            Calculate::ClearStatistics(channels) => {
                let now = execution.now;
                self.meter.clear_statistics(&self.relays, &channels, now)?;
            }
            Calculate::SetAlarmSource(alarm, channels) => {
                self.wait_for_measurement(execution)?;
                self.meter.assign_alarm(&self.relays, alarm, &channels)?;
            }
            Calculate::AlarmSource(alarm) => {
                return Ok(Some(block(&self.meter.assigned(alarm).to_string())));
            }
            Calculate::NextAlarm => return Ok(Some(self.next_alarm())),
        }
        Ok(None)
    }

    /// Removes the oldest alarm and returns its reading with every field, and its number; zeros if there is none.
    fn next_alarm(&mut self) -> String {
        let alarm = self.alarms.pop_front();
        self.status.alarm.set(QUEUE_FILLED, !self.alarms.is_empty());
        match alarm {
            Some((reading, number)) => {
                let reading = ReadingFormat::whole().write([&reading], &self.calendar);
                format!("{reading},{number}")
            }
            None => "0,0,0,0,0,0,0,0,0,0".to_owned(),
        }
    }

    /// Queues alarms.
    pub(crate) fn raise_alarms(&mut self, alarms: Vec<(Stored, u8)>) {
        for (reading, number) in alarms {
            self.status.alarm.latch(number - 1);
            if self.alarms.len() < ALARMS {
                self.alarms.push_back((reading, number));
            } else {
                self.status.alarm.latch(QUEUE_OVERFLOW);
            }
        }
        self.status.alarm.set(QUEUE_FILLED, !self.alarms.is_empty());
    }

    /// `*CLS` empties the alarm queue too.
    pub(crate) fn clear_alarms(&mut self) {
        self.alarms.clear();
        self.status.alarm.set(QUEUE_FILLED, false);
        self.status.alarm.clear();
    }
}
