//! How one channel is set up, and what follows from it: integration, delay, time, resolution (section 5).

use std::time::Duration;

use scpi::{Numeric, ParseError, format_nr3_signed};

use super::trouble::Trouble;
use crate::command::{INTEGRATION, Quantity, RANGES, Range, Setting};

/// Readings a second that the voltmeter alone can take (section 5).
const READINGS_PER_SECOND: f64 = 3000.0;
const WIDEST: f64 = RANGES[RANGES.len() - 1];

/// How one channel, or the bare voltmeter, is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Setup {
    pub(super) range: Range,
    nplc: f64,
    /// s.
    aperture: f64,
    aperture_enabled: bool,
    /// `None`: automatic.
    delay: Option<f64>,
    autozero: bool,
    input_auto: bool,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
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
    /// As CONF leaves a channel.
    pub(super) fn configured(range: Range, resolution: Option<Numeric>) -> Result<Self, Trouble> {
        let nplc = match resolution {
            Some(resolution) => integration_for(range, resolution)?,
            None => 1.0,
        };
        Ok(Self {
            range,
            nplc,
            ..Self::default()
        })
    }

    /// Integration, power-line cycles.
    pub(super) fn cycles(&self, line_hz: f64) -> f64 {
        if self.aperture_enabled {
            self.aperture * line_hz
        } else {
            self.nplc
        }
    }

    /// Delay before a scanned reading, s: 1 ms up to 1 cycle, 2 ms above, unless it is set.
    fn delay(&self, line_hz: f64) -> f64 {
        let automatic = if self.cycles(line_hz) <= 1.0 {
            1e-3
        } else {
            2e-3
        };
        self.delay.unwrap_or(automatic)
    }

    /// Time of one reading: for a channel the larger of 1/rate and 1/rate - 0.02 PLC + integration, and its delay
    /// (section 9).
    pub(super) fn period(&self, rate: Option<u32>, line_hz: f64) -> Duration {
        let zero = if self.autozero { 2.0 } else { 1.0 };
        let integration = zero * self.cycles(line_hz) / line_hz;
        let seconds = match rate {
            Some(rate) => {
                let shortest = 1.0 / f64::from(rate);
                shortest.max(shortest - 0.02 / line_hz + integration) + self.delay(line_hz)
            }
            None => integration.max(1.0 / READINGS_PER_SECOND),
        };
        Duration::from_secs_f64(seconds)
    }

    pub(super) fn change(&mut self, setting: Setting, line_hz: f64) -> Result<(), Trouble> {
        match setting {
            Setting::Range(range) => self.range = range,
            Setting::RangeAuto(true) => self.range = Range::Auto,
            // The range that it had is not known before it has measured; the widest loses nothing.
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
            Setting::InputAuto(on) => self.input_auto = on,
            Setting::Delay(delay) => self.delay = Some(delay),
            Setting::DelayAuto(true) => self.delay = None,
            Setting::DelayAuto(false) => self.delay = Some(self.delay(line_hz)),
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
        let cycles = self.cycles(line_hz);
        // The resolution of a time between two is that of the shorter.
        let fraction = INTEGRATION
            .into_iter()
            .rev()
            .find(|(nplc, _)| *nplc <= cycles)
            .map_or(1e-4, |(_, fraction)| fraction);
        fraction * self.fixed_range()
    }

    /// Answers a query for one setting, or for a limit of it.
    pub(super) fn answer(
        &self,
        quantity: Quantity,
        limit: Option<Numeric>,
        line_hz: f64,
    ) -> Result<String, Trouble> {
        let range = self.fixed_range();
        let (value, [least, most, default]) = match quantity {
            Quantity::Range => (range, [RANGES[0], WIDEST, WIDEST]),
            Quantity::Nplc => (self.nplc, [0.02, 200.0, 1.0]),
            Quantity::Aperture => (self.aperture, [300e-6, 1.0, 1.0]),
            Quantity::Resolution => (
                self.resolution(line_hz),
                [3e-7 * range, 1e-4 * range, 3e-6 * range],
            ),
            Quantity::Delay => (self.delay(line_hz), [0.0, 60.0, 0.0]),
            Quantity::RangeAuto => return yes_no(self.range == Range::Auto, limit),
            Quantity::ApertureEnabled => return yes_no(self.aperture_enabled, limit),
            Quantity::Autozero => return yes_no(self.autozero, limit),
            Quantity::InputAuto => return yes_no(self.input_auto, limit),
            Quantity::DelayAuto => return yes_no(self.delay.is_none(), limit),
        };
        let value = match limit {
            None => value,
            Some(Numeric::Min) => least,
            Some(Numeric::Max) => most,
            Some(_) => default,
        };
        Ok(format_nr3_signed(value, 8))
    }

    /// As CONF? answers it.
    pub(super) fn configuration(&self, line_hz: f64) -> String {
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

fn yes_no(yes: bool, limit: Option<Numeric>) -> Result<String, Trouble> {
    match limit {
        None => Ok(u8::from(yes).to_string()),
        Some(_) => Err(ParseError::IllegalParameter.into()),
    }
}

/// The shortest integration whose resolution suffices.
fn integration_for(range: Range, resolution: Numeric) -> Result<f64, Trouble> {
    let Range::Fixed(range) = range else {
        // A resolution in volts means nothing while the range is not fixed.
        return Err(ParseError::SettingsConflict.into());
    };
    // MIN is the smallest value, that is the finest; one coarser than any is the coarsest.
    let asked = match resolution {
        Numeric::Value(value) => value.abs(),
        Numeric::Min => 3e-7 * range,
        Numeric::Max => 1e-4 * range,
        Numeric::Def => 3e-6 * range,
        _ => return Err(ParseError::OutOfRange.into()),
    };
    INTEGRATION
        .into_iter()
        // The last digit of a value given in decimals must not cost a step.
        .find(|(_, fraction)| fraction * range <= asked * (1.0 + 1e-9))
        .map(|(nplc, _)| nplc)
        .ok_or(ParseError::OutOfRange.into())
}
