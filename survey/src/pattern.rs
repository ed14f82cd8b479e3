//! Stimulation patterns as iterators, and the protocol: the ordered list of a frame's measurements.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::{Dipole, Electrode, Reading};

/// One measurement: drive current through one pair, read the voltage across another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Measurement {
    /// Current enters at `drive.plus` and leaves at `drive.minus`.
    pub drive: Dipole,
    /// The reading is U\[sense.plus\] - U\[sense.minus\].
    pub sense: Dipole,
}

impl Measurement {
    /// The same transfer resistance with source and voltmeter exchanged (reciprocity).
    pub fn reciprocal(self) -> Self {
        Self {
            drive: self.sense,
            sense: self.drive,
        }
    }

    /// The electrodes that it drives and senses: plus and minus of each.
    pub fn electrodes(self) -> [Electrode; 4] {
        let Self { drive, sense } = self;
        [drive.plus, drive.minus, sense.plus, sense.minus]
    }
}

/// The Sheffield adjacent pattern: drive each neighbouring pair, sense every pair that shares no electrode with it.
/// Drives in ring order, sensing pairs ascending; `ring (ring - 3)` measurements.
///
/// ```
/// assert_eq!(survey::sheffield(26).count(), 598);
/// ```
pub fn sheffield(ring: usize) -> impl Iterator<Item = Measurement> + Clone {
    skip(ring, 0)
}

/// Like [`sheffield`], with `skip` electrodes between the two of each driving and sensing pair.
pub fn skip(ring: usize, skip: usize) -> impl Iterator<Item = Measurement> + Clone {
    (0..ring)
        .map(move |k| Dipole::skip(k, skip, ring))
        .flat_map(move |drive| {
            (0..ring)
                .map(move |m| Dipole::skip(m, skip, ring))
                .filter(move |sense| !sense.touches(drive))
                .map(move |sense| Measurement { drive, sense })
        })
}

/// Keeps the first measurement of each reciprocal pair: half the readings, the same information.
pub fn half(pattern: impl Iterator<Item = Measurement>) -> impl Iterator<Item = Measurement> {
    let mut requested = BTreeSet::new();
    pattern.filter(move |measurement| {
        requested.insert(*measurement);
        !requested.contains(&measurement.reciprocal())
    })
}

/// All measurements of a frame in the order of its readings, and the number of electrodes on the ring.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Unchecked")]
pub struct Protocol {
    electrodes: usize,
    measurements: Vec<Measurement>,
}

#[derive(Deserialize)]
struct Unchecked {
    electrodes: usize,
    measurements: Vec<Measurement>,
}

impl TryFrom<Unchecked> for Protocol {
    type Error = ProtocolError;
    fn try_from(unchecked: Unchecked) -> Result<Self, ProtocolError> {
        Self::new(unchecked.electrodes, unchecked.measurements)
    }
}

/// Why a list of measurements is not a protocol.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProtocolError {
    /// A measurement names an electrode that the ring does not have.
    #[error("reading {reading} names electrode {electrode}, but there are {electrodes} electrodes")]
    NoSuchElectrode {
        /// Index of the measurement, from 0.
        reading: usize,
        /// The electrode named.
        electrode: Electrode,
        /// Size of the ring.
        electrodes: usize,
    },
    /// Both ends of a pair are the same electrode.
    #[error("reading {reading} joins electrode {electrode} to itself")]
    Degenerate {
        /// Index of the measurement, from 0.
        reading: usize,
        /// The electrode named twice.
        electrode: Electrode,
    },
    /// No measurements.
    #[error(
        "the protocol has no measurement; it needs at least one, and the Sheffield pattern at least 4 electrodes"
    )]
    Empty,
}

impl Protocol {
    /// Checks every measurement against the ring.
    pub fn new(electrodes: usize, measurements: Vec<Measurement>) -> Result<Self, ProtocolError> {
        if measurements.is_empty() {
            return Err(ProtocolError::Empty);
        }
        for (reading, measurement) in measurements.iter().enumerate() {
            for pair in [measurement.drive, measurement.sense] {
                for electrode in [pair.plus, pair.minus] {
                    if electrode.0 >= electrodes {
                        return Err(ProtocolError::NoSuchElectrode {
                            reading,
                            electrode,
                            electrodes,
                        });
                    }
                }
                if pair.plus == pair.minus {
                    return Err(ProtocolError::Degenerate {
                        reading,
                        electrode: pair.plus,
                    });
                }
            }
        }
        Ok(Self {
            electrodes,
            measurements,
        })
    }

    /// The Sheffield adjacent pattern on `electrodes` electrodes (at least 4).
    ///
    /// # Errors
    /// [`ProtocolError::Empty`] for fewer than 4 electrodes.
    pub fn sheffield(electrodes: usize) -> Result<Self, ProtocolError> {
        if electrodes < 4 {
            return Err(ProtocolError::Empty);
        }
        Self::new(electrodes, sheffield(electrodes).collect())
    }

    /// Size of the ring.
    pub fn electrodes(&self) -> usize {
        self.electrodes
    }

    /// All measurements in the order of a frame's readings.
    pub fn measurements(&self) -> &[Measurement] {
        &self.measurements
    }

    /// Number of readings of a frame.
    pub fn len(&self) -> usize {
        self.measurements.len()
    }

