//! Functions other than DC volts: settings of a channel, time of a reading, and the value of a reading.
//!
//! A resistance is the voltage at the voltmeter's terminals, or on bus 2, while its test current flows, divided by that
//! current: the circuit's own voltages are included, unless offset compensation removes them. Nothing is connected to
//! the current inputs, so that currents are zero. Test currents, automatic delays and the reading of a counter without
//! a signal are those of the similar 34970A; they are not in the fact sheet.

use std::time::Duration;

use scpi::{Numeric, ParseError, format_nr3_signed};
use survey::{Amps, Relay, Volts};

use crate::command::{
    Detail, FREQUENCIES, Function, MeasurementRequest, Range, SettingValue, ValueKind, value_kind,
};
use crate::simulator::errors::QueuedError;
use crate::simulator::measurement::setup::{Timing, at, integration_for, resolution_of};
use crate::simulator::measurement::temperature;
use crate::simulator::{MeterRequest, Wires};

/// Overrange as a factor of the range (section 5).
pub(crate) const OVER_RANGE: f64 = 1.2;
/// Smallest signal of a counter, as a fraction of its voltage range.
const LEAST_SIGNAL: f64 = 0.1;
/// Temperature of a terminal block, degrees Celsius.
const AMBIENT_C: f64 = 23.0;

/// Settings of one function on one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FunctionSettings {
    pub(crate) function: Function,
    range: Range,
    nplc: f64,
    aperture: f64,
    aperture_enabled: bool,
    bandwidth: f64,
    compensated: bool,
    pub(crate) probe: &'static str,
    couple: &'static str,
    junction_source: &'static str,
    junction: f64,
    check: bool,
    rtd: f64,
    rtd_ohms: f64,
    rtd_compensated: bool,
    thermistor: f64,
    degrees: &'static str,
}

impl FunctionSettings {
    /// The settings after `*RST`.
    pub(crate) fn new(function: Function) -> Self {
        let counts = matches!(function, Function::Frequency | Function::Period);
        Self {
            function,
            range: Range::Auto,
            nplc: 1.0,
            aperture: if counts { 0.1 } else { 1.0 },
            aperture_enabled: false,
            bandwidth: 20.0,
            compensated: false,
            probe: "TC",
            couple: "J",
            junction_source: "FIX",
            junction: 0.0,
            check: false,
            rtd: 85.0,
            rtd_ohms: 100.0,
            rtd_compensated: false,
            thermistor: 5000.0,
            degrees: "C",
        }
    }

    /// The same settings for the related function: two- and four-wire resistance share their settings.
    pub(crate) fn measuring(self, function: Function) -> Self {
        Self { function, ..self }
    }

    /// The settings after CONF; the unit of temperatures stays.
    pub(crate) fn configured(self, request: MeasurementRequest) -> Result<Self, QueuedError> {
        let mut settings = Self {
            range: request.range,
            degrees: self.degrees,
            ..Self::new(request.function)
        };
        if let Some((probe, kind)) = request.probe {
            settings.probe = probe;
            let number = kind.parse().unwrap_or(0.0);
            match probe {
                "TC" => settings.couple = kind,
                "THER" => settings.thermistor = number,
                _ => settings.rtd = number,
            }
        }
        match request.resolution {
            Some(resolution) if settings.has(Detail::Resolution) => {
                settings.nplc = integration_for(settings.range, resolution)?;
            }
            _ => {}
        }
        Ok(settings)
    }

    fn has(&self, detail: Detail) -> bool {
        value_kind(self.function, detail).is_some()
    }

    /// Whether the voltage is sensed on bus 2, through the channel's partner in the other bank.
    pub(crate) fn four_wire(&self) -> bool {
        match self.function {
            Function::FourWire => true,
            Function::Temperature => self.probe == "FRTD",
            _ => false,
        }
    }

