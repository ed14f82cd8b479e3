//! Arbitrary replies to the driver of the 6221: no panic, no endless loop, and every result keeps the contract of the
//! trait.

#![no_main]

#[path = "../../../rig/tests/made_up_peer/mod.rs"]
mod made_up_peer;

use std::time::Duration;

use keithley_6221::Keithley6221;
use libfuzzer_sys::fuzz_target;
use rig::{CurrentSource, Link};
use survey::{Amps, Volts};

use made_up_peer::{Peer, RUNTIME};

const START: [&str; 1] = ["KEITHLEY INSTRUMENTS INC.,MODEL 6221,1234567,D04\n"];

fuzz_target!(|bytes: &[u8]| {
    let link = Link::new(Peer::new(&START, bytes), "6221", Duration::from_millis(10));
    RUNTIME.with(|runtime| {
        runtime.block_on(async {
            let Ok(mut source) = Keithley6221::connect(link).await else {
                return;
            };
            let prepared = source.prepare(Amps(1e-3), Volts(10.0)).await.is_ok();
            // a level is set only on a prepared range
            assert!(source.set_current(Amps(1e-3)).await.is_err() || prepared);
            source.set_output(true).await.ok();
            source.in_compliance().await.ok();
            source.output().await.ok();
            source.off().await.ok();
        });
    });
});
