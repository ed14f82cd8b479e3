//! Frames like those of a rig: 598 readings with means in a range of 4,700 : 1, 2 uV rms of noise, jitter in the times.
//! The same seed gives the same frames.

use std::time::Duration;

use chrono::{DateTime, Utc};
use survey::{Amps, Frame, Protocol, Reading, Settings, Volts};

/// The digits that the voltmeter sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Digits {
    /// Steps of 0.1 uV, as on a range of 1 V.
    Tenths,
    /// Nine varying digits at any magnitude.
    Nine,
}

/// Noise of one reading, V rms.
pub const NOISE: f64 = 2e-6;

/// Makes frames.
pub struct Rig {
    protocol: Protocol,
    settings: Settings,
    digits: Digits,
    state: u64,
}

impl Rig {
    pub fn new(digits: Digits, seed: u64) -> Self {
        let protocol = Protocol::sheffield(26).expect("26 electrodes");
        Self {
            settings: Settings {
                precautions: survey::Precautions::default(),
                protocol_hash: protocol.hash(),
                current: Amps(1e-3),
                range: Volts(1.0),
                nplc: 1.0,
                settle: Duration::from_millis(2),
                wiring: "pairs".into(),
            },
            protocol,
            digits,
            state: seed,
        }
    }

    pub fn protocol(&self) -> &Protocol {
        &self.protocol
    }

    /// Approximately normal, without a dependency: sum of twelve uniform numbers.
    fn noise(&mut self) -> f64 {
        let mut uniform = || {
            self.state = self
                .state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (self.state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }

    pub fn frame(&mut self, number: u64) -> Frame {
        let readings = (0..self.protocol.len())
            .map(|k| {
                let mean = 0.309 * 4700_f64.powf(-((k * 7919 % 598) as f64) / 597.0);
                let volts = mean + NOISE * self.noise();
                let sent = match self.digits {
                    Digits::Tenths => format!("{:.0}e-7", volts * 1e7),
                    Digits::Nine => format!("{volts:.8e}"),
                };
                Reading::Ok(Volts(sent.parse().expect("a number")))
            })
            .collect();
        let mut late = || Duration::from_micros((3000.0 * self.noise().abs()) as u64);
        let begun = Duration::from_secs(number) + late();
        Frame {
            extra: Vec::new(),
            sequence: number,
            readings,
            monotonic: begun,
            wall: at(0) + begun + late(),
            duration: Duration::from_millis(900) + late(),
            settings: self.settings.clone(),
            compliance: Vec::new(),
            simulated: true,
        }
    }
}

pub fn at(second: i64) -> DateTime<Utc> {
    DateTime::from_timestamp(1_800_000_000 + second, 0).expect("a time in range")
}
