//! Maps of single frames against the baseline of day 0, with and without removal of the drift of each frame.

use std::path::PathBuf;

use eit::metrics::likeness;
use imaging::{
    BuildError, Conditions, DriftRule, Geometry, Model, ReconstructionSettings, build, load,
    with_drift,
};
use phantom::Load;
use rayon::prelude::*;
use serde::Serialize;
use survey::{Amps, Reading};

use super::Settings;
use super::simulated::{CURRENT_A, Family, NOISE_V, Simulated, away_mm};
use super::single::{DAYS, SPANS, span_of};
use crate::evaluation::{average, quantile, test_set};
use crate::failure::Attempt;
use crate::honesty::MapMethod;
use crate::sheet::protocol;
use crate::{Failure, progress};

/// 95 % of a normal distribution is within this number of standard deviations.
const WITHIN_95: f64 = 1.96;

/// Loads and methods of the study.
#[derive(Debug, Clone, Default)]
pub struct MapSettings {
    /// Number of loads of each kind on each of eight days of a sheet.
    pub loads: usize,
    /// Methods without training.
    pub methods: Vec<MapMethod>,
    /// Model files of trained methods.
    pub models: Vec<PathBuf>,
}

/// A kind of load.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LoadKind {
    /// A disc of 10 mm, half the conductance lost.
    Press10,
    /// A disc of 30 mm.
    Press30,
    /// Polygons of Algorithm 1 of the paper.
    Polygons,
}

impl LoadKind {
    const ALL: [Self; 3] = [Self::Press10, Self::Press30, Self::Polygons];

    fn name(self) -> &'static str {
        match self {
            Self::Press10 => "press of 10 mm",
            Self::Press30 => "press of 30 mm",
            Self::Polygons => "polygons",
        }
    }
}

/// Results of one method for one kind of load in one span of days.
#[derive(Debug, Clone, Serialize)]
pub struct MapRow {
    /// Kind of drift.
    pub family: Family,
    /// Name of the method or of the model file.
    pub method: String,
    /// Whether the drift of each frame is removed.
    pub drift: DriftRule,
    /// Kind of load.
    pub load: LoadKind,
    /// Days since the baseline.
    pub days: &'static str,
    /// Number of frames.
    pub frames: usize,
    /// Median distance of the position found in the map from the centre of the load, mm; `None` for polygons.
    pub median_mm: Option<f64>,
    /// 95th percentile of that distance, mm; `None` for polygons.
    pub p95_mm: Option<f64>,
    /// Mean correlation of map and truth over the region.
    pub correlation: f64,
    /// Share of the region's area that the frame determines, so that a standard deviation is stated.
    pub resolved: f64,
    /// Share of that area in which the map is within 1.96 stated standard deviations of the truth.
    pub covered: f64,
    /// The same share for the part of that area under the load.
    pub covered_load: f64,
}

/// One method, prepared with and without removal of drift.
struct Prepared {
    name: String,
    models: [(DriftRule, Model); 2],
}

/// Results for one map.
struct Judged {
    method: usize,
    rule: usize,
    kind: LoadKind,
    span: usize,
    error_mm: Option<f64>,
    correlation: f64,
    resolved: f64,
    covered: f64,
    covered_load: f64,
}

/// All rows.
pub(super) fn rows(settings: &Settings, geometry: &Geometry) -> Result<Vec<MapRow>, Failure> {
    let prepared = prepared(&settings.maps, geometry)?;
    let bar = progress::bar(settings.families.len() * settings.sheets, "maps");
    let mut rows = Vec::new();
    for &family in &settings.families {
        let judged: Vec<Judged> = (0..settings.sheets as u64)
            .into_par_iter()
            .map(|number| {
                // other sheets than those of `single`
                let seed = settings.seed.wrapping_add(1000 * number + 500);
                let judged = sheet(family, seed, settings.maps.loads, geometry, &prepared);
                bar.inc(1);
                judged
            })
            .collect::<Result<Vec<_>, _>>()?
            .into_iter()
            .flatten()
            .collect();
        for kind in LoadKind::ALL {
            for (method, one) in prepared.iter().enumerate() {
                for (rule, (drift, _)) in one.models.iter().enumerate() {
                    for (span, (days, _)) in SPANS.iter().enumerate() {
                        let of = |judged: &&Judged| {
                            (judged.method, judged.rule, judged.kind, judged.span)
                                == (method, rule, kind, span)
                        };
                        let of: Vec<&Judged> = judged.iter().filter(of).collect();
                        rows.push(row(family, &one.name, *drift, kind, days, &of));
                    }
                }
            }
        }
    }
    bar.finish_and_clear();
    Ok(rows)
}

/// Each method with and without removal of drift, with the true noise stated.
fn prepared(settings: &MapSettings, geometry: &Geometry) -> Result<Vec<Prepared>, Failure> {
    let protocol = protocol(26)?;
    let conditions = Conditions::live(geometry, &protocol, Amps(CURRENT_A));
    let methods = settings.methods.iter().map(|method| {
        for_both(method.name(), &method.settings(), |settings| {
            build(settings, &conditions)
        })
    });
    let models = settings.models.iter().map(|file| {
        let name = file.file_stem().unwrap_or_default().to_string_lossy();
        for_both(&name, &ReconstructionSettings::default(), |settings| {
            let model = load(file, false, &protocol, Some(geometry))?;
            with_drift(model, settings, &conditions)
        })
    });
    methods.chain(models).collect()
}

