//! Faults by the control socket and on the time line.

use std::time::Duration;

use crate::program::Served;
use gpio_mux::GpioMux;
use phantom::Scene;
use rig::{Link, LinkError, connect_tcp, open_serial};
use simulator::{Fault, Instrument, LoadNetwork, Pace, Profile, SimulatedRig};
use survey::{Electrode, Relay};

const DEADLINE: Duration = Duration::from_secs(20);

fn simulated(profile: &str, load: LoadNetwork) -> SimulatedRig {
    let mut profile = Profile::shipped(profile).unwrap().at_pace(Pace::Instant);
    profile.load = load;
    SimulatedRig::new(&profile, Scene::quiet()).unwrap()
}

fn ask(rig: &SimulatedRig, instrument: Instrument, query: &str) -> String {
    rig.receive(instrument, query).0.unwrap()
}

/// The voltmeter's reading on a channel.
fn read(rig: &SimulatedRig, channel: u32) -> f64 {
    rig.receive(
        Instrument::Mainframe,
        &format!("CONF:VOLT:DC 10,(@{channel})"),
    );
    ask(rig, Instrument::Mainframe, "READ?").parse().unwrap()
}

/// One milliampere through terminals 1 and 2.
fn drive(rig: &SimulatedRig) {
    rig.receive(Instrument::Mainframe, "ROUT:CLOS (@1036)");
    rig.receive(Instrument::Source, "SOUR:CURR 1e-3;:OUTP ON");
}

fn near(value: f64, wanted: f64) -> bool {
    (value - wanted).abs() < 1e-6 * wanted.abs().max(1e-3)
}

#[tokio::test]
async fn a_power_cycle_does_not_close_the_interlock() {
    let rig = simulated("pairs-34924a", "resistor 1 2 470".parse().unwrap());
    let fault = |words: &str| rig.fault(&words.parse().unwrap()).unwrap();
    let interlock = || ask(&rig, Instrument::Source, "OUTP:INT:TRIP?");
    fault("interlock open");
    fault("reset 6221");
    assert_eq!(interlock(), "0");
    drive(&rig);
    assert!(!rig.source_output().0);
    fault("interlock closed");
    fault("power-cut");
    assert_eq!(interlock(), "1");
}

#[tokio::test]
async fn loads_beside_the_sheet_obey_ohm() {
    let rig = simulated("pairs-34924a", "resistor 1 2 470".parse().unwrap());
    drive(&rig);
    assert!(near(read(&rig, 1001), 0.47), "{}", read(&rig, 1001));
    // A pair with one end on the resistor and the other open has no voltage.
    assert!(near(read(&rig, 1002), 0.0));
    let rig = simulated("pairs-34924a", LoadNetwork::Nothing);
    drive(&rig);
    assert_eq!(ask(&rig, Instrument::Source, "STAT:MEAS:COND?"), "8");
    assert_eq!(rig.flowing(), survey::Amps(0.0));
    // A mesh: the voltages along its edge sum to zero.
    let rig = simulated("pairs-34924a", LoadNetwork::Mesh { ohms: 100.0 });
    drive(&rig);
    let around: f64 = (1001..=1026).map(|channel| read(&rig, channel)).sum();
    assert!(around.abs() < 1e-6, "{around}");
    assert!(read(&rig, 1001) > 0.03);
}

#[tokio::test]
async fn a_stuck_relay_reads_right_and_leads_wrong() {
    let rig = simulated("pairs-34924a", "resistor 1 2 470".parse().unwrap());
    drive(&rig);
    rig.fault(&Fault::StuckOpen(Relay(1036))).unwrap();
    assert_eq!(ask(&rig, Instrument::Mainframe, "ROUT:CLOS? (@1036)"), "1");
    assert!(rig.closed().is_empty());
    assert_eq!(ask(&rig, Instrument::Source, "STAT:MEAS:COND?"), "8");
    rig.fault(&Fault::Free(Relay(1036))).unwrap();
    assert_eq!(ask(&rig, Instrument::Source, "STAT:MEAS:COND?"), "0");
    rig.fault(&Fault::StuckClosed(Relay(1036))).unwrap();
    rig.receive(Instrument::Mainframe, "ROUT:OPEN (@1036)");
    assert_eq!(ask(&rig, Instrument::Mainframe, "ROUT:CLOS? (@1036)"), "0");
    assert_eq!(rig.closed().into_iter().collect::<Vec<_>>(), [Relay(1036)]);
    assert!(near(read(&rig, 1001), 0.47));
    // A measuring relay that does not close leaves the voltmeter's input at zero.
    rig.fault(&Fault::StuckOpen(Relay(1001))).unwrap();
    assert_eq!(read(&rig, 1001), 0.0);
    rig.fault(&Fault::None).unwrap();
    assert!(rig.closed().is_empty());
}

