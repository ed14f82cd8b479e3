//! Jitter: the noise added to the inputs.

use eit::{Jitter, SpreadChoice};
use rand_distr::{Distribution, Normal, StandardNormal};

use super::{Purpose, TrainError, positive, stream};

/// Jitter in the units of a normalised input.
#[derive(Debug, Clone)]
pub struct Noise {
    kind: Kind,
    seed: u64,
}

#[derive(Debug, Clone)]
enum Kind {
    /// One standard deviation or several, used in turn by the copies of a case.
    White(Vec<Normal<f64>>),
    /// Rows whose random combinations have the covariance of the noise, plus white noise.
    Rows {
        rows: Vec<Vec<f64>>,
        white: Option<Normal<f64>>,
    },
}

/// Refuses sizes of jitter that are not positive numbers.
pub(super) fn check(jitter: &Jitter) -> Result<(), TrainError> {
    match jitter {
        Jitter::Paper { gamma } => positive([("gamma", *gamma)]),
        Jitter::Matched { noise_v, current_a }
        | Jitter::Drift {
            noise_v, current_a, ..
        } => positive([("noise_v", *noise_v), ("current_a", *current_a)]),
        Jitter::Levels { noise_v, current_a } => {
            let levels = noise_v.iter().map(|level| ("noise_v", *level));
            positive(levels.chain([("current_a", *current_a)]))
        }
        Jitter::Measured { current_a, .. } => positive([("current_a", *current_a)]),
    }
}

impl Noise {
    /// `baseline`: the unloaded readings at 1 A.
    ///
    /// # Errors
    /// Sizes that are not positive numbers, repeats that do not determine a covariance, or rows of readings that do not
    /// fit the protocol or are not finite.
    pub fn new(
        jitter: &Jitter,
        spread: SpreadChoice,
        baseline: &[f64],
        seed: u64,
    ) -> Result<Self, TrainError> {
        check(jitter)?;
        let top = baseline.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
        let refuse = |setting, value, must| TrainError::Setting {
            setting,
            value,
            must,
        };
        let white = |levels: Vec<f64>| {
            levels
                .into_iter()
                .map(|level| {
                    if !(level > 0.0 && level.is_finite()) {
                        return Err(refuse("jitter", level, "a positive number"));
                    }
                    Normal::new(0.0, level)
                        .map_err(|_| refuse("jitter", level, "a positive number"))
                })
                .collect::<Result<Vec<_>, _>>()
                .map(Kind::White)
        };
        let check_rows = |rows: &[Vec<f64>], readings, row| {
            if let Some(row) = rows.iter().find(|row| row.len() != baseline.len()) {
                let must = "one per measurement of the protocol";
                return Err(refuse(readings, row.len() as f64, must));
            }
            if rows.iter().flatten().any(|value| !value.is_finite()) {
                return Err(refuse(row, f64::NAN, "finite in every reading"));
            }
            Ok(())
        };
        let both = std::f64::consts::SQRT_2;
        let kind = match jitter {
            Jitter::Paper { gamma } => {
                let n = baseline.len() as f64;
                let mean = baseline.iter().sum::<f64>() / n;
                let square: f64 = baseline.iter().map(|v| (v - mean).powi(2)).sum();
                let given = gamma * (square / (n - 1.0)).sqrt() / top;
                white(vec![match spread {
                    SpreadChoice::Deviation => given,
                    SpreadChoice::Variance => given.sqrt(),
                }])?
            }
            Jitter::Matched { noise_v, current_a } => {
                white(vec![both * noise_v / current_a / top])?
            }
            Jitter::Levels { noise_v, current_a } => {
                if noise_v.is_empty() {
                    return Err(refuse("noise_v", 0.0, "one level or more"));
                }
                white(noise_v.iter().map(|v| both * v / current_a / top).collect())?
            }
            Jitter::Measured { volts, current_a } => {
                let count = volts.len();
                if count < 2 {
                    return Err(refuse(
                        "repeats of the baseline",
                        count as f64,
                        "2 or more (20 or more for a useful covariance)",
                    ));
                }
                check_rows(
                    volts,
                    "readings of a repeat of the baseline",
                    "a repeat of the baseline",
                )?;
                let scale = both / (current_a * top * ((count - 1) as f64).sqrt());
                let mean: Vec<f64> = (0..baseline.len())
                    .map(|reading| volts.iter().map(|row| row[reading]).sum::<f64>() / count as f64)
                    .collect();
                let deviations = |row: &Vec<f64>| {
                    let deviations = row.iter().zip(&mean);
                    deviations.map(|(v, m)| scale * (v - m)).collect()
                };
                Kind::Rows {
                    rows: volts.iter().map(deviations).collect(),
                    white: None,
                }
            }
            Jitter::Drift {
                noise_v,
                current_a,
                drift_v,
            } => {
                check_rows(
                    drift_v,
                    "readings of a row of the drift",
                    "a row of the drift",
                )?;
                let level = both * noise_v / current_a / top;
                let scaled = |row: &Vec<f64>| row.iter().map(|v| v / current_a / top).collect();
                Kind::Rows {
                    rows: drift_v.iter().map(scaled).collect(),
                    white: Some(
                        Normal::new(0.0, level)
                            .map_err(|_| refuse("jitter", level, "a positive number"))?,
                    ),
                }
            }
        };
        Ok(Self { kind, seed })
    }

