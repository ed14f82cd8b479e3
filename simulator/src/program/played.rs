//! `tactus-sim golden` and `tactus-sim replay`: transcripts played to simulators.

use std::path::PathBuf;
use std::process::ExitCode;

use keysight_34980a::Module;
use outfile::{Existing, OutPath};
use rig::transcript::read_transcript;

use super::{CONFIGURATION, Fault, fail, say, scene_named, slot};
use crate::{
    Against, Closeness, Golden, Hanging, Instrument, Making, Pace, Profile, SimulatedRig,
    golden_of, replay,
};

#[derive(Debug, clap::Args)]
pub(super) struct MakeGolden {
    /// The transcript: lines of JSON, as `serve --record` and the daemon write them.
    file: PathBuf,
    /// Which instrument's part of it: 6221, 34980a, gpio.
    #[arg(long, value_name = "NAME", value_parser = instrument)]
    instrument: Instrument,
    /// Where the golden is written; without it to standard output.
    #[arg(long, short, value_name = "FILE")]
    out: Option<OutPath>,
    /// Replace a file that exists; recorded sessions are never replaced.
    #[arg(long)]
    force: bool,
    /// What the golden is to cite beside the transcript: a section of a manual, the unit's serial number.
    #[arg(long, value_name = "WORDS")]
    cites: Vec<String>,
    #[command(flatten)]
    making: MakingArguments,
}

#[derive(Debug, clap::Args)]
pub(super) struct Replay {
    /// The transcript.
    file: PathBuf,
    /// Play it to the instruments of a bench: a profile's file, or a name of `tactus-sim list`. Without one each
    /// instrument is played to on its own.
    #[arg(long, value_name = "FILE|NAME")]
    profile: Option<String>,
    /// With --profile: the sheet, its loads and effects.
    #[arg(long, value_name = "FILE|NAME", requires = "profile")]
    scene: Option<String>,
    /// With --profile: what hangs on the terminals in place of the profile's.
    #[arg(long, value_name = "WORDS", requires = "profile")]
    load: Option<Hanging>,
    /// Compare readings, times and serial numbers to the byte too.
    #[arg(long)]
    exact: bool,
    #[command(flatten)]
    making: MakingArguments,
}

#[derive(Debug, clap::Args)]
struct MakingArguments {
    /// A module of the mainframe that the transcript does not tell of: 1=34924A, 3=34934A,4x128.
    #[arg(long, value_name = "N=MODEL[,TERMINAL]", value_parser = slot)]
    slot: Vec<(usize, Module)>,
    /// What hangs on the source's terminals, ohm; without it nothing.
    #[arg(long, value_name = "R")]
    ohms: Option<f64>,
    /// What the voltmeter sees, V.
    #[arg(long, value_name = "V", allow_negative_numbers = true)]
    volts: Option<f64>,
}

fn instrument(text: &str) -> Result<Instrument, String> {
    Instrument::named(text).ok_or_else(|| "there are 6221, 34980a and gpio".to_owned())
}

impl MakingArguments {
    fn of(&self, instrument: Instrument) -> Result<Making, Fault> {
        let mut making = Making::of(instrument);
        for (number, module) in &self.slot {
            making.slots[number - 1] = Some(*module);
        }
        if let Some(ohms) = self.ohms {
            if ohms.is_nan() || ohms < 0.0 {
                return Err(format!("{ohms} ohm cannot hang on terminals").into());
            }
            making.ohms = ohms;
        }
        if let Some(volts) = self.volts {
            if volts.is_nan() {
                return Err("a voltage is a number".into());
            }
            making.volts = volts;
        }
        Ok(making)
    }
}

pub(super) fn make_golden(asked: &MakeGolden) -> ExitCode {
    match written_golden(asked) {
        Ok((golden, differs)) => {
            if let Some(differs) = differs {
                eprintln!(
                    "tactus-sim: the golden is made; the simulator does not hold it yet: {differs}"
                );
            }
            match &asked.out {
                Some(_) => ExitCode::SUCCESS,
                None => say(golden.to_string().trim_end()),
            }
        }
        Err(fault) => fail(&*fault, CONFIGURATION),
    }
}

/// The golden, and where the simulator answers otherwise.
fn written_golden(asked: &MakeGolden) -> Result<(Golden, Option<String>), Fault> {
    let entries = read_transcript(&asked.file)?;
    let place = asked.file.display().to_string();
    let name = asked.file.file_name().unwrap_or_default();
    let mut cites = asked.cites.clone();
    cites.push(format!("the transcript {}", name.to_string_lossy()));
    let making = asked.making.of(asked.instrument)?;
    let golden = golden_of(&place, &entries, &making, cites)?;
    let text = golden.to_string();
    let place = match &asked.out {
        Some(path) => {
            outfile::write(path, Existing::forced(asked.force), text.as_bytes())?;
            path.display().to_string()
        }
        None => "the golden".to_owned(),
    };
    // Read again, so that differences are told with their lines.
    let differs = Golden::parse(&place, &text)?.play(&place).err();
    Ok((golden, differs.map(|fault| fault.to_string())))
}

pub(super) fn play(asked: &Replay) -> ExitCode {
    let against = match against(asked) {
        Ok(against) => against,
        Err(fault) => return fail(&*fault, CONFIGURATION),
    };
    let entries = match read_transcript(&asked.file) {
        Ok(entries) => entries,
        Err(fault) => return fail(&fault, CONFIGURATION),
    };
    let closeness = match asked.exact {
        true => Closeness::Exact,
        false => Closeness::Shapes,
    };
    match replay(
        &asked.file.display().to_string(),
        &entries,
        &against,
        closeness,
    ) {
        Ok(played) => say(&format!(
            "{} messages, {} replies: the simulators answer as recorded",
            played.messages, played.replies
        )),
        Err(fault) => fail(&fault, 1),
    }
}

fn against(asked: &Replay) -> Result<Against, Fault> {
    let Some(name) = &asked.profile else {
        return Ok(Against::Alone {
            making: asked.making.of(Instrument::Mainframe)?,
        });
    };
    let mut profile = Profile::load(name)?.at_pace(Pace::Instant);
    for (number, module) in &asked.making.slot {
        profile.slots[number - 1] = Some(*module);
    }
    if let Some(load) = &asked.load {
        profile.load = load.clone();
    }
    let scene = scene_named(asked.scene.as_deref())?;
    Ok(Against::Together(SimulatedRig::new(&profile, scene)?))
}
