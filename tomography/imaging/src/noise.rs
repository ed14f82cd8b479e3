//! Default assumptions about the noise of one reading. Maps can be reproduced bit for bit only if all programs use the
//! same ones.

use eit::{Forward, ForwardError};
use survey::{Baseline, Protocol, Reading, Volts};

/// Default standard deviation of one reading, uV, if neither settings nor frames give it.
pub const DEFAULT_NOISE_UV: f64 = 1e6 * eit::DEFAULT_NOISE_V;
/// Noise assumed for a baseline from which none can be measured, as a share of its readings' rms: the typical
/// repeatability of a laboratory instrument.
pub const ASSUMED_SHARE: f64 = 1e-3;
/// Rounding error of a mean, as a share of the readings' rms; a smaller deviation is not noise.
pub const ROUNDING_SHARE: f64 = 1e-12;
/// Ratio above which a stated and a measured noise contradict each other, in either direction.
pub const CONTRADICTION: f64 = 2.0;

/// Standard deviation of one reading of a recording, in the recording's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Noise {
    /// Measured on the baseline's frames.
    Measured(f64),
    /// [`ASSUMED_SHARE`] of the readings' rms.
    Assumed(f64),
}

impl Noise {
    /// From the rms deviation of the baseline's frames and the baseline itself; `None` if no reading of the baseline is
    /// valid.
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

    /// As [`Noise::of_baseline`], from the deviations stored in the baseline.
    pub fn of(baseline: &Baseline) -> Option<Self> {
        Self::of_baseline(rms_deviation(baseline), &baseline.readings)
    }

    /// The measured deviation, in the recording's unit; `None` if it is assumed.
    pub fn measured(self) -> Option<f64> {
        match self {
            Self::Measured(deviation) => Some(deviation),
            Self::Assumed(_) => None,
        }
    }

    /// The deviation, in the recording's unit.
    pub fn deviation(self) -> f64 {
        match self {
            Self::Measured(deviation) | Self::Assumed(deviation) => deviation,
        }
    }
}

/// Standard deviation of one reading, V, if the settings do not give it: the deviation of the baseline's frames; for a
/// baseline of a single frame, which has no deviation, the voltmeter's resolution; otherwise [`DEFAULT_NOISE_UV`].
pub fn against(baseline: &Baseline) -> f64 {
    let resolution = || Some(baseline.settings.noise().0).filter(|_| baseline.frames < 2);
    Noise::of(baseline)
        .and_then(Noise::measured)
        .or_else(resolution)
        .filter(|noise| *noise > 0.0)
        .unwrap_or(DEFAULT_NOISE_UV * 1e-6)
}

/// A message if a configured noise, uV, differs from the baseline's by more than the factor [`CONTRADICTION`]; `None`
/// if they agree or the baseline's noise cannot be measured.
pub fn contradiction(noise_uv: f64, baseline: &Baseline) -> Option<String> {
    let measured = Noise::of(baseline)?.measured()?;
    let factor = measured / (noise_uv * 1e-6);
    let agrees = (1.0 / CONTRADICTION..=CONTRADICTION).contains(&factor);
    let shows = format!("baseline {} shows", baseline.id);
    (!agrees).then(|| contradicted(noise_uv, &shows, measured))
}

/// A message if a configured noise, uV, is below the voltmeter's own noise `resolution`, V, by more than the factor
/// [`CONTRADICTION`]; otherwise `None`. More noise than the voltmeter's is plausible for a real rig.
pub fn below_the_voltmeter(noise_uv: f64, resolution: f64) -> Option<String> {
    let below = resolution > CONTRADICTION * noise_uv * 1e-6;
    below.then(|| {
        contradicted(
            noise_uv,
            "the voltmeter at this integration has",
            resolution,
        )
    })
}

fn contradicted(noise_uv: f64, other: &str, noise: f64) -> String {
    let noise_v = noise_uv * 1e-6;
    let effect = match noise > noise_v {
        true => "maps show noise as loads",
        false => "maps are smoother than necessary",
    };
    format!(
        "model.noise_uv is {} for one reading, {other} {}: {effect}; delete noise_uv to use the noise measured on the \
         baseline",
        Volts(noise_v),
        Volts(noise)
    )
}

/// Rms of the deviations stored in a baseline, V; `None` if it has none or all are zero.
pub fn rms_deviation(baseline: &Baseline) -> Option<f64> {
    rms(baseline.deviation.iter().flatten().copied())
}

/// Root mean square; `None` without values, or if all are zero.
pub fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, squares) = values.fold((0_usize, 0.0), |(count, squares), value| {
        (count + 1, squares + value * value)
    });
    (count > 0 && squares > 0.0).then(|| (squares / count as f64).sqrt())
}

