//! Mains pickup in the leads: the mean of a sin(2 pi f t + phase) and its third harmonic over the integration time.
//!
//! The mean of a sine over T = NPLC / f_line is a sinc(f T). It is zero if f T is a whole number, which requires at
//! least one cycle and the nominal mains frequency: the rejection is 60 dB at +-0.1 %, 40 dB at +-1 %, and none below
//! one cycle (fact sheet, section 2.1). The phase is derived from the reading's time.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

use survey::Volts;

use super::bounds::parameters;
use super::{Effect, Effects, OnReading, SheetResponse};
use crate::scan::ReadingContext;

parameters! {
    /// Mains voltage at the voltmeter.
    MainsPickupSettings {
        /// Amplitude of the fundamental, mV.
        mv = 0.1, in [0.0, 1e3], "mV";
        /// Amplitude of the third harmonic as a share of the fundamental's.
        third = 0.2, in [0.0, 1.0];
        /// Nominal mains frequency, which defines the voltmeter's cycles, Hz.
        line_hz = 50.0, in [45.0, 440.0], "Hz";
        /// Deviation of the mains from the nominal frequency, %.
        off_percent = 0.05, in [-5.0, 5.0], "%";
    }
}

impl Effect for MainsPickupSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        // all phases are equally likely, so the rms of a sine is its amplitude over the root of two
        let time = response.scan().integration().as_secs_f64();
        let mains = self.line_hz * (1.0 + self.off_percent / 100.0);
        let both = kept(mains, time).hypot(self.third * kept(3.0 * mains, time));
        self.mv * 1e-3 * both * FRAC_1_SQRT_2
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(self.clone()));
    }
}

/// Factor of a sine's amplitude by averaging over `time`, s.
fn kept(hz: f64, time: f64) -> f64 {
    let half = PI * hz * time;
    if half == 0.0 { 1.0 } else { half.sin() / half }
}

impl OnReading for MainsPickupSettings {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        let Self {
            mv,
            third,
            line_hz,
            off_percent,
        } = *self;
        let time = context.integration.as_secs_f64();
        let mains = line_hz * (1.0 + off_percent / 100.0);
        let middle = context.at.as_secs_f64() - 0.5 * time;
        let mean = |hz: f64| (2.0 * PI * hz * middle).sin() * kept(hz, time);
        Volts(volts.0 + mv * 1e-3 * (mean(mains) + third * mean(3.0 * mains)))
    }
}

#[cfg(test)]
mod tests {

    use super::super::tests::context;
    use super::*;

    fn rms(off_percent: f64, nplc: f64) -> f64 {
        let mut pickup = MainsPickupSettings {
            mv: 1.0,
            third: 0.0,
            off_percent,
            ..Default::default()
        };
        let sum: f64 = (0..1000)
            .map(|k| {
                let at = survey::duration(k as f64 * 0.123_456_7);
                let context = ReadingContext {
                    at,
                    ..context(1.0, nplc)
                };
                pickup.bend(Volts(0.0), &context).0.powi(2)
            })
            .sum();
        (sum / 1000.0).sqrt() / (1e-3 / 2.0_f64.sqrt())
    }

    #[test]
    fn whole_cycles_reject_mains_as_in_the_manual() {
        let decibel = |share: f64| -20.0 * share.log10();
        assert!((decibel(rms(0.1, 1.0)) - 60.0).abs() < 1.0);
        assert!((decibel(rms(1.0, 1.0)) - 40.0).abs() < 1.0);
        assert!(decibel(rms(0.0, 0.2)) < 1.0);
        assert!(decibel(rms(0.0, 2.0)) > 200.0);
    }
}
