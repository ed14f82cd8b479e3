//! A frame's steps as data: counted, timed, printed and checked before a relay moves.

mod limits;
mod ranges;
mod step;
mod timing;

use std::fmt;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{Amps, Dipole, Protocol, Relay, Sensing, Transition, Volts, Wiring, WiringError};

pub use limits::{Limits, PlanError, RelayLimits, SourceLimits};
pub use ranges::{RangeRule, Resolution};
pub use step::{Channel, Routed, Step};
pub use timing::{Counts, Timing};

/// The steps of one frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// The measurements, in the order of the frame's readings.
    pub protocol: Protocol,
    /// The relays.
    pub wiring: Wiring,
    /// Injected current.
    pub current: Amps,
    /// Voltage limit of the source.
    pub compliance: Volts,
    /// Settling time after the current is switched or reversed.
    pub settle: Duration,
    /// Whether every injection is read with both polarities; a reading is half the difference.
    pub reversal: bool,
    /// Whether the source stays at 0 A, to read offset and noise.
    pub zero: bool,
    /// The steps in order; the first and the last are [`Step::AllOff`].
    pub steps: Vec<Step>,
}

/// The current applied to the sheet, and how.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Injection {
    /// Injected current.
    pub current: Amps,
    /// Voltage limit of the source.
    pub compliance: Volts,
    /// Settling time after the current is switched or reversed.
    pub settle: Duration,
    /// Read every injection with both polarities: cancels thermal EMFs and leakage, takes twice as long.
    pub reversal: bool,
}

impl Plan {
    /// Expands a protocol over a wiring, without reversal.
    ///
    /// # Errors
    /// A wiring that is faulty, is for another number of electrodes, or cannot serve a pair of the protocol.
    pub fn new(
        protocol: &Protocol,
        wiring: &Wiring,
        current: Amps,
        compliance: Volts,
        settle: Duration,
    ) -> Result<Self, PlanError> {
        let injection = Injection {
            current,
            compliance,
            settle,
            reversal: false,
        };
        Self::injecting(protocol, wiring, injection)
    }

    /// Expands a protocol over a wiring.
    ///
    /// If the protocol has all pairs that do not touch an injection, the scan also takes those that do: its channel
    /// list then never changes, and the extra readings serve the contact and loop-sum checks. If the protocol has fewer
    /// pairs (a half frame), only those are scanned.
    ///
    /// # Errors
    /// As [`Plan::new`].
    pub fn injecting(
        protocol: &Protocol,
        wiring: &Wiring,
        injection: Injection,
    ) -> Result<Self, PlanError> {
        wiring.check()?;
        if wiring.electrodes != protocol.electrodes() {
            return Err(PlanError::Wiring(WiringError::Electrodes {
                wiring: wiring.name.clone(),
                wired: wiring.electrodes,
                requested: protocol.electrodes(),
            }));
        }
        let mut steps = vec![Step::AllOff];
        if !wiring.bus.is_empty() {
            steps.push(Step::Bus {
                close: wiring.bus.clone(),
            });
        }
        let settle = Step::Settle {
            wait: injection.settle,
        };
        let mut driven: Vec<Relay> = Vec::new();
        let mut routed: Vec<Relay> = Vec::new();
        for drive in protocol.drives() {
            let close = wiring
                .injecting(drive)
                .ok_or_else(|| unserved(wiring, drive, "source"))?
                .to_vec();
            let open = std::mem::replace(&mut driven, close.clone());
            steps.push(
                if open.is_empty() || wiring.transition == Transition::Break {
                    Step::Break { drive, open, close }
                } else {
                    Step::Overlap { drive, close, open }
                },
            );
            for turned in [false, true] {
                if turned && !injection.reversal {
                    break;
                }
                if turned {
                    steps.push(Step::Reverse { drive });
                }
                if !injection.settle.is_zero() {
                    steps.push(settle.clone());
                }
                steps.extend(read(protocol, wiring, drive, &mut routed)?);
                steps.push(Step::Compliance { drive });
            }
        }
        steps.push(Step::AllOff);
        Ok(Self {
            protocol: protocol.clone(),
            wiring: wiring.clone(),
            current: injection.current,
            compliance: injection.compliance,
            settle: injection.settle,
            reversal: injection.reversal,
            zero: false,
            steps,
        })
    }

    /// The same frame with the source on at 0 A throughout and the same relays: reads offset and noise. Ranges stay,
    /// since offsets depend on the range; nothing is reversed.
    #[must_use]
    pub fn at_zero_current(&self) -> Self {
        let mut turned = false;
        let steps = self
            .steps
            .iter()
            .filter(|step| {
                let drop = turned || matches!(step, Step::Reverse { .. });
                turned = drop && !matches!(step, Step::Compliance { .. });
                !drop
            })
            .cloned()
            .collect();
        Self {
            steps,
            zero: true,
            reversal: false,
            ..self.clone()
        }
    }
}

