//! Wiring maps of section 8: the channels that connect each pair of electrodes to the source and to the voltmeter.

use survey::{Dipole, Electrode, Relay, RelayTable, Sensing, Transition, Wiring, WiringError};

/// Why a wiring map is invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MapError {
    /// A slot outside the mainframe.
    #[error("wiring '{wiring}': slot {slot} does not exist, slots are 1 to 8")]
    Slot {
        /// The wiring's name.
        wiring: String,
        /// The slot given.
        slot: u32,
    },
    /// Two modules have the same slot.
    #[error(
        "wiring '{wiring}': slot {slot} cannot hold both the measuring and the injecting module"
    )]
    OneSlot {
        /// The wiring's name.
        wiring: String,
        /// The slot.
        slot: u32,
    },
    /// The module has too few channels.
    #[error(transparent)]
    Wiring(#[from] WiringError),
}

/// Map M: measuring pair k on channel k of bank 1 of a 34924A, scanned by the voltmeter; injecting pair k on channel
/// 35+k of bank 2. Two to 35 electrodes.
///
/// # Errors
/// A slot outside 1 to 8, or more pairs than a bank has.
pub fn pairs_34924a(slot: u32, electrodes: usize) -> Result<Wiring, MapError> {
    let name = format!("34924A pairs in slot {slot}");
    pairs(name, slot, slot, electrodes)
}

/// Map M on a 34922A: the channel numbers of [`pairs_34924a`] on armature relays, which have less noise and are slower.
///
/// # Errors
/// As [`pairs_34924a`].
pub fn pairs_34922a(slot: u32, electrodes: usize) -> Result<Wiring, MapError> {
    let name = format!("34922A pairs in slot {slot}");
    pairs(name, slot, slot, electrodes)
}

/// Map F: measuring pair k on channel k of a 34925A, across both banks; injecting pair k on channel 35+k, in bank 2 of
/// a 34924A in another slot. Two to 35 electrodes.
///
/// # Errors
/// A slot outside 1 to 8, one slot for both modules, or more pairs than a bank has.
pub fn fast_34925a(slot: u32, inject_slot: u32, electrodes: usize) -> Result<Wiring, MapError> {
    let wiring = format!("34925A pairs in slot {slot}, injected by slot {inject_slot}");
    if slot == inject_slot {
        check_size(&wiring, slot, electrodes, 35)?;
        return Err(MapError::OneSlot { wiring, slot });
    }
    pairs(wiring, slot, inject_slot, electrodes)
}

/// Map X: pairs on one 34932A as a 4 x 32 matrix: row 1 (columns 1 to 16) and row 5 (17 to 32) to the voltmeter through
/// relay 921, rows 2 and 6 to the source. One reading a message. Up to 32 electrodes.
///
/// # Errors
/// A slot outside 1 to 8, or more than 32 electrodes.
pub fn matrix_34932a(slot: u32, electrodes: usize) -> Result<Wiring, MapError> {
    let name = format!("34932A matrix in slot {slot}");
    check_size(&name, slot, electrodes, 32)?;
    let row = |upper: u32, lower: u32| {
        move |k: usize| match u32::try_from(k).unwrap_or(u32::MAX) {
            k @ 0..16 => vec![upper * 100 + k + 1],
            k => vec![lower * 100 + k - 15],
        }
    };
    let bus = &[921];
    table(
        name,
        Sensing::Single,
        electrodes,
        [slot; 2],
        row(2, 6),
        row(1, 5),
        bus,
    )
}

/// Map Z: single electrodes on a 34934A as 4 x 128, rows I+ (101 up), I- (301), V+ (501), V- (701), the voltmeter at
/// the rear connector. One reading a message. Up to 128 electrodes.
///
/// # Errors
/// A slot outside 1 to 8, or more than 128 electrodes.
pub fn matrix_34934a(slot: u32, electrodes: usize) -> Result<Wiring, MapError> {
    let name = format!("34934A matrix in slot {slot}");
    check_size(&name, slot, electrodes, 128)?;
    let rows = |plus: u32, minus: u32| {
        move |k: usize| {
            let pair = Dipole::adjacent(k, electrodes);
            let on = |row: u32, electrode: Electrode| row * 100 + electrode.number() as u32;
            vec![on(plus, pair.plus), on(minus, pair.minus)]
        }
    };
    table(
        name,
        Sensing::Single,
        electrodes,
        [slot; 2],
        rows(1, 3),
        rows(5, 7),
        &[],
    )
}

