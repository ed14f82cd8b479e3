//! Measures the time that the drivers add to that of relays and voltmeter; prints the table of measurements.
//!
//! ```text
//! cargo run --release -p tactus-simulator --example speed            # everything (a minute)
//! cargo run --release -p tactus-simulator --example speed -- quick   # without the frames in real time
//! cargo run --release -p tactus-simulator --example speed -- messages    # the time of each message of a frame
//! cargo run --release -p tactus-simulator --example speed -- python=VENV/bin/python   # with pyvisa for comparison
//! ```
//!
//! All connections are loopback TCP. "Own time" is the time of a frame with instruments that take no time: servers
//! that replay the replies of a recorded conversation, one per message. Times are the minimum of several runs,
//! because other work on the machine only adds time.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use keithley_6221::Keithley6221;
use keysight_34980a::Keysight34980a;
use phantom::Scene;
use rig::{
    BoxStream, Link, MeterSettings, Rig, RingTranscript, Stop, SystemClock, acquire, connect_tcp,
};
use simulator::{Instrument, Pace, Profile, SimulatedRig, TranscriptLine};
use survey::{Amps, Plan, Protocol, Volts, Wiring};

type AnyError = Box<dyn std::error::Error>;
type MainframeRig =
    Rig<Keithley6221<BoxStream>, Keysight34980a<BoxStream>, Keysight34980a<BoxStream>>;

const DEADLINE: Duration = Duration::from_secs(20);
const FRAMES: usize = 20;
/// Delay after a change of current in the frames in real time; it counts as the instruments' time.
const SETTLE: Duration = Duration::from_millis(2);

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), AnyError> {
    let has_argument = |what: &str| std::env::args().any(|argument| argument == what);
    if has_argument("messages") {
        return messages().await;
    }
    let quick = has_argument("quick");
    let python =
        std::env::args().find_map(|argument| Some(argument.strip_prefix("python=")?.to_owned()));
    let peer = python.as_deref().map(pyvisa).transpose()?;
    println!("| what (loopback) | goal | measured |\n|---|---|---|");
    conversations(peer).await?;
    let pairs = keysight_34980a::pairs_34924a(1, 26)?;
    let matrix = keysight_34980a::matrix_34932a(1, 26)?;
    for (what, goal, profile, wiring) in [
        ("26 x 26 scan frame", 5.0, "pairs-34924a", pairs.clone()),
        (
            "matrix frame, 26 chained messages",
            15.0,
            "matrix-34932a",
            matrix.clone().chained(),
        ),
        (
            "matrix frame, 598 reading messages",
            60.0,
            "matrix-34932a",
            matrix,
        ),
    ] {
        let least = own_time(profile, &wiring).await?.as_secs_f64();
        let beside =
            peer.filter(|_| profile == "pairs-34924a")
                .map_or(String::new(), |(_, frame)| {
                    format!(
                        " (unmodified pyvisa, 104 messages: {:.0} times as long)",
                        frame / least
                    )
                });
        println!(
            "| own time, {what} | {goal} ms | {:.1} ms{beside} |",
            1e3 * least
        );
    }
    if !quick {
        for (nplc, goal) in [(0.02, 0.90), (0.2, 0.95), (1.0, 0.95)] {
            let (theory, achieved) = real_time(&pairs, nplc).await?;
            println!(
                "| theoretical over achieved frame time, pairs on a 34924A, {nplc} PLC | {goal:.2} | {:.3} ({:.3} s of {:.3} s) |",
                theory / achieved,
                theory,
                achieved
            );
        }
    }
    println!(
        "| peer close noticed, worst of 20 | 50 ms | {:.2} ms |",
        1e3 * closing().await?
    );
    Ok(())
}

/// A server that replies to every line immediately.
fn trivial() -> std::io::Result<SocketAddr> {
    serve(|_| Some("+1.00000000E+00".to_owned()))
}

/// Serves each client in its own thread, line by line.
fn serve(
    answer: impl FnMut(&str) -> Option<String> + Send + Clone + 'static,
) -> std::io::Result<SocketAddr> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let address = listener.local_addr()?;
    std::thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            let mut answer = answer.clone();
            std::thread::spawn(move || -> std::io::Result<()> {
                stream.set_nodelay(true)?;
                let mut writer = stream.try_clone()?;
                for line in BufReader::new(stream).lines() {
                    if let Some(text) = answer(&line?) {
                        writer.write_all(format!("{text}\n").as_bytes())?;
                    }
                }
                Ok(())
            });
        }
    });
    Ok(address)
}

/// An instrument that replies to each query of a line with one number, to READ? with 26, and takes no time.
fn answering() -> std::io::Result<SocketAddr> {
    serve(|line| {
        let queries = line.split(';').filter(|piece| piece.contains('?'));
        let answers: Vec<String> = queries
            .map(|query| match query.contains("READ?") {
                true => vec!["+1.00000000E-03"; 26].join(","),
                false => "0".to_owned(),
            })
            .collect();
        (!answers.is_empty()).then(|| answers.join(";"))
    })
}

