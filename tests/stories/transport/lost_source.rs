//! The connection to the source breaks in the middle of a frame: the injecting relays open, its state is reported as
//! unknown, and after reconnection it is switched off and read back.

use std::time::Duration;

use keithley_6221::Keithley6221;
use phantom::Scene;
use rig::{CurrentSource, Link, Stop, SystemClock};
use simulator::{Instrument, Wire};
use survey::Amps;

use crate::test_rig::runtime;
use crate::transport::frame_as_text::{METER, drivers, plan, simulated};

#[test]
fn lost_source_opens_relays_and_is_verified_off_on_return() {
    runtime().block_on(async {
        let bench = simulated("pairs-34924a", Scene::quiet());
        let rig = drivers(&bench).await;
        let wiring = keysight_34980a::pairs_34924a(1, 26).expect("26 pairs fit");
        let plan = plan(&wiring);
        let cutter = bench.clone();
        let cut = tokio::spawn(async move {
            // wait until current flows
            while cutter.flowing() == Amps(0.0) {
                tokio::task::yield_now().await;
            }
            cutter.set_wire(Instrument::Source, Wire::Cut);
        });
        let failure = rig::acquire(&rig, &plan, METER, SystemClock::new(), &Stop::never())
            .await
            .expect_err("a frame cannot be had without a source");
        cut.await.expect("the wire was cut");

        let cleanup = failure
            .cleanup()
            .expect("the source could not be made safe");
        assert!(cleanup.source_state_unknown(), "{cleanup}");
        let injecting = wiring.injecting_relays();
        assert!(
            bench
                .closed()
                .iter()
                .all(|relay| !injecting.contains(relay)),
            "every injecting relay is open: {:?}",
            bench.closed()
        );
        let (on, level) = bench.source_output();
        assert!(
            on && level != Amps(0.0),
            "the output of a 6221 stays on when its client vanishes"
        );

        bench.set_wire(Instrument::Source, Wire::Sound);
        let link = Link::new(
            bench.connect(Instrument::Source),
            "6221 in memory",
            Duration::from_secs(30),
        );
        let mut source = Keithley6221::connect(link).await.expect("it answers again");
        source.off().await.expect("off, and read back");
        assert_eq!(bench.source_output(), (false, Amps(0.0)));
    });
}
