//! Hard cases 31 and 39: an electrode that opens while the baseline is tracked, and a load on the sheet while the
//! baseline is recorded.

use std::sync::Arc;

use drift::Tracker;
use imaging::{Geometry, Model, baseline_remarks};
use phantom::Load;
use survey::{Amps, Baseline, Frame, Reading, Volts};

use crate::evaluation::average;
use crate::failure::{Attempt, Failure};
use crate::months::{CURRENT_A, Simulated, away_mm, model, shipped};
use crate::readings::plain_frame;
use crate::sheet;
use crate::stability::outcome::{Check, Naive, Outcome, worst};

const SEED: u64 = 31;
/// Interval of the frames, s.
const EVERY_S: f64 = 600.0;
/// Number of empty frames before the electrode opens, which happens between two frames.
const BEFORE: usize = 12;
/// The electrode, counted from 0, in the middle of the left side.
const ELECTRODE: usize = 22;
/// Diameter of the presses, mm; each halves the conductance.
const PRESS_MM: f64 = 10.0;
/// Positions of the presses, mm: within 45 mm of the electrode, and elsewhere.
const NEAR_MM: [[f64; 2]; 4] = [[40.0, 100.0], [42.0, 115.0], [40.0, 132.0], [48.0, 122.0]];
const ELSEWHERE_MM: [[f64; 2]; 4] = [[107.0, 115.0], [150.0, 70.0], [160.0, 160.0], [90.0, 180.0]];

/// Location errors of the presses, mm.
struct Located {
    near: Vec<f64>,
    elsewhere: Vec<f64>,
    /// Errors near the electrode of the default one-step map with the baseline as recorded.
    naive_near: Vec<f64>,
    /// Electrodes whose readings are not used at the end, counted from 0.
    masked: Vec<usize>,
    /// Number of frames from the opening on until the electrode's readings are not used; 0 if that did not happen.
    named_after: usize,
}

/// Tracks the baseline of a sheet, whose electrode opens if `opens`, then presses the sheet.
fn follow(opens: bool, geometry: &Geometry, one_step: &Model) -> Result<Located, Failure> {
    let failed = |fault| Failure::of("the tracked baseline", &fault);
    let from_s = EVERY_S * (BEFORE as f64 + 0.2);
    let open = match opens {
        true => format!(
            "[effects.detachment]\nelectrode = {}\nfrom_s = {from_s:.1}\nover_s = 100.0\n",
            ELECTRODE + 1
        ),
        false => String::new(),
    };
    let effects = "[effects.contact-spread]\nstd = 0.3\n[effects.contact-drift]\npercent = 10.0\ntau_h = 48.0\n\
        [effects.thermal-emf]\nuv = 0.9\n";
    let mut simulated = Simulated::of("an electrode opens", &(effects.to_owned() + &open), SEED)?;
    let baseline = simulated.frame(0.0, None)?;
    let mut tracker = Tracker::new(Arc::new(model(geometry, &baseline)?), 0.0).map_err(failed)?;
    let (centroids, areas) = (
        geometry.mesh.region_centroids(),
        geometry.mesh.region_areas(),
    );
    let mut out = Located {
        near: Vec::new(),
        elsewhere: Vec::new(),
        naive_near: Vec::new(),
        masked: Vec::new(),
        named_after: 0,
    };
    let mut number = 0;
    let mut next = |press: Option<[f64; 2]>, tracker: &mut Tracker| {
        number += 1;
        let at_s = EVERY_S * number as f64;
        let load = press.map(|place| Load::disc(place, PRESS_MM, 0.5));
        let frame = simulated.frame(at_s, load)?;
        let answer = tracker.follow(&frame, at_s).map_err(failed)?;
        Ok::<_, Failure>((frame, answer))
    };
    for _ in 0..BEFORE {
        next(None, &mut tracker)?;
    }
    for frame in 1..=3 {
        let (_, answer) = next(None, &mut tracker)?;
        if out.named_after == 0 && answer.masked == [ELECTRODE] {
            out.named_after = frame;
        }
    }
    for (near, place) in NEAR_MM
        .map(|place| (true, place))
        .into_iter()
        .chain(ELSEWHERE_MM.map(|place| (false, place)))
    {
        let (frame, answer) = next(Some(place), &mut tracker)?;
        let found = answer.event.filter(|event| event.came);
        let error = found.map_or(f64::INFINITY, |event| away_mm(event.fit.disc.centre, place));
        match near {
            true => out.near.push(error),
            false => out.elsewhere.push(error),
        }
        if near {
            let map = one_step.reconstruct(&baseline, &frame);
            let map = map.attempt("one-step")?;
            let at = map.found(&centroids, &areas).unwrap_or([0.0; 2]);
            out.naive_near.push(away_mm(at, place));
        }
        out.masked = answer.masked;
        next(None, &mut tracker)?;
    }
    Ok(out)
}

