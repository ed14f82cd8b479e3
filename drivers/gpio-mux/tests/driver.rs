//! The driver against the simulator over a pipe: the same bytes as over a serial line.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use gpio_mux::{GpioMux, Poles, Settings, SimulatorGpioMux, await_banner};
use rig::{Link, Move, RigError, Switch};
use scpi::Framer;
use survey::{Electrode, Plan, Protocol, Relay, Step};
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::time::Instant;

struct Sheet;

impl Poles for Sheet {
    fn poles(&mut self, joined: [Option<Electrode>; 4], _: Duration) {
        assert!(joined[0].is_none() || joined[0] != joined[1], "shorted");
    }
}

struct TestInstrument {
    board: SimulatorGpioMux,
    received: Vec<String>,
    /// Sent instead of the true reply to the next line.
    lie: Option<&'static str>,
}

type Shared = Arc<Mutex<TestInstrument>>;

fn device() -> Shared {
    Arc::new(Mutex::new(TestInstrument {
        board: SimulatorGpioMux::new(Settings::default()),
        received: Vec::new(),
        lie: None,
    }))
}

fn plug(device: &Shared) -> DuplexStream {
    let (here, mut there) = tokio::io::duplex(4096);
    let device = Arc::clone(device);
    let start = Instant::now();
    tokio::spawn(async move {
        let banner = device.lock().unwrap().board.banner();
        let greeting = format!("{banner}\n");
        there.write_all(greeting.as_bytes()).await.unwrap();
        let mut framer = Framer::new(200);
        let mut bytes = [0; 64];
        while let Ok(count @ 1..) = there.read(&mut bytes).await {
            framer.push(&bytes[..count]);
            for line in framer.by_ref() {
                let line = String::from_utf8(line.unwrap()).unwrap();
                let (text, busy) = {
                    let device = &mut *device.lock().unwrap();
                    let answer = device.board.receive(&line, start.elapsed(), &mut Sheet);
                    device.received.push(line);
                    let lie = device.lie.take().map(str::to_owned);
                    (lie.or(answer.text), answer.busy)
                };
                // the time that the board needs; the paused clock of the test advances at once
                tokio::time::sleep(busy).await;
                if let Some(text) = text {
                    there
                        .write_all(format!("{text}\n").as_bytes())
                        .await
                        .unwrap_or(());
                }
            }
        }
    });
    here
}

async fn link(device: &Shared) -> Link<DuplexStream> {
    let mut stream = plug(device);
    let banner = await_banner(&mut stream, Duration::from_secs(2)).await;
    assert_eq!(banner.as_deref(), Some("Tactus,GPIO-MUX,0001,1.0 ready"));
    Link::new(stream, "board in a test", Duration::from_secs(1))
}

async fn connected() -> (Shared, GpioMux<DuplexStream>) {
    let device = device();
    let board = GpioMux::connect(link(&device).await).await.unwrap();
    device.lock().unwrap().received.clear();
    (device, board)
}

fn received(device: &Shared) -> Vec<String> {
    std::mem::take(&mut device.lock().unwrap().received)
}

fn relays(numbers: &[u32]) -> Vec<Relay> {
    numbers.iter().copied().map(Relay).collect()
}

fn close(numbers: &[u32]) -> Move {
    Move::Close(relays(numbers))
}

fn open(numbers: &[u32]) -> Move {
    Move::Open(relays(numbers))
}

