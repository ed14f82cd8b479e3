//! Means, standard deviations and quantiles.

/// Mean and standard deviation.
pub fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square = values
        .iter()
        .map(|value| (value - mean).powi(2))
        .sum::<f64>();
    (mean, (square / (count - 1.0).max(1.0)).sqrt())
}

/// The mean; NaN without values.
pub fn average(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}

/// The mean of the values that are not NaN; NaN if there are none.
pub(super) fn average_of_known(values: impl Iterator<Item = f64>) -> f64 {
    average(values.filter(|value| !value.is_nan()))
}

/// The quantile of the values at `share`, 0 to 1, as the nearest of the values: at 0.5 the upper one of two in the
/// middle, as [`eit::metrics::median`]. NaN without values. Sorts `values`.
pub(crate) fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = share * (values.len().max(1) - 1) as f64;
    values.get(at.round() as usize).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::{average_of_known, quantile};

    #[test]
    fn values_that_are_not_known_are_no_part_of_a_mean() {
        let mean = |values: &[f64]| average_of_known(values.iter().copied());
        assert_eq!(mean(&[1.0, f64::NAN, 2.0]), 1.5);
        assert!(mean(&[f64::NAN]).is_nan());
    }

    #[test]
    fn quantiles_are_values_that_were_seen() {
        let mut values: Vec<f64> = (1..=200).map(f64::from).collect();
        assert_eq!(quantile(&mut values, 0.99), 198.0);
        assert_eq!(quantile(&mut values, 0.5), 101.0);
        assert_eq!(
            quantile(&mut values, 0.5),
            eit::metrics::median(&mut values)
        );
        assert_eq!(quantile(&mut [7.0], 0.99), 7.0);
        assert!(quantile(&mut [], 0.5).is_nan());
    }
}
