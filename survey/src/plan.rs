//! A frame's steps as data: counted, timed, printed and checked before a relay moves.

use std::fmt;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{Amps, Dipole, Protocol, Relay, Sensing, Volts, Wiring, WiringError};

/// How the current gets to the next pair. The wiring chooses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Transition {
    /// Source to 0 A, open the last, close the next, source on.
    Break,
    /// Close the next pair, then open the last, source on all the while: it is never open-circuit, for a moment shorted.
    Overlap,
}

/// One step of a frame. Stopping is something done between steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "step")]
pub enum Step {
    /// Source to 0 A and off, read back; every injecting and measuring relay open. The first and the last step.
    AllOff,
    /// Close relays that stay closed for the whole frame.
    Bus {
        /// To close.
        close: Vec<Relay>,
    },
    /// Source to 0 A, open the last pair, close the next, source on at the plan's current.
    Break {
        /// Where the current goes.
        drive: Dipole,
        /// Relays of the last pair.
        open: Vec<Relay>,
        /// Relays of this pair.
        close: Vec<Relay>,
    },
    /// Close the next pair, then open the last, source on.
    Overlap {
        /// Where the current goes.
        drive: Dipole,
        /// Relays of this pair.
        close: Vec<Relay>,
        /// Relays of the last pair.
        open: Vec<Relay>,
    },
    /// Wait for sheet and source.
    Settle {
        /// How long.
        wait: Duration,
    },
    /// The voltmeter scans every measuring pair of the wiring, in the wiring's order.
    Scan {
        /// For each measuring pair the index of its reading in the frame; `None` where the protocol does not ask.
        readings: Vec<Option<usize>>,
    },
    /// Join another pair to the voltmeter: open, then close.
    Route {
        /// The pair.
        sense: Dipole,
        /// Relays of the last pair.
        open: Vec<Relay>,
        /// Relays of this pair.
        close: Vec<Relay>,
    },
    /// Read the routed pair once.
    Read {
        /// Index of the reading in the frame.
        reading: usize,
    },
    /// Ask the source whether it was in compliance; if so this injection's readings are not measured.
    Compliance {
        /// The injection asked about.
        drive: Dipole,
    },
}

/// What a rig allows: the smallest over source, switch modules and settings.
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
    /// Whether the voltmeter is set to measure current: then it is a short, and must never meet the source's pair.
    pub meter_on_current_range: bool,
}

impl Limits {
    /// A 6221 behind the in-rush resistors of a 34924A: 105 mA and 0.1 to 105 V from the source, 50 mA and 150 V
    /// through the relays.
    pub const REED: Self = Self {
        source_current: Amps(0.105),
        source_compliance: (Volts(0.1), Volts(105.0)),
        relay_current: Amps(0.05),
        relay_voltage: Volts(150.0),
        meter_on_current_range: false,
    };

    /// A 6221 behind the armature relays of a 34932A: 1 A, 300 V.
    pub const ARMATURE: Self = Self {
        relay_current: Amps(1.0),
        relay_voltage: Volts(300.0),
        ..Self::REED
    };

    /// A 6221 behind a CD74HC4067 board on 5 V: 25 mA, compliance half a volt below the supply.
    pub const GPIO_BOARD_5V: Self = Self {
        relay_current: Amps(0.025),
        relay_voltage: Volts(4.5),
        ..Self::REED
    };
}

/// What the instruments cost in time, for [`Plan::duration`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// Closing of a relay.
    pub relay_close: Duration,
    /// Opening of a relay.
    pub relay_open: Duration,
    /// Shortest time from channel to channel in a scan.
    pub scan_period: Duration,
    /// Shortest time of a single reading.
    pub reading_period: Duration,
    /// Integration, power-line cycles.
    pub nplc: f64,
    /// Mains frequency, Hz.
    pub line_hz: f64,
    /// Whether every reading is followed by a zero reading.
    pub autozero: bool,
    /// Delay before each scanned channel.
    pub channel_delay: Duration,
    /// One message there and its answer back.
    pub round_trip: Duration,
}

