//! An Ornstein-Uhlenbeck process of rms 1, with an exact update over any step.

use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

#[derive(Debug)]
pub(super) struct Wander {
    tau: Duration,
    stream: ChaCha8Rng,
    last: Option<(Duration, f64)>,
}

impl Wander {
    pub(super) fn new(tau: Duration, stream: ChaCha8Rng) -> Self {
        Self {
            tau,
            stream,
            last: None,
        }
    }

    /// The value of the process at a time. A time earlier than that of the last call gives the last value.
    pub(super) fn at(&mut self, at: Duration) -> f64 {
        let value = match self.last {
            Some((then, value)) if at <= then => return value,
            Some((then, value)) => {
                let past = (at - then).as_secs_f64() / self.tau.as_secs_f64();
                // expm1 avoids cancellation in 1 - e^-2x for steps far shorter than the time constant
                let fresh = (-(-2.0 * past).exp_m1()).sqrt();
                value * (-past).exp() + fresh * self.draw()
            }
            None => self.draw(),
        };
        self.last = Some((at, value));
        value
    }

    fn draw(&mut self) -> f64 {
        StandardNormal.sample(&mut self.stream)
    }
}

#[cfg(test)]
mod tests {
    use super::super::stream;
    use super::*;

    #[test]
    fn wander_has_unit_rms_and_decays_with_tau() {
        let tau = Duration::from_secs(10);
        let step = Duration::from_secs(5);
        let mut wander = Wander::new(tau, stream(1, "test"));
        let values: Vec<f64> = (0..40_000).map(|k| wander.at(step * k)).collect();
        let mean = |pairs: &mut dyn Iterator<Item = f64>| pairs.sum::<f64>() / 40_000.0;
        let power = mean(&mut values.iter().map(|v| v * v));
        assert!((power - 1.0).abs() < 0.04, "{power}");
        let next = mean(&mut values.windows(2).map(|pair| pair[0] * pair[1]));
        assert!((next - (-0.5_f64).exp()).abs() < 0.04, "{next}");
        assert_eq!(wander.at(Duration::ZERO), values[39_999]);
    }
}