#[tokio::test]
async fn a_stuck_pole_of_the_board_is_no_electrode() {
    let rig = simulated("gpio-board", "resistor 3 4 100".parse().unwrap());
    let link = Link::new(rig.connect(Instrument::Board), "board", DEADLINE);
    let mut board = GpioMux::connect(link).await.unwrap();
    rig.fault(&Fault::StuckOpen(Relay(103))).unwrap();
    rig.receive(Instrument::Board, "PAIR I 3");
    rig.receive(Instrument::Source, "SOUR:CURR 1e-3;:OUTP ON");
    assert_eq!(board.state().await.unwrap().0[0], Some(Electrode(2)));
    assert_eq!(rig.flowing(), survey::Amps(0.0));
    rig.fault(&Fault::Free(Relay(103))).unwrap();
    assert_eq!(rig.flowing(), survey::Amps(1e-3));
}

#[tokio::test]
async fn instruments_fail_as_they_would() {
    let rig = simulated("pairs-34924a", "resistor 1 2 470".parse().unwrap());
    drive(&rig);
    rig.fault(&Fault::Overload(true)).unwrap();
    assert!(read(&rig, 1001) > 9e37);
    rig.fault(&Fault::Overload(false)).unwrap();
    rig.fault(&"interlock open".parse().unwrap()).unwrap();
    rig.advance(Duration::from_secs(1));
    assert_eq!(ask(&rig, Instrument::Source, "OUTP:INT:TRIP?"), "0");
    assert_eq!(ask(&rig, Instrument::Source, "OUTP?"), "0");
    for (instrument, depth) in [(Instrument::Source, 10), (Instrument::Mainframe, 20)] {
        rig.fault(&Fault::QueueOverflow(instrument)).unwrap();
        let codes: Vec<String> = (0..depth)
            .map(|_| ask(&rig, instrument, "SYST:ERR?"))
            .collect();
        assert!(codes[depth - 1].starts_with("-350"), "{codes:?}");
        assert!(ask(&rig, instrument, "SYST:ERR?").contains("No error"));
    }
    rig.fault(&"slot 1 empty".parse().unwrap()).unwrap();
    let card = ask(&rig, Instrument::Mainframe, "SYST:CTYP? 1");
    assert!(!card.contains("34924A"), "{card}");
    rig.fault(&"slot 1 filled".parse().unwrap()).unwrap();
    let card = ask(&rig, Instrument::Mainframe, "SYST:CTYP? 1");
    assert!(card.contains("34924A"), "{card}");
    rig.fault(&"voltmeter missing".parse().unwrap()).unwrap();
    rig.receive(Instrument::Mainframe, "CONF:VOLT:DC 10,(@1001)");
    assert_ne!(
        ask(&rig, Instrument::Mainframe, "SYST:ERR?"),
        "+0,\"No error\""
    );
    rig.fault(&Fault::None).unwrap();
    drive(&rig);
    rig.receive(Instrument::Mainframe, "*CLS");
    rig.receive(Instrument::Source, "OUTP ON");
    assert!(near(read(&rig, 1001), 0.47));
    assert!(rig.fault(&"serial unplug".parse().unwrap()).is_err());
}

#[tokio::test]
async fn the_time_line_breaks_and_mends() {
    let text = "time = \"instant\"\nload = \"resistor 1 2 470\"\n[slots]\n1 = \"34924A\"\n\
        [[fault]]\nat_s = 10\nfor_s = 5\nwhat = \"stuck-open 1036\"\n\
        [[fault]]\nat_s = 30\nwhat = \"reset 6221\"\n";
    let profile = Profile::parse("faults.toml", text).unwrap();
    let rig = SimulatedRig::new(&profile, Scene::quiet()).unwrap();
    drive(&rig);
    let compliance = || ask(&rig, Instrument::Source, "STAT:MEAS:COND?");
    assert_eq!(compliance(), "0");
    rig.advance(Duration::from_secs(11));
    assert_eq!(compliance(), "8");
    rig.advance(Duration::from_secs(5));
    assert_eq!(compliance(), "0");
    assert!(rig.source_output().0);
    rig.advance(Duration::from_secs(20));
    assert_eq!(compliance(), "0");
    assert!(!rig.source_output().0);
}

