//! The mean of a sweep's level over a time, for a reading that integrates over several points.

use std::time::Duration;

use super::{Nanos, Phase, Sweep};
use crate::simulator::plan::Point;

impl Sweep {
    /// Mean of `level` over the points between two instants; `None` before the first pass, and if each point waits for
    /// a trigger. Earlier passes are assumed to be like the present one.
    pub(in crate::simulator) fn mean(
        &self,
        from: Duration,
        to: Duration,
        level: impl Fn(&Point) -> f64,
    ) -> Option<f64> {
        if self.phase == Phase::Ready || self.line.is_some() || !self.looked {
            return None;
        }
        // The integral from the start of the pass to `time`, amperes times nanoseconds. The last point is held.
        let until = |time: Nanos| {
            let mut start = 0;
            let last = self.points.len() - 1;
            let parts = self.points.iter().zip(&self.ends).enumerate();
            let parts = parts.map(|(at, (point, end))| {
                let end = if at == last { time } else { (*end).min(time) };
                let length = end.saturating_sub(start);
                start = end.max(start);
                level(point) * length as f64
            });
            parts.sum::<f64>()
        };
        let (from, to, began) = (from.as_nanos(), to.as_nanos(), self.pass_since);
        if to <= began {
            return None;
        }
        let in_pass = from.max(began);
        let mut sum = until(to - began) - until(in_pass - began);
        let mut length = to - in_pass;
        let period = self.period();
        if from < began && self.passes_done > 0 && period > 0 {
            let (passes, rest) = ((began - from) / period, (began - from) % period);
            let whole = until(period);
            sum += passes as f64 * whole + (whole - until(period - rest));
            length += began - from;
        }
        (length > 0).then(|| sum / length as f64)
    }
}
