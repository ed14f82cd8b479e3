//! Voltages and currents of neighbouring pairs of electrodes; those of any other pair are sums of these.

use nalgebra::{DMatrix, DVector};
use survey::{Dipole, Protocol};

use super::Forward;

/// Voltages of neighbouring electrodes for 1 A through neighbouring electrodes: they determine the readings of any
/// protocol.
pub(super) struct Ring {
    /// A column per driven pair, without the drops over eliminated contacts.
    pub(super) volts: Vec<f64>,
    /// Resistance of each eliminated contact, ohm.
    pub(super) drops: Vec<f64>,
}

impl Ring {
    /// The readings of a protocol.
    pub(super) fn readings(&self, forward: &Forward, protocol: &Protocol) -> DVector<f64> {
        let count = forward.layout.electrodes.len();
        let volts = protocol.measurements().iter().map(|question| {
            let (drive, sense) = (arc(question.drive, count), arc(question.sense, count));
            let mut sum = 0.0;
            for a in drive.pairs(count) {
                for b in sense.pairs(count) {
                    sum += self.volts[a * count + b];
                }
            }
            let mut volts = drive.sign * sense.sign * sum;
            for (at, into) in [(question.drive.plus, 1.0), (question.drive.minus, -1.0)] {
                for (seen, sign) in [(question.sense.plus, 1.0), (question.sense.minus, -1.0)] {
                    if at == seen {
                        volts += into * sign * self.drops[at.0];
                    }
                }
            }
            volts
        });
        DVector::from_iterator(protocol.len(), volts)
    }
}

/// The neighbouring pairs whose sum is a given pair, the shorter way round.
pub(crate) struct Arc {
    first: usize,
    length: usize,
    pub(crate) sign: f64,
}

impl Arc {
    /// Pair k joins electrodes k and k + 1.
    pub(crate) fn pairs(&self, count: usize) -> impl Iterator<Item = usize> {
        let first = self.first;
        (0..self.length).map(move |k| (first + k) % count)
    }
}

pub(crate) fn arc(pair: Dipole, count: usize) -> Arc {
    let (plus, minus) = (pair.plus.0, pair.minus.0);
    let ahead = (minus + count - plus) % count;
    if 2 * ahead <= count {
        Arc {
            first: plus,
            length: ahead,
            sign: 1.0,
        }
    } else {
        Arc {
            first: minus,
            length: count - ahead,
            sign: -1.0,
        }
    }
}

/// 1 A in at each electrode and out at the next: a column per pair.
pub(super) fn neighbours(count: usize) -> DMatrix<f64> {
    DMatrix::from_fn(count, count, |electrode, pair| {
        let enters = f64::from(u8::from(electrode == pair));
        let leaves = f64::from(u8::from(electrode == (pair + 1) % count));
        enters - leaves
    })
}
