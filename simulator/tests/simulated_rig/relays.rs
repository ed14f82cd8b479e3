//! Effects of a scene on relays and wires, observed through the instruments.

use crate::drivers::{board_rig, frame, mainframe_rig, simulated};
use phantom::{Preview, Scan, Scene};
use simulator::{Fault, Instrument, LoadNetwork, Pace, Profile, SimulatedRig};
use survey::Relay;

fn load_network(scene: &str) -> SimulatedRig {
    let mut profile = Profile::shipped("pairs-34924a").unwrap();
    profile.load = "resistor 1 2 470".parse::<LoadNetwork>().unwrap();
    let scene = Scene::parse("test.toml", scene).unwrap();
    SimulatedRig::new(&profile.at_pace(Pace::Instant), scene).unwrap()
}

fn read(rig: &SimulatedRig, query: &str) -> f64 {
    let answer = rig.receive(Instrument::Mainframe, query).0.unwrap();
    answer.parse().unwrap()
}

fn compliance(rig: &SimulatedRig) -> String {
    rig.receive(Instrument::Source, "STAT:MEAS:COND?")
        .0
        .unwrap()
}

#[tokio::test]
async fn channels_add_their_resistance_to_two_wires_and_not_to_four() {
    let bare = load_network("");
    let clean =
        load_network("[effects.channel-resistance]\nohm = 2.0\nstd = 0.0\ndirty_percent = 0.0");
    let dirty =
        load_network("[effects.channel-resistance]\nohm = 2.0\nstd = 0.0\ndirty_percent = 100.0");
    let two_wires = |rig: &SimulatedRig| read(rig, "MEAS:RES? AUTO,(@1001)");
    let plain = two_wires(&bare);
    // a channel and the relay to the bus, two poles each
    assert!((two_wires(&clean) - plain - 8.0).abs() < 1e-3);
    assert!((two_wires(&dirty) - plain - 208.0).abs() < 1e-3);
    for rig in [&clean, &dirty] {
        assert!((read(rig, "MEAS:FRES? AUTO,(@1001)") - 470.0).abs() < 1e-3);
    }
}

#[tokio::test]
async fn leads_reach_compliance_and_no_reading() {
    for (ohm, reached) in [("0.0", "0"), ("14.0", "0"), ("16.0", "8")] {
        let rig = load_network(&format!("[effects.lead-resistance]\nohm = {ohm}"));
        rig.receive(Instrument::Mainframe, "ROUT:CLOS (@1036)");
        // 1 mA through 470 ohm and two poles of 100.1: 670.2 mV, and 2 mV for each ohm of lead
        rig.receive(
            Instrument::Source,
            "SOUR:CURR:COMP 0.70;:SOUR:CURR 1e-3;:OUTP ON",
        );
        assert_eq!(compliance(&rig), reached, "{ohm}");
        if reached == "0" {
            let volts = read(&rig, "MEAS:VOLT:DC? 1,(@1001)");
            assert!((volts - 0.47).abs() < 1e-6, "{volts}");
        }
    }
}

#[tokio::test]
async fn a_relay_whose_life_is_over_sticks_and_can_be_replaced() {
    let worn = |closed: u32| {
        load_network(&format!(
            "[effects.wear]\nlife_closures = 3\nshape = 20\nclosed_percent = {closed}"
        ))
    };
    let drive = |rig: &SimulatedRig| {
        rig.receive(Instrument::Source, "SOUR:CURR 1e-3;:OUTP ON");
    };
    let open = |rig: &SimulatedRig| {
        rig.receive(Instrument::Mainframe, "ROUT:OPEN (@1036)");
    };
    let close = |rig: &SimulatedRig| {
        rig.receive(Instrument::Mainframe, "ROUT:CLOS (@1036)");
    };
    // With a shape of 20, all lives are within a few percent of three closures.
    let rig = worn(0);
    drive(&rig);
    for _ in 0..2 {
        close(&rig);
        assert_eq!(compliance(&rig), "0");
        open(&rig);
    }
    close(&rig);
    close(&rig);
    open(&rig);
    close(&rig);
    let requested = rig.receive(Instrument::Mainframe, "ROUT:CLOS? (@1036)").0;
    assert_eq!(requested.unwrap(), "1", "it reads closed");
    assert_eq!(compliance(&rig), "8", "and is open");
    rig.fault(&Fault::Free(Relay(1036))).unwrap();
    assert_eq!(compliance(&rig), "0");
    for _ in 0..9 {
        open(&rig);
        close(&rig);
    }
    assert_eq!(compliance(&rig), "0", "the new one has its life before it");

    let rig = worn(100);
    for _ in 0..5 {
        close(&rig);
        open(&rig);
    }
    assert_eq!(rig.closed().into_iter().collect::<Vec<_>>(), [Relay(1036)]);
}

#[tokio::test]
async fn a_board_that_does_not_wait_reads_before_its_relays_are_there() {
    let wiring = gpio_mux::wiring(26).unwrap();
    let volts = |frame: survey::Frame| -> Vec<f64> {
        let readings = frame.readings.iter();
        readings.map(|reading| reading.volts().unwrap().0).collect()
    };
    let mut frames = Vec::new();
    for text in [
        "",
        "[effects.relay-bounce]\noperate_ms = 0.0\nbounce_ms = 0.0",
        "[effects.relay-bounce]\noperate_ms = 0.7\nbounce_ms = 100.0",
    ] {
        let scene = Scene::parse("test.toml", text).unwrap();
        let simulated = simulated("gpio-board", scene);
        let rig = board_rig(&simulated).await;
        frames.push(volts(frame(&rig, &wiring).await.unwrap()));
    }
    assert_eq!(frames[0], frames[1]);
    // while they bounce, a reading is a share of the true one
    let shares: Vec<f64> = frames[0]
        .iter()
        .zip(&frames[2])
        .filter(|(volts, _)| volts.abs() > 1e-3)
        .map(|(volts, seen)| seen / volts)
        .collect();
    assert!(shares.iter().all(|share| (0.0..1.0001).contains(share)));
    let mean = shares.iter().sum::<f64>() / shares.len() as f64;
    assert!(mean < 0.9, "{mean}");
}

#[tokio::test]
async fn what_channels_do_to_readings_is_as_large_as_predicted() {
    let wiring = keysight_34980a::pairs_34924a(1, 26).unwrap();
    let input = "[effects.input-resistance]\nmohm = 0.01\n";
    let channels = format!("{input}[effects.channel-resistance]\nohm = 20\ndirty_percent = 0.0\n");
    let mut frames = Vec::new();
    for text in [input, &channels] {
        let scene = Scene::parse("test.toml", text).unwrap();
        let rig = mainframe_rig(&simulated("pairs-34924a", scene)).await;
        let frame = frame(&rig, &wiring).await.unwrap();
        let volts = frame.readings.iter().map(|one| one.volts().unwrap().0);
        frames.push(volts.collect::<Vec<f64>>());
    }
    let apart = frames[0]
        .iter()
        .zip(&frames[1])
        .map(|(a, b)| (a - b).powi(2));
    let seen = (apart.sum::<f64>() / frames[0].len() as f64).sqrt();
    let scene = Scene::parse("test.toml", &channels).unwrap();
    let all = Preview::new(&scene, Scan::usual(26).unwrap())
        .unwrap()
        .predictions();
    let reported = all
        .iter()
        .find(|reported| reported.name == "channel-resistance");
    let ratio = reported.unwrap().volts / seen;
    println!("{seen:.2e} V seen, {ratio:.2} of it predicted");
    assert!((0.5..2.0).contains(&ratio), "{ratio}");
}
