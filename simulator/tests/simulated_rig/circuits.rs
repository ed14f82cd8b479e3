//! Measurements of the network other than DC volts.

use std::time::Duration;

use phantom::Scene;
use simulator::{Instrument, LoadNetwork, Pace, Profile, SimulatedRig};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};

fn simulated(load: LoadNetwork) -> SimulatedRig {
    let mut profile = Profile::shipped("pairs-34924a").unwrap();
    profile.load = load;
    SimulatedRig::new(&profile.at_pace(Pace::Instant), Scene::quiet()).unwrap()
}

fn read(rig: &SimulatedRig, query: &str) -> f64 {
    let answer = rig.receive(Instrument::Mainframe, query).0.unwrap();
    answer.parse().unwrap()
}

#[track_caller]
fn near(value: f64, wanted: f64) {
    assert!(
        (value - wanted).abs() < 1e-6 * wanted.abs(),
        "{value}, not {wanted}"
    );
}

#[tokio::test]
async fn two_wires_measure_relays_and_load_four_the_load_alone() {
    let rig = simulated("resistor 1 2 470".parse().unwrap());
    // two poles of a reed with its in-rush resistor, two of the relay to the bus
    near(
        read(&rig, "MEAS:RES? AUTO,(@1001)"),
        470.0 + 2.0 * (100.1 + 0.1),
    );
    near(read(&rig, "MEAS:FRES? AUTO,(@1001)"), 470.0);
    // one end on the resistor, the other open
    assert_eq!(read(&rig, "MEAS:RES? AUTO,(@1002)"), 9.9e37);
    assert_eq!(read(&rig, "MEAS:FRES? AUTO,(@1002)"), 9.9e37);
    // the source's own current is part of the reading, unless it is compensated
    rig.receive(Instrument::Mainframe, "ROUT:SCAN (@)");
    rig.receive(Instrument::Mainframe, "ROUT:CLOS (@1036)");
    rig.receive(Instrument::Source, "SOUR:CURR 1e-4;:OUTP ON");
    near(read(&rig, "MEAS:RES? 1E3,(@1001)"), 470.0 * 1.1 + 200.4);
    near(read(&rig, "RES:OCOM ON,(@1001);:READ?"), 470.0 + 200.4);
    let rig = simulated(LoadNetwork::Nothing);
    assert_eq!(read(&rig, "MEAS:RES? AUTO,(@1001)"), 9.9e37);
    // an intact sheet has several hundred ohm between neighbours
    let sheet = simulated(LoadNetwork::Mesh { ohms: 100.0 });
    assert!((10.0..100.0).contains(&read(&sheet, "MEAS:FRES? AUTO,(@1003)")));
}

#[tokio::test]
async fn a_wave_of_the_source_is_read_as_ac_volts_and_frequency() {
    let rig = simulated("resistor 1 2 470".parse().unwrap());
    rig.receive(Instrument::Mainframe, "ROUT:CLOS (@1036)");
    rig.receive(Instrument::Source, "SOUR:CURR 1e-3;:OUTP ON");
    assert_eq!(read(&rig, "MEAS:VOLT:AC? AUTO,(@1001)"), 0.0);
    assert_eq!(read(&rig, "MEAS:FREQ? (@1001)"), 0.0);
    let wave = "SOUR:WAVE:FUNC SIN;FREQ 123;AMPL 1e-3;OFFS 0;RANG BEST;ARM;INIT";
    rig.receive(Instrument::Source, wave);
    assert_eq!(
        rig.receive(Instrument::Source, "SYST:ERR?").0.unwrap(),
        "0,\"No error\""
    );
    near(read(&rig, "MEAS:VOLT:AC? AUTO,(@1001)"), 0.47 / 2f64.sqrt());
    near(read(&rig, "MEAS:FREQ? (@1001)"), 123.0);
    near(read(&rig, "MEAS:PER? (@1001)"), 1.0 / 123.0);
    // clipped at the voltage limit it approaches a square wave
    rig.receive(
        Instrument::Source,
        "SOUR:WAVE:ABOR;:SOUR:CURR:COMP 0.1;:SOUR:WAVE:ARM;INIT",
    );
    let clipped = read(&rig, "MEAS:VOLT:AC? AUTO,(@1001)");
    let flowing = 0.1 / (470.0 + 200.2);
    assert!(
        clipped > 0.8 * 470.0 * flowing && clipped < 470.0 * flowing,
        "{clipped}"
    );
    rig.receive(Instrument::Source, "SOUR:WAVE:ABOR");
    assert_eq!(read(&rig, "MEAS:VOLT:AC? AUTO,(@1001)"), 0.0);
}

