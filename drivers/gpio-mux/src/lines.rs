//! The board's 24 lines (fact sheet section 2): their numbers, and the connections that their levels make.
//!
//! Each pole has six lines: the address S0 to S3, shared by both chips, and an enable for each chip. Lines are numbered
//! from 0, pole by pole in the order of [`Pole::ALL`]. Levels are logical: an enable that is set is on, independent of
//! its polarity at the chip.

use std::collections::BTreeSet;
use std::fmt;

use survey::{Electrode, Relay};

use crate::command::{Pole, State};

/// Number of lines.
pub const LINES: u32 = 24;

/// One of the two chips of a pole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Chip {
    /// Electrodes 1 to 16.
    A,
    /// Electrodes 17 to 32.
    B,
}

impl Chip {
    /// The chip of an electrode; `None` beyond the 32 electrodes of two chips.
    pub fn of(electrode: Electrode) -> Option<Self> {
        match electrode.0 {
            0..=15 => Some(Self::A),
            16..=31 => Some(Self::B),
            _ => None,
        }
    }

    fn first(self) -> usize {
        match self {
            Self::A => 0,
            Self::B => 16,
        }
    }
}

/// The function of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Line {
    /// One bit, 0 to 3, of a pole's address.
    Address(Pole, u8),
    /// A chip's enable.
    Enable(Pole, Chip),
}

impl Line {
    /// Every line, by number.
    pub fn all() -> impl Iterator<Item = Self> {
        Pole::ALL.into_iter().flat_map(|pole| {
            let address = (0..4).map(move |bit| Self::Address(pole, bit));
            address.chain([Chip::A, Chip::B].map(|chip| Self::Enable(pole, chip)))
        })
    }

    /// The line's number, 0 to 23.
    pub fn number(self) -> u32 {
        let (pole, place) = match self {
            // A bit beyond the address counts as its last one, so that every line has a number.
            Self::Address(pole, bit) => (pole, u32::from(bit.min(3))),
            Self::Enable(pole, Chip::A) => (pole, 4),
            Self::Enable(pole, Chip::B) => (pole, 5),
        };
        pole.index() as u32 * 6 + place
    }

    /// The line's bit among the levels.
    pub fn mask(self) -> u32 {
        1 << self.number()
    }
}

impl fmt::Display for Line {
    /// The name of the line: `I+.S0`, `V-.EN_B`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address(pole, bit) => write!(f, "{pole}.S{bit}"),
            Self::Enable(pole, chip) => write!(f, "{pole}.EN_{chip:?}"),
        }
    }
}

/// The levels of all lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Levels(pub u32);

impl Levels {
    /// The mask of both enables of a pole.
    pub fn enables(pole: Pole) -> u32 {
        Line::Enable(pole, Chip::A).mask() | Line::Enable(pole, Chip::B).mask()
    }

    /// The mask of the address lines of a pole.
    pub fn addresses(pole: Pole) -> u32 {
        (0..4).map(|bit| Line::Address(pole, bit).mask()).sum()
    }

    /// The levels of the address lines of a pole that select an electrode.
    pub fn address_of(pole: Pole, electrode: Electrode) -> u32 {
        let address = electrode.0 % 16;
        (0..4)
            .filter(|bit| address & 1 << bit != 0)
            .map(|bit| Line::Address(pole, bit).mask())
            .sum()
    }

    /// Whether a line is set.
    pub fn is_set(self, line: Line) -> bool {
        self.0 & line.mask() != 0
    }

    /// These levels with the lines of a mask at those of `bits`.
    pub fn with(self, mask: u32, bits: u32) -> Self {
        Self(self.0 & !mask | bits & mask)
    }

    /// The electrodes connected to a pole: one for every chip that is enabled.
    pub fn electrodes(self, pole: Pole) -> impl Iterator<Item = Electrode> {
        let address: usize = (0..4)
            .filter(|bit| self.is_set(Line::Address(pole, *bit)))
            .map(|bit| 1 << bit)
            .sum();
        [Chip::A, Chip::B]
            .into_iter()
            .filter(move |chip| self.is_set(Line::Enable(pole, *chip)))
            .map(move |chip| Electrode(chip.first() + address))
    }

    /// The electrode on each pole; the lower one if there are two.
    pub fn state(self) -> State {
        State(Pole::ALL.map(|pole| self.electrodes(pole).next()))
    }

    /// All connections, as relay numbers of a wiring.
    pub fn joined(self) -> BTreeSet<Relay> {
        let joined = |pole: Pole| self.electrodes(pole).map(move |one| pole.relay(one));
        Pole::ALL.into_iter().flat_map(joined).collect()
    }
}

/// One simultaneous change of several lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Step {
    /// The lines that change.
    pub mask: u32,
    /// The levels of these lines.
    pub bits: u32,
}

/// The steps from one state to another: enables off, addresses, enables on, each only if needed (section 3). Electrodes
/// beyond a pole's two chips are ignored; callers reject them first.
pub fn steps(from: State, to: State) -> Vec<Step> {
    let moving: Vec<Pole> = Pole::ALL
        .into_iter()
        .filter(|pole| from.on(*pole) != to.on(*pole))
        .collect();
    let mut off = Step { mask: 0, bits: 0 };
    let mut address = off;
    let mut on = off;
    for pole in moving {
        if from.on(pole).is_some() {
            off.mask |= Levels::enables(pole);
        }
        if let Some(electrode) = to.on(pole)
            && let Some(chip) = Chip::of(electrode)
        {
            address.mask |= Levels::addresses(pole);
            address.bits |= Levels::address_of(pole, electrode);
            let enable = Line::Enable(pole, chip).mask();
            on.mask |= enable;
            on.bits |= enable;
        }
    }
    let steps = [off, address, on].into_iter();
    steps.filter(|step| step.mask != 0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_has_a_number_and_a_name_of_its_own() {
        let lines: Vec<Line> = Line::all().collect();
        assert_eq!(lines.len(), LINES as usize);
        for (number, line) in (0..).zip(&lines) {
            assert_eq!(line.number(), number);
        }
        let names: BTreeSet<String> = lines.iter().map(Line::to_string).collect();
        assert_eq!(names.len(), lines.len());
        assert!(names.contains("I+.S0") && names.contains("V-.EN_B"));
    }

    #[test]
    fn electrodes_are_those_of_the_map() {
        // Section 2: chip A up to 16, S3..S0 = (n - 1) mod 16.
        for (number, chip, address) in [
            (1, Chip::A, 0),
            (16, Chip::A, 15),
            (17, Chip::B, 0),
            (26, Chip::B, 9),
        ] {
            let electrode = Electrode(number - 1);
            assert_eq!(Chip::of(electrode), Some(chip));
            let bits = Levels::address_of(Pole::IMinus, electrode);
            assert_eq!(bits >> 6, address);
            let levels = Levels(bits | Line::Enable(Pole::IMinus, chip).mask());
            assert_eq!(levels.state().on(Pole::IMinus), Some(electrode));
            assert_eq!(levels.joined(), [Relay(200 + number as u32)].into());
        }
    }
}