#[tokio::test]
async fn a_scene_has_faults_beside_its_loads() {
    let text = "[[fault]]\nat_s = 10\nfor_s = 5\nwhat = \"overload on\"\n";
    let scene = Scene::parse("faulty.toml", text).unwrap();
    let profile = Profile::default().at_pace(Pace::Instant);
    let rig = SimulatedRig::new(&profile, scene).unwrap();
    drive(&rig);
    assert!(read(&rig, 1001) < 10.0);
    rig.advance(Duration::from_secs(10));
    assert!(read(&rig, 1001) > 9e37);
    rig.advance(Duration::from_secs(5));
    assert!(read(&rig, 1001) < 10.0);
    let scene = Scene::parse("faulty.toml", &text.replace("on", "of")).unwrap();
    let refusal = SimulatedRig::new(&profile, scene).unwrap_err();
    let reported = refusal.to_string();
    assert!(
        reported.starts_with("faulty.toml:4:8: 'overload of' is not a fault"),
        "{reported}"
    );
}

#[tokio::test]
async fn a_repeated_fault_happens_and_ends_each_time() {
    let text = "[[fault]]\nat_s = 10\nfor_s = 5\nrepeat = { every_s = 20, times = 3 }\nwhat = \"overload on\"\n";
    let scene = Scene::parse("faulty.toml", text).unwrap();
    let profile = Profile::default().at_pace(Pace::Instant);
    let rig = SimulatedRig::new(&profile, scene).unwrap();
    drive(&rig);
    let mut seen = Vec::new();
    for _ in 0..4 {
        for step in [11, 5, 4] {
            rig.advance(Duration::from_secs(step));
            seen.push(read(&rig, 1001) > 9e37);
        }
    }
    let mut wanted = [true, false, false].repeat(3);
    wanted.extend([false; 3]);
    assert_eq!(seen, wanted);
}

async fn link(served: &Served, instrument: &str) -> Link<rig::BoxStream> {
    let stream = connect_tcp(served.address(instrument), DEADLINE)
        .await
        .unwrap();
    Link::new(stream, instrument, DEADLINE)
}

#[tokio::test]
async fn reply_faults_follow_the_commands() {
    let served = Served::start(&[]);
    let mut mainframe = link(&served, "34980a").await;
    let identity = mainframe.ask("*IDN?").await.unwrap();
    served.fault("doubled 34980a");
    // A link that receives more than one reply returns an error.
    let doubled = mainframe.ask("*IDN?").await;
    assert!(doubled.is_err(), "{doubled:?}");
    let mut mainframe = link(&served, "34980a").await;
    let short = Duration::from_millis(300);
    served.fault("lost 34980a 2");
    for _ in 0..2 {
        let lost = mainframe.ask_within("*IDN?", short).await;
        assert!(lost.is_err(), "{lost:?}");
        mainframe = link(&served, "34980a").await;
    }
    assert_eq!(mainframe.ask("*IDN?").await.unwrap(), identity);
    served.fault("half-line 34980a");
    assert!(mainframe.ask_within("*IDN?", short).await.is_err());
    let mut mainframe = link(&served, "34980a").await;
    served.fault("late 34980a 600");
    assert!(mainframe.ask_within("*IDN?", short).await.is_err());
    let mut mainframe = link(&served, "34980a").await;
    served.fault("slow 34980a 0.2");
    let before = std::time::Instant::now();
    mainframe.ask("*IDN?").await.unwrap();
    assert!(before.elapsed() >= Duration::from_millis(200));
    served.fault("none");
    served.fault("drop 34980a");
    let dropped: Result<String, LinkError> = mainframe.ask("*IDN?").await;
    assert!(dropped.is_err(), "{dropped:?}");
    assert_eq!(
        link(&served, "34980a").await.ask("*IDN?").await.unwrap(),
        identity
    );
    served.fault("wire 6221 cut");
    let mut source = link(&served, "6221").await;
    assert!(source.ask("*IDN?").await.is_err());
    served.fault("wire 6221 sound");
    assert!(link(&served, "6221").await.ask("*IDN?").await.is_ok());
    let refused = served.command("fault", "wire 6221");
    assert_eq!(refused.status.code(), Some(1));
    let reported = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        reported.contains("wire INSTRUMENT cut|silent|sound"),
        "{reported}"
    );
}

