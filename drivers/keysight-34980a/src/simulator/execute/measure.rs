//! Execution of the voltmeter's commands (section 5).

use std::time::Duration;

use scpi::{ChannelList, ParseError};
use survey::Relay;

use crate::command::{Functions, Measure, Sense, time_word};
use crate::simulator::errors::QueuedError;
use crate::simulator::execute::{Execution, Reply, block, yes_no};
use crate::simulator::measurement::memory::ReadingFormat;
use crate::simulator::measurement::meter::Settings;
use crate::simulator::{CONFIGURATION_CHANGED, Simulator34980a};

impl Simulator34980a {
    pub(crate) fn execute_sense(&mut self, sense: Sense, execution: &mut Execution<'_>) -> Reply {
        match sense {
            Sense::Configure {
                range,
                resolution,
                channels,
            } => {
                self.wait_for_measurement(execution)?;
                let channels = self
                    .meter
                    .configure(&self.relays, range, resolution, &channels)?;
                self.configured(channels, execution);
            }
            Sense::Set(setting, channels) | Sense::SetOlder(setting, channels) => {
                self.wait_for_measurement(execution)?;
                let channels = self.meter.set(&self.relays, setting, &channels)?;
                self.configured(channels, execution);
            }
            Sense::Ask(quantity, limit, channels) | Sense::AskOlder(quantity, limit, channels) => {
                let answer = self.meter.ask(&self.relays, quantity, limit, &channels);
                return answer.map(Some);
            }
            Sense::Configuration(channels) => {
                let answer = self.meter.configuration(&self.relays, &channels);
                return answer.map(Some);
            }
        }
        Ok(None)
    }

    /// Latches the configuration event, and adds the time that a setting takes for each of its channels.
    fn configured(&mut self, channels: usize, execution: &mut Execution<'_>) {
        self.status.operation.latch(CONFIGURATION_CHANGED);
        let channels = u32::try_from(channels).unwrap_or(u32::MAX);
        execution.now += self.settings.setting_time * channels;
    }

    pub(crate) fn execute_measure(
        &mut self,
        measure: Measure,
        execution: &mut Execution<'_>,
    ) -> Reply {
        match measure {
            Measure::Read(channels) => {
                let list = match channels {
                    Some(list) => {
                        let relays = self.relays.expand(&list)?;
                        self.meter.arranged(&self.relays, relays)?
                    }
                    None => self.meter.scan_list().to_vec(),
                };
                return self.read(&list, execution);
            }
            Measure::Volts {
                range,
                resolution,
                channels,
            } => {
                self.wait_for_measurement(execution)?;
                let set_up = self
                    .meter
                    .configure(&self.relays, range, resolution, &channels)?;
                self.configured(set_up, execution);
                return self.read_once(channels.is_some(), execution);
            }
            Measure::Initiate => {
                self.meter
                    .initiate(execution.now, &mut self.relays, execution.wires)?
            }
            Measure::Fetch => {
                if !self.meter.is_endless() {
                    self.wait_for_measurement(execution)?;
                }
                let memory = self.meter.memory();
                if memory.points(execution.now) == 0 {
                    return Err(ParseError::DataStale.into());
                }
                let readings = memory.read(execution.now);
                return Ok(Some(
                    self.meter.settings.format.write(readings, &self.calendar),
                ));
            }
            Measure::ReadAndErase(most) => {
                let most = most.map_or(usize::MAX, |most| most as usize);
                let taken = self.meter.memory_mut().take(most, execution.now);
                return Ok(Some(block(
                    &self.meter.settings.format.write(&taken, &self.calendar),
                )));
            }
            Measure::Remove(count) => {
                let count = count as usize;
                if self.meter.memory().points(execution.now) < count {
                    return Err(ParseError::OutOfRange.into());
                }
                let taken = self.meter.memory_mut().take(count, execution.now);
                return Ok(Some(
                    self.meter.settings.format.write(&taken, &self.calendar),
                ));
            }
            Measure::Points => {
                return Ok(Some(format!(
                    "{:+}",
                    self.meter.memory().points(execution.now)
                )));
            }
            Measure::Last(channel) => return self.last_reading(channel.as_ref(), execution),
            Measure::SetThreshold(count) => self.meter.settings.threshold = count,
            Measure::Threshold => return Ok(Some(format!("{:+}", self.meter.settings.threshold))),
            Measure::Abort => self.stop_measuring(execution.now, execution.wires),
            Measure::SetSource(source) => self.triggers(execution)?.source = source,
            Measure::Source => return Ok(Some(self.meter.settings.source.word())),
            Measure::SetTimer(timer) => self.triggers(execution)?.timer = timer,
            Measure::Timer(limit) => return Ok(Some(self.meter.timer(limit))),
            Measure::SetCount(count) => self.triggers(execution)?.count = count,
            Measure::Count(limit) => return Ok(Some(self.meter.sweeps(limit))),
            Measure::SetSamples(count) => self.triggers(execution)?.samples = count,
            Measure::Samples(limit) => return Ok(Some(self.meter.samples(limit))),
            Measure::SetTriggerDelay(delay) => self.triggers(execution)?.trigger_delay = delay,
            Measure::TriggerDelay(limit) => return Ok(Some(self.meter.trigger_delay(limit))),
            Measure::TriggerDelayAuto => {
                return yes_no(self.meter.settings.trigger_delay.is_none());
            }
            Measure::SetField(field, on) => {
                let fields = &mut self.meter.settings.format.fields;
                if on {
                    fields.insert(field);
                } else {
                    fields.remove(&field);
                }
            }
            Measure::Field(field) => {
                return yes_no(self.meter.settings.format.fields.contains(&field));
            }
            Measure::SetAbsoluteTime(absolute) => self.meter.settings.format.absolute = absolute,
            Measure::AbsoluteTime => {
                return Ok(Some(time_word(self.meter.settings.format.absolute)));
            }
        }
        Ok(None)
    }

