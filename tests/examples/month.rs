//! A month of the shipped month scene in minutes, with continual faults: afterwards the record is complete, every gap
//! in it has an event that explains it, and the source is off.
//!
//! ```text
//! cargo run --release -p tactus-tests --example month [-- FRAMES [SEED]]
//! ```
//!
//! 4,320 frames by default, one per ten minutes of the scene. This process serves the instruments over TCP; every tenth
//! of a second it advances their time by ten minutes. The daemon is a separate process; between faults of the
//! instruments it is killed, stopped, frozen and restarted.

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};
use logbook::{SessionReader, Verified};
use rustix::process::{Pid, Signal, kill_process};
use simulator::{Fault, Pace, Profile, Scene, ServeOptions, SimulatedRig};
use tactus_tests::{DEADLINE, DaemonProcess, SIMULATED, Stage, act_as};

type Failure = Box<dyn std::error::Error>;

/// The shipped scene, on its own mesh.
const MONTH: &str = include_str!("../../tomography/phantom/scenes/month.toml");
/// Time between frames of the scene, s, as stated in its first comment.
const SCENE_S: f64 = 600.0;
const EVERY_S: f64 = 0.1;
/// Speed of the instruments. Most of the scene's time passes in steps between frames: the sheet changes every minute
/// of the scene, so at 6,000 times real time each message would need a solution of its own.
const SPEED: f64 = 100.0;
/// Frames between two faults.
const FRAMES_BETWEEN: u64 = 60;

/// A fault of the instruments or the daemon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Incident {
    /// The text of a `tactus-sim fault`, and the text that ends it, unless it has no duration.
    Instruments(&'static str, Option<&'static str>),
    /// SIGKILL, followed by a new daemon.
    Killed,
    /// SIGTERM, followed by a new daemon: an update.
    Updated,
    /// SIGSTOP for some periods.
    Frozen,
    /// Instruments and daemon lose power together.
    PowerCut,
}
use Incident::{Frozen, Instruments, Killed, PowerCut, Updated};

const INCIDENTS: [Incident; 30] = [
    Killed,
    Instruments("drop 34980a", None),
    Instruments("wire 34980a cut", Some("wire 34980a sound")),
    Updated,
    Instruments("wire 34980a silent", Some("wire 34980a sound")),
    Instruments("lost 34980a 1", None),
    Frozen,
    Instruments("late 34980a 8 1", None),
    Instruments("doubled 34980a 1", None),
    PowerCut,
    Instruments("half-line 34980a 1", None),
    Instruments("slow 34980a 8", Some("slow 34980a 0")),
    Killed,
    Instruments("reset 34980a", None),
    Instruments("queue-overflow 34980a", None),
    Instruments("slot 1 empty", Some("slot 1 filled")),
    Instruments("voltmeter missing", Some("voltmeter present")),
    Updated,
    Instruments("interlock open", Some("interlock closed")),
    Instruments("drop 6221", None),
    Instruments("wire 6221 cut", Some("wire 6221 sound")),
    Killed,
    Instruments("wire 6221 silent", Some("wire 6221 sound")),
    Instruments("lost 6221 1", None),
    Instruments("late 6221 8 1", None),
    Instruments("doubled 6221 1", None),
    PowerCut,
    Instruments("half-line 6221 1", None),
    Instruments("reset 6221", None),
    Instruments("queue-overflow 6221", None),
];

fn main() -> ExitCode {
    if let Some(code) = act_as(std::env::args_os()) {
        return code;
    }
    match month() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("month: {failure}");
            ExitCode::FAILURE
        }
    }
}