/// The steps that read one injection. `routed`: relays left closed by the previous steps.
fn read(
    protocol: &Protocol,
    wiring: &Wiring,
    drive: Dipole,
    routed: &mut Vec<Relay>,
) -> Result<Vec<Step>, PlanError> {
    let senses: Vec<(usize, Dipole)> = protocol
        .measurements()
        .iter()
        .enumerate()
        .filter(|(_, measurement)| measurement.drive == drive)
        .map(|(reading, measurement)| (reading, measurement.sense))
        .collect();
    let relays = |sense| {
        wiring
            .measuring(sense)
            .ok_or_else(|| unserved(wiring, sense, "voltmeter"))
    };
    if wiring.sensing == Sensing::Scan {
        for (_, sense) in &senses {
            relays(*sense)?;
        }
        let channels: Vec<Channel> = wiring
            .measure
            .iter()
            .flat_map(|(sense, relays)| relays.iter().map(move |relay| (*sense, *relay)))
            .map(|(sense, relay)| Channel {
                relay,
                sense,
                reading: senses
                    .iter()
                    .find(|(_, other)| *other == sense)
                    .map(|(reading, _)| *reading),
                range: None,
            })
            .collect();
        let whole = channels
            .iter()
            .all(|channel| channel.reading.is_some() || channel.sense.touches(drive));
        let channels = channels
            .into_iter()
            .filter(|channel| whole || channel.reading.is_some())
            .collect();
        return Ok(vec![Step::Scan { channels }]);
    }
    let mut routes = Vec::with_capacity(senses.len());
    for (reading, sense) in senses {
        let close = relays(sense)?.to_vec();
        let open = std::mem::replace(routed, close.clone());
        routes.push(Routed {
            sense,
            open,
            close,
            reading,
            range: None,
        });
    }
    if wiring.sensing == Sensing::Chain {
        return Ok(vec![Step::Chain { routes }]);
    }
    let single = |route: Routed| {
        let Routed {
            sense,
            open,
            close,
            reading,
            range,
        } = route;
        [
            Step::Route { sense, open, close },
            Step::Read { reading, range },
        ]
    };
    Ok(routes.into_iter().flat_map(single).collect())
}

fn unserved(wiring: &Wiring, pair: Dipole, to: &'static str) -> WiringError {
    WiringError::Unserved {
        wiring: wiring.name.clone(),
        pair,
        to,
    }
}

impl fmt::Display for Plan {
    /// One numbered line for each step.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, step) in self.steps.iter().enumerate() {
            writeln!(f, "{:>5}  {step}", index + 1)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wiring::examples;

    fn limits() -> Limits {
        let source = SourceLimits {
            current: Amps(0.105),
            compliance: (Volts(0.1), Volts(105.0)),
        };
        let relay = |current, voltage| RelayLimits {
            current: Amps(current),
            voltage: Volts(voltage),
        };
        Limits::of(source, [relay(1.0, 150.0), relay(0.05, 300.0)])
    }

    fn plan(wiring: &Wiring) -> Plan {
        Plan::new(
            &Protocol::sheffield(26).unwrap(),
            wiring,
            Amps(1e-3),
            Volts(10.0),
            Duration::ZERO,
        )
        .unwrap()
    }

    #[test]
    fn pair_wiring_needs_26_queries_and_a_matrix_598() {
        let pairs = plan(&examples::pairs(26));
        let counts = pairs.counts();
        assert_eq!((counts.injections, counts.readings), (26, 598));
        assert_eq!((counts.extra_readings, counts.reading_messages), (78, 26));
        let matrix = plan(&examples::matrix(26));
        assert_eq!(matrix.counts().reading_messages, 598);
        for plan in [&pairs, &matrix, &plan(&examples::board(26))] {
            assert_eq!(plan.counts().readings, 598);
            assert_eq!(
                plan.check(&Limits {
                    relay_voltage: Volts(10.0),
                    ..limits()
                }),
                Ok(())
            );
            assert_eq!(plan.steps.first(), Some(&Step::AllOff));
            assert_eq!(plan.steps.last(), Some(&Step::AllOff));
            assert_eq!(plan.to_string().lines().count(), plan.steps.len());
        }
    }

    #[test]
    fn limits_refuse_and_name_both_numbers() {
        let mut plan = plan(&examples::pairs(26));
        plan.current = Amps(0.06);
        plan.compliance = Volts(200.0);
        let faults = plan.check(&limits()).unwrap_err();
        assert_eq!(faults.len(), 3, "{faults:?}");
        assert!(faults[0].to_string().contains("60 mA is over the 50 mA"));
    }

    #[test]
    fn a_wiring_for_another_ring_is_refused() {
        let refusal = Plan::new(
            &Protocol::sheffield(16).unwrap(),
            &examples::pairs(26),
            Amps(1e-3),
            Volts(10.0),
            Duration::ZERO,
        )
        .unwrap_err();
        assert!(
            refusal
                .to_string()
                .contains("26 electrodes, the protocol has 16"),
            "{refusal}"
        );
    }
}
