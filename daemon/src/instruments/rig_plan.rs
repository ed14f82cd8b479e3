//! The plan of a frame, and the instruments that it uses.

use std::collections::BTreeMap;
use std::time::Duration;

use rig::MeterSettings;
use survey::{Limits, Plan, RangeRule, Relay, Settings, Step, Timing};

use crate::instruments::address::InstrumentAddress;
use crate::instruments::simulation::{Profile, Scene};
use config::EnableName;

/// A plan of a frame, and the instruments that execute it.
#[derive(Clone)]
pub(crate) struct RigPlan {
    pub plan: Plan,
    pub limits: Limits,
    pub timing: Timing,
    pub meter: MeterSettings,
    /// Rule for individual ranges, if readings have them.
    pub ranges: Option<RangeRule>,
    /// Number of frames that are corrected by one zero-current frame; `None` without correction.
    pub zero_every: Option<u64>,
    /// Electrodes skipped between the two of a pair.
    pub skip: usize,
    /// Whether only one of two reciprocal readings is taken.
    pub half: bool,
    /// The required modules by slot; none with a multiplexer board.
    pub modules: BTreeMap<u32, keysight_34980a::Module>,
    pub instruments: InstrumentAddresses,
    pub simulation: Option<(Profile, Scene)>,
}

impl RigPlan {
    /// The settings that its frames carry.
    pub(crate) fn settings(&self) -> Settings {
        let mut settings = rig::settings(&self.plan, self.meter);
        settings.precautions.zeroed = self.zero_every.is_some();
        settings
    }

    /// How often the steps are executed for each frame, on average: a zero-current frame has the same steps, and is
    /// used for `zero_every` frames.
    fn runs_per_frame(&self) -> f64 {
        1.0 + self.zero_every.map_or(0.0, |every| 1.0 / every as f64)
    }

    /// Mean time of a frame without a pause, with its share of a zero-current frame.
    pub(crate) fn mean_duration(&self) -> Duration {
        let frame = self.plan.duration(&self.timing);
        survey::duration(frame.as_secs_f64() * self.runs_per_frame())
    }

    /// Mean number of closures of each relay of the wiring for a frame, including the frame's share of a zero-current
    /// frame. A relay of a scanned channel closes once in each of the scans that are averaged.
    pub(crate) fn closures(&self) -> Vec<(Relay, f64)> {
        let wiring = &self.plan.wiring;
        let relays = wiring.relays().into_iter();
        let mut closures: Vec<(Relay, f64)> = relays.map(|relay| (relay, 0.0)).collect();
        let runs = self.runs_per_frame();
        let mut count = |closed: &[Relay], times: u32| {
            for (relay, closures) in &mut closures {
                if closed.contains(relay) {
                    *closures += runs * f64::from(times);
                }
            }
        };
        for step in &self.plan.steps {
            match step {
                Step::Bus { close }
                | Step::Break { close, .. }
                | Step::Overlap { close, .. }
                | Step::Route { close, .. } => count(close, 1),
                Step::Scan { channels } => {
                    let relays: Vec<Relay> = channels.iter().map(|channel| channel.relay).collect();
                    count(&relays, self.meter.averages);
                }
                Step::Chain { routes } => {
                    routes.iter().for_each(|route| count(&route.close, 1));
                }
                _ => {}
            }
        }
        closures
    }

    /// Whether a multiplexer board switches, and the mainframe only measures.
    pub(crate) fn has_board(&self) -> bool {
        self.modules.is_empty()
    }
}

/// Addresses of the instruments, and their reply timeouts.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct InstrumentAddresses {
    pub source: (InstrumentAddress, Duration),
    pub switch: (InstrumentAddress, Duration),
    pub voltmeter: (InstrumentAddress, Duration),
    /// For a board on a gpiochip.
    pub enable: EnableName,
}
