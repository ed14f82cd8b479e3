//! The board on a gpiochip: break before make in the recorded edges, rejections before a line is set, lines that stick.

mod memory_chip;

use std::time::Duration;

use gpio_mux::{Chip, GpioBoard, Line, Pole};
use memory_chip::{LineEdge, MemoryChip};
use proptest::prelude::*;
use rig::{LinkError, Move, RigError, Switch};
use survey::{Electrode, Relay};

fn board() -> (MemoryChip, GpioBoard<MemoryChip>) {
    let chip = MemoryChip::new(Duration::from_micros(5));
    let board = GpioBoard::new(chip.clone(), 26, Duration::ZERO).unwrap();
    (chip, board)
}

fn close(relays: &[u32]) -> Move {
    Move::Close(relays.iter().copied().map(Relay).collect())
}

fn open(relays: &[u32]) -> Move {
    Move::Open(relays.iter().copied().map(Relay).collect())
}

/// Asserts that an address changes only while its pole is off, that no pole ever has two enables, and that the enable
/// follows the address.
fn breaks_before_it_makes(edges: &[LineEdge]) {
    let mut on: [Vec<(Chip, Duration)>; 4] = Default::default();
    let mut broken = [Duration::ZERO; 4];
    for edge in edges {
        match edge.line {
            Line::Address(pole, _) => {
                assert!(on[pole.index()].is_empty(), "{edge:?} while its pole is on");
                assert!(edge.at > broken[pole.index()] || broken[pole.index()].is_zero());
            }
            Line::Enable(pole, chip) if edge.level => {
                assert!(
                    on[pole.index()].is_empty(),
                    "{edge:?} makes a second enable"
                );
                assert!(edge.at > broken[pole.index()]);
                on[pole.index()].push((chip, edge.at));
            }
            Line::Enable(pole, _) => {
                assert!(on[pole.index()].pop().is_some());
                broken[pole.index()] = edge.at;
            }
        }
    }
}

#[tokio::test]
async fn enables_off_then_address_then_enable() {
    let (chip, mut board) = board();
    board.move_relays(&[close(&[103, 204])]).await.unwrap();
    board
        .move_relays(&[open(&[103]), close(&[120])])
        .await
        .unwrap();
    let commands: Vec<String> = chip
        .edges()
        .iter()
        .map(|edge| {
            let level = u8::from(edge.level);
            format!("{} {}={level}", edge.at.as_micros(), edge.line)
        })
        .collect();
    // The first call, at 5 us, switched everything off.
    assert_eq!(
        commands,
        [
            "10 I+.S1=1",
            "10 I-.S0=1",
            "10 I-.S1=1",
            "15 I+.EN_A=1",
            "15 I-.EN_A=1",
            "20 I+.EN_A=0",
            "25 I+.S0=1",
            "30 I+.EN_B=1",
        ]
    );
    breaks_before_it_makes(&chip.edges());
    let relays = [103, 120, 204].map(Relay);
    assert_eq!(board.closed(&relays).await.unwrap(), [false, true, true]);
}

#[tokio::test]
async fn what_must_not_be_is_refused_before_a_line_is_touched() {
    let (chip, mut board) = board();
    board.move_relays(&[close(&[101, 202])]).await.unwrap();
    let before = chip.edges();
    for moves in [
        vec![close(&[102])],
        vec![open(&[101]), close(&[102])],
        vec![close(&[127])],
        vec![close(&[301, 501])],
        vec![open(&[99])],
    ] {
        let error = board.move_relays(&moves).await.unwrap_err();
        assert!(matches!(error, RigError::Unable { .. }), "{error}");
    }
    assert_eq!(chip.edges(), before);
    let too_many = GpioBoard::new(chip, 33, Duration::ZERO);
    assert!(matches!(too_many, Err(RigError::Unable { .. })));
}

#[tokio::test]
async fn gpio_line_that_does_not_follow_turns_all_lines_off() {
    let (chip, mut board) = board();
    chip.stick(Line::Address(Pole::VPlus, 2), false);
    let fault = board.move_relays(&[close(&[101, 305])]).await.unwrap_err();
    assert!(
        matches!(&fault, RigError::Mismatch { setting, .. } if setting == "line V+.S2"),
        "{fault}"
    );
    assert!(chip.levels().joined().is_empty());
    chip.unstick(Line::Address(Pole::VPlus, 2));
    board.move_relays(&[close(&[101, 305])]).await.unwrap();
}

