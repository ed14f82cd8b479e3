//! Edges, times and the watchdog of the simulated board, and arbitrary input.

use std::time::Duration;

use gpio_mux::{Chip, Edge, Pole, Poles, Settings, SimulatorGpioMux, State};
use proptest::prelude::*;
use survey::Electrode;

#[derive(Default)]
struct Sheet {
    joined: [Option<Electrode>; 4],
    history: Vec<(Duration, [Option<Electrode>; 4])>,
}

impl Poles for Sheet {
    fn poles(&mut self, joined: [Option<Electrode>; 4], at: Duration) {
        assert!(joined[0].is_none() || joined[0] != joined[1], "shorted");
        self.joined = joined;
        self.history.push((at, joined));
    }
}

fn board() -> (SimulatorGpioMux, Sheet) {
    (SimulatorGpioMux::new(Settings::default()), Sheet::default())
}

/// Asserts on the edges that an address changes only while its pole is off, and that no pole ever has two enables.
fn breaks_before_it_makes(board: &SimulatorGpioMux) {
    let mut enabled: [Vec<Chip>; 4] = Default::default();
    let mut last = Duration::ZERO;
    for record in board.edges() {
        assert!(record.at > last, "two edges at {last:?}");
        last = record.at;
        let pole = &mut enabled[record.pole.index()];
        match record.edge {
            Edge::Enable(chip, true) => {
                assert!(pole.is_empty(), "{record:?} while {pole:?} is on");
                pole.push(chip);
            }
            Edge::Enable(chip, false) => assert_eq!(pole.pop(), Some(chip)),
            Edge::Address(_) => assert!(pole.is_empty(), "{record:?} while {pole:?} is on"),
        }
    }
}

#[test]
fn enables_off_then_address_then_enable() {
    let (mut board, mut sheet) = board();
    let at = Duration::from_secs(1);
    board.receive("SET I+ 3", at, &mut sheet);
    board.receive("SET I+ 20", at * 2, &mut sheet);
    let edges: Vec<Edge> = board.edges().map(|record| record.edge).collect();
    assert_eq!(
        edges,
        [
            Edge::Address(2),
            Edge::Enable(Chip::A, true),
            Edge::Enable(Chip::A, false),
            Edge::Address(3),
            Edge::Enable(Chip::B, true),
        ]
    );
    let micro = Duration::from_micros;
    assert_eq!(
        board.edges().map(|record| record.at).collect::<Vec<_>>()[2..],
        [at * 2 + micro(1), at * 2 + micro(2), at * 2 + micro(3)]
    );
    assert!(board.edges().all(|record| record.pole == Pole::IPlus));
    // The sheet is also notified while nothing is connected.
    let seen: Vec<Option<usize>> = sheet
        .history
        .iter()
        .map(|(_, joined)| joined[0].map(Electrode::number))
        .collect();
    assert_eq!(seen, [Some(3), None, Some(20)]);
    breaks_before_it_makes(&board);
}

#[test]
fn the_watchdog_opens_at_its_own_time() {
    let (mut board, mut sheet) = board();
    let ms = Duration::from_millis;
    board.receive("PAIR I 5", ms(100), &mut sheet);
    board.pass(ms(2099), &mut sheet);
    assert_eq!(
        sheet.joined,
        [Some(Electrode(4)), Some(Electrode(5)), None, None]
    );
    let answer = board.receive("STAT?", ms(9000), &mut sheet);
    assert_eq!(answer.text.as_deref(), Some("OFF,OFF,OFF,OFF"));
    assert_eq!(answer.busy, Duration::from_micros(1500));
    let (opened, _) = sheet.history[2];
    assert_eq!(opened, ms(2100) + Duration::from_micros(1));

    board.receive("WDOG 0", ms(9000), &mut sheet);
    board.receive("PAIR V 5", ms(9000), &mut sheet);
    board.pass(Duration::from_secs(99_999), &mut sheet);
    assert_eq!(sheet.joined[2], Some(Electrode(4)));
}

#[test]
fn a_reset_is_all_off_and_a_new_banner() {
    let (mut board, mut sheet) = board();
    let second = Duration::from_secs(1);
    board.receive("PAIR I 5", Duration::ZERO, &mut sheet);
    board.receive("BLAH", Duration::ZERO, &mut sheet);
    let banner = board.reset(second, &mut sheet);
    assert_eq!(banner, "Tactus,GPIO-MUX,0001,1.0 ready");
    assert_eq!(board.state(), State::default());
    assert_eq!(sheet.joined, [None; 4]);
    // The firmware's clock, the error queue and the watchdog's time start again.
    let mut say = |line: &str, at| board.receive(line, at, &mut sheet).text.unwrap();
    assert_eq!(say("LAST?", second), "0");
    assert_eq!(say("SYST:ERR?", second), "+0,\"No error\"");
    assert_eq!(say("SET I+ 1", second * 2), "1,OFF,OFF,OFF");
    assert_eq!(say("LAST?", second * 2), "1000002");
    assert_eq!(say("STAT?", second * 4), "OFF,OFF,OFF,OFF");
}

#[test]
fn watchdog_ignores_noise_and_oversized_line_gets_a_reply() {
    let (mut board, mut sheet) = board();
    let ms = Duration::from_millis;
    board.receive("PAIR I 5", ms(0), &mut sheet);
    // A rejected command also restarts the watchdog.
    let refused = board.receive("SET I- 5", ms(1500), &mut sheet).text;
    assert!(refused.unwrap().starts_with("ERR -221,"));
    board.receive("\u{fffd}\u{fffd}", ms(3000), &mut sheet);
    board.receive("", ms(3200), &mut sheet);
    let too_long = board.receive_oversized(ms(3400), &mut sheet);
    assert_eq!(
        too_long.text.as_deref(),
        Some("ERR -363,\"Input buffer overrun\"")
    );
    assert_eq!(sheet.joined[0], Some(Electrode(4)));
    board.pass(ms(3500), &mut sheet);
    assert_eq!(sheet.joined, [None; 4]);
    let errors = (0..4).map(|_| {
        board
            .receive("SYST:ERR?", ms(3500), &mut sheet)
            .text
            .unwrap()
    });
    let codes: Vec<String> = errors
        .map(|text| text.split(',').next().unwrap().to_owned())
        .collect();
    assert_eq!(codes, ["-221", "-113", "-363", "+0"]);
}

proptest! {
    #[test]
    fn any_messages_leave_the_simulator_consistent(
        lines in prop::collection::vec(prop_oneof![
            (0..4_usize, 0..30_usize).prop_map(|(pole, electrode)| {
                format!("SET {} {electrode}", Pole::ALL[pole])
            }),
            (0..4_usize).prop_map(|pole| format!("SET {} OFF", Pole::ALL[pole])),
            (prop::sample::select(vec!["I", "V", "X"]), 0..30_usize)
                .prop_map(|(pair, electrode)| format!("PAIR {pair} {electrode}")),
            prop::sample::select(vec!["OFF", "STAT?", "LAST?", "WDOG 99999999999", "SYST:ERR?", "*IDN?"])
                .prop_map(str::to_owned),
            ".{0,20}",
        ], 0..60),
    ) {
        let (mut board, mut sheet) = board();
        let mut at = Duration::ZERO;
        for line in lines {
            let answer = board.receive(&line, at, &mut sheet);
            prop_assert_eq!(answer.text.is_none(), line.trim().is_empty());
            prop_assert_eq!(sheet.joined, board.state().0);
            at += Duration::from_millis(700);
        }
        breaks_before_it_makes(&board);
        prop_assert!(board.errors_waiting() <= 20);
    }
}