#[test]
fn what_a_rig_does_not_have_is_refused_with_its_reason() {
    let served = Served::start(&[]);
    for (command, words, reason) in [
        (
            "press",
            "500 500 10 50",
            "at 500, 500 mm covers no part of the sheet",
        ),
        ("press", "1 2 3 x 5", "a press is written press X_MM Y_MM"),
        ("release", "", "no load was added with press"),
        (
            "fault",
            "stuck-open 9999",
            "there is no relay 9999 in this rig",
        ),
        (
            "fault",
            "stuck-closed 1999",
            "there is no relay 1999 in this rig",
        ),
        (
            "fault",
            "stuck-open 2001",
            "there is no relay 2001 in this rig",
        ),
        (
            "fault",
            "stuck-open 101",
            "there is no relay 101 in this rig",
        ),
        ("fault", "free 1001", "relay 1001 is not stuck"),
        ("fault", "slot 5 empty", "there is no module in slot 5"),
        (
            "fault",
            "terminal-block 5 open",
            "there is no module in slot 5",
        ),
        ("fault", "lost board", "there is no multiplexer board"),
        ("fault", "wire board cut", "there is no multiplexer board"),
    ] {
        let done = served.command(command, words);
        let reported = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(1), "{command} {words}: {reported}");
        assert!(reported.contains(reason), "{command} {words}: {reported}");
    }
    // commands for existing parts are executed
    for (command, words) in [
        ("press", "107 115 10 50"),
        ("release", ""),
        ("fault", "stuck-open 1001"),
        ("fault", "free 1001"),
        ("fault", "stuck-closed 1911"),
        ("fault", "slot 1 empty"),
        ("fault", "none"),
    ] {
        let done = served.command(command, words);
        assert!(done.status.success(), "{command} {words}: {done:?}");
    }
}

#[test]
fn impossible_addresses_and_loads_are_refused_with_the_reason() {
    for (arguments, code, reason) in [
        (
            ["serve", "--bind", "192.0.2.1"],
            1,
            "192.0.2.1 is not an address of this machine: give one of its own by --bind",
        ),
        (
            ["serve", "--load", "resistor 1 1 5"],
            2,
            "both ends are terminal 1; name two",
        ),
        (
            ["serve", "--load", "resistor 1 2 -5"],
            2,
            "a resistance is 1e-6 to 1e15 ohm, not '-5'",
        ),
    ] {
        let ended = std::process::Command::new(env!("CARGO_BIN_EXE_tactus-sim"))
            .args(arguments)
            .output()
            .unwrap();
        let reported = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert_eq!(ended.status.code(), Some(code), "{reported}");
        assert!(reported.contains(reason), "{reported}");
    }
}

#[test]
fn a_closed_terminal_leaves_no_socket_behind() {
    let served = Served::start(&[]);
    assert_eq!(served.ready["6221-second-client"], "held");
    let control = served.address("control").to_owned();
    assert!(std::path::Path::new(&control).exists());
    assert_eq!(served.end("-HUP"), Some(0));
    assert!(!std::path::Path::new(&control).exists());
}

#[tokio::test]
async fn a_person_presses_looks_and_lists() {
    let served = Served::start(&[]);
    let mut mainframe = link(&served, "34980a").await;
    mainframe.send("FOO;:ROUT:CLOS (@1036)").await.unwrap();
    mainframe.send("ROUT:CLOS (@1036)").await.unwrap();
    mainframe.ask("*OPC?").await.unwrap();
    let done = served.command("press", "107 115 10 50");
    assert!(done.status.success());
    assert!(served.command("release", "").status.success());
    assert!(!served.command("press", "107 115").status.success());
    let status = served.command("status", "");
    let text = String::from_utf8(status.stdout).unwrap();
    assert!(text.contains("clients  34980a from 127.0.0.1:"), "{text}");
    assert!(text.contains("closed   1036"), "{text}");
    assert!(text.contains("error    34980a"), "{text}");
    let status = served.command("status", "--json");
    let status: serde_json::Value = serde_json::from_slice(&status.stdout).unwrap();
    assert_eq!(status["closed"][0], 1036);
    let list = std::process::Command::new(env!("CARGO_BIN_EXE_tactus-sim"))
        .args(["list", "--json"])
        .output()
        .unwrap();
    let list: serde_json::Value = serde_json::from_slice(&list.stdout).unwrap();
    assert_eq!(list["profiles"][0]["name"], "pairs-34924a");
    // The socket is removed with the program.
    let control = served.address("control").to_owned();
    assert_eq!(served.terminate(), Some(0));
    assert!(!std::path::Path::new(&control).exists());
}

