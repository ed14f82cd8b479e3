//! Converts a frame to means of reciprocal readings, relative to a baseline.
//!
//! A reading and its reciprocal twin (drive and sense exchanged) are equal on any sheet. Their mean carries all
//! information about the sheet; their difference shows only errors of the instruments.

use nalgebra::DVector;
use survey::{Measurement, Protocol, Reading};

use crate::DriftError;

/// Plausible range of the ratio of model to baseline; outside of it the baseline's reading is wrong and the ratio is
/// not used.
const RATIO: [f64; 2] = [0.5, 2.0];

/// Share of its baseline below which a reading is nearly 0 V.
pub(crate) const NEARLY_ZERO: f64 = 0.05;

/// The reciprocal pairs of a protocol, in the order of their first reading. A reading without twin forms a pair by itself.
#[derive(Debug, Clone)]
pub struct Pairs {
    protocol: Protocol,
    half: Protocol,
    readings: Vec<[usize; 2]>,
}

/// A frame relative to a baseline.
#[derive(Debug, Clone, PartialEq)]
pub struct Relative {
    /// Change of the mean of each pair, scaled to the model's readings, V. Zero if a reading is missing.
    pub data: DVector<f64>,
    /// Pairs with both readings, ascending.
    pub rows: Vec<usize>,
}

impl Pairs {
    /// The pairs of a protocol.
    ///
    /// # Panics
    /// Never: any subset of a protocol's measurements is a valid protocol.
    pub fn new(protocol: &Protocol) -> Self {
        let twins = protocol.reciprocal_twins();
        let readings: Vec<[usize; 2]> = (0..protocol.len())
            .filter(|&reading| twins[reading].is_none_or(|twin| twin >= reading))
            .map(|reading| [reading, twins[reading].unwrap_or(reading)])
            .collect();
        let first: Vec<Measurement> = readings
            .iter()
            .map(|pair| protocol.measurements()[pair[0]])
            .collect();
        let half = Protocol::new(protocol.electrodes(), first).expect("measurements of a protocol");
        Self {
            protocol: protocol.clone(),
            half,
            readings,
        }
    }

    /// Number of pairs.
    pub fn len(&self) -> usize {
        self.readings.len()
    }

    /// Whether there is no pair.
    pub fn is_empty(&self) -> bool {
        self.readings.is_empty()
    }

    /// The protocol of the frames.
    pub fn protocol(&self) -> &Protocol {
        &self.protocol
    }

    /// The first measurement of each pair.
    pub fn half(&self) -> &Protocol {
        &self.half
    }

    /// The two readings of a pair; without a twin, the same reading twice.
    pub fn readings(&self, row: usize) -> [usize; 2] {
        self.readings[row]
    }

    /// The mean of each pair of values, one for each reading.
    pub fn mean(&self, values: &[f64]) -> DVector<f64> {
        let mean = |&[a, b]: &[usize; 2]| 0.5 * (values[a] + values[b]);
        DVector::from_iterator(self.len(), self.readings.iter().map(mean))
    }

    /// The scale factor of each reading: model over baseline, or 1 if that ratio is not plausible. `model` has a value
    /// per pair, `baseline` a value per reading, V.
    pub fn ratios(&self, model: &DVector<f64>, baseline: &[f64]) -> Vec<f64> {
        let mut ratios = vec![1.0; baseline.len()];
        for (pair, model) in self.readings.iter().zip(model) {
            for &reading in pair {
                let ratio = model / baseline[reading];
                if (RATIO[0]..=RATIO[1]).contains(&ratio) {
                    ratios[reading] = ratio;
                }
            }
        }
        ratios
    }

    /// A frame relative to a baseline (V, all readings present), scaled by [`Pairs::ratios`].
    ///
    /// # Errors
    /// Wrong number of readings, or fewer than half of the pairs are complete.
    pub fn relative(
        &self,
        ratios: &[f64],
        baseline: &[f64],
        frame: &[Reading],
    ) -> Result<Relative, DriftError> {
        let wants = self.protocol.len();
        for has in [frame.len(), baseline.len(), ratios.len()] {
            if has != wants {
                return Err(DriftError::Readings { has, wants });
            }
        }
        let change: Vec<Option<f64>> = (0..wants)
            .map(|reading| {
                let volts = frame[reading].volts()?.0;
                let change = ratios[reading] * (volts - baseline[reading]);
                change.is_finite().then_some(change)
            })
            .collect();
        let known: Vec<f64> = change.iter().map(|change| change.unwrap_or(0.0)).collect();
        let mut data = self.mean(&known);
        let mut rows = Vec::new();
        for (row, pair) in self.readings.iter().enumerate() {
            if pair.iter().all(|&reading| change[reading].is_some()) {
                rows.push(row);
            } else {
                data[row] = 0.0;
            }
        }
        if 2 * rows.len() < self.len() {
            return Err(DriftError::TooFew {
                rows: rows.len(),
                wants: self.len(),
            });
        }
        Ok(Relative { data, rows })
    }
}

/// The values of a baseline, V.
///
/// # Errors
/// A reading that is missing, zero or not a number.
pub(crate) fn baseline_volts(pairs: &Pairs, baseline: &[Reading]) -> Result<Vec<f64>, DriftError> {
    let wants = pairs.protocol.len();
    if baseline.len() != wants {
        return Err(DriftError::Readings {
            has: baseline.len(),
            wants,
        });
    }
    baseline
        .iter()
        .enumerate()
        .map(|(reading, value)| {
            let volts = value.volts().map(|volts| volts.0);
            volts
                .filter(|volts| volts.is_finite() && *volts != 0.0)
                .ok_or(DriftError::Baseline { reading })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use survey::Volts;

    #[test]
    fn half_of_the_readings_of_the_pattern_are_pairs() {
        let pairs = Pairs::new(&Protocol::sheffield(26).unwrap());
        assert_eq!((pairs.len(), pairs.half().len()), (299, 299));
        let values: Vec<f64> = (0..598).map(f64::from).collect();
        let [a, b] = pairs.readings(100);
        assert_eq!(pairs.mean(&values)[100], 0.5 * (a + b) as f64);
    }

    #[test]
    fn missing_reading_takes_its_pair_and_no_other() {
        let pairs = Pairs::new(&Protocol::sheffield(8).unwrap());
        let baseline = vec![1.0; 40];
        let mut frame = vec![Reading::Ok(Volts(1.1)); 40];
        frame[3] = Reading::Ok(Volts(f64::NAN));
        let found = pairs.relative(&baseline, &baseline, &frame).unwrap();
        assert_eq!((found.rows.len(), found.data.len()), (19, 20));
        let lost = (0..20).find(|row| !found.rows.contains(row)).unwrap();
        assert!(pairs.readings(lost).contains(&3));
        assert_eq!(found.data[lost], 0.0);
        assert!((found.data[found.rows[0]] - 0.1).abs() < 1e-12);
        assert!(pairs.relative(&baseline, &baseline, &frame[1..]).is_err());
    }
}
