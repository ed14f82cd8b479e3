//! `tactus-sim`, as a function.

pub(crate) mod list;
pub(crate) mod panel;
mod replay;

use std::ffi::OsString;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::SystemTime;

use clap::{CommandFactory, Parser, Subcommand};
use keysight_34980a::Module;
use outfile::OutPath;
use phantom::Scene;
use rig::transcript::TranscriptWriter;
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::EnvFilter;

use crate::instrument::fault::GRAMMAR;
use crate::profile::{fill, slot};
use crate::program::panel::Panel;
use crate::{LoadNetwork, Pace, Profile, ServeOptions, SimulatedRig, serve};

/// Exit code of a profile or scene that cannot be used (EX_CONFIG).
const CONFIGURATION: u8 = 78;
/// Exit code of a wrong command line.
const USAGE: u8 = 2;

/// Simulated instruments, connected to one simulated sheet, for any SCPI client.
#[derive(Debug, Parser)]
#[command(name = "tactus-sim", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve the instruments until stopped; prints one line of JSON once clients can connect.
    Serve(Serve),
    /// Start or end a fault in a served rig.
    #[command(
        after_help = GRAMMAR.as_str(),
        mut_arg("words", |words| words.help("The fault: a line of the list below"))
    )]
    Fault(Words),
    /// Press a disc on the sheet of a served rig.
    #[command(mut_arg("words", |words| words.help("X_MM Y_MM DIAMETER_MM LOSS_PERCENT")))]
    Press(Words),
    /// Remove the pressed loads.
    Release(Control),
    /// Show clients, state of the source, closed relays and last error of a served rig.
    Status(Status),
    /// Convert a transcript to a golden: a conversation that the simulator must reproduce.
    Golden(replay::MakeGolden),
    /// Play a transcript to the simulators and report the first reply that differs.
    Replay(replay::Replay),
    /// List modules, profiles, scenes, loads and faults.
    List {
        /// Print one line of JSON.
        #[arg(long)]
        json: bool,
    },
}

