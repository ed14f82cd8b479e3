//! Electrodes on a ring, and the pairs of them that a current source or a voltmeter is joined to.

use std::fmt;

use serde::{Deserialize, Serialize};

/// An electrode: counted from 0 in programs and case folders, shown to people from 1 as in the paper. Only
/// [`Electrode::from_number`] and [`Electrode::number`] convert between the two.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Electrode(pub usize);

impl Electrode {
    /// From the number that a person writes, 1 or more. `None` for 0.
    pub fn from_number(number: usize) -> Option<Self> {
        number.checked_sub(1).map(Self)
    }

    /// The number that a person reads, 1 or more.
    pub fn number(self) -> usize {
        self.0 + 1
    }
}

impl fmt::Display for Electrode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.number())
    }
}

/// Two electrodes with a direction: current enters at `plus` and leaves at `minus`, or a reading is U\[plus\] -
/// U\[minus\].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Dipole {
    /// Source of the current, or the voltmeter's HI.
    pub plus: Electrode,
    /// Sink of the current, or the voltmeter's LO.
    pub minus: Electrode,
}

impl Dipole {
    /// From electrode k to its next neighbour on a ring of `ring` electrodes: (k, k+1), the last with the first.
    pub fn adjacent(k: usize, ring: usize) -> Self {
        Self::skip(k, 0, ring)
    }

    /// From electrode k to the one `skip` electrodes beyond its neighbour: (k, k+1+skip) round the ring.
    pub fn skip(k: usize, skip: usize, ring: usize) -> Self {
        Self {
            plus: Electrode(k % ring),
            minus: Electrode((k + 1 + skip) % ring),
        }
    }

    /// Whether the two pairs share an electrode.
    pub fn touches(self, other: Self) -> bool {
        self.contains(other.plus) || self.contains(other.minus)
    }

    /// Whether the electrode is one of the two.
    pub fn contains(self, electrode: Electrode) -> bool {
        self.plus == electrode || self.minus == electrode
    }
}

impl fmt::Display for Dipole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.plus, self.minus)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn people_count_from_one() {
        assert_eq!(Electrode::from_number(26), Some(Electrode(25)));
        assert_eq!(Electrode::from_number(0), None);
        assert_eq!(Dipole::adjacent(25, 26).to_string(), "26-1");
    }

    #[test]
    fn neighbours_touch_and_strangers_do_not() {
        let drive = Dipole::adjacent(0, 26);
        assert!(drive.touches(Dipole::adjacent(1, 26)));
        assert!(drive.touches(Dipole::adjacent(25, 26)));
        assert!(!drive.touches(Dipole::adjacent(2, 26)));
    }
}