fn pairs(name: String, slot: u32, inject_slot: u32, electrodes: usize) -> Result<Wiring, MapError> {
    for slot in [slot, inject_slot] {
        check_size(&name, slot, electrodes, 35)?;
    }
    let from = |first: u32| move |k: usize| vec![first + k as u32];
    table(
        name,
        Sensing::Scan,
        electrodes,
        [inject_slot, slot],
        from(36),
        from(1),
        &[],
    )
}

/// A wiring in which pair k has these channels, in the slots of the injecting and of the measuring module.
fn table(
    name: String,
    sensing: Sensing,
    electrodes: usize,
    [inject_slot, slot]: [u32; 2],
    inject: impl Fn(usize) -> Vec<u32>,
    measure: impl Fn(usize) -> Vec<u32>,
    bus: &[u32],
) -> Result<Wiring, MapError> {
    let relays = |slot: u32, channels: Vec<u32>| -> Vec<Relay> {
        let relay = |channel| Relay(slot * 1000 + channel);
        channels.into_iter().map(relay).collect()
    };
    Ok(Wiring::from_table(RelayTable {
        name,
        sensing,
        transition: Transition::Overlap,
        inject: (0..electrodes)
            .map(|k| relays(inject_slot, inject(k)))
            .collect(),
        measure: (0..electrodes).map(|k| relays(slot, measure(k))).collect(),
        bus: relays(slot, bus.to_vec()),
    })?)
}

fn check_size(wiring: &str, slot: u32, electrodes: usize, most: usize) -> Result<(), MapError> {
    let wiring = wiring.to_owned();
    if !(1..=8).contains(&slot) {
        return Err(MapError::Slot { wiring, slot });
    }
    if electrodes > most {
        return Err(MapError::Wiring(WiringError::TooMany {
            wiring,
            electrodes,
            most,
        }));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use survey::{Amps, Plan, Protocol, Volts};

    use super::*;
    use crate::Model;

    #[test]
    fn maps_have_the_channels_of_the_fact_sheet() {
        let pairs = [
            (pairs_34924a(1, 26), 0, [1036, 1001]),
            (pairs_34924a(1, 26), 25, [1061, 1026]),
            (pairs_34922a(3, 26), 25, [3061, 3026]),
            (fast_34925a(1, 2, 26), 25, [2061, 1026]),
            (matrix_34932a(2, 26), 15, [2216, 2116]),
            (matrix_34932a(2, 26), 16, [2601, 2501]),
        ];
        for (wiring, k, [inject, measure]) in pairs {
            let (wiring, pair) = (wiring.unwrap(), Dipole::adjacent(k, 26));
            assert_eq!(wiring.injecting(pair), Some(&[Relay(inject)][..]));
            assert_eq!(wiring.measuring(pair), Some(&[Relay(measure)][..]));
        }
        let large = matrix_34934a(1, 26).unwrap();
        let last = Dipole::adjacent(25, 26);
        assert_eq!(large.injecting(last), Some(&[Relay(1126), Relay(1301)][..]));
        assert_eq!(large.measuring(last), Some(&[Relay(1526), Relay(1701)][..]));
        let refusal = fast_34925a(2, 2, 26).unwrap_err();
        assert!(refusal.to_string().contains("slot 2"), "{refusal}");
        assert!(matches!(pairs_34924a(9, 26), Err(MapError::Slot { .. })));
        assert!(matrix_34934a(1, 129).is_err());
    }

    #[test]
    fn durations_follow_the_table_of_lower_bounds() {
        let seconds = |wiring: &Wiring, model: Model| {
            let protocol = Protocol::sheffield(26).unwrap();
            let plan = Plan::new(&protocol, wiring, Amps(1e-3), Volts(10.0), Duration::ZERO);
            plan.unwrap()
                .duration(&model.timing(1.0, 50.0))
                .as_secs_f64()
        };
        // 34924A, 26 per injection, 1 PLC at 50 Hz: 14.6 s; the 34932A matrix, 23 per injection: 17.0 s
        let pairs = seconds(&pairs_34924a(1, 26).unwrap(), Model::M34924A);
        assert!((pairs - 14.6).abs() < 0.05, "{pairs}");
        let matrix = seconds(&matrix_34932a(1, 26).unwrap(), Model::M34932A);
        assert!((matrix - 17.0).abs() < 0.3, "{matrix}");
    }
}
