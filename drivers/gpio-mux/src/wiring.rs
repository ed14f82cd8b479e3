//! The board's wiring, limits and time as plain data.

use std::time::Duration;

use survey::{
    Amps, Dipole, RelayLimits, RelayTable, Sensing, Transition, Volts, Wiring, WiringError,
};

use crate::command::Pole;

/// Most electrodes: two 16-way chips a pole.
const MOST_ELECTRODES: usize = 32;

/// Limits of a CD74HC4067 at 5 V: 25 mA, and 0.5 V below the supply.
pub const RELAY_LIMITS: RelayLimits = RelayLimits {
    current: Amps(0.025),
    voltage: Volts(4.5),
};

/// Time of one command and its reply on the serial line; the switching time of the chips is negligible.
pub const ROUND_TRIP: Duration = Duration::from_micros(1500);

/// The wiring of a board for this number of electrodes: four poles, any electrode on each. The current is set to 0 A
/// before a pole moves.
///
/// # Errors
/// More than 32 electrodes.
pub fn wiring(electrodes: usize) -> Result<Wiring, WiringError> {
    let name = "gpio board".to_owned();
    if electrodes > MOST_ELECTRODES {
        return Err(WiringError::TooMany {
            wiring: name,
            electrodes,
            most: MOST_ELECTRODES,
        });
    }
    let pairs = |plus: Pole, minus: Pole| {
        let each = (0..electrodes).map(|k| Dipole::adjacent(k, electrodes));
        each.map(|pair| vec![plus.relay(pair.plus), minus.relay(pair.minus)])
            .collect()
    };
    Wiring::from_table(RelayTable {
        name,
        sensing: Sensing::Single,
        transition: Transition::Break,
        inject: pairs(Pole::IPlus, Pole::IMinus),
        measure: pairs(Pole::VPlus, Pole::VMinus),
        bus: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use survey::Relay;

    use super::*;

    #[test]
    fn last_pair_wraps_round_on_both_poles() {
        let board = wiring(26).unwrap();
        let last = Dipole::adjacent(25, 26);
        assert_eq!(board.injecting(last), Some(&[Relay(126), Relay(201)][..]));
        assert_eq!(board.measuring(last), Some(&[Relay(326), Relay(401)][..]));
        assert!(wiring(33).is_err());
    }
}