    /// The unit that follows a reading.
    pub(crate) fn mark(&self) -> &'static str {
        match self.function {
            Function::Temperature => self.degrees,
            function => function.mark(),
        }
    }

    pub(crate) fn change(
        &mut self,
        detail: Detail,
        value: SettingValue,
    ) -> Result<(), QueuedError> {
        match (detail, value) {
            (Detail::Range, SettingValue::Range(range)) => self.range = range,
            (Detail::RangeAuto, SettingValue::Switch(true)) => self.range = Range::Auto,
            (Detail::RangeAuto, SettingValue::Switch(false)) => {
                self.range = Range::Fixed(self.fixed_range());
            }
            (Detail::Nplc, SettingValue::Number(nplc)) => {
                self.nplc = nplc;
                self.aperture_enabled = false;
            }
            (Detail::Aperture, SettingValue::Number(seconds)) => {
                // Integrating functions store steps of 4 us.
                self.aperture = (seconds / 4e-6).round() * 4.0 / 1e6;
                self.aperture_enabled = self.function.integrates();
            }
            (Detail::ApertureEnabled, SettingValue::Switch(on)) => self.aperture_enabled = on,
            (Detail::Resolution, SettingValue::Resolution(resolution)) => {
                let range = Range::Fixed(self.fixed_range());
                self.nplc = integration_for(range, resolution)?;
                self.aperture_enabled = false;
            }
            (Detail::Bandwidth, SettingValue::Number(hertz)) => self.bandwidth = hertz,
            (Detail::Compensated, SettingValue::Switch(on)) => self.compensated = on,
            (Detail::Probe, SettingValue::Word(probe)) => self.probe = probe,
            (Detail::Couple, SettingValue::Word(couple)) => self.couple = couple,
            (Detail::JunctionSource, SettingValue::Word(source)) => self.junction_source = source,
            (Detail::Junction, SettingValue::Number(degrees)) => self.junction = degrees,
            (Detail::CoupleCheck, SettingValue::Switch(on)) => self.check = on,
            (Detail::Rtd, SettingValue::Number(kind)) => self.rtd = kind,
            (Detail::RtdOhms, SettingValue::Number(ohms)) => self.rtd_ohms = ohms,
            (Detail::RtdCompensated, SettingValue::Switch(on)) => self.rtd_compensated = on,
            (Detail::Thermistor, SettingValue::Number(kind)) => self.thermistor = kind,
            (Detail::Degrees, SettingValue::Word(degrees)) => self.degrees = degrees,
            // autozero is a setting of the channel, not of a function; the grammar yields no other combination
            _ => return Err(ParseError::SettingsConflict.into()),
        }
        Ok(())
    }

    fn fixed_range(&self) -> f64 {
        match self.range {
            Range::Fixed(range) => range,
            Range::Auto => self.function.ranges().last().copied().unwrap_or(1.0),
        }
    }

    /// Integration time, power-line cycles.
    pub(crate) fn cycles(&self, line_hz: f64) -> f64 {
        if self.aperture_enabled {
            self.aperture * line_hz
        } else {
            self.nplc
        }
    }

    /// Reply to a query for one setting, or for a limit of it.
    pub(crate) fn answer(
        &self,
        detail: Detail,
        limit: Option<Numeric>,
        line_hz: f64,
    ) -> Result<String, QueuedError> {
        let ranges = self.function.ranges();
        let word = |text: &str| match limit {
            None => Ok(text.to_owned()),
            Some(_) => Err(ParseError::IllegalParameter.into()),
        };
        let switch = |on: bool| word(if on { "1" } else { "0" });
        let value = match detail {
            Detail::RangeAuto => return switch(self.range == Range::Auto),
            Detail::ApertureEnabled => return switch(self.aperture_enabled),
            Detail::Compensated => return switch(self.compensated),
            Detail::CoupleCheck => return switch(self.check),
            Detail::RtdCompensated => return switch(self.rtd_compensated),
            Detail::Probe => return word(self.probe),
            Detail::Couple => return word(self.couple),
            Detail::JunctionSource => return word(self.junction_source),
            Detail::Degrees => return word(self.degrees),
            // autozero is a setting of the channel, which replies to this query
            Detail::Autozero => return Err(ParseError::SettingsConflict.into()),
            Detail::Range => self.fixed_range(),
            Detail::Nplc => self.nplc,
            Detail::Aperture => self.aperture,
            Detail::Bandwidth => self.bandwidth,
            Detail::Junction => self.junction,
            Detail::Rtd => self.rtd,
            Detail::RtdOhms => self.rtd_ohms,
            Detail::Thermistor => self.thermistor,
            Detail::Resolution => resolution_of(self.cycles(line_hz), self.fixed_range()),
        };
        let limits = match (detail, value_kind(self.function, detail)) {
            (Detail::Range, _) => {
                let [least, most] = [ranges.first(), ranges.last()].map(|end| *end.unwrap_or(&0.0));
                [least, most, most]
            }
            (Detail::Resolution, _) => [3e-7, 1e-4, 3e-6].map(|part| part * self.fixed_range()),
            (_, Some(ValueKind::Number(_, limits))) => limits,
            (
                _,
                Some(ValueKind::Step(_, steps, default)) | Some(ValueKind::OneOf(steps, default)),
            ) => [steps[0], steps[steps.len() - 1], default],
            _ => [value; 3],
        };
        let reported = at(limit, value, limits);
        // Numbers from a short list are reported as integers.
        Ok(match detail {
            Detail::Bandwidth | Detail::Rtd | Detail::Thermistor => format!("{reported:+.0}"),
            _ => format_nr3_signed(reported, 8),
        })
    }

    /// The reply to CONF?.
    pub(crate) fn configuration(&self, line_hz: f64) -> String {
        let word = self.function.word();
        let numbers = |range: f64, resolution: f64| {
            let [range, resolution] = [range, resolution].map(|value| format_nr3_signed(value, 6));
            format!("\"{word} {range},{resolution}\"")
        };
        let resolution = |range| match self.function.integrates() {
            true => resolution_of(self.cycles(line_hz), range),
            false => 1e-6 * range,
        };
        match (self.function, self.range) {
            (Function::Temperature, _) => match self.probe {
                "TC" => format!("\"TEMP TC,{}\"", self.couple),
                "THER" => format!("\"TEMP THER,{:.0}\"", self.thermistor),
                probe => format!("\"TEMP {probe},{:.0}\"", self.rtd),
            },
            (Function::Frequency | Function::Period, _) => format!("\"{word}\""),
            (_, Range::Fixed(range)) => numbers(range, resolution(range)),
            (_, Range::Auto) => format!("\"{word} AUTO\""),
        }
    }

    /// Time of a reading.
    pub(crate) fn timing(&self, line_hz: f64) -> Timing {
        let slow = self.cycles(line_hz) > 1.0;
        let by_filter = |times: [f64; 3]| match self.bandwidth {
            3.0 => times[0],
            20.0 => times[1],
            _ => times[2],
        };
        let (seconds, zero_too, delay) = match self.function {
            Function::AcVolts | Function::AcCurrent => {
                (1.0 / line_hz, false, by_filter([7.0, 1.0, 0.12]))
            }
            Function::Frequency | Function::Period => {
                (self.aperture, false, by_filter([0.6, 0.3, 0.1]))
            }
            Function::Resistance | Function::FourWire => {
                let delay = match self.fixed_range() {
                    range if range <= 1e4 || self.range == Range::Auto => [1e-3, 2e-3],
                    1e5 => [20e-3, 25e-3],
                    1e6 => [25e-3, 30e-3],
                    _ => [200e-3, 200e-3],
                };
                let times = if self.compensated { 2.0 } else { 1.0 };
                let seconds = times * self.cycles(line_hz) / line_hz;
                (seconds, true, delay[usize::from(slow)])
            }
            Function::DcVolts | Function::DcCurrent | Function::Temperature => {
                let seconds = self.cycles(line_hz) / line_hz;
                (seconds, true, if slow { 2e-3 } else { 1e-3 })
            }
        };
        Timing {
            seconds,
            zero_too,
            delay,
        }
    }

    /// One reading; infinite, with its sign, for an overload.
    pub(crate) fn reading(
        &self,
        channel: Option<Relay>,
        nplc: f64,
        at: Duration,
        wires: &mut dyn Wires,
    ) -> f64 {
        let volts = |range: f64| MeterRequest {
            nplc,
            ..MeterRequest::volts(channel, Volts(range))
        };
        match self.function {
            Function::DcVolts => dc_volts(self.range, channel, nplc, at, wires),
            Function::AcVolts => self.ranged(|range| wires.alternating(at, volts(range)).rms.0),
            Function::DcCurrent | Function::AcCurrent => 0.0,
            Function::Resistance | Function::FourWire => {
                self.ranged(|range| self.ohms(range, self.compensated, channel, nplc, at, wires))
            }
            Function::Frequency | Function::Period => {
                let range = match self.range {
                    Range::Fixed(range) => range,
                    Range::Auto => self.function.ranges()[0],
                };
                let [lowest, highest] = FREQUENCIES;
                let signal = wires.alternating(at, volts(range));
                let received = signal.rms.0 >= LEAST_SIGNAL * range
                    && (lowest..=highest).contains(&signal.hertz);
                match self.function {
                    _ if !received => 0.0,
                    Function::Period => 1.0 / signal.hertz,
                    _ => signal.hertz,
                }
            }
            Function::Temperature => {
                let celsius = self.celsius(channel, nplc, at, wires);
                match self.degrees {
                    "F" => celsius * 1.8 + 32.0,
                    "K" => celsius + 273.15,
                    _ => celsius,
                }
            }
        }
    }

    fn ranged(&self, measure: impl FnMut(f64) -> f64) -> f64 {
        ranged(self.function, self.range, measure)
    }

    fn ohms(
        &self,
        range: f64,
        compensated: bool,
        channel: Option<Relay>,
        nplc: f64,
        at: Duration,
        wires: &mut dyn Wires,
    ) -> f64 {
        let test = test_current(range);
        let mut with = |test_current: Amps| {
            let request = MeterRequest {
                nplc,
                test_current,
                four_wire: self.four_wire(),
                ..MeterRequest::volts(channel, Volts(if range > 1e5 { 10.0 } else { 1.0 }))
            };
            wires.measure(at, request).0
        };
        let offset = if compensated { with(Amps(0.0)) } else { 0.0 };
        (with(test) - offset) / test.0
    }

    fn celsius(
        &self,
        channel: Option<Relay>,
        nplc: f64,
        at: Duration,
        wires: &mut dyn Wires,
    ) -> f64 {
        let range = match self.probe {
            "TC" => {
                let request = MeterRequest {
                    nplc,
                    ..MeterRequest::volts(channel, Volts(0.1))
                };
                let Volts(volts) = wires.measure(at, request);
                let junction = match self.junction_source {
                    "FIX" => self.junction,
                    _ => AMBIENT_C,
                };
                return temperature::of_couple(self.couple, volts, junction);
            }
            "THER" => 1e5,
            _ => 1e3,
        };
        let ohms = self.ohms(range, self.rtd_compensated, channel, nplc, at, wires);
        match self.probe {
            "THER" => temperature::of_thermistor(self.thermistor, ohms),
            _ => temperature::of_rtd(self.rtd, self.rtd_ohms, ohms),
        }
    }
}