fn month() -> Result<(), Failure> {
    let mut words = std::env::args().skip(1);
    let frames: u64 = words.next().map_or(Ok(4320), |word| word.parse())?;
    let seed: u64 = words.next().map_or(Ok(1), |word| word.parse())?;
    let runtime = tokio::runtime::Runtime::new()?;
    let _inside = runtime.enter();
    let scene = Scene::parse("month.toml", MONTH)?;
    let profile = Profile::load("pairs-34924a")?.at_pace(Pace::Scaled(SPEED));
    let rig = SimulatedRig::new(&profile, scene)?;
    let options = ServeOptions {
        port_6221: 0,
        port_34980a: 0,
        ..ServeOptions::default()
    };
    let server = runtime.block_on(simulator::serve(rig.clone(), &options))?;
    let advanced = rig.clone();
    runtime.spawn(async move {
        let mut ticks = tokio::time::interval(survey::duration(EVERY_S));
        loop {
            ticks.tick().await;
            advanced.advance(survey::duration(SCENE_S - SPEED * EVERY_S));
        }
    });
    let (source, mainframe) = (&server.ready().source, &server.ready().mainframe);
    let stage = Stage::with_program(
        &configuration(&source.to_string(), &mainframe.to_string()),
        std::env::current_exe()?,
    )?;
    let mut month = Month {
        daemon: Some(stage.start_daemon()?),
        stage,
        rig,
        bar: ProgressBar::new(frames).with_style(ProgressStyle::with_template(
            "{bar:40} {pos}/{len} frames, {eta} left: {msg}",
        )?),
    };
    month.run(&["baseline", "record", "--frames", "4"])?;
    month.run(&["start", "--every", &format!("{EVERY_S}s")])?;
    let began = Instant::now();
    let mut order = shuffled(seed);
    let mut injected: BTreeMap<String, u64> = BTreeMap::new();
    let mut next = FRAMES_BETWEEN;
    while next + FRAMES_BETWEEN <= frames {
        let incident = order.pop().unwrap_or_else(|| {
            order = shuffled(seed.wrapping_add(next));
            Killed
        });
        let before = month.frames(next);
        before.map_err(|failure| month.explained(&format!("before {incident:?}"), failure))?;
        month.bar.set_message(format!("{incident:?}"));
        let ended = month.inject(incident);
        ended.map_err(|failure| {
            month.explained(&format!("{incident:?} at frame {next}"), failure)
        })?;
        *injected.entry(format!("{incident:?}")).or_default() += 1;
        let frame = month.durable()?;
        month.bar.suspend(|| {
            println!(
                "{:6.0} s  frame {frame}: {incident:?}",
                began.elapsed().as_secs_f64()
            );
        });
        next = frame + FRAMES_BETWEEN;
    }
    month.frames(frames)?;
    month.run(&["stop"])?;
    month.bar.finish_and_clear();
    if let Some(daemon) = month.daemon.take() {
        daemon.stop()?;
    }
    let incidents: u64 = injected.values().sum();
    println!(
        "{incidents} incidents of {} kinds in {:.0} s",
        injected.len(),
        began.elapsed().as_secs_f64()
    );
    month.judge(frames, incidents)
}

/// The stories' rig, with its instruments on TCP, and parts of a few megabytes.
fn configuration(source: &str, mainframe: &str) -> String {
    // much longer than a reply takes on a busy machine, shorter than the late and slow ones above
    let deadline = "deadline_ms = 5000";
    SIMULATED
        .replace(
            "kind = \"simulated\"\nprofile = \"STAGE/profile.toml\"\nscene = \"STAGE/scene.toml\"\n",
            &format!(
                "kind = \"instruments\"\n[source]\naddress = \"tcp:{source}\"\n{deadline}\n\
                 [switch]\naddress = \"tcp:{mainframe}\"\n{deadline}\n\
                 [voltmeter]\naddress = \"tcp:{mainframe}\"\n{deadline}\n"
            ),
        )
        .replace(
            "[record]\n",
            // time is compressed here
            "[record]\nroll_mb = 1\nresume_per_hour = 1000\n",
        )
}

/// All faults, each once, in an order given by the seed.
fn shuffled(seed: u64) -> Vec<Incident> {
    let mut order = INCIDENTS.to_vec();
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    for last in (1..order.len()).rev() {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        order.swap(last, (state >> 33) as usize % (last + 1));
    }
    order
}

struct Month {
    stage: Stage,
    rig: SimulatedRig,
    daemon: Option<DaemonProcess>,
    bar: ProgressBar,
}

impl Month {
    fn run(&self, words: &[&str]) -> Result<(), Failure> {
        self.stage.tactus(words)?.succeeded()?;
        Ok(())
    }

    /// Number of frames on disk, and of failed frames.
    fn so_far(&self) -> Result<(u64, u64), Failure> {
        let message = self.stage.tactus(&["status", "--json"])?.succeeded()?;
        let session = &message.json()[0]["session"];
        let count = |name: &str| session[name].as_u64().ok_or("the session has ended");
        Ok((count("frames_durable")?, count("frames_failed")?))
    }

    fn durable(&self) -> Result<u64, Failure> {
        let (durable, _) = self.so_far()?;
        self.bar.set_position(durable);
        Ok(durable)
    }

    /// Waits for an event for at most [`DEADLINE`] since the last frame.
    fn until(&self, what: &str, happened: impl Fn((u64, u64)) -> bool) -> Result<(), Failure> {
        let mut last = (self.so_far()?, Instant::now());
        while !happened(last.0) {
            std::thread::sleep(Duration::from_millis(100));
            let now = self.so_far()?;
            self.bar.set_position(now.0);
            if now != last.0 {
                last = (now, Instant::now());
            }
            if last.1.elapsed() > DEADLINE {
                return Err(format!("{what} did not come").into());
            }
        }
        Ok(())
    }

