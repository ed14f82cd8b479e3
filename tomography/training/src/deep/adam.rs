//! Adam (Kingma and Ba, 2015): the step of each parameter is its mean gradient over the root of its mean squared
//! gradient.

use super::product;

/// Constants of a step; `rate` and `epsilon` include the bias correction of the moments, which start at zero.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    beta1: f32,
    beta2: f32,
    rate: f32,
    epsilon: f32,
}

impl Step {
    /// Step `number`, from 1. With m' = m / (1 - beta1^t) and v' = v / (1 - beta2^t) the formula rate m' / (sqrt v' +
    /// eps) becomes (rate r2 / r1) m / (sqrt v + eps r2), r1 = 1 - beta1^t, r2 = sqrt(1 - beta2^t).
    pub(super) fn new(rate: f64, beta1: f64, beta2: f64, epsilon: f64, number: u64) -> Self {
        let number = i32::try_from(number).unwrap_or(i32::MAX);
        let r1 = 1.0 - beta1.powi(number);
        let r2 = (1.0 - beta2.powi(number)).sqrt();
        Self {
            beta1: beta1 as f32,
            beta2: beta2 as f32,
            rate: (rate * r2 / r1) as f32,
            epsilon: (epsilon * r2) as f32,
        }
    }

    /// Updates all entries of equally long slices.
    pub(super) fn take(self, values: &mut [f32], moments: [&mut [f32]; 2], gradient: &[f32]) {
        let constants = [self.beta1, self.beta2, self.rate, self.epsilon];
        product::adam(constants, values, moments, gradient);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_those_of_the_paper_by_kingma_and_ba() {
        let (rate, beta1, beta2, epsilon) = (1e-2, 0.9, 0.999, 1e-8);
        let (mut value, mut m, mut v) = ([0.5_f32], [0.0_f32], [0.0_f32]);
        let (mut exact, mut em, mut ev) = (0.5_f64, 0.0, 0.0);
        for t in 1..=20 {
            let g = (f64::from(t) * 0.7).sin();
            Step::new(rate, beta1, beta2, epsilon, t as u64).take(
                &mut value,
                [&mut m, &mut v],
                &[g as f32],
            );
            em = beta1 * em + (1.0 - beta1) * g;
            ev = beta2 * ev + (1.0 - beta2) * g * g;
            let (hm, hv) = (em / (1.0 - beta1.powi(t)), ev / (1.0 - beta2.powi(t)));
            exact -= rate * hm / (hv.sqrt() + epsilon);
            assert!((f64::from(value[0]) - exact).abs() < 1e-6, "{t}");
        }
    }
}
