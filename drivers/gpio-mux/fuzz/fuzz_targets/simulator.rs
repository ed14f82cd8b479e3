//! Arbitrary bytes at the simulated board, with time advancing between its lines, and at the parsers of its replies:
//! nothing panics, break comes before make, never two electrodes on a pole or one on both current poles, queues keep
//! their bound, every line has exactly one reply, and every reply parses as the reply that it is.

#![no_main]

use std::time::Duration;

use gpio_mux::{Chip, Command, Edge, Poles, Settings, SimulatorGpioMux, State, error_in_reply};
use libfuzzer_sys::fuzz_target;
use scpi::Framer;
use survey::Electrode;

const LONGEST: usize = 256;

/// Checks the poles that the board connects.
#[derive(Default)]
struct Watched {
    joined: [Option<Electrode>; 4],
}

impl Poles for Watched {
    fn poles(&mut self, joined: [Option<Electrode>; 4], _: Duration) {
        assert!(joined[0].is_none() || joined[0] != joined[1]);
        self.joined = joined;
    }
}

fuzz_target!(|bytes: &[u8]| {
    let [pace, input @ ..] = bytes else {
        return;
    };
    let pause = Duration::from_micros(1 << (pace % 32));
    let mut board = SimulatorGpioMux::new(Settings::default());
    let mut poles = Watched::default();
    let mut framer = Framer::new(LONGEST);
    framer.push(input);
    let mut now = Duration::ZERO;
    for message in framer.flatten() {
        let line = String::from_utf8_lossy(&message);
        let reply = board.receive(&line, now, &mut poles).text;
        assert_eq!(reply.is_none(), line.trim().is_empty());
        if let Some(reply) = reply {
            assert!(!reply.contains('\n'));
            match line.parse::<Command>() {
                Ok(command) => {
                    assert_eq!(command.to_string().parse(), Ok(command));
                    if let Command::Set(..) | Command::Pair(..) | Command::Off | Command::AskState =
                        command
                    {
                        let state = reply.parse::<State>();
                        assert!(state.is_ok() || error_in_reply(&reply).is_some());
                        assert!(state.is_err() || state == Ok(board.state()));
                    }
                }
                Err(refused) => assert_eq!(error_in_reply(&reply), Some(refused)),
            }
        }
        assert_eq!(poles.joined, board.state().0);
        assert!(board.errors_waiting() <= 20);
        now += pause;
        board.pass(now, &mut poles);
        // Replies of an arbitrary instrument.
        let _ = line.parse::<State>();
        let _ = error_in_reply(&line);
        let _ = line.parse::<scpi::ErrorEntry>();
    }
    let mut enabled = [None::<Chip>; 4];
    for record in board.edges() {
        let on = &mut enabled[record.pole.index()];
        match record.edge {
            Edge::Enable(chip, true) => {
                assert_eq!(*on, None, "made before broken");
                *on = Some(chip);
            }
            Edge::Enable(..) => *on = None,
            Edge::Address(_) => assert_eq!(*on, None, "an address moved under an enable"),
        }
    }
});