    /// The settings, to change one of the triggers after a running measurement.
    fn triggers(&mut self, execution: &mut Execution<'_>) -> Result<&mut Settings, QueuedError> {
        self.wait_for_measurement(execution)?;
        Ok(self.meter.triggers_mut())
    }

    pub(crate) fn execute_functions(
        &mut self,
        functions: Functions,
        execution: &mut Execution<'_>,
    ) -> Reply {
        match functions {
            Functions::Configure(request, channels) => {
                self.wait_for_measurement(execution)?;
                let meter = &mut self.meter;
                let channels = meter.configure_function(&self.relays, request, &channels)?;
                self.configured(channels, execution);
            }
            Functions::Measure(request, channels) => {
                self.wait_for_measurement(execution)?;
                let meter = &mut self.meter;
                let set_up = meter.configure_function(&self.relays, request, &channels)?;
                self.configured(set_up, execution);
                return self.read_once(channels.is_some(), execution);
            }
            Functions::Select(function, channels) => {
                self.wait_for_measurement(execution)?;
                let channels = self.meter.select(&self.relays, function, &channels)?;
                self.configured(channels, execution);
            }
            Functions::Selected(channels) => {
                return self.meter.selected(&self.relays, &channels).map(Some);
            }
            Functions::Set(function, detail, value, channels) => {
                self.wait_for_measurement(execution)?;
                let of = (function, detail);
                let channels = self.meter.set_detail(&self.relays, of, value, &channels)?;
                self.configured(channels, execution);
            }
            Functions::Ask(function, detail, limit, channels) => {
                let of = (function, detail);
                let answer = self.meter.detail(&self.relays, of, limit, &channels);
                return answer.map(Some);
            }
        }
        Ok(None)
    }

    /// The last reading of one channel, or of the bare voltmeter, with every field and the time of day; zeros if there
    /// is none (help: DATA:LAST?).
    fn last_reading(&self, channel: Option<&ChannelList>, execution: &Execution<'_>) -> Reply {
        let channel = match channel {
            None => None,
            Some(list) => match self.relays.expand(list)?[..] {
                [only] => Some(only),
                _ => return Err(ParseError::ParameterNotAllowed.into()),
            },
        };
        Ok(Some(
            match self.meter.memory().last(channel, execution.now) {
                Some(reading) => ReadingFormat::whole().write([reading], &self.calendar),
                None => "0,0,0,0,0,0,0,0,0".to_owned(),
            },
        ))
    }

    /// Takes and returns the readings of MEAS?.
    fn read_once(&mut self, scans: bool, execution: &mut Execution<'_>) -> Reply {
        let meter = &mut self.meter;
        let end = meter.read_once(scans, execution.now, &mut self.relays, execution.wires)?;
        self.answer_readings(end, execution)
    }

    fn read(&mut self, list: &[Relay], execution: &mut Execution<'_>) -> Reply {
        let end = self
            .meter
            .read(list, execution.now, &mut self.relays, execution.wires)?;
        self.answer_readings(end, execution)
    }

    fn answer_readings(&mut self, end: Duration, execution: &mut Execution<'_>) -> Reply {
        execution.now = end;
        if self.deferring && execution.last {
            self.defer(execution.session, end);
            return Ok(None);
        }
        self.meter
            .take_ahead(end, &mut self.relays, execution.wires);
        let readings = self.meter.memory().read(end);
        Ok(Some(
            self.meter.settings.format.write(readings, &self.calendar),
        ))
    }
}