impl Timing {
    /// A 34924A: 0.5 ms relays, 500 channels a second, 3,000 readings a second, autozero off.
    pub fn reed(nplc: f64, line_hz: f64) -> Self {
        Self {
            relay_close: Duration::from_micros(500),
            relay_open: Duration::from_micros(500),
            scan_period: Duration::from_millis(2),
            reading_period: Duration::from_secs_f64(1.0 / 3000.0),
            nplc,
            line_hz,
            autozero: false,
            channel_delay: Duration::ZERO,
            round_trip: Duration::ZERO,
        }
    }

    /// A 34932A: 4 ms armature relays.
    pub fn armature(nplc: f64, line_hz: f64) -> Self {
        Self {
            relay_close: Duration::from_millis(4),
            relay_open: Duration::from_millis(4),
            scan_period: Duration::from_millis(10),
            ..Self::reed(nplc, line_hz)
        }
    }

    /// A multiplexer board: the chips need no time worth counting, its serial line 1.5 ms a message.
    pub fn gpio_board(nplc: f64, line_hz: f64) -> Self {
        Self {
            relay_close: Duration::ZERO,
            relay_open: Duration::ZERO,
            round_trip: Duration::from_micros(1500),
            ..Self::reed(nplc, line_hz)
        }
    }

    /// Integration of one reading, s.
    fn integration(&self) -> f64 {
        let zero = if self.autozero { 2.0 } else { 1.0 };
        zero * self.nplc / self.line_hz
    }

    /// One scanned channel, s: the larger of 1/rate and 1/rate - 0.02 PLC + integration, plus the channel delay.
    fn scanned(&self) -> f64 {
        let period = self.scan_period.as_secs_f64();
        let slow = period - 0.02 / self.line_hz + self.integration();
        period.max(slow) + self.channel_delay.as_secs_f64()
    }

    /// One single reading, s.
    fn single(&self) -> f64 {
        self.integration().max(self.reading_period.as_secs_f64())
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
    #[error("{asked} is over the source's {most}; nothing is clipped, ask for less")]
    SourceCurrent {
        /// Asked.
        asked: Amps,
        /// Allowed.
        most: Amps,
    },
    /// Over the relays' limit.
    #[error("{asked} is over the {most} that a relay of this wiring carries; ask for less")]
    RelayCurrent {
        /// Asked.
        asked: Amps,
        /// Allowed.
        most: Amps,
    },
    /// Compliance outside the source's range.
    #[error("a compliance of {asked} is outside the source's {least} to {most}")]
    Compliance {
        /// Asked.
        asked: Volts,
        /// Smallest.
        least: Volts,
        /// Largest.
        most: Volts,
    },
    /// Compliance over what an open relay withstands.
    #[error(
        "a compliance of {asked} is over the {most} that an open relay of this wiring withstands"
    )]
    RelayVoltage {
        /// Asked.
        asked: Volts,
        /// Allowed.
        most: Volts,
    },
    /// The voltmeter, on a current range, would short the source.
    #[error(
        "step {step}: pair {pair} is joined to the source and to the voltmeter on a current range, which shorts the source"
    )]
    MeterShortsSource {
        /// Number of the step, from 1.
        step: usize,
        /// The pair.
        pair: Dipole,
    },
    /// More or fewer than one injecting pair closed while the source is on.
    #[error(
        "step {step}: {closed} injecting pairs are closed while the source is on and a reading is taken"
    )]
    InjectingPairs {
        /// Number of the step, from 1.
        step: usize,
        /// How many.
        closed: usize,
    },
}

/// The steps of one frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// The questions, whose order the frame's readings have.
    pub protocol: Protocol,
    /// The relays.
    pub wiring: Wiring,
    /// Injected current.
    pub current: Amps,
    /// Voltage limit of the source.
    pub compliance: Volts,
    /// The steps in order; the first and the last are [`Step::AllOff`].
    pub steps: Vec<Step>,
}