#[tokio::test]
async fn dc_volts_are_the_mean_over_the_aperture() {
    let rig = simulated("resistor 1 2 470".parse().unwrap());
    rig.receive(Instrument::Mainframe, "ROUT:CLOS (@1036)");
    let wave = "SOUR:WAVE:FUNC SIN;FREQ 50;AMPL 1e-3;OFFS 0;RANG BEST;ARM;INIT";
    rig.receive(Instrument::Source, wave);
    let volts = |cycles: &str| {
        let set_up = format!(
            "CONF:VOLT:DC 10,(@1001);:VOLT:DC:NPLC {cycles},(@1001);:VOLT:DC:ZERO:AUTO OFF,(@1001)"
        );
        rig.receive(Instrument::Mainframe, &set_up);
        // at an arbitrary phase of the wave
        rig.receive(Instrument::Mainframe, "SYST:DEL 0.003");
        read(&rig, "READ?")
    };
    // averaging over whole power-line cycles removes a sine of the mains frequency
    for cycles in ["1", "2", "10"] {
        for _ in 0..4 {
            assert!(volts(cycles).abs() < 1e-7, "{cycles}");
        }
    }
    let short: Vec<f64> = (0..8).map(|_| volts("0.02")).collect();
    let most = short
        .iter()
        .fold(0.0, |most: f64, volts| most.max(volts.abs()));
    assert!((0.2..0.4701).contains(&most), "{short:?}");
    rig.receive(Instrument::Source, "SOUR:WAVE:OFFS 1e-4");
    near(volts("1"), 0.047);
    // a square wave with a duty cycle of a quarter
    rig.receive(
        Instrument::Source,
        "SOUR:WAVE:ABOR;FUNC SQU;DCYC 25;OFFS 0;ARM;INIT",
    );
    near(volts("10"), -0.235);
    // a sweep of two levels, each for one cycle
    rig.receive(
        Instrument::Source,
        "SOUR:WAVE:ABOR;:SOUR:SWE:SPAC LIST;COUN INF;:SOUR:LIST:CURR 1e-3,3e-3;DEL 0.02;:SOUR:SWE:ARM;:INIT",
    );
    near(volts("2"), 0.94);
}

#[tokio::test(start_paused = true)]
async fn source_change_during_a_scan_shows_in_later_readings() {
    let mut profile = Profile::shipped("pairs-34924a").unwrap();
    profile.load = "resistor 1 2 470".parse().unwrap();
    let rig = SimulatedRig::new(&profile.at_pace(Pace::Real), Scene::quiet()).unwrap();
    rig.receive(Instrument::Mainframe, "ROUT:CLOS (@1036)");
    rig.receive(Instrument::Source, "SOUR:CURR 1e-3;:OUTP ON");
    let (reader, mut writer) = tokio::io::split(rig.connect(Instrument::Mainframe));
    let mut reader = BufReader::new(reader);
    let mut message = String::new();
    // five readings of 200 ms and their delay each
    let scan = "CONF:VOLT:DC 10,(@1001);:VOLT:DC:NPLC 10,(@1001);:VOLT:DC:ZERO:AUTO OFF,(@1001);:TRIG:COUN 5;*OPC?\n";
    writer.write_all(scan.as_bytes()).await.unwrap();
    reader.read_line(&mut message).await.unwrap();
    writer.write_all(b"*IDN?;:READ?\n").await.unwrap();
    tokio::time::sleep(Duration::from_millis(500)).await;
    rig.receive(Instrument::Source, "SOUR:CURR -2e-3");
    message.clear();
    reader.read_line(&mut message).await.unwrap();
    let (identity, readings) = message.trim().split_once(';').unwrap();
    assert!(identity.starts_with("Agilent"), "{identity}");
    let readings: Vec<f64> = readings
        .split(',')
        .map(|text| text.parse().unwrap())
        .collect();
    let before = readings.iter().take_while(|volts| **volts > 0.0).count();
    assert!((2..=3).contains(&before), "{readings:?}");
    // the reading in progress at the change is the mean over its aperture
    let [first, .., last] = readings.as_slice() else {
        panic!("{readings:?}");
    };
    near(*first, 0.47);
    near(*last, -0.94);
    let between = |volts: &&f64| (-0.93..0.46).contains(*volts);
    assert_eq!(readings.iter().filter(between).count(), 1, "{readings:?}");
    // aborted by another client: the readings so far are returned
    writer.write_all(b"READ?\n").await.unwrap();
    tokio::time::sleep(Duration::from_millis(500)).await;
    rig.receive(Instrument::Mainframe, "ABOR");
    let aborted = tokio::time::Instant::now();
    message.clear();
    reader.read_line(&mut message).await.unwrap();
    assert_eq!(message.trim().split(',').count(), 2, "{message}");
    // at once, not at the end of the scan
    assert!(aborted.elapsed() <= Duration::from_millis(100));
    let next = "*IDN?\n";
    writer.write_all(next.as_bytes()).await.unwrap();
    message.clear();
    reader.read_line(&mut message).await.unwrap();
    assert!(aborted.elapsed() <= Duration::from_millis(200));
}