/// Least-squares ratio of a baseline to these readings of a model; `None` if they have opposite signs or no reading is
/// valid.
pub(crate) fn factor(model: impl Iterator<Item = f64>, baseline: &[Reading]) -> Option<f64> {
    let (mut both, mut own) = (0.0, 0.0);
    for (reading, ohms) in baseline.iter().zip(model) {
        if let Some(volts) = reading.volts() {
            both += ohms * volts.0;
            own += ohms * ohms;
        }
    }
    Some(both / own).filter(|gain| *gain > 0.0 && gain.is_finite())
}

/// Least-squares ratio of a baseline to the geometry's readings at 1 A: the current if conductance and unit are known,
/// otherwise the factor from the model's unit to the recording's. `None` if they have opposite signs or no reading is
/// valid.
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
    Ok(factor(model.iter().copied(), baseline))
}

/// A geometry's readings at 1 A scaled to these currents (A), one per reading.
pub(crate) fn at_currents<'a>(
    ohms: &'a [f64],
    currents: &'a [f64],
) -> impl Iterator<Item = f64> + 'a {
    ohms.iter().zip(currents).map(|(ohms, amps)| ohms * amps)
}

/// The uniform conductance, S per square, whose readings at these currents (A, one per reading) fit the baseline best
/// in the least-squares sense; `None` if the baseline does not match the geometry.
///
/// # Errors
/// The forward model cannot be solved.
pub(crate) fn fitted_conductance(
    forward: &Forward,
    triangles: usize,
    currents: &[f64],
    protocol: &Protocol,
    baseline: &[Reading],
) -> Result<Option<f64>, ForwardError> {
    let mut conductance = 1e-3;
    // Readings are inversely proportional to the conductance except for the contacts' share: a few iterations suffice.
    for _ in 0..20 {
        let sigma = vec![conductance; triangles];
        let ohms = forward.readings(&sigma, protocol)?;
        let Some(excess) = factor(at_currents(ohms.as_slice(), currents), baseline) else {
            return Ok(None);
        };
        conductance /= excess;
        if (excess - 1.0).abs() < 1e-9 {
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
        // frames equal except for rounding
        assert_eq!(of(Some(1e-13)), Some(Noise::Assumed(3e-3)));
        assert_eq!(of(None).map(Noise::deviation), Some(3e-3));
        assert_eq!(Noise::of_baseline(None, &[Reading::Overload]), None);
    }

    fn baseline(frames: &[f64]) -> Baseline {
        let settings = survey::Settings {
            protocol_hash: "p".into(),
            current: survey::Amps(1e-3),
            range: Volts(1.0),
            nplc: 0.02,
            settle: std::time::Duration::ZERO,
            wiring: "w".into(),
            precautions: survey::Precautions {
                resolution: 1e-4,
                ..survey::Precautions::default()
            },
        };
        let (count, mean) = (frames.len() as f64, frames.iter().sum::<f64>());
        let mean = mean / count;
        let squares: f64 = frames.iter().map(|volts| (volts - mean).powi(2)).sum();
        Baseline {
            id: "b1".into(),
            readings: vec![Reading::Ok(Volts(mean))],
            deviation: vec![(frames.len() > 1).then(|| (squares / (count - 1.0)).sqrt())],
            frames: frames.len(),
            wall: chrono::DateTime::UNIX_EPOCH,
            settings,
            simulated: false,
        }
    }

    #[test]
    fn a_method_is_set_by_the_noise_of_the_baseline() {
        let noisy = baseline(&[0.0499, 0.0501]);
        assert!((against(&noisy) / (0.0002 / 2_f64.sqrt()) - 1.0).abs() < 1e-9);
        // noise cannot be measured from one frame: the voltmeter's resolution on its range is used
        assert_eq!(against(&baseline(&[0.05])), 1e-4);
        // simulated without noise
        assert_eq!(against(&baseline(&[0.05, 0.05])), DEFAULT_NOISE_UV * 1e-6);
    }

    #[test]
    fn a_stated_noise_that_the_baseline_contradicts_is_named() {
        let noisy = baseline(&[0.0499, 0.0501]);
        let text = contradiction(2.0, &noisy).unwrap();
        assert!(
            text.contains("2 uV for one reading, baseline b1 shows 141.42"),
            "{text}"
        );
        assert!(text.contains("noise as loads"), "{text}");
        let smooth = contradiction(400.0, &noisy).unwrap();
        assert!(smooth.contains("smoother"), "{smooth}");
        assert_eq!(contradiction(100.0, &noisy), None);
        assert_eq!(contradiction(2.0, &baseline(&[0.05, 0.05])), None);
        assert!(below_the_voltmeter(2.0, 1.04e-4).is_some());
        // a real rig may have more noise than the voltmeter
        assert_eq!(below_the_voltmeter(500.0, 1.04e-4), None);
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
            fitted_conductance(
                &forward,
                triangles,
                &vec![5e-3; protocol.len()],
                &protocol,
                &baseline,
            )
            .unwrap()
        };
        let found = fitted(1.0).unwrap();
        assert!((found / 0.02 - 1.0).abs() < 1e-9, "{found}");
        assert_eq!(fitted(-1.0), None);
    }
}
