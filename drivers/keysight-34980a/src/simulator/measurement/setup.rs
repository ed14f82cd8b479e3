//! Settings of one channel, and the integration, delay, time and resolution that result from them (section 5).

use std::time::Duration;

use scpi::{Numeric, ParseError, format_nr3_signed};

use crate::command::{Function, Quantity, Range, Setting};
use crate::meter::{INTEGRATION, RANGES};
use crate::simulator::errors::QueuedError;

/// Readings a second of the voltmeter alone (section 5).
const READINGS_PER_SECOND: f64 = 3000.0;
const WIDEST: f64 = RANGES[RANGES.len() - 1];

/// Times of a reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Timing {
    /// Integration time or gate time, s.
    pub(crate) seconds: f64,
    /// Whether autozero doubles that time.
    pub(crate) zero_too: bool,
    /// Automatic channel delay, s.
    pub(crate) delay: f64,
}

/// Settings of one channel, or of the bare voltmeter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Setup {
    pub(crate) function: Function,
    /// The range for DC volts. All further fields except delay and autozero are also for DC volts.
    pub(crate) range: Range,
    nplc: f64,
    /// Integration time, s; used if `aperture_enabled`.
    aperture: f64,
    aperture_enabled: bool,
    /// Delay before a scanned reading, s; `None`: automatic.
    delay: Option<f64>,
    autozero: bool,
    input_auto: bool,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            function: Function::DcVolts,
            range: Range::Auto,
            nplc: 1.0,
            aperture: 1.0,
            aperture_enabled: false,
            delay: None,
            autozero: true,
            input_auto: false,
        }
    }
}

impl Setup {
    /// The settings after CONF.
    pub(crate) fn configured(
        range: Range,
        resolution: Option<Numeric>,
    ) -> Result<Self, QueuedError> {
        let nplc = match resolution {
            Some(resolution) => integration_for(range, resolution)?,
            None => 1.0,
        };
        let mut setup = Self {
            range,
            nplc,
            ..Self::default()
        };
        setup.without_zero_below_a_cycle(nplc);
        Ok(setup)
    }

    /// Switches autozero off if the integration time is set below one power-line cycle, as the instrument does
    /// (section 5); returns whether it is below.
    pub(crate) fn without_zero_below_a_cycle(&mut self, cycles: f64) -> bool {
        let below = cycles < 1.0;
        self.autozero &= !below;
        below
    }

    /// The same settings for another function.
    pub(crate) fn measuring(self, function: Function) -> Self {
        Self { function, ..self }
    }

    /// Integration time, power-line cycles.
    pub(crate) fn cycles(&self, line_hz: f64) -> f64 {
        if self.aperture_enabled {
            self.aperture * line_hz
        } else {
            self.nplc
        }
    }

    /// The times of a DC voltage reading: automatic delay of 1 ms up to 1 cycle, 2 ms above.
    pub(crate) fn timing(&self, line_hz: f64) -> Timing {
        let cycles = self.cycles(line_hz);
        Timing {
            seconds: cycles / line_hz,
            zero_too: true,
            delay: if cycles <= 1.0 { 1e-3 } else { 2e-3 },
        }
    }

    /// Delay before a scanned reading, s.
    fn delay(&self, timing: Timing) -> f64 {
        self.delay.unwrap_or(timing.delay)
    }

    /// Time of one reading: for a channel the larger of 1/rate and 1/rate - 0.02 PLC + integration, and its delay
    /// (section 9).
    pub(crate) fn period(&self, timing: Timing, rate: Option<u32>, line_hz: f64) -> Duration {
        let zero = if self.autozero && timing.zero_too {
            2.0
        } else {
            1.0
        };
        let integration = zero * timing.seconds;
        let seconds = match rate {
            Some(rate) => {
                let shortest = 1.0 / f64::from(rate);
                shortest.max(shortest - 0.02 / line_hz + integration) + self.delay(timing)
            }
            None => integration.max(1.0 / READINGS_PER_SECOND),
        };
        survey::duration(seconds)
    }