/// Pairs of a write and a query per second, and the minimum time of a frame of 26 x 26 readings, s, by pyvisa with
/// this Python.
fn pyvisa(python: &str) -> Result<(f64, f64), AnyError> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/pyvisa_speed.py");
    let mut command = std::process::Command::new(python);
    command.arg(script);
    for _ in 0..3 {
        command.arg(answering()?.to_string());
    }
    let ended = command.output()?;
    let reported = String::from_utf8_lossy(&ended.stdout);
    let mut numbers = reported.lines().map(str::parse::<f64>);
    match (numbers.next(), numbers.next()) {
        (Some(Ok(rate)), Some(Ok(frame))) => Ok((rate, frame)),
        _ => Err(format!("{python}: {}", String::from_utf8_lossy(&ended.stderr)).into()),
    }
}

/// Prints the messages of a frame in real time: when each was sent, the time until its reply, and the instrument.
async fn messages() -> Result<(), AnyError> {
    let simulated = SimulatedRig::new(&Profile::load("pairs-34924a")?, Scene::quiet())?;
    let transcript = RingTranscript::new(1);
    let link =
        |stream, name: &str| Link::new(stream, name, DEADLINE).with_transcript(transcript.clone());
    let source = Keithley6221::connect(link(simulated.connect(Instrument::Source), "6221")).await?;
    let mainframe =
        Keysight34980a::connect(link(simulated.connect(Instrument::Mainframe), "34980a")).await?;
    let rig = Rig::new(source, mainframe.clone(), mainframe).as_simulated(true);
    let plan = plan(&keysight_34980a::pairs_34924a(1, 26)?, SETTLE)?;
    let meter = MeterSettings::new(Volts(1.0), 0.02);
    for _ in 0..3 {
        transcript.next_transcript();
        acquire(&rig, &plan, meter, SystemClock::new(), &Stop::never()).await?;
    }
    let transcripts = transcript.transcripts();
    let entries = transcripts
        .last()
        .map_or(&[][..], |transcript| &transcript.entries);
    let begun = entries.first().map_or(0.0, |entry| entry.t_s);
    let mut sent: HashMap<&str, (f64, &str)> = HashMap::new();
    println!("sent at ms | answered after ms | instrument | message");
    for entry in entries {
        match &entry.content {
            rig::transcript::EntryContent::Sent(text) => {
                sent.insert(&entry.instrument, (entry.t_s, text));
            }
            rig::transcript::EntryContent::Received(_) => {
                let Some((at, text)) = sent.remove(entry.instrument.as_str()) else {
                    continue;
                };
                let text: String = text.chars().take(100).collect();
                let (at, took) = (1e3 * (at - begun), 1e3 * (entry.t_s - at));
                println!("{at:9.2} {took:9.2}  {:6}  {text}", entry.instrument);
            }
            rig::transcript::EntryContent::Note(text) => println!("{text}"),
        }
    }
    Ok(())
}

/// Prints the pairs of a write and a query per second: our driver, a bare blocking socket as the limit, and pyvisa if
/// measured.
async fn conversations(peer: Option<(f64, f64)>) -> Result<(), AnyError> {
    const REQUESTED: u32 = 5_000;
    let address = trivial()?;
    let mut link = Link::new(
        connect_tcp(&address.to_string(), DEADLINE).await?,
        "trivial",
        DEADLINE,
    );
    let bare = TcpStream::connect(address)?;
    bare.set_nodelay(true)?;
    let (mut writer, mut reader) = (bare.try_clone()?, BufReader::new(bare));
    let (mut ours, mut floor) = (0.0_f64, 0.0_f64);
    for _ in 0..5 {
        let begun = Instant::now();
        for _ in 0..REQUESTED {
            link.ask("SOUR:CURR 1e-3;:SOUR:CURR?").await?;
        }
        ours = ours.max(f64::from(REQUESTED) / begun.elapsed().as_secs_f64());
        let begun = Instant::now();
        let mut line = String::new();
        for _ in 0..REQUESTED {
            writer.write_all(b"SOUR:CURR 1e-3;:SOUR:CURR?\n")?;
            line.clear();
            reader.read_line(&mut line)?;
        }
        floor = floor.max(f64::from(REQUESTED) / begun.elapsed().as_secs_f64());
    }
    println!(
        "| write + query a second, trivial server | 10,000 | {ours:.0} ({:.2} of a bare blocking socket's {floor:.0}{}) |",
        ours / floor,
        peer.map_or(String::new(), |(rate, _)| format!(
            "; {:.0} times pyvisa's {rate:.1}",
            ours / rate
        ))
    );
    Ok(())
}

fn plan(wiring: &Wiring, settle: Duration) -> Result<Plan, AnyError> {
    Ok(Plan::new(
        &Protocol::sheffield(26)?,
        wiring,
        Amps(1e-3),
        Volts(4.0),
        settle,
    )?)
}

async fn connect(source: BoxStream, mainframe: BoxStream) -> Result<MainframeRig, AnyError> {
    let source = Keithley6221::connect(Link::new(source, "6221", DEADLINE)).await?;
    let mainframe = Keysight34980a::connect(Link::new(mainframe, "34980A", DEADLINE)).await?;
    Ok(Rig::new(source, mainframe.clone(), mainframe).as_simulated(true))
}

