//! `tactus-lab scene explain`: which effects a scene includes, which it omits, and whether they matter.

use std::time::Duration;

use phantom::{Prediction, Preview, Repeat};
use serde::Serialize;
use serde_json::json;
use survey::printable;

use crate::args::ExplainOptions;
use crate::output::print_line;
use studies::Failure;

/// An effect is negligible if it is below this share of the noise and below [`OF_SIGNAL`] of the signal.
const OF_NOISE: f64 = 0.1;
/// Largest share of the load's signal of a negligible effect.
const OF_SIGNAL: f64 = 1e-3;

/// Assessment of an effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum EffectStatus {
    /// Named in the scene and significant, or neither.
    Fine,
    /// Not named, but significant.
    Missing,
    /// Not named, and significant if it occurred.
    Fault,
    /// Named, but not significant.
    Negligible,
}

impl EffectStatus {
    fn of(prediction: &Prediction, noise: f64, signal: Option<f64>) -> Self {
        let matters = prediction.volts > OF_NOISE * noise
            || signal.is_some_and(|signal| prediction.volts > OF_SIGNAL * signal);
        match (prediction.named, matters) {
            (true, false) => Self::Negligible,
            (false, true) if prediction.assumes.is_some() => Self::Fault,
            (false, true) => Self::Missing,
            _ => Self::Fine,
        }
    }

    fn word(self) -> &'static str {
        match self {
            Self::Fine => "",
            Self::Missing => "left out, would matter",
            Self::Fault => "left out, would matter if it happened",
            Self::Negligible => "negligible",
        }
    }
}

