//! Execution of the voltmeter's commands (section 5).

use std::time::Duration;

use scpi::{ChannelList, ParseError};
use survey::Relay;

use crate::command::{Functions, Measure, Sense, time_word};
use crate::simulator::execute::{Reply, Turn, block, yes_no};
use crate::simulator::measurement::memory::Form;
use crate::simulator::{CONFIGURATION_CHANGED, Simulator34980a};

impl Simulator34980a {
    pub(crate) fn obey_sense(&mut self, sense: Sense, turn: &mut Turn<'_>) -> Reply {
        match sense {
            Sense::Configure {
                range,
                resolution,
                channels,
            } => {
                self.wait_for_measurement(turn)?;
                let channels = self
                    .meter
                    .configure(&self.relays, range, resolution, &channels)?;
                self.configured(channels, turn);
            }
            Sense::Set(setting, channels) | Sense::SetOlder(setting, channels) => {
                self.wait_for_measurement(turn)?;
                let channels = self.meter.set(&self.relays, setting, &channels)?;
                self.configured(channels, turn);
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

    /// A setting takes time for each of its channels.
    fn configured(&mut self, channels: usize, turn: &mut Turn<'_>) {
        self.status.operation.latch(CONFIGURATION_CHANGED);
        let channels = u32::try_from(channels).unwrap_or(u32::MAX);
        turn.now += self.settings.setting_time * channels;
    }

    pub(crate) fn obey_measure(&mut self, measure: Measure, turn: &mut Turn<'_>) -> Reply {
        match measure {
            Measure::Read(channels) => {
                let list = match channels {
                    Some(list) => {
                        let relays = self.relays.expand(&list)?;
                        self.meter.arranged(&self.relays, relays)?
                    }
                    None => self.meter.scan_list().to_vec(),
                };
                return self.read(&list, turn);
            }
            Measure::Volts {
                range,
                resolution,
                channels,
            } => {
                self.wait_for_measurement(turn)?;
                let set_up = self
                    .meter
                    .configure(&self.relays, range, resolution, &channels)?;
                self.configured(set_up, turn);
                return self.read_once(channels.is_some(), turn);
            }
            Measure::Initiate => self
                .meter
                .initiate(turn.now, &mut self.relays, turn.wires)?,
            Measure::Fetch => {
                if !self.meter.is_endless() {
                    self.wait_for_measurement(turn)?;
                }
                let memory = self.meter.memory();
                if memory.points(turn.now) == 0 {
                    return Err(ParseError::DataStale.into());
                }
                let readings = memory.read(turn.now);
                return Ok(Some(self.meter.form.write(readings, &self.calendar)));
            }
            Measure::ReadAndErase(most) => {
                let most = most.map_or(usize::MAX, |most| most as usize);
                let taken = self.meter.memory_mut().take(most, turn.now);
                return Ok(Some(block(&self.meter.form.write(&taken, &self.calendar))));
            }
            Measure::Remove(count) => {
                let count = count as usize;
                if self.meter.memory().points(turn.now) < count {
                    return Err(ParseError::OutOfRange.into());
                }
                let taken = self.meter.memory_mut().take(count, turn.now);
                return Ok(Some(self.meter.form.write(&taken, &self.calendar)));
            }
            Measure::Points => {
                return Ok(Some(format!("{:+}", self.meter.memory().points(turn.now))));
            }
            Measure::Last(channel) => return self.last_reading(channel.as_ref(), turn),
            Measure::SetThreshold(count) => self.meter.set_threshold(count),
            Measure::Threshold => return Ok(Some(format!("{:+}", self.meter.threshold()))),
            Measure::Abort => self.stop_measuring(turn.now, turn.wires),
            Measure::SetSource(source) => {
                self.wait_for_measurement(turn)?;
                self.meter.set_source(source);
            }
            Measure::Source => return Ok(Some(self.meter.source().word())),
            Measure::SetTimer(timer) => {
                self.wait_for_measurement(turn)?;
                self.meter.set_timer(timer);
            }
            Measure::Timer(limit) => return Ok(Some(self.meter.timer(limit))),
            Measure::SetCount(count) => {
                self.wait_for_measurement(turn)?;
                self.meter.set_count(count);
            }
            Measure::Count(limit) => return Ok(Some(self.meter.sweeps(limit))),
            Measure::SetSamples(count) => {
                self.wait_for_measurement(turn)?;
                self.meter.set_samples(count);
            }
            Measure::Samples(limit) => return Ok(Some(self.meter.samples(limit))),
            Measure::SetTriggerDelay(delay) => {
                self.wait_for_measurement(turn)?;
                self.meter.set_trigger_delay(delay);
            }
            Measure::TriggerDelay(limit) => return Ok(Some(self.meter.trigger_delay(limit))),
            Measure::TriggerDelayAuto => return yes_no(self.meter.trigger_delay_is_auto()),
            Measure::SetField(field, on) => {
                let fields = &mut self.meter.form.fields;
                if on {
                    fields.insert(field);
                } else {
                    fields.remove(&field);
                }
            }
            Measure::Field(field) => return yes_no(self.meter.form.fields.contains(&field)),
            Measure::SetAbsoluteTime(absolute) => self.meter.form.absolute = absolute,
            Measure::AbsoluteTime => return Ok(Some(time_word(self.meter.form.absolute))),
        }
        Ok(None)
    }

    pub(crate) fn obey_functions(&mut self, functions: Functions, turn: &mut Turn<'_>) -> Reply {
        match functions {
            Functions::Configure(wanted, channels) => {
                self.wait_for_measurement(turn)?;
                let meter = &mut self.meter;
                let channels = meter.configure_function(&self.relays, wanted, &channels)?;
                self.configured(channels, turn);
            }
            Functions::Measure(wanted, channels) => {
                self.wait_for_measurement(turn)?;
                let meter = &mut self.meter;
                let set_up = meter.configure_function(&self.relays, wanted, &channels)?;
                self.configured(set_up, turn);
                return self.read_once(channels.is_some(), turn);
            }
            Functions::Select(function, channels) => {
                self.wait_for_measurement(turn)?;
                let channels = self.meter.select(&self.relays, function, &channels)?;
                self.configured(channels, turn);
            }
            Functions::Selected(channels) => {
                return self.meter.selected(&self.relays, &channels).map(Some);
            }
            Functions::Set(function, detail, given, channels) => {
                self.wait_for_measurement(turn)?;
                let of = (function, detail);
                let channels = self.meter.set_detail(&self.relays, of, given, &channels)?;
                self.configured(channels, turn);
            }
            Functions::Ask(function, detail, limit, channels) => {
                let of = (function, detail);
                let answer = self.meter.detail(&self.relays, of, limit, &channels);
                return answer.map(Some);
            }
        }
        Ok(None)
    }

    /// The last reading of one channel, or of the voltmeter alone, with every field and the time of day; zeros if there
    /// is none (help: DATA:LAST?).
    fn last_reading(&self, channel: Option<&ChannelList>, turn: &Turn<'_>) -> Reply {
        let channel = match channel {
            None => None,
            Some(list) => match self.relays.expand(list)?[..] {
                [only] => Some(only),
                _ => return Err(ParseError::ParameterNotAllowed.into()),
            },
        };
        Ok(Some(match self.meter.memory().last(channel, turn.now) {
            Some(reading) => Form::whole().write([reading], &self.calendar),
            None => "0,0,0,0,0,0,0,0,0".to_owned(),
        }))
    }

    /// The readings of MEAS?.
    fn read_once(&mut self, scans: bool, turn: &mut Turn<'_>) -> Reply {
        let meter = &mut self.meter;
        let end = meter.read_once(scans, turn.now, &mut self.relays, turn.wires)?;
        self.answer_readings(end, turn)
    }

    fn read(&mut self, list: &[Relay], turn: &mut Turn<'_>) -> Reply {
        let end = self
            .meter
            .read(list, turn.now, &mut self.relays, turn.wires)?;
        self.answer_readings(end, turn)
    }

    fn answer_readings(&mut self, end: Duration, turn: &mut Turn<'_>) -> Reply {
        turn.now = end;
        if self.deferring && turn.last {
            self.defer(turn.session, end);
            return Ok(None);
        }
        self.meter.take_ahead(end, &mut self.relays, turn.wires);
        let readings = self.meter.memory().read(end);
        Ok(Some(self.meter.form.write(readings, &self.calendar)))
    }
}