    /// Changes one setting. `timing` is that of the channel's function.
    pub(crate) fn change(
        &mut self,
        setting: Setting,
        timing: Timing,
        line_hz: f64,
    ) -> Result<(), QueuedError> {
        match setting {
            Setting::Range(range) => self.range = range,
            Setting::RangeAuto(true) => self.range = Range::Auto,
            // the range in use is not known before a measurement; no reading overflows the largest one
            Setting::RangeAuto(false) => self.range = Range::Fixed(self.fixed_range()),
            Setting::Nplc(nplc) => {
                self.nplc = nplc;
                self.aperture_enabled = false;
            }
            Setting::Aperture(aperture) => {
                self.aperture = aperture;
                self.aperture_enabled = true;
            }
            Setting::ApertureEnabled(on) => self.aperture_enabled = on,
            Setting::Resolution(resolution) => {
                self.nplc = integration_for(Range::Fixed(self.fixed_range()), resolution)?;
                self.aperture_enabled = false;
            }
            Setting::Autozero(on) => self.autozero = on,
            Setting::AutozeroOnce => self.autozero = false,
            Setting::InputAuto(on) => self.input_auto = on,
            Setting::Delay(delay) => self.delay = Some(delay),
            Setting::DelayAuto(true) => self.delay = None,
            Setting::DelayAuto(false) => self.delay = Some(self.delay(timing)),
        }
        if matches!(
            setting.quantity(),
            Quantity::Nplc | Quantity::Aperture | Quantity::ApertureEnabled | Quantity::Resolution
        ) {
            self.without_zero_below_a_cycle(self.cycles(line_hz));
        }
        Ok(())
    }

    fn fixed_range(&self) -> f64 {
        match self.range {
            Range::Fixed(range) => range,
            Range::Auto => WIDEST,
        }
    }

    fn resolution(&self, line_hz: f64) -> f64 {
        resolution_of(self.cycles(line_hz), self.fixed_range())
    }

    /// Reply to a query for one setting, or for a limit of it.
    pub(crate) fn answer(
        &self,
        quantity: Quantity,
        limit: Option<Numeric>,
        line_hz: f64,
        timing: Timing,
    ) -> Result<String, QueuedError> {
        let range = self.fixed_range();
        let (value, limits) = match quantity {
            Quantity::Range => (range, [RANGES[0], WIDEST, WIDEST]),
            Quantity::Nplc => (self.nplc, [0.02, 200.0, 1.0]),
            Quantity::Aperture => (self.aperture, [300e-6, 1.0, 1.0]),
            Quantity::Resolution => (
                self.resolution(line_hz),
                [3e-7 * range, 1e-4 * range, 3e-6 * range],
            ),
            Quantity::Delay => (self.delay(timing), [0.0, 60.0, 0.0]),
            Quantity::RangeAuto => return yes_no(self.range == Range::Auto, limit),
            Quantity::ApertureEnabled => return yes_no(self.aperture_enabled, limit),
            Quantity::Autozero => return yes_no(self.autozero, limit),
            Quantity::InputAuto => return yes_no(self.input_auto, limit),
            Quantity::DelayAuto => return yes_no(self.delay.is_none(), limit),
        };
        Ok(format_nr3_signed(at(limit, value, limits), 8))
    }

    /// The reply to CONF?.
    pub(crate) fn configuration(&self, line_hz: f64) -> String {
        match self.range {
            Range::Fixed(range) => format!(
                "\"VOLT {},{}\"",
                format_nr3_signed(range, 6),
                format_nr3_signed(self.resolution(line_hz), 6)
            ),
            Range::Auto => "\"VOLT AUTO\"".to_owned(),
        }
    }
}

/// What a query with MIN, MAX or DEF replies: the least, the most or the default value; without them the present one.
pub(crate) fn at<T>(limit: Option<Numeric>, now: T, [least, most, default]: [T; 3]) -> T {
    match limit {
        None => now,
        Some(Numeric::Min) => least,
        Some(Numeric::Max) => most,
        Some(_) => default,
    }
}

fn yes_no(yes: bool, limit: Option<Numeric>) -> Result<String, QueuedError> {
    match limit {
        None => Ok(u8::from(yes).to_string()),
        Some(_) => Err(ParseError::IllegalParameter.into()),
    }
}

/// Resolution for an integration time in power-line cycles; between two listed times the resolution of the shorter.
pub(crate) fn resolution_of(cycles: f64, range: f64) -> f64 {
    let fraction = INTEGRATION
        .into_iter()
        .rev()
        .find(|(nplc, _)| *nplc <= cycles)
        .map_or(1e-4, |(_, fraction)| fraction);
    fraction * range
}

/// The shortest integration time with a sufficient resolution.
pub(crate) fn integration_for(range: Range, resolution: Numeric) -> Result<f64, QueuedError> {
    let Range::Fixed(range) = range else {
        // A resolution in volts is undefined while the range is not fixed.
        return Err(ParseError::SettingsConflict.into());
    };
    // MIN is the finest resolution; a value coarser than every available resolution selects the coarsest
    let requested = match resolution {
        Numeric::Value(value) => value.abs(),
        Numeric::Min => 3e-7 * range,
        Numeric::Max => 1e-4 * range,
        Numeric::Def => 3e-6 * range,
        _ => return Err(ParseError::OutOfRange.into()),
    };
    INTEGRATION
        .into_iter()
        // a rounding error in the last digit of the value must not change the result
        .find(|(_, fraction)| fraction * range <= requested * (1.0 + 1e-9))
        .map(|(nplc, _)| nplc)
        .ok_or(ParseError::OutOfRange.into())
}