/// How much a plan does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Steps.
    pub steps: usize,
    /// Injections.
    pub injections: usize,
    /// Relays opened or closed by the plan itself (a scan's own are not counted).
    pub relay_moves: usize,
    /// Readings kept.
    pub readings: usize,
    /// Readings that the scan takes beside them.
    pub extra_readings: usize,
    /// Messages that ask the voltmeter for readings.
    pub reading_messages: usize,
}

impl Plan {
    /// Expands a protocol over a wiring.
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
        wiring.check()?;
        if wiring.electrodes != protocol.electrodes() {
            return Err(PlanError::Wiring(WiringError::Electrodes {
                wiring: wiring.name.clone(),
                wired: wiring.electrodes,
                asked: protocol.electrodes(),
            }));
        }
        let unserved = |pair, to| WiringError::Unserved {
            wiring: wiring.name.clone(),
            pair,
            to,
        };
        let mut steps = vec![Step::AllOff];
        if !wiring.bus.is_empty() {
            steps.push(Step::Bus {
                close: wiring.bus.clone(),
            });
        }
        let mut driven: Vec<Relay> = Vec::new();
        let mut routed: Vec<Relay> = Vec::new();
        for drive in protocol.drives() {
            let close = wiring
                .injecting(drive)
                .ok_or_else(|| unserved(drive, "source"))?
                .to_vec();
            let open = std::mem::replace(&mut driven, close.clone());
            steps.push(
                if open.is_empty() || wiring.transition == Transition::Break {
                    Step::Break { drive, open, close }
                } else {
                    Step::Overlap { drive, close, open }
                },
            );
            if !settle.is_zero() {
                steps.push(Step::Settle { wait: settle });
            }
            let asked: Vec<(usize, Dipole)> = protocol
                .measurements()
                .iter()
                .enumerate()
                .filter(|(_, question)| question.drive == drive)
                .map(|(reading, question)| (reading, question.sense))
                .collect();
            for (_, sense) in &asked {
                wiring
                    .measuring(*sense)
                    .ok_or_else(|| unserved(*sense, "voltmeter"))?;
            }
            match wiring.sensing {
                Sensing::Scan => steps.push(Step::Scan {
                    readings: wiring
                        .measure
                        .iter()
                        .map(|(pair, _)| {
                            asked
                                .iter()
                                .find(|(_, sense)| sense == pair)
                                .map(|(reading, _)| *reading)
                        })
                        .collect(),
                }),
                Sensing::Single => {
                    for (reading, sense) in asked {
                        let close = wiring
                            .measuring(sense)
                            .ok_or_else(|| unserved(sense, "voltmeter"))?
                            .to_vec();
                        let open = std::mem::replace(&mut routed, close.clone());
                        steps.push(Step::Route { sense, open, close });
                        steps.push(Step::Read { reading });
                    }
                }
            }
            steps.push(Step::Compliance { drive });
        }
        steps.push(Step::AllOff);
        Ok(Self {
            protocol: protocol.clone(),
            wiring: wiring.clone(),
            current,
            compliance,
            steps,
        })
    }

    /// Checks the plan against what the rig allows, and its own steps against the rules of the wiring.
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
                asked: self.current,
                most: limits.source_current,
            });
        }
        if self.current > limits.relay_current {
            faults.push(PlanError::RelayCurrent {
                asked: self.current,
                most: limits.relay_current,
            });
        }
        let (least, most) = limits.source_compliance;
        if !(self.compliance >= least && self.compliance <= most) {
            faults.push(PlanError::Compliance {
                asked: self.compliance,
                least,
                most,
            });
        }
        if self.compliance > limits.relay_voltage {
            faults.push(PlanError::RelayVoltage {
                asked: self.compliance,
                most: limits.relay_voltage,
            });
        }
        self.check_steps(limits, &mut faults);
        if faults.is_empty() {
            Ok(())
        } else {
            Err(faults)
        }
    }

    /// Follows the injecting relays through the steps.
    fn check_steps(&self, limits: &Limits, faults: &mut Vec<PlanError>) {
        let mut closed: Vec<Relay> = Vec::new();
        let mut driven: Option<Dipole> = None;
        let mut routed: Option<Dipole> = None;
        for (number, step) in self
            .steps
            .iter()
            .enumerate()
            .map(|(index, step)| (index + 1, step))
        {
            match step {
                Step::AllOff => {
                    closed.clear();
                    driven = None;
                }
                Step::Break { drive, open, close } | Step::Overlap { drive, open, close } => {
                    closed.retain(|relay| !open.contains(relay));
                    closed.extend(close);
                    driven = Some(*drive);
                }
                Step::Route { sense, .. } => routed = Some(*sense),
                Step::Scan { .. } | Step::Read { .. } => {
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
                    if let Some(pair) = driven.filter(|_| limits.meter_on_current_range) {
                        let meets = match step {
                            Step::Scan { .. } => self.wiring.measuring(pair).is_some(),
                            _ => routed == Some(pair),
                        };
                        if meets {
                            faults.push(PlanError::MeterShortsSource { step: number, pair });
                        }
                    }
                }
                Step::Bus { .. } | Step::Settle { .. } | Step::Compliance { .. } => {}
            }
        }
    }

    /// How much the plan does.
    pub fn counts(&self) -> Counts {
        let mut counts = Counts {
            steps: self.steps.len(),
            injections: 0,
            relay_moves: 0,
            readings: 0,
            extra_readings: 0,
            reading_messages: 0,
        };
        for step in &self.steps {
            match step {
                Step::AllOff | Step::Settle { .. } | Step::Compliance { .. } => {}
                Step::Bus { close } => counts.relay_moves += close.len(),
                Step::Break { open, close, .. } | Step::Overlap { open, close, .. } => {
                    counts.injections += 1;
                    counts.relay_moves += open.len() + close.len();
                }
                Step::Route { open, close, .. } => counts.relay_moves += open.len() + close.len(),
                Step::Scan { readings } => {
                    let kept = readings.iter().flatten().count();
                    counts.readings += kept;
                    counts.extra_readings += readings.len() - kept;
                    counts.reading_messages += 1;
                }
                Step::Read { .. } => {
                    counts.readings += 1;
                    counts.reading_messages += 1;
                }
            }
        }
        counts
    }

    /// How long the instruments need for a frame (`instruments/keysight-34980a.md` section 9, plus round trips).
    pub fn duration(&self, timing: &Timing) -> Duration {
        let close = timing.relay_close.as_secs_f64();
        let open = timing.relay_open.as_secs_f64();
        let round_trip = timing.round_trip.as_secs_f64();
        let seconds: f64 = self
            .steps
            .iter()
            .map(|step| match step {
                Step::AllOff => open,
                Step::Bus { .. } => close,
                Step::Break { open: last, .. } | Step::Overlap { open: last, .. } => {
                    close + if last.is_empty() { 0.0 } else { open }
                }
                Step::Settle { wait } => wait.as_secs_f64(),
                Step::Scan { readings } => readings.len() as f64 * timing.scanned() + round_trip,
                Step::Route { open: last, .. } => close + if last.is_empty() { 0.0 } else { open },
                Step::Read { .. } => timing.single() + round_trip,
                Step::Compliance { .. } => round_trip,
            })
            .sum();
        Duration::from_secs_f64(seconds)
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |relays: &[Relay]| {
            if relays.is_empty() {
                return "none".to_owned();
            }
            relays
                .iter()
                .map(Relay::to_string)
                .collect::<Vec<_>>()
                .join(",")
        };
        match self {
            Self::AllOff => write!(f, "all off: source 0 A and off, read back; relays open"),
            Self::Bus { close } => write!(f, "bus: close {}", list(close)),
            Self::Break { drive, open, close } => write!(
                f,
                "break to {drive}: 0 A, open {}, close {}, source on",
                list(open),
                list(close)
            ),
            Self::Overlap { drive, close, open } => write!(
                f,
                "overlap to {drive}: close {}, open {}, source on",
                list(close),
                list(open)
            ),
            Self::Settle { wait } => write!(f, "settle {wait:?}"),
            Self::Scan { readings } => write!(
                f,
                "scan {} pairs, {} of them asked",
                readings.len(),
                readings.iter().flatten().count()
            ),
            Self::Route { sense, open, close } => write!(
                f,
                "route {sense}: open {}, close {}",
                list(open),
                list(close)
            ),
            Self::Read { reading } => write!(f, "read m{reading}"),
            Self::Compliance { drive } => write!(f, "ask the source about compliance at {drive}"),
        }
    }
}