#[derive(Debug, clap::Args)]
struct Control {
    /// Control socket, as in the ready line; not needed if only one rig is served.
    #[arg(long, value_name = "PATH")]
    control: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct Words {
    #[command(flatten)]
    control: Control,
    /// Arguments of the command.
    #[arg(required = true, allow_negative_numbers = true)]
    words: Vec<String>,
}

#[derive(Debug, clap::Args)]
struct Status {
    #[command(flatten)]
    control: Control,
    /// Print one line of JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct Serve {
    /// Profile of the instruments: a file, or a name of `tactus-sim list` [default: pairs-34924a].
    #[arg(long, value_name = "FILE|NAME")]
    profile: Option<String>,
    /// Scene (sheet, loads and effects): a file, or a name of `tactus-sim list` [default: an unloaded sheet].
    #[arg(long, value_name = "FILE|NAME")]
    scene: Option<String>,
    /// Port of the 6221; 0 for a free one.
    #[arg(long, value_name = "N", default_value_t = 1394)]
    port_6221: u16,
    /// Port of the 34980A; 0 for a free one.
    #[arg(long, value_name = "N", default_value_t = 5025)]
    port_34980a: u16,
    /// Port of the 34980A's VXI-11 core channel; 0 for a free one [default: none].
    #[arg(long, value_name = "N")]
    port_vxi11: Option<u16>,
    /// Port of the 34980A's telnet server (5024 on the instrument); 0 for a free one [default: none].
    #[arg(long, value_name = "N")]
    port_telnet: Option<u16>,
    /// Port of the 34980A's LXI identification and web page; 0 for a free one [default: none, or a free one with
    /// --announce].
    #[arg(long, value_name = "N")]
    port_http: Option<u16>,
    /// Serve the 6221's serial port too, as a pseudo-terminal.
    #[arg(long)]
    serial_6221: bool,
    /// Path of the control socket [default: in a temporary folder].
    #[arg(long, value_name = "PATH")]
    control: Option<PathBuf>,
    /// Load on the terminals instead of the profile's: sheet, nothing, "resistor FROM TO OHMS", "mesh OHMS".
    #[arg(long, value_name = "WORDS")]
    load: Option<LoadNetwork>,
    /// Module in a slot, instead of the profile's: 1=34924A, 3=34934A,4x128.
    #[arg(long, value_name = "N=MODEL[,TERMINAL]", value_parser = slot)]
    slot: Vec<(usize, Module)>,
    /// Reply immediately, without the instruments' delays.
    #[arg(long)]
    instant: bool,
    /// New file for a transcript of all messages to the instruments and their replies, for `golden` and `replay`.
    #[arg(long, value_name = "FILE")]
    record: Option<OutPath>,
    /// Announce the instruments by mDNS.
    #[arg(long)]
    announce: bool,
    /// Address to listen on.
    #[arg(long, default_value = "127.0.0.1")]
    bind: String,
}

/// The definition of the command line: every command and option, for reference pages and completions.
pub fn command() -> clap::Command {
    let command = Arguments::command();
    help_examples::with_examples(command, include_str!("examples.txt"))
}

/// Runs `tactus-sim`; the first argument is the program's name.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let words: Vec<OsString> = arguments.into_iter().collect();
    let json = survey::asks_for_json(&words);
    let command = command();
    let report = |text: String| {
        eprintln!("{}", survey::error_line("usage", USAGE, &text));
        ExitCode::from(USAGE)
    };
    let parsed = help_examples::parsed::<Arguments>(&command, &words, json, report);
    let (matches, arguments) = match parsed {
        Ok(parsed) => parsed,
        Err(code) => return code,
    };
    if let Err(refused) = outfile::check_arguments(&command, &matches) {
        return fail(&refused, CONFIGURATION);
    }
    let options = match arguments.command {
        Command::Serve(options) => options,
        Command::Fault(Words { control, words }) => {
            return send_command(&control, &words.join(" "));
        }
        Command::Press(Words { control, words }) => {
            return send_command(&control, &format!("press {}", words.join(" ")));
        }
        Command::Release(control) => return send_command(&control, "release"),
        Command::Status(Status { control, json }) => return show(&control, json),
        Command::Golden(options) => return replay::make_golden(&options),
        Command::Replay(options) => return replay::play(&options),
        Command::List { json } => {
            return print_line(&if json {
                list::json().to_string()
            } else {
                list::text()
            });
        }
    };
    let panel = std::io::stderr().is_terminal().then(Panel::default);
    let filter = EnvFilter::try_from_env("TACTUS_LOG")
        .unwrap_or_else(|_| EnvFilter::new("warn,mdns_sd=error"));
    let log = tracing_subscriber::fmt().with_env_filter(filter);
    match &panel {
        Some(panel) => log.with_writer(panel.clone()).try_init().ok(),
        None => log.with_writer(std::io::stderr).try_init().ok(),
    };
    let (profile, scene) = match prepare(&options) {
        Ok(prepared) => prepared,
        Err(fault) => return fail(&*fault, CONFIGURATION),
    };
    let runtime = match tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
    {
        Ok(runtime) => runtime,
        Err(fault) => return fail(&fault, 1),
    };
    runtime.block_on(async {
        let rig = match SimulatedRig::new(&profile, scene) {
            Ok(rig) => rig,
            Err(fault) => return fail(&fault, CONFIGURATION),
        };
        if let Some(path) = &options.record {
            match TranscriptWriter::create(path) {
                Ok(writer) => rig.record(writer),
                Err(fault) => return fail(&fault, CONFIGURATION),
            }
        }
        match serve_until_stopped(rig, &options, panel).await {
            Ok(()) => ExitCode::SUCCESS,
            Err(fault) => fail(&*fault, 1),
        }
    })
}

type Fault = Box<dyn std::error::Error>;

fn prepare(options: &Serve) -> Result<(Profile, Scene), Fault> {
    let mut profile = match &options.profile {
        Some(name) => Profile::load(name)?,
        None => Profile::default(),
    };
    fill(&mut profile.slots, &options.slot)?;
    if profile.mainframe.clock_unix_s.is_none() {
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let now = now.unwrap_or_default().as_secs();
        profile.mainframe.clock_unix_s = u32::try_from(now).ok();
    }
    if let Some(load) = &options.load {
        profile.load = load.clone();
    }
    if options.instant {
        profile.pace = Pace::Instant;
    }
    let scene = scene_named(options.scene.as_deref())?;
    Ok((profile, scene))
}

/// A shipped scene, or one in a file; the unloaded sheet without a name.
fn scene_named(name: Option<&str>) -> Result<Scene, Fault> {
    Ok(name.map_or_else(|| Ok(Scene::quiet()), Scene::open)?)
}

/// Sends a command line to a served rig.
fn send_command(to: &Control, line: &str) -> ExitCode {
    match crate::control::ask(to.control.as_deref(), line) {
        Ok(_) => ExitCode::SUCCESS,
        Err(refusal) => {
            eprintln!("tactus-sim: {}", survey::printable(&refusal));
            ExitCode::FAILURE
        }
    }
}