#[tokio::test]
async fn the_levels_named_are_those_of_the_named_line() {
    let (chip, mut board) = board();
    // two lines that do not follow, in opposite directions
    chip.stick(Line::Address(Pole::IPlus, 0), true);
    chip.stick(Line::Address(Pole::VPlus, 2), false);
    let fault = board.move_relays(&[close(&[101, 305])]).await.unwrap_err();
    let RigError::Mismatch {
        setting, set, read, ..
    } = &fault
    else {
        panic!("{fault}");
    };
    assert_eq!(
        [setting.as_str(), set.as_str(), read.as_str()],
        ["line I+.S0", "0", "1"],
        "{fault}"
    );
}

#[tokio::test]
async fn an_enable_that_stays_on_is_named() {
    let (chip, mut board) = board();
    board.move_relays(&[close(&[126])]).await.unwrap();
    chip.stick(Line::Enable(Pole::IPlus, Chip::B), true);
    let fault = board.open_verified(&[Relay(126)]).await.unwrap_err();
    assert!(
        matches!(&fault, RigError::StillClosed { relays, .. } if *relays == [Relay(126)]),
        "{fault}"
    );
    assert!(board.all_off().is_err());
    chip.unstick(Line::Enable(Pole::IPlus, Chip::B));
    board.open_verified(&[Relay(126)]).await.unwrap();
}

#[tokio::test]
async fn relays_that_are_open_already_are_verified_open() {
    let (chip, mut board) = board();
    let all: Vec<Relay> = gpio_mux::wiring(26).unwrap().relays();
    // the first step of every plan
    board.open_verified(&all).await.unwrap();
    board.move_relays(&[close(&[101, 202])]).await.unwrap();
    board.open_verified(&[Relay(303)]).await.unwrap();
    assert_eq!(chip.levels().joined(), [Relay(101), Relay(202)].into());
    board.open_verified(&all).await.unwrap();
    board.open_verified(&all).await.unwrap();
    assert!(chip.levels().joined().is_empty());
}

#[tokio::test]
async fn an_unplugged_chip_is_a_lost_link_with_everything_open() {
    let (chip, mut board) = board();
    board
        .move_relays(&[close(&[101, 202, 303, 404])])
        .await
        .unwrap();
    chip.unplug(Some("no such device"));
    let all = gpio_mux::wiring(26).unwrap().relays();
    for fault in [
        board.move_relays(&[open(&[101])]).await.unwrap_err(),
        board.closed(&all).await.unwrap_err(),
        board.open_verified(&all).await.unwrap_err(),
        board.all_off().unwrap_err(),
        GpioBoard::new(chip.clone(), 26, Duration::ZERO).unwrap_err(),
    ] {
        assert!(
            matches!(&fault, RigError::Link(LinkError::Lost { .. })),
            "a session is suspended and reconnects: {fault}"
        );
        assert_eq!(fault.instrument(), Some("GPIO board on the chip in memory"));
        let text = survey::error_chain(&fault);
        assert!(text.contains("no such device"), "{text}");
    }
    chip.unplug(None);
    assert_eq!(board.state().unwrap().on(Pole::IPlus), None);
}

proptest! {
    #[test]
    fn no_walk_of_moves_makes_before_it_breaks(
        walk in prop::collection::vec((0_usize..4, 0_usize..28, any::<bool>()), 0..80),
    ) {
        let (chip, mut board) = board();
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        for (pole, electrode, closes) in walk {
            let pole = Pole::ALL[pole];
            let before = board.state().unwrap();
            let mut moves: Vec<Move> = Vec::new();
            if let Some(other) = before.on(pole) {
                moves.push(Move::Open(vec![pole.relay(other)]));
            }
            if closes {
                moves.push(Move::Close(vec![pole.relay(Electrode(electrode))]));
            }
            let moved = runtime.block_on(board.move_relays(&moves));
            let state = board.state().unwrap();
            prop_assert!(state.shorted().is_none());
            if moved.is_err() {
                prop_assert_eq!(state, before);
            }
        }
        breaks_before_it_makes(&chip.edges());
    }
}
