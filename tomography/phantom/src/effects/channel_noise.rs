//! Noisy channels: a loose terminal, a worn contact, or an electrode's wire with pickup.
//!
//! n ~ N(0, s²) on each reading through a named channel, in addition to the voltmeter's noise; a noisy wire affects the
//! two channels that share its electrode. A fault, absent from a healthy rig; its size is arbitrary.

use std::collections::BTreeMap;

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use survey::{Relay, Volts};

use super::bounds::{Bounds, Fault, Parameters};
use super::{Effect, Effects, OnReading, SheetResponse, stream};
use crate::scan::ReadingContext;

/// Which channels are noisy, and how much.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelNoiseSettings {
    /// Channel numbers of the mainframe.
    pub channels: Vec<u32>,
    /// Rms of one reading, uV.
    #[serde(default = "uv")]
    pub uv: f64,
}

fn uv() -> f64 {
    50.0
}

impl Default for ChannelNoiseSettings {
    /// The first channel of the first slot.
    fn default() -> Self {
        Self {
            channels: vec![1001],
            uv: uv(),
        }
    }
}

impl Parameters for ChannelNoiseSettings {
    fn check(&self) -> Result<(), Fault> {
        Bounds::new().within("uv", self.uv, [0.0, 1e6], "uV").end()
    }
}

impl Effect for ChannelNoiseSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| {
            let noisy = (sight.context.relay).is_some_and(|relay| self.channels.contains(&relay.0));
            if noisy { self.uv * 1e-6 } else { 0.0 }
        })
    }

    fn assumes(&self) -> Option<String> {
        Some(format!("channels {:?}", self.channels))
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        let channels = self.channels.iter().map(|channel| {
            let own = stream(seed, &format!("channel-noise {channel}"));
            (Relay(*channel), own)
        });
        effects.readings.push(Box::new(ChannelNoise {
            volts: self.uv * 1e-6,
            channels: channels.collect(),
        }));
    }
}

#[derive(Debug)]
pub(super) struct ChannelNoise {
    volts: f64,
    /// One random stream per channel, so that the numbers do not depend on the order of readings.
    channels: BTreeMap<Relay, ChaCha8Rng>,
}

impl OnReading for ChannelNoise {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        let own = context
            .relay
            .and_then(|relay| self.channels.get_mut(&relay));
        match own {
            None => volts,
            Some(own) => {
                let draw: f64 = StandardNormal.sample(own);
                Volts(volts.0 + self.volts * draw)
            }
        }
    }
}
