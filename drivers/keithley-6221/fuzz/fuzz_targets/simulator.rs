//! Arbitrary bytes at the simulated 6221, with time advancing between its messages: nothing panics, the error queue
//! keeps its bound, and the current keeps the instrument's limits.

#![no_main]

use std::time::Duration;

use keithley_6221::{Resistor, Settings6221, Simulator6221};
use libfuzzer_sys::fuzz_target;
use scpi::Framer;
use survey::{Amps, Ohms};

const LONGEST: usize = 4096;
const MOST: f64 = 0.105 * (1.0 + 1e-9);

fuzz_target!(|bytes: &[u8]| {
    // The first byte selects the load, the second the time between messages.
    let [load, pace, input @ ..] = bytes else {
        return;
    };
    let mut load = Resistor::new(Ohms(match load {
        0 => 0.0,
        255 => f64::INFINITY,
        decades => 10f64.powf(f64::from(*decades) / 20.0),
    }));
    let pause = Duration::from_secs_f64(10f64.powf(f64::from(*pace) / 25.0 - 4.0));
    let mut source = Simulator6221::new(Settings6221::default());
    let mut framer = Framer::new(LONGEST);
    framer.push(input);
    let mut now = Duration::ZERO;
    for message in framer.flatten() {
        let reply = source.receive(&String::from_utf8_lossy(&message), now, &mut load);
        assert!(reply.text.is_none_or(|text| !text.contains('\n')));
        now += pause;
        source.load_changed(now, &mut load);
        assert!(source.errors() <= 10);
        assert!(source.level().0.abs() <= MOST);
        assert!(load.flowing.abs() <= source.level().abs());
        assert!(source.output() || load.flowing == Amps(0.0));
    }
});