/// 31: an electrode opens between two frames; its readings are not used from then on.
pub(crate) fn open_electrode() -> Result<Outcome, Failure> {
    let geometry = sheet::geometry()?;
    let one_step = shipped(&geometry)?;
    let (open, healthy) = rayon::join(
        || follow(true, &geometry, &one_step),
        || follow(false, &geometry, &one_step),
    );
    let (open, healthy) = (open?, healthy?);
    let mean = |errors: &[f64]| average(errors.iter().copied());
    let most = |errors: &[f64]| errors.iter().copied().fold(0.0, worst);
    let named = match (open.masked == [ELECTRODE], healthy.masked.is_empty()) {
        (true, true) => open.named_after as f64,
        _ => f64::INFINITY,
    };
    Ok(Outcome::of([
        Check::at_most(
            "frames until the open electrode, and no other, is left out",
            Naive::Absent("the naive map omits no reading".into()),
            named,
            1.0,
        ),
        Check::at_most(
            "mean error of a 10 mm press near it, mm; naive: the map of the baseline as recorded",
            Naive::Error(mean(&open.naive_near)),
            mean(&open.near),
            1.0,
        ),
        Check::at_most(
            "largest error of a 10 mm press near it, mm; naive: the same",
            Naive::Error(most(&open.naive_near)),
            most(&open.near),
            2.0,
        ),
        Check::at_most(
            "mean error elsewhere over that with all electrodes",
            Naive::Absent("the naive map has one place only".into()),
            mean(&open.elsewhere) / mean(&healthy.elsewhere),
            2.0,
        ),
    ])
    .noted(
        "The readings of the electrode are marginalised; the pairs of the ring stay as planned.",
    ))
}

/// Seeds of the sheets of case 39, which differ in contacts and noise.
const SHEETS: std::ops::Range<u64> = 390..398;
/// Number of frames of a baseline.
const FRAMES: usize = 10;
/// Effects of these sheets: contacts and thermal voltages, and uneven spraying.
const EVERYDAY: &str = "[effects.contact-spread]\nstd = 0.3\n[effects.thermal-emf]\nuv = 0.9\n";
const SPRAYED: &str = "[effects.spray]\nstd = 0.1\n";
/// The load during a baseline, mm: position, diameter of a load that is detected in a first baseline, and diameter of
/// one that is not.
const LAID_MM: [f64; 2] = [150.0, 70.0];
const WIDE_MM: f64 = 30.0;
const NARROW_MM: f64 = 10.0;
/// Smallest largest loss of a map that shows the load, which halves the conductance.
const SHOWN: f64 = 0.1;

/// Baselines of one sheet: empty, with the wide load, with the narrow one, and empty again; and a frame with the wide
/// load.
struct Recorded {
    empty: Baseline,
    wide: Baseline,
    narrow: Baseline,
    again: Baseline,
    later: Vec<Reading>,
}

