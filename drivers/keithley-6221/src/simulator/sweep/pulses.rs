//! The pulses that the layers of a sweep send on their output lines.

use super::{Arm, Phase, Sweep, Trigger};

/// When the arm layer sends a pulse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ArmOutput {
    /// At the start of a pass.
    Entering,
    /// At the end of a pass.
    Leaving,
}

/// When the trigger layer sends a pulse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TriggerOutput {
    /// After a point's level has been set.
    Source,
    /// After a point's delay.
    Delay,
}

/// Pulses that a sweep has sent since it began: by the arm layer, by the trigger layer.
pub(super) type PulseCounts = [u64; 2];

impl Sweep {
    /// Whether a layer waits for pulses on its own output line.
    pub(in crate::simulator) fn receives_own_output(&self) -> bool {
        let arm = match self.arm {
            Arm::Event(Trigger::Link(line)) => Some(line),
            _ => None,
        };
        let arm_speaks = self.arm_output.map(|(line, _)| line);
        let trigger_speaks = self.trigger_output.map(|(line, _)| line);
        (arm.is_some() && arm == arm_speaks) || (self.line.is_some() && self.line == trigger_speaks)
    }

    /// Pulses that each layer has sent by now.
    fn pulses_sent(&self) -> PulseCounts {
        let whole = self.passes_done.saturating_mul(self.points.len() as u64);
        let under_way = self.now_at.map_or(0, |at| at as u64 + 1);
        // For the present pass: whether it has begun, points begun, points ended.
        let (begun, points_begun, points_ended) = match self.phase {
            Phase::Ready | Phase::AwaitArm | Phase::AwaitTimer { .. } => (0, 0, 0),
            Phase::AwaitTrigger { point } => (1, point as u64, point as u64),
            Phase::Point { point, .. } => (1, point as u64 + 1, point as u64),
            Phase::Pass { .. } if !self.looked => (1, 0, 0),
            Phase::Pass { .. } => (1, under_way, under_way - 1),
            // A pass that compliance has ended counts up to its last point.
            Phase::Done if Some(self.passes_done) == self.passes => (0, 0, 0),
            Phase::Done => (1, under_way, under_way.saturating_sub(1)),
        };
        let arm = match self.arm_output {
            Some((_, ArmOutput::Entering)) => self.passes_done + begun,
            Some((_, ArmOutput::Leaving)) => self.passes_done,
            None => 0,
        };
        let trigger = match self.trigger_output {
            Some((_, TriggerOutput::Source)) => whole.saturating_add(points_begun),
            Some((_, TriggerOutput::Delay)) => whole.saturating_add(points_ended),
            None => 0,
        };
        [arm, trigger]
    }

    /// The lines with pulses since the last call, each with its number of pulses.
    pub(in crate::simulator) fn take_pulses(&mut self) -> impl Iterator<Item = (u8, u64)> + use<> {
        let (before, now) = (self.counted, self.pulses_sent());
        self.counted = now;
        let lines = [
            self.arm_output.map(|(line, _)| line),
            self.trigger_output.map(|(line, _)| line),
        ];
        (0..2).filter_map(move |layer| {
            let sent = now[layer].saturating_sub(before[layer]);
            Some((lines[layer]?, sent))
        })
    }
}