    /// Always false: a protocol has at least one measurement.
    pub fn is_empty(&self) -> bool {
        self.measurements.is_empty()
    }

    /// The driving pairs in the order of their first use, each once.
    pub fn drives(&self) -> Vec<Dipole> {
        let mut seen = BTreeSet::new();
        self.measurements
            .iter()
            .map(|measurement| measurement.drive)
            .filter(|drive| seen.insert(*drive))
            .collect()
    }

    /// For each reading the index of its reciprocal twin, if the protocol has both.
    pub fn reciprocal_twins(&self) -> Vec<Option<usize>> {
        let index: std::collections::BTreeMap<_, _> = self
            .measurements
            .iter()
            .enumerate()
            .map(|(reading, measurement)| (*measurement, reading))
            .collect();
        self.measurements
            .iter()
            .map(|measurement| index.get(&measurement.reciprocal()).copied())
            .collect()
    }

    /// Selects the readings of this protocol from the readings of `requested`: each measurement is matched by itself or
    /// by its reciprocal, so a half frame fills a whole one. `None` if a measurement has neither, or the number of
    /// readings differs from the number of measurements in `requested`.
    pub fn answered_by(&self, requested: &Self, readings: &[Reading]) -> Option<Vec<Reading>> {
        if requested.len() != readings.len() {
            return None;
        }
        let answers: std::collections::BTreeMap<_, _> = requested
            .measurements
            .iter()
            .copied()
            .zip(readings)
            .collect();
        self.measurements
            .iter()
            .map(|measurement| {
                let own = answers.get(measurement);
                own.or_else(|| answers.get(&measurement.reciprocal()))
                    .map(|reading| **reading)
            })
            .collect()
    }

    /// SHA-256 over ring size and measurements, hex: identifies the protocol of a model or baseline.
    pub fn hash(&self) -> String {
        let mut hasher = Sha256::new();
        hasher.update((self.electrodes as u64).to_le_bytes());
        for measurement in &self.measurements {
            for electrode in [
                measurement.drive.plus,
                measurement.drive.minus,
                measurement.sense.plus,
                measurement.sense.minus,
            ] {
                hasher.update((electrode.0 as u64).to_le_bytes());
            }
        }
        hex(&hasher.finalize())
    }
}

/// Bytes as lower-case hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paper_pattern_has_598_readings_of_26_electrodes() {
        assert_eq!(sheffield(26).count(), 26 * 23);
        assert_eq!(half(sheffield(26)).count(), 299);
    }

    #[test]
    fn the_order_is_source_major_and_ascending() {
        let protocol = Protocol::sheffield(16).unwrap();
        let first: Vec<_> = protocol.measurements()[..3]
            .iter()
            .map(|q| (q.drive.to_string(), q.sense.to_string()))
            .collect();
        assert_eq!(
            first,
            [
                ("1-2".into(), "3-4".into()),
                ("1-2".into(), "4-5".into()),
                ("1-2".into(), "5-6".into())
            ]
        );
        assert_eq!(protocol.len(), 208);
        // the first sensing pair of the second drive, 2-3, is 4-5
        assert_eq!(protocol.measurements()[13].drive, Dipole::adjacent(1, 16));
        assert_eq!(protocol.measurements()[13].sense, Dipole::adjacent(3, 16));
    }

    #[test]
    fn a_skip_pattern_is_one_more_iterator() {
        // skip 1 on 8 electrodes: each pair shares an electrode with itself and two others
        assert_eq!(skip(8, 1).count(), 8 * 5);
    }

    #[test]
    fn every_sheffield_reading_has_its_twin() {
        let protocol = Protocol::sheffield(26).unwrap();
        let twins = protocol.reciprocal_twins();
        for (reading, twin) in twins.iter().enumerate() {
            assert_eq!(twins[twin.unwrap()], Some(reading));
        }
    }

    #[test]
    fn a_half_frame_answers_a_whole_one_by_reciprocity() {
        let whole = Protocol::sheffield(8).unwrap();
        let requested = Protocol::new(8, half(sheffield(8)).collect()).unwrap();
        let reading_of = |measurement: &Measurement| {
            let pairs = [measurement.drive.plus.0, measurement.sense.plus.0];
            let (low, high) = (pairs[0].min(pairs[1]), pairs[0].max(pairs[1]));
            Reading::Ok(crate::Volts((10 * low + high) as f64))
        };
        let readings: Vec<Reading> = requested.measurements().iter().map(reading_of).collect();
        let completed = whole.answered_by(&requested, &readings).unwrap();
        assert_eq!(completed.len(), 2 * readings.len());
        for (measurement, reading) in whole.measurements().iter().zip(&completed) {
            assert_eq!(*reading, reading_of(measurement));
        }
        assert_eq!(whole.answered_by(&requested, &readings[1..]), None);
        let skipped = Protocol::new(8, skip(8, 1).collect()).unwrap();
        assert_eq!(skipped.answered_by(&requested, &readings), None);
    }

    #[test]
    fn a_stranger_electrode_is_refused_by_name() {
        let measurement = Measurement {
            drive: Dipole::adjacent(0, 30),
            sense: Dipole::adjacent(28, 30),
        };
        let refusal = Protocol::new(26, vec![measurement]).unwrap_err();
        assert_eq!(
            refusal.to_string(),
            "reading 0 names electrode 29, but there are 26 electrodes"
        );
    }
}
