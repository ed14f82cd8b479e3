//! Arbitrary replies to the driver of the multiplexer board: no panic, no endless loop, and every result keeps the
//! contract of the trait.

#![no_main]

#[path = "../../../rig/tests/made_up_peer/mod.rs"]
mod made_up_peer;

use std::time::Duration;

use gpio_mux::{GpioMux, Options};
use libfuzzer_sys::fuzz_target;
use rig::{Link, Move, Switch};
use survey::Relay;

use made_up_peer::{Peer, RUNTIME};

const START: [&str; 2] = ["Tactus,GPIO-MUX,0001,1.0\n", "OFF,OFF,OFF,OFF\n"];

fuzz_target!(|bytes: &[u8]| {
    let link = Link::new(Peer::new(&START, bytes), "board", Duration::from_millis(10));
    let options = Options {
        settling: Duration::ZERO,
        ..Options::default()
    };
    RUNTIME.with(|runtime| {
        runtime.block_on(async {
            let Ok(mut board) = GpioMux::connect_with(link, options).await else {
                return;
            };
            let pair = vec![Relay(101), Relay(202)];
            board.move_relays(&[Move::Close(pair.clone())]).await.ok();
            let both = vec![Relay(105), Relay(205)];
            assert!(
                board.move_relays(&[Move::Close(both)]).await.is_err(),
                "one electrode on both current poles"
            );
            board.state().await.ok();
            if let Ok(states) = board.closed(&pair).await {
                assert_eq!(states.len(), 2);
            }
            board
                .move_relays(&[Move::Open(pair.clone()), Move::Close(vec![Relay(309)])])
                .await
                .ok();
            board.open_verified(&pair).await.ok();
        });
    });
});