#[tokio::test]
async fn a_serial_port_is_pulled_and_plugged() {
    let served = Served::start(&["--profile", "gpio-board", "--serial-6221"]);
    let path = served.address("serial").to_owned();
    let open = || {
        Link::new(
            open_serial(&path, 115_200).unwrap(),
            path.as_str(),
            DEADLINE,
        )
    };
    let port_exists = async |wanted: bool| {
        let until = async {
            while std::path::Path::new(&path).exists() != wanted {
                tokio::task::yield_now().await;
            }
        };
        tokio::time::timeout(DEADLINE, until).await.unwrap();
    };
    let mut board = GpioMux::connect(open()).await.unwrap();
    served.fault("serial unplug");
    assert!(board.state().await.is_err());
    port_exists(false).await;
    served.fault("serial plug");
    port_exists(true).await;
    let mut board = GpioMux::connect(open()).await.unwrap();
    assert_eq!(board.state().await.unwrap().0, [None; 4]);
    let source = served.address("6221-serial");
    let mut source = Link::new(open_serial(source, 9600).unwrap(), "6221", DEADLINE);
    assert!(source.ask("*IDN?").await.unwrap().contains("MODEL 6221"));
}

#[tokio::test]
async fn the_serial_port_of_the_source_ends_its_lines_as_it_is_set() {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    let served = Served::start(&["--serial-6221"]);
    let mut port = open_serial(served.address("6221-serial"), 9600).unwrap();
    let mut before = "\n";
    for (word, end) in [
        ("CR", "\r"),
        ("CRLF", "\r\n"),
        ("LFCR", "\n\r"),
        ("LF", "\n"),
    ] {
        // The reply to the query after the setting uses the new line end already.
        for (message, reported) in [
            (format!("SYST:COMM:SER:TERM {word};TERM?{before}"), word),
            (format!("*ESE?{end}"), "0"),
        ] {
            port.write_all(message.as_bytes()).await.unwrap();
            let expected = format!("{reported}{end}");
            let mut received = vec![0; expected.len()];
            let read = tokio::time::timeout(DEADLINE, port.read_exact(&mut received));
            read.await.unwrap().unwrap();
            assert_eq!(String::from_utf8_lossy(&received), expected);
        }
        before = end;
    }
    // Network lines still end in a line feed.
    let message = b"SYST:COMM:SER:TERM CR;TERM?\n";
    port.write_all(message).await.unwrap();
    let mut received = [0; 3];
    let read = tokio::time::timeout(DEADLINE, port.read_exact(&mut received));
    read.await.unwrap().unwrap();
    assert_eq!(&received, b"CR\r");
    assert_eq!(link(&served, "6221").await.ask("*ESE?").await.unwrap(), "0");
}

#[tokio::test]
async fn a_board_that_is_reset_sends_its_banner() {
    let rig = simulated("gpio-board", LoadNetwork::Sheet);
    let mut wire = rig.connect(Instrument::Board);
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    wire.write_all(b"PAIR I 3\n").await.unwrap();
    let mut reply = [0; 64];
    let count = wire.read(&mut reply).await.unwrap();
    assert!(reply[..count].ends_with(b"\n"));
    rig.fault(&Fault::Reset(Instrument::Board)).unwrap();
    let count = wire.read(&mut reply).await.unwrap();
    let banner = String::from_utf8_lossy(&reply[..count]).into_owned();
    assert!(banner.ends_with(" ready\n"), "{banner}");
    assert_eq!(rig.poles(), [None; 4]);
}

#[tokio::test]
async fn a_line_too_long_for_the_board_has_its_reply() {
    let rig = simulated("gpio-board", LoadNetwork::Sheet);
    let mut board = Link::new(rig.connect(Instrument::Board), "board", DEADLINE);
    let too_long = board.ask(&"A".repeat(100_000)).await.unwrap();
    assert_eq!(too_long, "ERR -363,\"Input buffer overrun\"");
    assert_eq!(
        board.ask("SYST:ERR?").await.unwrap(),
        "-363,\"Input buffer overrun\""
    );
    assert_eq!(board.ask("STAT?").await.unwrap(), "OFF,OFF,OFF,OFF");
}