impl fmt::Display for Plan {
    /// One numbered line a step.
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
    fn pair_wiring_asks_26_times_and_a_matrix_598_times() {
        let pairs = plan(&Wiring::pairs_34924a(1, 26).unwrap());
        let counts = pairs.counts();
        assert_eq!((counts.injections, counts.readings), (26, 598));
        assert_eq!((counts.extra_readings, counts.reading_messages), (78, 26));
        let matrix = plan(&Wiring::matrix_34932a(1, 26).unwrap());
        assert_eq!(matrix.counts().reading_messages, 598);
        for plan in [&pairs, &matrix, &plan(&Wiring::gpio_board(26).unwrap())] {
            assert_eq!(plan.counts().readings, 598);
            assert_eq!(
                plan.check(&Limits {
                    relay_voltage: Volts(10.0),
                    ..Limits::REED
                }),
                Ok(())
            );
            assert_eq!(plan.steps.first(), Some(&Step::AllOff));
            assert_eq!(plan.steps.last(), Some(&Step::AllOff));
            assert_eq!(plan.to_string().lines().count(), plan.steps.len());
        }
    }

    #[test]
    fn duration_follows_the_table_of_lower_bounds() {
        // 34924A, 26 per injection, 1 PLC at 50 Hz: 14.6 s; the 34932A matrix, 23 per injection: 17.0 s
        let pairs = plan(&Wiring::pairs_34924a(1, 26).unwrap());
        let seconds = pairs.duration(&Timing::reed(1.0, 50.0)).as_secs_f64();
        assert!((seconds - 14.6).abs() < 0.05, "{seconds}");
        let matrix = plan(&Wiring::matrix_34932a(1, 26).unwrap());
        let seconds = matrix.duration(&Timing::armature(1.0, 50.0)).as_secs_f64();
        assert!((seconds - 17.0).abs() < 0.3, "{seconds}");
    }

