//! Results from the readings alone: the part of the sheet's pattern in them, reciprocity, van der Pauw.

use crate::assessment::Assessment;
use crate::median::median;
use crate::van_der_pauw::sheet_resistance;

impl Assessment<'_> {
    /// Whether two pairs share an electrode, or are the same.
    pub(super) fn share_electrode(&self, one: usize, other: usize) -> bool {
        let apart = (one + self.n - other) % self.n;
        apart <= 1 || apart == self.n - 1
    }

    /// The readings whose driven and sensed pair share no electrode: driven pair, sensed pair, measured and expected
    /// value, ohm.
    pub(super) fn readings(&self) -> impl Iterator<Item = (usize, usize, f64, f64)> + '_ {
        (0..self.n).flat_map(move |drive| {
            (0..self.n)
                .filter(move |sense| !self.share_electrode(drive, *sense))
                .filter_map(move |sense| {
                    let read = self.matrix[drive][sense]?;
                    Some((drive, sense, read, self.sheet.pair(drive, sense)))
                })
        })
    }

    /// Ratio of the sheet's resistance to the configured one: the median over all readings, which a few relays and
    /// electrodes at fault do not change.
    pub(super) fn factor(&self) -> Option<f64> {
        let median = median(self.readings().map(|(.., read, model)| read / model))?;
        (median > 1e-6 && median < 1e6).then_some(median)
    }

    /// Fits the expected values to these (measured, expected) readings: the factor, and the unexplained rest; `None`
    /// for fewer than three readings.
    pub(super) fn gain(readings: impl Iterator<Item = (f64, f64)>) -> Option<(f64, f64)> {
        let readings: Vec<(f64, f64)> = readings.collect();
        let power: f64 = readings.iter().map(|(_, model)| model * model).sum();
        let shared: f64 = readings.iter().map(|(read, model)| read * model).sum();
        if readings.len() < 3 || power == 0.0 {
            return None;
        }
        let gain = shared / power;
        let rest: f64 = readings
            .iter()
            .map(|(read, model)| (read - gain * model).powi(2))
            .sum();
        Some((gain, (rest / power).sqrt()))
    }

    pub(super) fn misfit(&self) -> Option<f64> {
        let (mut rest, mut power) = (0.0, 0.0);
        for (.., read, model) in self.readings() {
            rest += (read - model) * (read - model);
            power += model * model;
        }
        (power > 0.0).then(|| (rest / power).sqrt())
    }

    pub(super) fn reciprocity(&self) -> Option<f64> {
        let (mut differing, mut power) = (0.0, 0.0);
        for (drive, sense, read, _) in self.readings() {
            if let Some(exchanged) = self.matrix[sense][drive] {
                differing += (read - exchanged) * (read - exchanged);
                power += read * read;
            }
        }
        (power > 0.0).then(|| (differing / power).sqrt())
    }

    /// Sheet resistance, ohm, by van der Pauw's formula on four electrodes a quarter ring apart, whose readings are
    /// superposed from those of neighbouring pairs: the raw value, and the value corrected by the error of the formula
    /// on a model sheet of known resistance. Every placement of the four electrodes is tried until one has all
    /// readings; a missing reading is replaced by its reciprocal.
    pub(super) fn van_der_pauw(&self) -> Option<(f64, f64)> {
        let n = self.n;
        let quarter = |place: usize| (place * n + 2) / 4;
        let corners = [0, 1, 2, 3].map(quarter);
        let resistance = |matrix: &dyn Fn(usize, usize) -> Option<f64>,
                          drive: (usize, usize),
                          sense: (usize, usize)| {
            let mut sum = 0.0;
            for from in drive.0..drive.1 {
                for to in sense.0..sense.1 {
                    sum += matrix(from % n, to % n)?;
                }
            }
            Some(sum.abs())
        };
        let formula = |matrix: &dyn Fn(usize, usize) -> Option<f64>, shift: usize| {
            let [a, b, c, d] = corners.map(|corner| corner + shift);
            let first = resistance(matrix, (a, b), (c, d))?;
            let second = resistance(matrix, (b, c), (d, a + n))?;
            sheet_resistance(first, second)
        };
        let read =
            |drive: usize, sense: usize| self.matrix[drive][sense].or(self.matrix[sense][drive]);
        let model = |drive: usize, sense: usize| Some(self.sheet.pair(drive, sense));
        (0..n).find_map(|shift| {
            let raw = formula(&read, shift)?;
            let correction = self.sheet.sheet_ohm / formula(&model, shift)?;
            Some((raw, raw * correction))
        })
    }
}
