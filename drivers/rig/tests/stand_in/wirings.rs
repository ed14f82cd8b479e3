//! Wirings for the tests.

use survey::{Dipole, Relay, RelayTable, Sensing, Transition, Wiring};

fn wiring(
    electrodes: usize,
    (sensing, transition): (Sensing, Transition),
    inject: impl Fn(Dipole) -> Vec<u32>,
    measure: impl Fn(Dipole) -> Vec<u32>,
    bus: &[u32],
) -> Wiring {
    let pairs = |relays: &dyn Fn(Dipole) -> Vec<u32>| {
        let each = (0..electrodes).map(|k| relays(Dipole::adjacent(k, electrodes)));
        each.map(|relays| relays.into_iter().map(Relay).collect())
            .collect()
    };
    Wiring::from_table(RelayTable {
        name: "an example".to_owned(),
        sensing,
        transition,
        inject: pairs(&inject),
        measure: pairs(&measure),
        bus: bus.iter().copied().map(Relay).collect(),
    })
    .unwrap()
}

fn number(pair: Dipole) -> u32 {
    pair.plus.number() as u32
}

/// A relay for each pair, measuring pairs scanned.
pub fn pairs(electrodes: usize) -> Wiring {
    wiring(
        electrodes,
        (Sensing::Scan, Transition::Overlap),
        |pair| vec![1035 + number(pair)],
        |pair| vec![1000 + number(pair)],
        &[],
    )
}

/// A relay for each pair, one reading in each message, with a bus relay.
pub fn matrix(electrodes: usize) -> Wiring {
    wiring(
        electrodes,
        (Sensing::Single, Transition::Overlap),
        |pair| vec![1200 + number(pair)],
        |pair| vec![1100 + number(pair)],
        &[1921],
    )
}

/// A multiplexer board: four poles, any electrode on each.
pub fn board(electrodes: usize) -> Wiring {
    let poles = |plus: u32, minus: u32| {
        move |pair: Dipole| {
            vec![
                plus + pair.plus.number() as u32,
                minus + pair.minus.number() as u32,
            ]
        }
    };
    wiring(
        electrodes,
        (Sensing::Single, Transition::Break),
        poles(100, 200),
        poles(300, 400),
        &[],
    )
}