    /// Number of levels that the copies of a case use in turn; 1 if all copies have the same noise.
    pub fn levels(&self) -> usize {
        match &self.kind {
            Kind::White(levels) => levels.len(),
            Kind::Rows { .. } => 1,
        }
    }

    /// Refuses fewer copies of a case than levels: some level would not be used.
    ///
    /// # Errors
    /// [`TrainError::Setting`].
    pub fn check_copies(&self, copies: usize) -> Result<(), TrainError> {
        if copies < self.levels() {
            return Err(TrainError::Setting {
                setting: "repeats",
                value: copies as f64,
                must: "as many as there are levels of noise, or more",
            });
        }
        Ok(())
    }

    /// Root mean square of the noise over readings and levels, in units of the normalised input.
    pub fn size(&self) -> f64 {
        match &self.kind {
            Kind::White(levels) => {
                let square: f64 = levels.iter().map(|level| level.std_dev().powi(2)).sum();
                (square / levels.len() as f64).sqrt()
            }
            Kind::Rows { rows, white } => {
                let square: f64 = rows.iter().flatten().map(|value| value * value).sum();
                let readings = rows.first().map_or(1, Vec::len);
                (square / readings as f64 + variance(white)).sqrt()
            }
        }
    }

    /// Adds to `row` the noise of copy `copy` of case `case` of `cases`; it depends on these and the seed only.
    pub fn add(&self, row: &mut [f32], copy: usize, case: usize, cases: usize) {
        let random = &mut stream(self.seed, Purpose::Jitter, copy * cases + case);
        match &self.kind {
            Kind::White(levels) => {
                let level = levels[copy % levels.len()];
                for value in row {
                    *value = (f64::from(*value) + level.sample(random)) as f32;
                }
            }
            Kind::Rows { rows, white } => {
                let mut noise = vec![0.0_f64; row.len()];
                for deviations in rows {
                    let amount: f64 = StandardNormal.sample(random);
                    for (noise, deviation) in noise.iter_mut().zip(deviations) {
                        *noise += amount * deviation;
                    }
                }
                if let Some(white) = white {
                    for noise in &mut noise {
                        *noise += white.sample(random);
                    }
                }
                for (value, noise) in row.iter_mut().zip(noise) {
                    *value = (f64::from(*value) + noise) as f32;
                }
            }
        }
    }

    /// Adds the covariance of the noise, averaged over its levels, to a symmetric row-major matrix with a row and a
    /// column per reading.
    pub fn add_covariance(&self, matrix: &mut [f64]) {
        match &self.kind {
            Kind::White(_) => {
                let readings = (matrix.len() as f64).sqrt().round() as usize;
                for i in 0..readings {
                    matrix[i * readings + i] += self.size().powi(2);
                }
            }
            Kind::Rows { rows, white } => {
                let readings = (matrix.len() as f64).sqrt().round() as usize;
                for i in 0..readings {
                    matrix[i * readings + i] += variance(white);
                }
                for row in rows {
                    for i in 0..readings {
                        for j in 0..readings {
                            matrix[i * readings + j] += row[i] * row[j];
                        }
                    }
                }
            }
        }
    }
}