/// The replies of an instrument in order, and the index from which frames repeat.
#[derive(Clone)]
struct Script {
    answers: Vec<(String, Option<String>)>,
    repeats_from: usize,
    next: usize,
}

impl Script {
    fn of(transcript: &[TranscriptLine], first: usize, instrument: Instrument) -> Self {
        let of = |transcript: &[TranscriptLine]| -> Vec<(String, Option<String>)> {
            let received = transcript.iter().filter(|one| one.instrument == instrument);
            received
                .map(|one| (one.received.clone(), one.answered.clone()))
                .collect()
        };
        Self {
            answers: of(transcript),
            repeats_from: of(&transcript[..first]).len(),
            next: 0,
        }
    }

    fn answer(&mut self, line: &str) -> Option<String> {
        if self.next == self.answers.len() {
            self.next = self.repeats_from;
        }
        let (received, answered) = &self.answers[self.next];
        assert_eq!(
            received, line,
            "the conversation differs from the recorded one"
        );
        self.next += 1;
        answered.clone()
    }
}

/// The minimum time of a frame with instruments that take no time.
async fn own_time(profile: &str, wiring: &Wiring) -> Result<Duration, AnyError> {
    let profile = Profile::load(profile)?.at_pace(Pace::Instant);
    let simulated = SimulatedRig::new(&profile, Scene::quiet())?;
    simulated.keep_transcript();
    let plan = plan(wiring, Duration::ZERO)?;
    let meter = MeterSettings::new(Volts(1.0), 1.0);
    let (clock, never) = (SystemClock::new(), Stop::never());
    let mut marks = Vec::new();
    let rig = connect(
        simulated.connect(Instrument::Source),
        simulated.connect(Instrument::Mainframe),
    )
    .await?;
    for _ in 0..3 {
        acquire(&rig, &plan, meter, clock, &never).await?;
        marks.push(simulated.transcript().len());
    }
    // The first two frames set up the instruments; all later frames are like the third.
    let transcript = simulated.transcript();
    let mut streams = HashMap::new();
    for instrument in [Instrument::Source, Instrument::Mainframe] {
        let script = Script::of(&transcript, marks[1], instrument);
        let address = serve({
            let mut script = script;
            move |line: &str| script.answer(line)
        })?;
        streams.insert(
            instrument.to_string(),
            connect_tcp(&address.to_string(), DEADLINE).await?,
        );
    }
    let mut stream = |instrument: Instrument| {
        streams
            .remove(&instrument.to_string())
            .ok_or("no connection to this instrument is left")
    };
    let rig = connect(stream(Instrument::Source)?, stream(Instrument::Mainframe)?).await?;
    let mut least = Duration::MAX;
    for frame in 0..FRAMES + 2 {
        let begun = Instant::now();
        acquire(&rig, &plan, meter, clock, &never).await?;
        if frame >= 2 {
            least = least.min(begun.elapsed());
        }
    }
    Ok(least)
}

/// The time of the instruments by their data sheets, and the minimum time of a frame, s.
async fn real_time(wiring: &Wiring, nplc: f64) -> Result<(f64, f64), AnyError> {
    let simulated = SimulatedRig::new(&Profile::load("pairs-34924a")?, Scene::quiet())?;
    let rig = connect(
        simulated.connect(Instrument::Source),
        simulated.connect(Instrument::Mainframe),
    )
    .await?;
    let plan = plan(wiring, SETTLE)?;
    let timing = keysight_34980a::Model::M34924A.timing(nplc, 50.0);
    let meter = MeterSettings {
        deadline: Some(plan.longest_answer(&timing)),
        ..MeterSettings::new(Volts(1.0), nplc)
    };
    let frames = if nplc < 1.0 { 6 } else { 2 };
    let mut least = f64::MAX;
    for frame in 0..=frames {
        let begun = Instant::now();
        acquire(&rig, &plan, meter, SystemClock::new(), &Stop::never()).await?;
        if frame > 0 {
            least = least.min(begun.elapsed().as_secs_f64());
        }
    }
    Ok((plan.duration(&timing).as_secs_f64(), least))
}

/// Time from the close of a peer's connection to the error of the pending query, s.
async fn closing() -> Result<f64, AnyError> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let address = listener.local_addr()?.to_string();
    let (closed, closes) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            std::thread::sleep(Duration::from_millis(20));
            let now = Instant::now();
            drop(stream);
            let _ = closed.send(now);
        }
    });
    let mut worst = 0.0_f64;
    for _ in 0..20 {
        let mut link = Link::new(connect_tcp(&address, DEADLINE).await?, "closing", DEADLINE);
        let lost = link.ask("*IDN?").await;
        let noticed = Instant::now();
        assert!(lost.is_err(), "no answer was expected");
        let closed: Instant = closes.recv()?;
        worst = worst.max(noticed.saturating_duration_since(closed).as_secs_f64());
    }
    Ok(worst)
}
