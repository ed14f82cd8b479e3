//! Arbitrary replies to the driver of the 34980A: no panic, no endless loop, and every result keeps the contract of the
//! trait.

#![no_main]

#[path = "../../../rig/tests/made_up_peer/mod.rs"]
mod made_up_peer;

use std::time::Duration;

use keysight_34980a::Keysight34980a;
use libfuzzer_sys::fuzz_target;
use rig::{Link, MeterSettings, Move, Switch, Voltmeter};
use survey::{Reading, Relay, Volts, Wiring};

use made_up_peer::{Peer, RUNTIME};

const START: [&str; 9] = [
    "Agilent Technologies,34980A,MY44001234,2.43-2.43-0.00-0.00\n",
    "Agilent Technologies,34924A,MY1,1.0\n",
    "\"Agilent Technologies,34934A-4x128,MY2,1.0\"\n",
    "Agilent Technologies,0,0,0\n",
    "Agilent Technologies,0,0,0\n",
    "Agilent Technologies,0,0,0\n",
    "Agilent Technologies,0,0,0\n",
    "Agilent Technologies,0,0,0\n",
    "Agilent Technologies,0,0,0\n",
];
const METER: MeterSettings = MeterSettings::new(Volts(1.0), 1.0);

fuzz_target!(|bytes: &[u8]| {
    let link = Link::new(
        Peer::new(&START, bytes),
        "34980A",
        Duration::from_millis(10),
    );
    let way = bytes.first().copied().unwrap_or(0) >> 1;
    RUNTIME.with(|runtime| {
        runtime.block_on(async {
            let Ok(mut unit) = Keysight34980a::connect(link).await else {
                return;
            };
            let wiring = keysight_34980a::pairs_34924a(1, 4).expect("four pairs fit");
            let fits = unit.check_wiring(&wiring).is_ok();
            let (inject, measure) = (wiring.injecting_relays(), wiring.measuring_relays());
            let scan = if way % 2 == 0 {
                measure.clone()
            } else {
                Vec::new()
            };
            if way % 3 == 0 {
                unit.prepare(METER, &scan).await.ok();
            }
            let moved = unit.move_relays(&[Move::Close(vec![Relay(1036)])]).await;
            assert!(
                moved.is_err() || fits,
                "a relay moved on a module that lacks it"
            );
            if let Ok(counts) = unit.relay_cycles(&inject).await {
                assert_eq!(counts.len(), inject.len());
            }
            let readings = match scan.is_empty() {
                true => unit.read().await.map(|reading| vec![reading]),
                false => unit.scan().await,
            };
            if let Ok(readings) = readings {
                assert_eq!(readings.len(), scan.len().max(1));
                for reading in readings {
                    if let Reading::Ok(volts) = reading {
                        assert!(volts.0.is_finite() && volts.0.abs() < 1.3, "{volts}");
                    }
                }
            }
            if let Ok(states) = unit.closed(&inject).await {
                assert_eq!(states.len(), inject.len());
            }
            if let Ok(states) = unit.closed_before_opening(&measure, &inject).await {
                assert_eq!(states.len(), measure.len());
            }
            unit.open_verified(&inject).await.ok();
        });
    });
});
