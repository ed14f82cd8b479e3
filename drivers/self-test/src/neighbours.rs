//! The pairs that a self-test drives and measures.

use survey::{Dipole, Plan, Protocol, Relay};

/// The plan with the pairs of neighbouring electrodes in the order of the ring instead of its own pairs, because the
/// assessment needs these. `None` if the wiring lacks a relay of one of them.
pub fn with_neighbours(plan: &Plan) -> Option<Plan> {
    let electrodes = plan.wiring.electrodes;
    let ring = Protocol::sheffield(electrodes).ok()?;
    let wiring = plan.wiring.clone().joining(&ring);
    let is_ring = |pairs: &[(Dipole, Vec<Relay>)]| {
        let neighbours = (0..electrodes).map(|k| Dipole::adjacent(k, electrodes));
        pairs.iter().map(|(pair, _)| *pair).eq(neighbours)
    };
    (is_ring(&wiring.inject) && is_ring(&wiring.measure)).then(|| Plan {
        wiring,
        ..plan.clone()
    })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use survey::{Amps, RelayTable, Sensing, Transition, Volts, Wiring};

    use super::*;

    /// A relay for each pole and electrode.
    fn wiring() -> Wiring {
        let pairs = |plus: u32, minus: u32| {
            let pair = |k| vec![Relay(plus + k), Relay(minus + (k + 1) % 8)];
            (0..8).map(pair).collect()
        };
        Wiring::from_table(RelayTable {
            name: "poles".to_owned(),
            sensing: Sensing::Single,
            transition: Transition::Break,
            inject: pairs(101, 201),
            measure: pairs(301, 401),
            bus: Vec::new(),
        })
        .unwrap()
    }

    fn tested(measurements: Vec<survey::Measurement>) -> Option<Wiring> {
        let protocol = Protocol::new(8, measurements).unwrap();
        let joined = wiring().joining(&protocol);
        let plan = Plan::new(&protocol, &joined, Amps(1e-3), Volts(4.0), Duration::ZERO);
        with_neighbours(&plan.unwrap()).map(|plan| plan.wiring)
    }

    #[test]
    fn neighbours_are_tested_whatever_pairs_a_survey_has() {
        assert_eq!(tested(survey::sheffield(8).collect()), Some(wiring()));
        assert_eq!(tested(survey::skip(8, 1).collect()), Some(wiring()));
        // in this protocol the last pairs are never driven, and the first is never measured
        assert_eq!(tested(survey::half(survey::sheffield(8)).collect()), None);
    }
}
