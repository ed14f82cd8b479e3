//! Counts and duration of a plan.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::{Plan, Step};
use crate::bounds::duration;

/// Timing of the instruments, for [`Plan::duration`].
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
    /// Readings averaged to one, 1 or more.
    pub averages: u32,
    /// Setting the range of one channel (not specified by the manufacturer; to be measured on the instrument).
    pub range_command: Duration,
    /// Round trip of one message and its reply.
    pub round_trip: Duration,
}

impl Timing {
    /// Instruments that need no time beyond the integration.
    pub const fn ideal(nplc: f64, line_hz: f64) -> Self {
        Self {
            relay_close: Duration::ZERO,
            relay_open: Duration::ZERO,
            scan_period: Duration::ZERO,
            reading_period: Duration::ZERO,
            nplc,
            line_hz,
            autozero: false,
            channel_delay: Duration::ZERO,
            averages: 1,
            range_command: Duration::ZERO,
            round_trip: Duration::ZERO,
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
        f64::from(self.averages) * (period.max(slow) + self.channel_delay.as_secs_f64())
    }

    /// One single reading, s.
    fn single(&self) -> f64 {
        f64::from(self.averages) * self.integration().max(self.reading_period.as_secs_f64())
    }

    /// Opening the previous relays and closing the next, s.
    fn move_on(&self, opens: bool) -> f64 {
        let open = if opens {
            self.relay_open
        } else {
            Duration::ZERO
        };
        (self.relay_close + open).as_secs_f64()
    }

    /// Duration of the voltmeter's reply to one step, s, without round trip.
    fn answer(&self, step: &Step) -> f64 {
        match step {
            Step::Scan { channels } => channels.len() as f64 * self.scanned(),
            Step::Read { .. } => self.single(),
            Step::Chain { routes } => routes
                .iter()
                .map(|route| self.move_on(!route.open.is_empty()) + self.single())
                .sum(),
            _ => 0.0,
        }
    }
}

/// Counts of a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Steps.
    pub steps: usize,
    /// Injections.
    pub injections: usize,
    /// Relays opened or closed by the plan itself (not by a scan).
    pub relay_moves: usize,
    /// Readings kept.
    pub readings: usize,
    /// Additional readings that the scan takes.
    pub extra_readings: usize,
    /// Messages that request readings from the voltmeter.
    pub reading_messages: usize,
    /// Range commands, one channel each.
    pub range_changes: usize,
}

impl Plan {
    /// Counts the plan's work. A reading taken with both polarities counts once.
    pub fn counts(&self) -> Counts {
        let mut counts = Counts {
            steps: self.steps.len(),
            injections: 0,
            relay_moves: 0,
            readings: 0,
            extra_readings: 0,
            reading_messages: 0,
            range_changes: self.range_changes(),
        };
        let mut turned = false;
        for step in &self.steps {
            if step.reads() {
                counts.reading_messages += 1;
                if !turned {
                    counts.readings += step.readings().len();
                }
            }
            match step {
                Step::AllOff | Step::Settle { .. } | Step::Read { .. } => {}
                Step::Compliance { .. } => turned = false,
                Step::Reverse { .. } => turned = true,
                Step::Bus { close } => counts.relay_moves += close.len(),
                Step::Break { open, close, .. } | Step::Overlap { open, close, .. } => {
                    counts.injections += 1;
                    counts.relay_moves += open.len() + close.len();
                }
                Step::Route { open, close, .. } => counts.relay_moves += open.len() + close.len(),
                Step::Scan { channels } if !turned => {
                    counts.extra_readings += channels
                        .iter()
                        .filter(|channel| channel.reading.is_none())
                        .count();
                }
                Step::Scan { .. } => {}
                Step::Chain { routes } => {
                    counts.relay_moves += routes
                        .iter()
                        .map(|route| route.open.len() + route.close.len())
                        .sum::<usize>();
                }
            }
        }
        counts
    }

    /// Time that the instruments need for a frame, round trips included.
    pub fn duration(&self, timing: &Timing) -> Duration {
        let round_trip = timing.round_trip.as_secs_f64();
        let seconds: f64 = self
            .steps
            .iter()
            .map(|step| match step {
                Step::AllOff => timing.relay_open.as_secs_f64(),
                Step::Bus { .. } => timing.relay_close.as_secs_f64(),
                Step::Break { open, .. }
                | Step::Overlap { open, .. }
                | Step::Route { open, .. } => timing.move_on(!open.is_empty()),
                Step::Settle { wait } => wait.as_secs_f64(),
                Step::Scan { .. } | Step::Read { .. } | Step::Chain { .. } => {
                    timing.answer(step) + round_trip
                }
                Step::Compliance { .. } | Step::Reverse { .. } => round_trip,
            })
            .sum();
        let ranges = self.range_changes() as f64 * timing.range_command.as_secs_f64();
        duration(seconds + ranges)
    }

    /// The longest time that one reply of the voltmeter may take: the readings of the largest request, plus a fifth.
    /// The transport's timeout is added by the caller.
    pub fn longest_answer(&self, timing: &Timing) -> Duration {
        let longest = self
            .steps
            .iter()
            .map(|step| timing.answer(step))
            .fold(0.0, f64::max);
        duration(1.2 * longest)
    }
}