    #[test]
    fn limits_refuse_and_name_both_numbers() {
        let mut plan = plan(&Wiring::pairs_34924a(1, 26).unwrap());
        plan.current = Amps(0.06);
        plan.compliance = Volts(200.0);
        let faults = plan.check(&Limits::REED).unwrap_err();
        assert_eq!(faults.len(), 3, "{faults:?}");
        assert!(faults[0].to_string().contains("60 mA is over the 50 mA"));
    }

    #[test]
    fn a_meter_on_a_current_range_never_meets_the_source() {
        let plan = plan(&Wiring::pairs_34924a(1, 26).unwrap());
        let limits = Limits {
            meter_on_current_range: true,
            ..Limits::REED
        };
        let faults = plan.check(&limits).unwrap_err();
        assert!(
            matches!(faults[0], PlanError::MeterShortsSource { .. }),
            "{faults:?}"
        );
    }

    #[test]
    fn a_wiring_for_another_ring_is_refused() {
        let refusal = Plan::new(
            &Protocol::sheffield(16).unwrap(),
            &Wiring::pairs_34924a(1, 26).unwrap(),
            Amps(1e-3),
            Volts(10.0),
            Duration::ZERO,
        )
        .unwrap_err();
        assert!(
            refusal
                .to_string()
                .contains("26 electrodes, the protocol asks for 16"),
            "{refusal}"
        );
    }
}