fn variance(white: &Option<Normal<f64>>) -> f64 {
    white.map_or(0.0, |white| white.std_dev().powi(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measured_jitter_has_the_repeats_covariance() {
        // two correlated readings, a third anticorrelated with them, and a constant one
        let volts: Vec<Vec<f64>> = (0..40)
            .map(|k| {
                let wave = 1e-6 * f64::from((k * 7 % 11) - 5);
                vec![1.0 + wave, 1.0 + wave, 1.0 - 2.0 * wave, 1.0]
            })
            .collect();
        let square = volts.iter().map(|row| (row[0] - 1.0).powi(2)).sum::<f64>();
        let mean = volts.iter().map(|row| row[0] - 1.0).sum::<f64>() / 40.0;
        let variance = (square - 40.0 * mean * mean) / 39.0;
        let noise = Noise::new(
            &Jitter::Measured {
                volts,
                current_a: 1.0,
            },
            SpreadChoice::Deviation,
            &[1.0; 4],
            3,
        )
        .unwrap();
        let mut sums = [0.0; 3];
        let draws = 20_000;
        for case in 0..draws {
            let mut row = [0.0_f32; 4];
            noise.add(&mut row, 0, case, draws);
            let row = row.map(f64::from);
            assert_eq!(row[3], 0.0);
            sums[0] += row[0] * row[0];
            sums[1] += row[0] * row[1];
            sums[2] += row[0] * row[2];
        }
        let wants = 2.0 * variance * draws as f64;
        for (sum, factor) in sums.into_iter().zip([1.0, 1.0, -2.0]) {
            assert!((sum / (factor * wants) - 1.0).abs() < 0.05);
        }
        let mut matrix = vec![0.0; 16];
        noise.add_covariance(&mut matrix);
        assert!((matrix[2] / (-4.0 * variance) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn drift_is_added_once_and_noise_twice() {
        let jitter = Jitter::Drift {
            noise_v: 1e-6,
            current_a: 1e-3,
            drift_v: vec![vec![3e-6, 4e-6, 0.0], vec![0.0, 5e-6, 0.0]],
        };
        let noise = Noise::new(&jitter, SpreadChoice::Deviation, &[2.0; 3], 1).unwrap();
        let mut matrix = vec![0.0; 9];
        noise.add_covariance(&mut matrix);
        // V over 1 mA over the largest reading, 2 V at 1 A
        let wants = [11.0, 12.0, 0.0, 12.0, 43.0, 0.0, 0.0, 0.0, 2.0].map(|v| 0.25e-6 * v);
        for (found, wants) in matrix.iter().zip(wants) {
            assert!((found - wants).abs() < 1e-12, "{matrix:?}");
        }
        assert!((noise.size() - (14e-6_f64 / 3.0).sqrt()).abs() < 1e-9);
        let (mut sum, draws) = ([0.0; 3], 20_000);
        for case in 0..draws {
            let mut row = [0.0_f32; 3];
            noise.add(&mut row, 0, case, draws);
            let row = row.map(f64::from);
            for (sum, [i, j]) in sum.iter_mut().zip([[0, 1], [1, 1], [2, 2]]) {
                *sum += row[i] * row[j] / draws as f64;
            }
        }
        for (sum, wants) in sum.into_iter().zip([12.0, 43.0, 2.0]) {
            assert!((sum / (0.25e-6 * wants) - 1.0).abs() < 0.05, "{sum:e}");
        }
    }

    #[test]
    fn wrong_rows_and_currents_are_refused_with_their_value() {
        let refused =
            |jitter: &Jitter| match Noise::new(jitter, SpreadChoice::Deviation, &[2.0; 3], 1)
                .unwrap_err()
            {
                TrainError::Setting { setting, value, .. } => (setting, value),
                other => panic!("{other}"),
            };
        let drift = |row: Vec<f64>| Jitter::Drift {
            noise_v: 1e-6,
            current_a: 1e-3,
            drift_v: vec![vec![1e-6; 3], row],
        };
        let longer = refused(&drift(vec![1e-6; 4]));
        assert_eq!(longer, ("readings of a row of the drift", 4.0));
        let (setting, value) = refused(&drift(vec![1e-6, f64::INFINITY, 0.0]));
        assert!(setting == "a row of the drift" && value.is_nan());
        let measured = Jitter::Measured {
            volts: vec![vec![1.0; 3], vec![1.1; 3]],
            current_a: -1e-3,
        };
        assert_eq!(refused(&measured), ("current_a", -1e-3));
    }

    #[test]
    fn levels_are_taken_in_turn() {
        let jitter = Jitter::Levels {
            noise_v: vec![1e-6, 1e-3],
            current_a: 1e-3,
        };
        let noise = Noise::new(&jitter, SpreadChoice::Deviation, &[300.0; 500], 1).unwrap();
        let size = |copy| {
            let mut row = vec![0.0_f32; 500];
            noise.add(&mut row, copy, 4, 10);
            (row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / 500.0).sqrt()
        };
        assert!(size(1) > 500.0 * size(0) && size(3) > 500.0 * size(2));
        assert!(noise.check_copies(2).is_ok() && noise.check_copies(1).is_err());
        let wrong = Jitter::Levels {
            noise_v: vec![-1.0],
            current_a: 1e-3,
        };
        assert!(Noise::new(&wrong, SpreadChoice::Deviation, &[300.0; 4], 1).is_err());
    }
}
