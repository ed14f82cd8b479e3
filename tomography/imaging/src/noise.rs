//! What is assumed of the noise of one reading where nobody says it. A recorded map can only be made again to the bit
//! while every program assumes the same.

use eit::{Forward, ForwardError};
use survey::{Protocol, Reading};

/// Standard deviation of one reading where neither settings nor frames say it, uV: a 34980A on its 1 V range at 1 PLC.
pub const DEFAULT_NOISE_UV: f64 = 2.0;
/// Noise assumed of a baseline that shows none, as a share of its readings' rms: the order of what a laboratory
/// instrument repeats to.
pub const ASSUMED_SHARE: f64 = 1e-3;
/// What rounding alone leaves of a mean, as a share of the readings' rms; a smaller deviation says nothing about noise.
pub const ROUNDING_SHARE: f64 = 1e-12;

/// Standard deviation of one reading of a recording, in the recording's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Noise {
    /// Measured on the baseline's frames.
    Measured(f64),
    /// [`ASSUMED_SHARE`] of the readings' rms.
    Assumed(f64),
}

impl Noise {
    /// From the deviation that the baseline's frames show (rms over the readings) and the baseline itself; `None` where
    /// no reading of the baseline is valid.
    pub fn of_baseline(deviation: Option<f64>, baseline: &[Reading]) -> Option<Self> {
        let size = rms(baseline
            .iter()
            .filter_map(|reading| reading.volts())
            .map(|volts| volts.0))?;
        Some(
            match deviation.filter(|deviation| *deviation > ROUNDING_SHARE * size) {
                Some(deviation) => Self::Measured(deviation),
                None => Self::Assumed(ASSUMED_SHARE * size),
            },
        )
    }

    /// The deviation, in the recording's unit.
    pub fn deviation(self) -> f64 {
        match self {
            Self::Measured(deviation) | Self::Assumed(deviation) => deviation,
        }
    }
}

/// Root mean square; `None` of no values, or of nothing but zeros.
pub fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, squares) = values.fold((0_usize, 0.0), |(count, squares), value| {
        (count + 1, squares + value * value)
    });
    (count > 0 && squares > 0.0).then(|| (squares / count as f64).sqrt())
}

/// By how much a baseline exceeds the geometry's own readings at 1 A, in the least squares: the current, where
/// conductance and unit are known; else the factor from the model's unit to the recording's. `None` where they have
/// opposite signs or no reading is valid.
///
/// # Errors
/// The forward model cannot be solved.
pub fn gain(
    forward: &Forward,
    sigma: &[f64],
    protocol: &Protocol,
    baseline: &[Reading],
) -> Result<Option<f64>, ForwardError> {
    let model = forward.readings(sigma, protocol)?;
    let (mut both, mut own) = (0.0, 0.0);
    for (reading, &ohms) in baseline.iter().zip(model.iter()) {
        if let Some(volts) = reading.volts() {
            both += ohms * volts.0;
            own += ohms * ohms;
        }
    }
    Ok(Some(both / own).filter(|gain| *gain > 0.0 && gain.is_finite()))
}

/// The uniform conductance, S per square, whose readings at `current_a` (A) are nearest to the baseline in the least
/// squares; `None` where the baseline does not look like the geometry.
///
/// # Errors
/// The forward model cannot be solved.
pub fn fitted_conductance(
    forward: &Forward,
    triangles: usize,
    current_a: f64,
    protocol: &Protocol,
    baseline: &[Reading],
) -> Result<Option<f64>, ForwardError> {
    let mut conductance = 1e-3;
    // Readings are inversely proportional to the conductance but for the contacts' share: a few rounds are enough.
    for _ in 0..20 {
        let sigma = vec![conductance; triangles];
        let Some(gain) = gain(forward, &sigma, protocol, baseline)? else {
            return Ok(None);
        };
        let factor = current_a / gain;
        conductance *= factor;
        if (factor - 1.0).abs() < 1e-9 {
            break;
        }
    }
    Ok(Some(conductance))
}

#[cfg(test)]
mod tests {
    use super::*;
    use eit::DiscTank;
    use std::sync::Arc;
    use survey::Volts;

    #[test]
    fn noise_is_measured_or_a_thousandth_of_the_readings() {
        let baseline = [
            Reading::Ok(Volts(3.0)),
            Reading::Overload,
            Reading::Ok(Volts(-3.0)),
        ];
        let of = |deviation| Noise::of_baseline(deviation, &baseline);
        assert_eq!(of(Some(1e-6)), Some(Noise::Measured(1e-6)));
        // frames equal but for rounding
        assert_eq!(of(Some(1e-13)), Some(Noise::Assumed(3e-3)));
        assert_eq!(of(None).map(Noise::deviation), Some(3e-3));
        assert_eq!(Noise::of_baseline(None, &[Reading::Overload]), None);
    }

    #[test]
    fn a_uniform_conductance_is_found_again() {
        let tank = DiscTank {
            fineness: 0.25,
            ..DiscTank::default()
        };
        let mesh = Arc::new(tank.mesh().unwrap());
        let triangles = mesh.triangles().len();
        let forward = Forward::new(mesh, &tank.contact_ohm_m()).unwrap();
        let protocol = Protocol::sheffield(16).unwrap();
        let baseline: Vec<Reading> = forward
            .readings(&vec![0.02; triangles], &protocol)
            .unwrap()
            .iter()
            .map(|ohms| Reading::Ok(Volts(5e-3 * ohms)))
            .collect();
        let fitted = |sign: f64| {
            let baseline: Vec<Reading> = baseline
                .iter()
                .filter_map(|reading| reading.volts())
                .map(|volts| Reading::Ok(Volts(sign * volts.0)))
                .collect();
            fitted_conductance(&forward, triangles, 5e-3, &protocol, &baseline).unwrap()
        };
        let found = fitted(1.0).unwrap();
        assert!((found / 0.02 - 1.0).abs() < 1e-9, "{found}");
        assert_eq!(fitted(-1.0), None);
    }
}
