//! Noise of the voltmeter, and channels and wires with more noise than the others.

use crate::assessment::pairs::named;
use crate::assessment::{Assessment, NOISY_CHANNEL_FACTOR};
use crate::median::median;
use crate::report::{CheckOutcome, ReportLine};

/// Sum of squared deviations from the mean, and its degrees of freedom.
type Spread = (f64, f64);

fn deviation((squares, freedom): Spread) -> Option<f64> {
    (freedom > 0.0).then(|| (squares / freedom).sqrt())
}

/// The spread of the readings of one position over the rows.
fn spread(rows: &[Vec<Option<f64>>], place: usize) -> Spread {
    let read: Vec<f64> = rows
        .iter()
        .filter_map(|row| row.get(place).copied().flatten())
        .collect();
    if read.len() < 2 {
        return (0.0, 0.0);
    }
    let mean = read.iter().sum::<f64>() / read.len() as f64;
    let squares = read.iter().map(|volts| (volts - mean) * (volts - mean));
    (squares.sum(), read.len() as f64 - 1.0)
}

impl Assessment<'_> {
    /// Standard deviation of each measuring pair's reading at 0 A.
    fn at_zero(&self) -> Vec<Option<f64>> {
        (0..self.wiring.measure.len())
            .map(|pair| deviation(spread(&self.raw.zero, pair)))
            .collect()
    }

    /// The median noise of the measuring pairs at 0 A, V, and the pairs that are noisy ([`NOISY_CHANNEL_FACTOR`]).
    fn noisy(&self, noise_v: f64) -> (f64, Vec<usize>) {
        let each = self.at_zero();
        let usual = median(each.iter().copied().flatten()).unwrap_or(0.0);
        // noise up to the configured one never makes a channel noisy
        let most = NOISY_CHANNEL_FACTOR * usual.max(noise_v);
        let noisy = (0..each.len()).filter(|pair| each[*pair].is_some_and(|noise| noise > most));
        (usual, noisy.collect())
    }

    /// Standard deviation of one reading while current flows, pooled over the repeated positions that are not noisier
    /// than the others.
    pub(super) fn noise(&self, noise_v: f64) -> Option<f64> {
        let (_, noisy) = self.noisy(noise_v);
        let places = self.raw.repeats.first()?.len();
        let pooled = (0..places)
            .filter(|place| !noisy.contains(place))
            .map(|place| spread(&self.raw.repeats, place))
            .fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
        deviation(pooled)
    }

    /// Reports the noise of every measuring pair. Of exactly two neighbouring noisy pairs the shared electrode is
    /// named, of any other noisy pair its relays.
    pub(super) fn channels(
        &self,
        noise_v: f64,
        findings: &mut Vec<String>,
        lines: &mut Vec<ReportLine>,
    ) {
        let (usual, noisy) = self.noisy(noise_v);
        let each = self.at_zero();
        let n = each.len();
        let is_noisy = |pair: usize| noisy.contains(&(pair % n));
        let size = |pair: usize| 1e6 * each[pair].unwrap_or(0.0);
        let usual_uv = 1e6 * usual;
        for pair in &noisy {
            let last = (pair + n - 1) % n;
            let next = (pair + 1) % n;
            let (ends, relays) = &self.wiring.measure[*pair];
            if is_noisy(next) && !is_noisy(last) && !is_noisy(next + 1) {
                findings.push(format!(
                    "electrode {}: noisy, {:.0} uV in one reading where the others have {usual_uv:.1}; check its wire \
                     and its contact with the sheet",
                    self.wiring.measure[next].0.plus,
                    size(*pair).max(size(next))
                ));
            } else if !(is_noisy(last) && !is_noisy(next) && !is_noisy(last + n - 1)) {
                findings.push(format!(
                    "{}: noisy, {:.0} uV in one reading where the others have {usual_uv:.1}; check its contacts and \
                     the wires of electrodes {} and {}",
                    named(relays),
                    size(*pair),
                    ends.plus,
                    ends.minus
                ));
            }
        }
        for (pair, (_, relays)) in self.wiring.measure.iter().enumerate() {
            lines.push(ReportLine {
                subject: named(relays),
                check: "noise",
                verdict: match each[pair] {
                    None => CheckOutcome::NotJudged,
                    Some(_) if is_noisy(pair) => CheckOutcome::Failed,
                    Some(_) => CheckOutcome::Ok,
                },
                measured: each[pair],
                expected: Some(usual.max(noise_v)),
                unit: "V",
                text: String::new(),
            });
        }
    }
}