/// Heading and members of a group of the table of effects.
type Group = (&'static str, fn(&Prediction, EffectStatus) -> bool);

/// Each group lists its largest effect first.
const GROUPS: [Group; 3] = [
    ("in the scene:", |prediction, _| prediction.named),
    ("left out, and it would matter:", |_, verdict| {
        matches!(verdict, EffectStatus::Missing | EffectStatus::Fault)
    }),
    (
        "left out, and too small to matter:",
        |prediction, verdict| !prediction.named && verdict == EffectStatus::Fine,
    ),
];

/// A load or a fault of the scene, and its time.
#[derive(Debug, Serialize)]
struct TimedEntry {
    name: String,
    from_s: f64,
    to_s: Option<f64>,
    every_s: Option<f64>,
    times: u32,
}

impl TimedEntry {
    fn new(name: &str, from: Duration, to: Option<Duration>, repeat: Option<Repeat>) -> Self {
        Self {
            name: name.to_owned(),
            from_s: from.as_secs_f64(),
            to_s: to.map(|to| to.as_secs_f64()),
            every_s: repeat.map(|repeat| repeat.every().as_secs_f64()),
            times: repeat.map_or(1, Repeat::times),
        }
    }

    fn line(&self, kind: &str) -> String {
        let until = self.to_s.map(|to| format!(" to {to} s"));
        let again = (self.every_s)
            .map(|every| format!("; again every {every} s, {} times in all", self.times));
        format!(
            "{kind:5} {:24} from {} s{}{}",
            self.name,
            self.from_s,
            until.unwrap_or_default(),
            again.unwrap_or_default(),
        )
    }
}

/// Prints the time line and the sizes of all effects, and warns.
pub(crate) fn explain(options: &ExplainOptions) -> Result<(), Failure> {
    let scene = super::open(&options.scene)?;
    let scan = super::scan(&scene, &options.session)?;
    let preview = Preview::new(&scene, scan)
        .map_err(|fault| Failure::of(&format!("scene {}", options.scene), &fault))?;
    let (noise, signal) = (preview.noise(), preview.signal());
    let mut predictions: Vec<(Prediction, EffectStatus)> = preview
        .predictions()
        .into_iter()
        .map(|prediction| {
            let verdict = EffectStatus::of(&prediction, noise, signal);
            (prediction, verdict)
        })
        .collect();
    predictions.sort_by(|(a, _), (b, _)| b.volts.total_cmp(&a.volts));
    let of = |wanted: EffectStatus| -> Vec<&str> {
        let those = predictions.iter().filter(|(_, verdict)| *verdict == wanted);
        those.map(|(prediction, _)| prediction.name).collect()
    };
    let source = if scene.effects.voltmeter_noise.is_some() {
        "the scene's"
    } else {
        "the voltmeter's table"
    };
    let loads = scene.loads.iter();
    let loads: Vec<_> = loads
        .map(|load| TimedEntry::new(&load.load.name, load.from, load.to, load.repeat))
        .collect();
    let faults = scene.faults.iter();
    let faults: Vec<_> = faults
        .map(|fault| {
            let to = fault.lasts.map(|lasts| fault.at.saturating_add(lasts));
            TimedEntry::new(&fault.what, fault.at, to, fault.repeat)
        })
        .collect();
    if options.json {
        let effects: Vec<_> = predictions
            .iter()
            .map(|(prediction, verdict)| {
                json!({
                    "name": prediction.name,
                    "what": prediction.what,
                    "named": prediction.named,
                    "volts": prediction.volts,
                    "of_noise": (noise > 0.0).then(|| prediction.volts / noise),
                    "of_signal": signal.map(|signal| prediction.volts / signal),
                    "assumes": prediction.assumes,
                    "verdict": verdict.word(),
                })
            })
            .collect();
        let line = json!({
            "scene": scene.name,
            "frames": preview.scan().frames,
            "frame_s": preview.scan().frame_time().as_secs_f64(),
            "noise_v": noise,
            "noise_from": source,
            "signal_v": signal,
            "loads": loads,
            "faults": faults,
            "effects": effects,
            "missing": of(EffectStatus::Missing),
            "negligible": of(EffectStatus::Negligible),
        });
        print_line!("{}", survey::printable_json(line.to_string()));
        return Ok(());
    }
    let name = printable(&scene.name);
    print_line!("{name}: {}", super::in_words(preview.scan()));
    let signal_text = signal.map_or("no load, so no signal".to_owned(), |signal| {
        format!("signal {signal:.1e} V rms, in the frame in which the loads change most")
    });
    print_line!("noise {noise:.1e} V a reading ({source}); {signal_text}\n");
    for load in &loads {
        print_line!("{}", printable(&load.line("load")));
    }
    for fault in &faults {
        print_line!("{}", printable(&fault.line("fault")));
    }
    if !(loads.is_empty() && faults.is_empty()) {
        print_line!("");
    }
    print_line!(
        "{:20} {:5} {:>9} {:>9} {:>9}",
        "effect",
        "named",
        "volts rms",
        "of noise",
        "of signal"
    );
    for (heading, has) in GROUPS {
        let members: Vec<_> = predictions
            .iter()
            .filter(|(prediction, verdict)| has(prediction, *verdict))
            .collect();
        if !members.is_empty() {
            print_line!("{heading}");
        }
        for (prediction, verdict) in members {
            print_line!("{}", row(prediction, *verdict, noise, signal));
        }
    }
    print_line!("");
    for (verdict, text) in [
        (
            EffectStatus::Missing,
            "left out, though more than 0.1 of the noise or 0.1 % of the signal",
        ),
        (
            EffectStatus::Negligible,
            "named, though negligible: the scene could omit them",
        ),
    ] {
        let names = of(verdict);
        if !names.is_empty() {
            print_line!("{text}: {}", names.join(", "));
        }
    }
    Ok(())
}

/// A row of the table of effects.
fn row(prediction: &Prediction, verdict: EffectStatus, noise: f64, signal: Option<f64>) -> String {
    let share = |of: f64| format!("{:.1e}", prediction.volts / of);
    let assumed = prediction.assumes.as_ref().map(|text| format!(" [{text}]"));
    let line = format!(
        "{:20} {:5} {:>9} {:>9} {:>9}  {}{}",
        prediction.name,
        if prediction.named { "yes" } else { "-" },
        format!("{:.1e}", prediction.volts),
        if noise > 0.0 {
            share(noise)
        } else {
            "-".to_owned()
        },
        signal.map_or("-".to_owned(), share),
        verdict.word(),
        assumed.unwrap_or_default(),
    );
    line.trim_end().to_owned()
}