    fn frames(&self, count: u64) -> Result<(), Failure> {
        self.until("a frame", |(durable, _)| durable >= count)
    }

    fn inject(&mut self, incident: Incident) -> Result<(), Failure> {
        let (durable, failed) = self.so_far()?;
        match incident {
            Instruments(words, end) => {
                self.fault(words)?;
                // a fault without duration may pass between two frames, unnoticed
                self.until("a failed frame", |now| {
                    now.1 > failed || (end.is_none() && now.0 > durable + 20)
                })?;
                if let Some(end) = end {
                    self.fault(end)?;
                }
            }
            Killed => {
                self.kill()?;
                // as systemd does it by ExecStopPost
                let config = self.stage.config_path();
                let safe_off = ["--safe-off", "--config", &config.to_string_lossy()];
                self.stage.run("tactusd", &safe_off)?.succeeded()?;
            }
            PowerCut => self.kill()?,
            Updated => {
                if let Some(daemon) = self.daemon.take() {
                    daemon.stop()?;
                }
            }
            Frozen => {
                let id = self.daemon.as_ref().map_or(0, DaemonProcess::id);
                let daemon = Pid::from_raw(id.try_into()?).ok_or("no daemon runs")?;
                kill_process(daemon, Signal::STOP)?;
                std::thread::sleep(survey::duration(20.0 * EVERY_S));
                kill_process(daemon, Signal::CONT)?;
            }
        }
        if incident == PowerCut {
            self.fault("reset 6221")?;
            self.fault("reset 34980a")?;
        }
        if self.daemon.is_none() {
            self.daemon = Some(self.stage.start_daemon()?);
        }
        self.frames(durable + 3)
    }

    /// A failure with the daemon's log.
    fn explained(&self, when: &str, failure: Failure) -> Failure {
        let log = self.daemon.as_ref().map(DaemonProcess::log);
        format!("{when}: {failure}\n{}", log.unwrap_or_default()).into()
    }

    fn kill(&mut self) -> Result<(), Failure> {
        self.daemon.take().ok_or("no daemon runs")?.kill();
        Ok(())
    }

    fn fault(&self, words: &str) -> Result<(), Failure> {
        let fault: Fault = words.parse()?;
        Ok(self.rig.fault(&fault)?)
    }

    fn judge(&self, frames: u64, incidents: u64) -> Result<(), Failure> {
        if self.rig.source_output().0 || !self.rig.closed().is_empty() {
            return Err("the source is on, or relays are closed, when all has ended".into());
        }
        let session = newest_measurement(&self.stage)?;
        let verified = logbook::verify(&session, |_| ())?;
        self.print(&verified)?;
        if verified.frames < frames || !verified.closed {
            return Err(format!("{} frames of {frames} are there", verified.frames).into());
        }
        // a few faults fall between two frames and cause no gap
        if (verified.gaps.len() as u64) < incidents / 2 {
            return Err(format!("{} gaps of {incidents} incidents", verified.gaps.len()).into());
        }
        match verified.findings.first() {
            None => {
                println!(
                    "{incidents} incidents, {} frames in {} parts, {} gaps, every one explained",
                    verified.frames,
                    verified.parts.len(),
                    verified.gaps.len()
                );
                Ok(())
            }
            Some(first) => Err(format!(
                "{} findings, the first in {}: {}",
                verified.findings.len(),
                first.part,
                first.text
            )
            .into()),
        }
    }

    fn print(&self, verified: &Verified) -> Result<(), Failure> {
        let mut kinds: BTreeMap<String, u64> = BTreeMap::new();
        for part in &verified.parts {
            let reader =
                SessionReader::open(self.stage.state_path().join(format!("{part}.tactus")))?;
            for event in reader.events()? {
                *kinds.entry(event.kind).or_default() += 1;
            }
        }
        let longest = verified
            .gaps
            .iter()
            .map(|gap| gap.seconds)
            .fold(0.0, f64::max);
        println!(
            "the longest gap is {longest:.1} s; the scene stands at day {:.1}",
            self.rig.now().as_secs_f64() / 86_400.0
        );
        for (kind, count) in kinds {
            println!("{count:6} {kind}");
        }
        Ok(())
    }
}

/// Any part of the session that was measured.
fn newest_measurement(stage: &Stage) -> Result<std::path::PathBuf, Failure> {
    for entry in std::fs::read_dir(stage.state_path())? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with('m') && name.ends_with(".tactus") {
            return Ok(path);
        }
    }
    Err("no session was recorded".into())
}