fn show(of: &Control, json: bool) -> ExitCode {
    let reported = crate::control::ask(of.control.as_deref(), "status").and_then(|status| {
        if json {
            return Ok(status.to_string());
        }
        let status: crate::Status = serde_json::from_value(status)
            .map_err(|fault| format!("a command to the rig is not valid: {fault}"))?;
        Ok(status.to_string())
    });
    match reported {
        Ok(text) => print_line(&text),
        Err(refusal) if json => {
            eprintln!("{}", survey::error_line("failed", 1, &refusal));
            ExitCode::FAILURE
        }
        Err(refusal) => {
            eprintln!("tactus-sim: {}", survey::printable(&refusal));
            ExitCode::FAILURE
        }
    }
}

/// Prints; a closed pipe is not an error.
fn print_line(text: &str) -> ExitCode {
    match writeln!(std::io::stdout(), "{text}") {
        Err(fault) if fault.kind() != std::io::ErrorKind::BrokenPipe => fail(&fault, 1),
        _ => ExitCode::SUCCESS,
    }
}

async fn serve_until_stopped(
    rig: SimulatedRig,
    options: &Serve,
    panel: Option<Panel>,
) -> Result<(), Fault> {
    // Before the ready line: a parent process may stop this one as soon as it appears.
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    // Sent when the terminal closes.
    let mut hangup = signal(SignalKind::hangup())?;
    let shown = rig.clone();
    let server = serve(
        rig,
        &ServeOptions {
            bind: options.bind.clone(),
            port_6221: options.port_6221,
            port_34980a: options.port_34980a,
            port_vxi11: options.port_vxi11,
            port_telnet: options.port_telnet,
            port_http: options.port_http,
            serial_6221: options.serial_6221,
            control: options.control.clone(),
            announce: options.announce,
        },
    )
    .await?;
    let mut line = serde_json::to_string(server.ready())?;
    line.push('\n');
    {
        let mut out = std::io::stdout().lock();
        out.write_all(line.as_bytes())?;
        out.flush()?;
    }
    let draw = async {
        match panel {
            Some(panel) => panel.keep_drawing(&shown).await,
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        _ = terminate.recv() => {}
        _ = interrupt.recv() => {}
        _ = hangup.recv() => {}
        () = draw => {}
    }
    server.stop().await;
    Ok(())
}

/// Prints the chain of causes.
fn fail(fault: &dyn std::error::Error, code: u8) -> ExitCode {
    eprintln!("tactus-sim: {}", survey::error_chain(fault));
    ExitCode::from(code)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_output_replaces_what_is_not_its_own() {
        let paths = outfile::trial::Paths {
            outputs: &[
                ("golden --out", "golden t --instrument 6221 --out {}"),
                ("serve --record", "serve --record {}"),
            ],
            inputs: &[
                "fault --control",
                "golden file",
                "press --control",
                "release --control",
                "replay file",
                // serve creates its control socket only where no file exists
                "serve --control",
                "status --control",
            ],
        };
        outfile::trial::attack_every_output(&Arguments::command(), &paths, run);
    }

    #[test]
    fn every_command_of_the_chapter_is_understood() {
        let manual = include_str!("../../../docs/how-to/develop-without-instruments.md");
        let chapter = [manual, include_str!("../../README.md")].concat();
        let mut commands = 0;
        let lines = chapter.lines().map(str::trim);
        for line in lines.filter(|line| line.starts_with("tactus-sim ")) {
            let line = line.split(" #").next().unwrap_or_default();
            // The shell's background operator.
            let line = line.trim_end().trim_end_matches('&');
            // Quotes group words.
            let words = line.split('"').enumerate().flat_map(|(index, part)| {
                if index % 2 == 1 {
                    vec![part]
                } else {
                    part.split_whitespace().collect()
                }
            });
            let arguments = Arguments::try_parse_from(words)
                .unwrap_or_else(|refusal| panic!("{line}: {refusal}"));
            if let Command::Fault(Words { words, .. }) = arguments.command {
                let words = words.join(" ");
                assert!(words.parse::<crate::Fault>().is_ok(), "{words}");
            }
            commands += 1;
        }
        assert!(commands > 10);
        for profile in chapter.split("```toml\n").skip(1) {
            let text = profile.split("```").next().unwrap_or_default();
            // the block is either a profile or a part of a scene
            if let Err(fault) = Profile::parse("README.md", text) {
                assert!(
                    crate::Scene::parse("README.md", text).is_ok(),
                    "{fault}: {text}"
                );
            }
        }
    }
}