/// A reading of DC volts; infinite, with its sign, for an overload.
pub(crate) fn dc_volts(
    range: Range,
    channel: Option<Relay>,
    nplc: f64,
    at: Duration,
    wires: &mut dyn Wires,
) -> f64 {
    ranged(Function::DcVolts, range, |range| {
        let request = MeterRequest {
            nplc,
            ..MeterRequest::volts(channel, Volts(range))
        };
        wires.measure(at, request).0
    })
}

/// The value measured on the fixed range; with autorange on the smallest range that holds the value measured on the
/// largest.
fn ranged(function: Function, range: Range, mut measure: impl FnMut(f64) -> f64) -> f64 {
    let mut on = |range: f64| over(measure(range), range * OVER_RANGE);
    match range {
        Range::Fixed(range) => on(range),
        Range::Auto => {
            let ranges = function.ranges();
            let widest = ranges.last().copied().unwrap_or(1.0);
            let probe = on(widest);
            let fits = ranges
                .iter()
                .find(|range| probe.abs() <= *range * OVER_RANGE);
            match fits {
                Some(range) if *range < widest => on(*range),
                _ => probe,
            }
        }
    }
}

/// Infinite, with its sign, if a value exceeds its limit.
fn over(value: f64, limit: f64) -> f64 {
    if value.abs() <= limit {
        value
    } else if value < 0.0 {
        f64::NEG_INFINITY
    } else {
        f64::INFINITY
    }
}

/// The test current of a resistance range.
fn test_current(range: f64) -> Amps {
    Amps(match range {
        range if range <= 1e3 => 1e-3,
        range if range <= 1e4 => 1e-4,
        range if range <= 1e5 => 1e-5,
        range if range <= 1e6 => 5e-6,
        _ => 5e-7,
    })
}