fn for_both(
    name: &str,
    settings: &ReconstructionSettings,
    make: impl Fn(&ReconstructionSettings) -> Result<Model, BuildError>,
) -> Result<Prepared, Failure> {
    let model = |drift| {
        let settings = ReconstructionSettings {
            drift: Some(drift),
            noise_uv: Some(1e6 * NOISE_V),
            ..settings.clone()
        };
        make(&settings).map_err(|fault| Failure::of(name, &fault))
    };
    Ok(Prepared {
        name: name.to_owned(),
        models: [
            (DriftRule::Off, model(DriftRule::Off)?),
            (DriftRule::Frame, model(DriftRule::Frame)?),
        ],
    })
}

fn sheet(
    family: Family,
    seed: u64,
    loads: usize,
    geometry: &Geometry,
    prepared: &[Prepared],
) -> Result<Vec<Judged>, Failure> {
    let mut simulated = Simulated::new(family, seed)?;
    let baseline = simulated.frame(0.0, None)?;
    let mut judged = Vec::new();
    for day in DAYS {
        for kind in LoadKind::ALL {
            for _ in 0..loads {
                let (centre, pressed) = match kind {
                    LoadKind::Press10 => press(&mut simulated, 10.0),
                    LoadKind::Press30 => press(&mut simulated, 30.0),
                    LoadKind::Polygons => (None, simulated.polygons(&geometry.mesh)),
                };
                let frame = simulated.frame(86_400.0 * day, pressed.clone())?;
                let truth = test_set::true_map(&geometry.mesh, &pressed)?;
                for one in judge(geometry, prepared, &baseline, &frame, &truth, centre)? {
                    judged.push(Judged {
                        kind,
                        span: span_of(day),
                        ..one
                    });
                }
            }
        }
    }
    Ok(judged)
}

fn press(simulated: &mut Simulated, diameter_mm: f64) -> (Option<[f64; 2]>, Vec<Load>) {
    let place = simulated.place();
    (Some(place), vec![Load::disc(place, diameter_mm, 0.5)])
}

fn judge(
    geometry: &Geometry,
    prepared: &[Prepared],
    baseline: &[Reading],
    frame: &[Reading],
    truth: &[f64],
    centre: Option<[f64; 2]>,
) -> Result<Vec<Judged>, Failure> {
    let mesh = &geometry.mesh;
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    let area: f64 = areas.iter().sum();
    let mut judged = Vec::new();
    // the standard deviation is the same for all methods
    let first = &prepared[0].models[0].1;
    let deviation = first
        .deviation(baseline, frame)
        .attempt("the map's deviation")?
        .ok_or_else(|| Failure::usage("a model without a geometry has no deviation"))?;
    let resolved: f64 = areas
        .iter()
        .zip(&deviation.resolved)
        .filter(|(_, resolved)| **resolved)
        .map(|(area, _)| area)
        .sum();
    for (method, one) in prepared.iter().enumerate() {
        for (rule, (_, model)) in one.models.iter().enumerate() {
            let map = model
                .reconstruct(baseline, frame)
                .map_err(|fault| Failure::of(&one.name, &fault))?;
            let covered = |of: &dyn Fn(usize) -> bool| -> f64 {
                let known = (0..areas.len()).filter(|&k| deviation.resolved[k] && of(k));
                let (mut within, mut all) = (0.0, 0.0);
                for k in known {
                    let off = (map.values[k] - truth[k]).abs();
                    all += areas[k];
                    within += f64::from(off <= WITHIN_95 * deviation.deviation[k]) * areas[k];
                }
                within / all
            };
            let found = map.found(&centroids, &areas).unwrap_or([0.0; 2]);
            judged.push(Judged {
                method,
                rule,
                kind: LoadKind::Polygons,
                span: 0,
                error_mm: centre.map(|centre| away_mm(found, centre)),
                correlation: likeness(&map.values, truth, &areas).correlation,
                resolved: resolved / area,
                covered: covered(&|_| true),
                covered_load: covered(&|k| truth[k] != 0.0),
            });
        }
    }
    Ok(judged)
}

fn row(
    family: Family,
    method: &str,
    drift: DriftRule,
    load: LoadKind,
    days: &'static str,
    of: &[&Judged],
) -> MapRow {
    let mut errors: Vec<f64> = of.iter().filter_map(|one| one.error_mm).collect();
    let mean = |of_one: &dyn Fn(&Judged) -> f64| average(of.iter().map(|one| of_one(one)));
    let mut at = |share| (!errors.is_empty()).then(|| quantile(&mut errors, share));
    MapRow {
        family,
        method: method.to_owned(),
        drift,
        load,
        days,
        frames: of.len(),
        median_mm: at(0.5),
        p95_mm: at(0.95),
        correlation: mean(&|one| one.correlation),
        resolved: mean(&|one| one.resolved),
        covered: mean(&|one| one.covered),
        covered_load: mean(&|one| one.covered_load),
    }
}

/// The rows as text.
pub(super) fn text(rows: &[MapRow]) -> String {
    let mut text = String::from(
        "drift           load            method               drift= days      frames  median mm   p95 mm  correlation resolved  covered under it\n",
    );
    let mm = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
    for row in rows {
        text += &format!(
            "{:<15} {:<15} {:<20} {:<6} {:<9} {:>6} {:>10} {:>8} {:>12.3} {:>4.0} % {:>6.0} % {:>6.0} %\n",
            row.family.name(),
            row.load.name(),
            row.method,
            match row.drift {
                DriftRule::Off => "off",
                DriftRule::Frame => "frame",
            },
            row.days,
            row.frames,
            mm(row.median_mm),
            mm(row.p95_mm),
            row.correlation,
            100.0 * row.resolved,
            100.0 * row.covered,
            100.0 * row.covered_load
        );
    }
    text
}
