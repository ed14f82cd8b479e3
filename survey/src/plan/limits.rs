//! Limits of a rig, reasons why a plan is refused, and the check of a plan against the limits.

use serde::{Deserialize, Serialize};

use super::{Plan, Step};
use crate::{Amps, Relay, Volts, WiringError};

/// The settings that a source allows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SourceLimits {
    /// Largest current.
    pub current: Amps,
    /// Smallest and largest compliance.
    pub compliance: (Volts, Volts),
}

/// The ratings of a relay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelayLimits {
    /// Largest current through it, closed.
    pub current: Amps,
    /// Largest voltage over it, open.
    pub voltage: Volts,
}

/// The limits of a rig: the smallest over source, switch modules and settings. The drivers measure DC volts only, so a
/// voltmeter that is joined to the driven pair never shorts the source.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Limits {
    /// Largest current of the source.
    pub source_current: Amps,
    /// Range of compliance that the source can be set to.
    pub source_compliance: (Volts, Volts),
    /// Largest current through a closed relay.
    pub relay_current: Amps,
    /// Largest voltage over an open relay.
    pub relay_voltage: Volts,
}

impl Limits {
    /// The limits of a source behind relays: the smallest that any of them allows.
    pub fn of(source: SourceLimits, relays: impl IntoIterator<Item = RelayLimits>) -> Self {
        let unlimited = Self {
            source_current: source.current,
            source_compliance: source.compliance,
            relay_current: Amps(f64::INFINITY),
            relay_voltage: Volts(f64::INFINITY),
        };
        relays.into_iter().fold(unlimited, |least, next| Self {
            relay_current: Amps(least.relay_current.0.min(next.current.0)),
            relay_voltage: Volts(least.relay_voltage.0.min(next.voltage.0)),
            ..least
        })
    }
}

/// Why a plan cannot be made, or must not be run.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The wiring is unusable or does not fit the protocol.
    #[error(transparent)]
    Wiring(#[from] WiringError),
    /// Current not a positive number.
    #[error("a current of {0} cannot be injected; give a positive one")]
    NotACurrent(Amps),
    /// Over the source's limit.
    #[error("a current of {requested} is over the source's maximum of {most}; set a smaller one")]
    SourceCurrent {
        /// Requested.
        requested: Amps,
        /// Allowed.
        most: Amps,
    },
    /// Over the relays' limit.
    #[error(
        "a current of {requested} is over the {most} that a relay of this wiring carries; set a smaller one"
    )]
    RelayCurrent {
        /// Requested.
        requested: Amps,
        /// Allowed.
        most: Amps,
    },
    /// Compliance outside the source's range.
    #[error(
        "a compliance of {requested} is outside the source's range of {least} to {most}; set one within it"
    )]
    Compliance {
        /// Requested.
        requested: Volts,
        /// Smallest.
        least: Volts,
        /// Largest.
        most: Volts,
    },
    /// Compliance over what an open relay withstands.
    #[error(
        "a compliance of {requested} is over the {most} that an open relay of this wiring withstands; set a smaller one"
    )]
    RelayVoltage {
        /// Requested.
        requested: Volts,
        /// Allowed.
        most: Volts,
    },
    /// More or fewer than one injecting pair closed while the source is on.
    #[error(
        "step {step}: {closed} injecting pairs are closed while the source is on and a reading is taken"
    )]
    InjectingPairs {
        /// Number of the step, from 1.
        step: usize,
        /// Number of closed injecting pairs.
        closed: usize,
    },
}
impl Plan {
    /// Checks the plan against the rig's limits, and its steps against the rules of the wiring.
    ///
    /// # Errors
    /// Every fault found, in order.
    pub fn check(&self, limits: &Limits) -> Result<(), Vec<PlanError>> {
        let mut faults = Vec::new();
        if !(self.current.0 > 0.0 && self.current.0.is_finite()) {
            faults.push(PlanError::NotACurrent(self.current));
        }
        if self.current > limits.source_current {
            faults.push(PlanError::SourceCurrent {
                requested: self.current,
                most: limits.source_current,
            });
        }
        if self.current > limits.relay_current {
            faults.push(PlanError::RelayCurrent {
                requested: self.current,
                most: limits.relay_current,
            });
        }
        let (least, most) = limits.source_compliance;
        if !(self.compliance >= least && self.compliance <= most) {
            faults.push(PlanError::Compliance {
                requested: self.compliance,
                least,
                most,
            });
        }
        if self.compliance > limits.relay_voltage {
            faults.push(PlanError::RelayVoltage {
                requested: self.compliance,
                most: limits.relay_voltage,
            });
        }
        self.check_steps(&mut faults);
        if faults.is_empty() {
            Ok(())
        } else {
            Err(faults)
        }
    }

    /// Checks the injecting relays that are closed at each step.
    fn check_steps(&self, faults: &mut Vec<PlanError>) {
        let mut closed: Vec<Relay> = Vec::new();
        for (number, step) in self
            .steps
            .iter()
            .enumerate()
            .map(|(index, step)| (index + 1, step))
        {
            match step {
                Step::AllOff => closed.clear(),
                Step::Break { open, close, .. } | Step::Overlap { open, close, .. } => {
                    closed.retain(|relay| !open.contains(relay));
                    closed.extend(close);
                }
                Step::Scan { .. } | Step::Read { .. } | Step::Chain { .. } => {
                    let pairs = self
                        .wiring
                        .inject
                        .iter()
                        .filter(|(_, relays)| relays.iter().all(|relay| closed.contains(relay)))
                        .count();
                    if pairs != 1 {
                        faults.push(PlanError::InjectingPairs {
                            step: number,
                            closed: pairs,
                        });
                    }
                }
                Step::Route { .. }
                | Step::Bus { .. }
                | Step::Settle { .. }
                | Step::Reverse { .. }
                | Step::Compliance { .. } => {}
            }
        }
    }
}