fn record(effects: &str, seed: u64, protocol_hash: &str) -> Result<Recorded, Failure> {
    let mut simulated = Simulated::of("a baseline with a load", effects, seed)?;
    let mut at_s = 0.0;
    let mut frame = |diameter: Option<f64>| {
        at_s += 1.0;
        simulated.frame(at_s, diameter.map(|mm| Load::disc(LAID_MM, mm, 0.5)))
    };
    let as_measured = |readings| {
        plain_frame(
            readings,
            protocol_hash.to_owned(),
            Amps(CURRENT_A),
            Volts(0.1),
        )
    };
    let mut baseline = |id: &str, diameter: Option<f64>| {
        let frames = (0..FRAMES).map(|_| Ok(as_measured(frame(diameter)?)));
        let frames: Vec<Frame> = frames.collect::<Result<_, Failure>>()?;
        Baseline::from_frames(id, &frames).attempt("the baseline")
    };
    Ok(Recorded {
        empty: baseline("empty", None)?,
        wide: baseline("wide", Some(WIDE_MM))?,
        narrow: baseline("narrow", Some(NARROW_MM))?,
        again: baseline("again", None)?,
        later: frame(Some(WIDE_MM))?,
    })
}

/// 39: a load lies on the sheet while the baseline is recorded.
pub(crate) fn loaded_baseline() -> Result<Outcome, Failure> {
    let geometry = sheet::geometry()?;
    let one_step = shipped(&geometry)?;
    let hash = one_step.reconstructor.protocol().hash();
    let remarked = |baseline: &Baseline, before: Option<&Baseline>, begins: &str| {
        let remarks = baseline_remarks(&one_step, &geometry, baseline, before);
        f64::from(u8::from(
            remarks.iter().any(|text| text.starts_with(begins)),
        ))
    };
    let (fitted, before) = ("the sheet fitted to it", "against baseline");
    let [mut shown, mut flagged, mut falsely, mut sprayed] = [0.0; 4];
    let [mut alone, mut against, mut against_falsely] = [0.0; 3];
    for seed in SHEETS {
        let sheet = record(EVERYDAY, seed, &hash)?;
        let map = one_step.reconstruct(&sheet.wide.readings, &sheet.later);
        let map = map.attempt("one-step")?;
        let shows = map.largest_loss().is_some_and(|(_, loss)| loss > SHOWN);
        shown += f64::from(u8::from(shows));
        flagged += remarked(&sheet.wide, None, fitted);
        falsely += remarked(&sheet.empty, None, fitted);
        alone += remarked(&sheet.narrow, None, fitted);
        against += remarked(&sheet.narrow, Some(&sheet.empty), before);
        against_falsely += remarked(&sheet.again, Some(&sheet.empty), before);
        let sheet = record(&(EVERYDAY.to_owned() + SPRAYED), seed, &hash)?;
        sprayed += remarked(&sheet.empty, None, fitted);
    }
    let share = |count: f64| count / (SHEETS.end - SHEETS.start) as f64;
    let nothing = || Naive::Absent("the naive form flags nothing".into());
    Ok(Outcome::of([
        Check::at_least(
            "30 mm load: share flagged; naive: shown while it lies there",
            Naive::Error(share(shown)),
            share(flagged),
            1.0,
        ),
        Check::at_most(
            "empty sheet: share flagged",
            nothing(),
            share(falsely),
            0.0,
        ),
        Check::at_most(
            "empty sheet sprayed unevenly by 10 %: share flagged",
            nothing(),
            share(sprayed),
            0.0,
        ),
        Check::at_least(
            "10 mm load: flagged by the baseline before; naive: without",
            Naive::Error(share(alone)),
            share(against),
            1.0,
        ),
        Check::at_most(
            "empty sheet: flagged by an empty baseline before",
            nothing(),
            share(against_falsely),
            0.0,
        ),
    ])
    .noted(
        "A load that takes less than 10 % of the fitted conductance, or less than the unevenness of the sheet, is not found in a first baseline; `tactus baseline record` states this.",
    ))
}
