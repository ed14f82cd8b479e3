//! `tactus-sim golden` and `tactus-sim replay`: replay of transcripts to simulators.

use std::path::PathBuf;
use std::process::ExitCode;

use keysight_34980a::Module;
use outfile::{Existing, OutPath};
use rig::transcript::read_transcript;

use super::{CONFIGURATION, Fault, fail, print_line, scene_named};
use crate::profile::{fill, slot};
use crate::{
    Comparison, Golden, Instrument, InstrumentSetup, LoadNetwork, Pace, Profile, ReplayTarget,
    SimulatedRig, golden_of, replay,
};

#[derive(Debug, clap::Args)]
pub(super) struct MakeGolden {
    /// The transcript: lines of JSON, as `serve --record` and the daemon write them.
    file: PathBuf,
    #[arg(long, value_name = "NAME", value_parser = instrument, help = instruments())]
    instrument: Instrument,
    /// File for the golden [default: standard output].
    #[arg(long, short, value_name = "FILE")]
    out: Option<OutPath>,
    /// Replace a file that exists; recorded sessions are never replaced.
    #[arg(long)]
    force: bool,
    /// Source to cite in the golden besides the transcript: a section of a manual, the unit's serial number.
    #[arg(long, value_name = "WORDS")]
    cites: Vec<String>,
    #[command(flatten)]
    setup: SetupArguments,
}

#[derive(Debug, clap::Args)]
pub(super) struct Replay {
    /// The transcript.
    file: PathBuf,
    /// Play it to the instruments of one rig: a profile's file, or a name of `tactus-sim list` [default: to each
    /// instrument separately].
    #[arg(long, value_name = "FILE|NAME")]
    profile: Option<String>,
    /// With --profile: the sheet, its loads and effects.
    #[arg(long, value_name = "FILE|NAME", requires = "profile")]
    scene: Option<String>,
    /// With --profile: load on the terminals instead of the profile's.
    #[arg(long, value_name = "WORDS", requires = "profile")]
    load: Option<LoadNetwork>,
    /// Compare readings, times and serial numbers byte by byte too.
    #[arg(long)]
    exact: bool,
    #[command(flatten)]
    setup: SetupArguments,
}

#[derive(Debug, clap::Args)]
struct SetupArguments {
    /// Module of the mainframe that the transcript does not identify: 1=34924A, 3=34934A,4x128.
    #[arg(long, value_name = "N=MODEL[,TERMINAL]", value_parser = slot)]
    slot: Vec<(usize, Module)>,
    /// Resistance on the source's terminals, ohm [default: open].
    #[arg(long, value_name = "R")]
    ohms: Option<f64>,
    /// Voltage at the voltmeter, V [default: 0]
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    volts: Option<f64>,
}

fn instrument(text: &str) -> Result<Instrument, String> {
    let known = || Instrument::listed(|kind| kind.name, "and");
    Instrument::named(text).ok_or_else(|| format!("there are {}", known()))
}

fn instruments() -> String {
    format!(
        "Instrument: {}",
        Instrument::ALL.map(Instrument::name).join(", ")
    )
}

impl SetupArguments {
    fn of(&self, instrument: Instrument) -> Result<InstrumentSetup, Fault> {
        let mut setup = InstrumentSetup::of(instrument);
        fill(&mut setup.slots, &self.slot)?;
        if let Some(ohms) = self.ohms {
            if ohms.is_nan() || ohms < 0.0 {
                return Err(format!("{ohms} ohm cannot be connected to terminals").into());
            }
            setup.ohms = ohms;
        }
        if let Some(volts) = self.volts {
            if volts.is_nan() {
                return Err("a voltage is a number".into());
            }
            setup.volts = volts;
        }
        Ok(setup)
    }
}

pub(super) fn make_golden(options: &MakeGolden) -> ExitCode {
    match written_golden(options) {
        Ok((golden, differs)) => {
            if let Some(differs) = differs {
                eprintln!(
                    "tactus-sim: the golden is written, but the simulator does not reproduce it: {differs}"
                );
            }
            match &options.out {
                Some(_) => ExitCode::SUCCESS,
                None => print_line(golden.to_string().trim_end()),
            }
        }
        Err(fault) => fail(&*fault, CONFIGURATION),
    }
}

/// The golden, and the first difference of the simulator's replies.
fn written_golden(options: &MakeGolden) -> Result<(Golden, Option<String>), Fault> {
    let entries = read_transcript(&options.file)?;
    let place = options.file.display().to_string();
    let name = options.file.file_name().unwrap_or_default();
    let mut cites = options.cites.clone();
    cites.push(format!("the transcript {}", name.to_string_lossy()));
    let setup = options.setup.of(options.instrument)?;
    let golden = golden_of(&place, &entries, &setup, cites)?;
    let text = golden.to_string();
    let place = match &options.out {
        Some(path) => {
            outfile::write(path, Existing::forced(options.force), text.as_bytes())?;
            path.display().to_string()
        }
        None => "the golden".to_owned(),
    };
    // Parsed again, so that differences are reported with their lines.
    let differs = Golden::parse(&place, &text)?.play(&place).err();
    Ok((golden, differs.map(|fault| fault.to_string())))
}

pub(super) fn play(options: &Replay) -> ExitCode {
    let target = match target(options) {
        Ok(target) => target,
        Err(fault) => return fail(&*fault, CONFIGURATION),
    };
    let entries = match read_transcript(&options.file) {
        Ok(entries) => entries,
        Err(fault) => return fail(&fault, CONFIGURATION),
    };
    let comparison = match options.exact {
        true => Comparison::Exact,
        false => Comparison::Shapes,
    };
    match replay(
        &options.file.display().to_string(),
        &entries,
        &target,
        comparison,
    ) {
        Ok(played) => print_line(&format!(
            "{} messages, {} replies: the simulators reply as recorded",
            played.messages, played.replies
        )),
        Err(fault) => fail(&fault, 1),
    }
}

fn target(options: &Replay) -> Result<ReplayTarget, Fault> {
    let Some(name) = &options.profile else {
        return Ok(ReplayTarget::Alone {
            setup: options.setup.of(Instrument::Mainframe)?,
        });
    };
    let mut profile = Profile::load(name)?.at_pace(Pace::Instant);
    fill(&mut profile.slots, &options.setup.slot)?;
    if let Some(load) = &options.load {
        profile.load = load.clone();
    }
    let scene = scene_named(options.scene.as_deref())?;
    Ok(ReplayTarget::Together(SimulatedRig::new(&profile, scene)?))
}