#[tokio::test(start_paused = true)]
async fn connecting_asks_who_it_is_and_sets_the_watchdog() {
    let device = device();
    let board = GpioMux::connect(link(&device).await).await.unwrap();
    assert_eq!(board.identity(), "Tactus,GPIO-MUX,0001,1.0");
    assert_eq!(received(&device), ["*IDN?", "WDOG 10000"]);
    device.lock().unwrap().lie = Some("Acme,OTHER,1,1");
    let error = GpioMux::connect(link(&device).await).await.unwrap_err();
    assert!(error.to_string().contains("expected GPIO-MUX"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn a_whole_plan_moves_the_poles_break_before_make() {
    let (device, mut board) = connected().await;
    let plan = Plan::new(
        &Protocol::sheffield(26).unwrap(),
        &gpio_mux::wiring(26).unwrap(),
        survey::Amps(1e-3),
        survey::Volts(4.0),
        Duration::ZERO,
    )
    .unwrap();
    for step in &plan.steps {
        match step {
            Step::Break { open, close, drive } => {
                let moves = [Move::Open(open.clone()), Move::Close(close.clone())];
                board.move_relays(&moves).await.unwrap();
                let state = board.state().await.unwrap();
                assert_eq!(state.0[..2], [Some(drive.plus), Some(drive.minus)]);
            }
            Step::Route { open, close, sense } => {
                let moves = [Move::Open(open.clone()), Move::Close(close.clone())];
                board.move_relays(&moves).await.unwrap();
                let device = device.lock().unwrap();
                let state = device.board.state();
                assert_eq!(state.0[2..], [Some(sense.plus), Some(sense.minus)]);
            }
            _ => {}
        }
    }
    let device = device.lock().unwrap();
    let pairs = device
        .received
        .iter()
        .filter(|line| line.starts_with("PAIR"));
    // One message for each move, except for the pair that closes the ring.
    assert!(pairs.count() > 590);
    let mut on = [false; 4];
    for record in device.board.edges() {
        if let gpio_mux::Edge::Enable(_, enable) = record.edge {
            assert_ne!(on[record.pole.index()], enable, "{record:?}");
            on[record.pole.index()] = enable;
        }
    }
}

#[tokio::test(start_paused = true)]
async fn illegal_combinations_are_refused_before_the_wire_is_touched() {
    let (device, mut board) = connected().await;
    board.move_relays(&[close(&[101, 202])]).await.unwrap();
    assert_eq!(received(&device), ["PAIR I 1"]);
    for (moves, reason) in [
        (vec![close(&[102])], "a pole carries one electrode"),
        (
            vec![open(&[101]), close(&[102])],
            "electrode 2 on I+ and on I-",
        ),
        (vec![close(&[505])], "poles 1 to 4"),
        (vec![open(&[100])], "poles 1 to 4"),
    ] {
        let error = board.move_relays(&moves).await.unwrap_err();
        assert!(matches!(error, RigError::Unable { .. }));
        assert!(error.to_string().contains(reason), "{error}");
    }
    assert!(received(&device).is_empty());
    // The board rejects electrode 27, which is not wired; the driver does not have the number of electrodes.
    let error = board.move_relays(&[close(&[327])]).await.unwrap_err();
    assert!(
        matches!(error, RigError::Refused { code: -222, .. }),
        "{error}"
    );
    // The driver queries the board's state before the next move.
    board.move_relays(&[close(&[303])]).await.unwrap();
    assert_eq!(received(&device), ["SET V+ 27", "STAT?", "SET V+ 3"]);
}

#[tokio::test(start_paused = true)]
async fn opening_is_verified() {
    let (device, mut board) = connected().await;
    let moves = [close(&[126, 201]), close(&[303, 304 + 100])];
    board.move_relays(&moves).await.unwrap();
    let requested = relays(&[126, 201, 127, 303]);
    assert_eq!(
        board.closed(&requested).await.unwrap(),
        [true, true, false, true]
    );
    board.open_verified(&relays(&[126, 201])).await.unwrap();
    assert_eq!(
        board.closed(&requested).await.unwrap(),
        [false, false, false, true]
    );
    board.open_verified(&relays(&[303, 404])).await.unwrap();
    assert_eq!(
        device.lock().unwrap().board.state(),
        gpio_mux::State::default()
    );
    received(&device);
    device.lock().unwrap().lie = Some("5,OFF,OFF,OFF");
    let fault = board.open_verified(&relays(&[105])).await;
    // The first reply is faked and reports "off"; the driver sends OFF nevertheless, and the read-back is correct.
    fault.unwrap();
    assert_eq!(received(&device), ["STAT?", "OFF", "STAT?"]);
}

#[tokio::test(start_paused = true)]
async fn a_board_that_opened_by_itself_is_noticed_at_the_next_move() {
    let (device, mut board) = connected().await;
    board.move_relays(&[close(&[101, 202])]).await.unwrap();
    tokio::time::advance(Duration::from_secs(11)).await;
    let fault = board.move_relays(&[close(&[303, 404])]).await.unwrap_err();
    assert!(
        matches!(&fault, RigError::Mismatch { read, .. } if read == "OFF,OFF,3,4"),
        "{fault}"
    );
    board.open_verified(&relays(&[303, 404])).await.unwrap();
    device.lock().unwrap().lie = Some("3,4");
    let fault = board.state().await.unwrap_err();
    assert!(matches!(fault, RigError::Garbled { .. }), "{fault}");
}

#[tokio::test(start_paused = true)]
async fn the_watchdog_waits_for_the_longest_silence() {
    let (device, mut board) = connected().await;
    let seconds = Duration::from_secs;
    board.prepare_for_silence(seconds(8)).await.unwrap();
    assert!(received(&device).is_empty());
    for _ in 0..2 {
        board.prepare_for_silence(seconds(60)).await.unwrap();
    }
    assert_eq!(received(&device), ["WDOG 62000"]);
    board.move_relays(&[close(&[101, 202])]).await.unwrap();
    tokio::time::advance(seconds(61)).await;
    board.move_relays(&[close(&[303, 404])]).await.unwrap();
    board.prepare_for_silence(seconds(1)).await.unwrap();
    assert!(received(&device).contains(&"WDOG 10000".to_owned()));
}
