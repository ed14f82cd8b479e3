//! Single frames against the baseline of day 0: location errors of presses by days since the baseline, for each kind of
//! drift.

use drift::{DiscFit, DriftModel};
use imaging::{Conditions, Geometry, Method, Model, ReconstructionSettings, build};
use phantom::Load;
use rayon::prelude::*;
use serde::Serialize;
use survey::{Amps, Map, Reading};

use super::Settings;
use super::simulated::{CURRENT_A, Family, NOISE_V, Simulated, away_mm, model};
use crate::evaluation::{average, quantile};
use crate::failure::Attempt;
use crate::sheet::protocol;
use crate::{Failure, progress};

/// Days of the frames.
pub(super) const DAYS: [f64; 8] = [0.01, 0.2, 1.0, 3.0, 7.0, 14.0, 30.0, 90.0];
pub(super) const SPANS: [(&str, [f64; 2]); 4] = [
    ("0.01-0.2", [0.0, 0.5]),
    ("1-3", [0.5, 5.0]),
    ("7-14", [5.0, 20.0]),
    ("30-90", [20.0, 100.0]),
];
/// Diameters of the presses, mm; each halves the conductance.
const DIAMETERS_MM: [f64; 2] = [10.0, 30.0];
/// 95 % quantile of chi squared with two degrees of freedom.
pub(super) const CHI_95: f64 = 5.991;
/// Prior standard deviation of local change, for the whitened one-step map.
const MAP_SIZE: f64 = 0.05;

/// Method of locating a press.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Locator {
    /// The one-step map with default settings.
    OneStep,
    /// A disc fitted after gain and contacts are projected out.
    Projection,
    /// The one-step map of the data whitened with a covariance chosen by evidence.
    EvidenceMap,
    /// A disc fitted with a covariance chosen by evidence.
    EvidenceDisc,
}

impl Locator {
    fn name(self) -> &'static str {
        match self {
            Self::OneStep => "one-step, no tracking",
            Self::Projection => "projection, disc",
            Self::EvidenceMap => "evidence, map",
            Self::EvidenceDisc => "evidence, disc",
        }
    }
}

/// Results for presses of one diameter in one span of days.
#[derive(Debug, Clone, Serialize)]
pub struct SingleRow {
    /// Kind of drift.
    pub family: Family,
    /// Method.
    pub locator: Locator,
    /// Diameter of the presses, mm.
    pub diameter_mm: f64,
    /// Days since the baseline.
    pub days: &'static str,
    /// Number of presses.
    pub presses: usize,
    /// Median distance from the truth, mm.
    pub median_mm: f64,
    /// 95th percentile of that distance, mm.
    pub p95_mm: f64,
    /// Share of fits that are accepted; `None` for maps.
    pub accepted: Option<f64>,
    /// Share of accepted fits whose 95 % ellipse contains the truth; `None` for maps, or if no fit is accepted.
    pub covered: Option<f64>,
}

/// One located press.
struct Located {
    span: usize,
    diameter: usize,
    locator: Locator,
    error_mm: f64,
    /// Whether the fit is accepted, and whether its 95 % ellipse contains the truth; `None` for maps.
    disc: Option<(bool, bool)>,
}

/// Results for one simulated sheet: presses, fit to the baseline, and empty frames.
struct OneSheet {
    located: Vec<Located>,
    misfit: f64,
    nominal_misfit: f64,
    unevenness: f64,
    empty: Vec<f64>,
}

/// Sheets of one kind: the fit to the baseline, and empty frames.
#[derive(Debug, Clone, Serialize)]
pub struct SheetRow {
    /// Kind of drift.
    pub family: Family,
    /// Number of sheets.
    pub sheets: usize,
    /// Mean misfit of the fitted sheet, %.
    pub misfit_percent: f64,
    /// Mean misfit of the nominal sheet, %.
    pub nominal_misfit_percent: f64,
    /// Mean unevenness of the fitted conductance, %.
    pub unevenness_percent: f64,
    /// Number of empty frames.
    pub empty: usize,
    /// Number of empty frames whose best disc improves chi squared by more than 45.
    pub above_45: usize,
    /// Number of empty frames whose best disc improves chi squared by more than 100.
    pub above_100: usize,
}

/// All rows.
pub(super) fn rows(
    settings: &Settings,
    geometry: &Geometry,
) -> Result<(Vec<SingleRow>, Vec<SheetRow>), Failure> {
    let one_step = shipped(geometry)?;
    let bar = progress::bar(settings.families.len() * settings.sheets, "one frame");
    let (mut rows, mut sheets) = (Vec::new(), Vec::new());
    for &family in &settings.families {
        let done: Vec<OneSheet> = (0..settings.sheets as u64)
            .into_par_iter()
            .map(|number| {
                let seed = settings.seed.wrapping_add(1000 * number);
                let done = sheet(family, seed, settings.presses, geometry, &one_step);
                bar.inc(1);
                done
            })
            .collect::<Result<_, _>>()?;
        let mean = |of: &dyn Fn(&OneSheet) -> f64| 100.0 * average(done.iter().map(of));
        let empty: Vec<f64> = done.iter().flat_map(|one| one.empty.clone()).collect();
        sheets.push(SheetRow {
            family,
            sheets: done.len(),
            misfit_percent: mean(&|one| one.misfit),
            nominal_misfit_percent: mean(&|one| one.nominal_misfit),
            unevenness_percent: mean(&|one| one.unevenness),
            above_45: empty.iter().filter(|score| **score > 45.0).count(),
            above_100: empty.iter().filter(|score| **score > 100.0).count(),
            empty: empty.len(),
        });
        let located: Vec<&Located> = done.iter().flat_map(|one| &one.located).collect();
        for locator in [
            Locator::OneStep,
            Locator::Projection,
            Locator::EvidenceMap,
            Locator::EvidenceDisc,
        ] {
            for (diameter, diameter_mm) in DIAMETERS_MM.into_iter().enumerate() {
                for (span, (days, _)) in SPANS.iter().enumerate() {
                    let of: Vec<&&Located> = located
                        .iter()
                        .filter(|one| {
                            (one.locator, one.diameter, one.span) == (locator, diameter, span)
                        })
                        .collect();
                    rows.push(row(family, locator, diameter_mm, days, &of));
                }
            }
        }
    }
    bar.finish_and_clear();
    Ok((rows, sheets))
}

fn row(
    family: Family,
    locator: Locator,
    diameter_mm: f64,
    days: &'static str,
    of: &[&&Located],
) -> SingleRow {
    let mut errors: Vec<f64> = of.iter().map(|one| one.error_mm).collect();
    let discs: Vec<(bool, bool)> = of.iter().filter_map(|one| one.disc).collect();
    let accepted = discs.iter().filter(|(accepted, _)| *accepted).count();
    let covered = discs.iter().filter(|disc| **disc == (true, true)).count();
    SingleRow {
        family,
        locator,
        diameter_mm,
        days,
        presses: errors.len(),
        median_mm: quantile(&mut errors, 0.5),
        p95_mm: quantile(&mut errors, 0.95),
        accepted: (!discs.is_empty()).then(|| accepted as f64 / discs.len() as f64),
        covered: (accepted > 0).then(|| covered as f64 / accepted as f64),
    }
}

/// The one-step method with default settings and the true noise stated.
pub(crate) fn shipped(geometry: &Geometry) -> Result<Model, Failure> {
    let settings = ReconstructionSettings {
        method: Some(Method::OneStep),
        noise_uv: Some(1e6 * NOISE_V),
        ..ReconstructionSettings::default()
    };
    let protocol = protocol(26)?;
    let conditions = Conditions::live(geometry, &protocol, Amps(CURRENT_A));
    build(&settings, &conditions).attempt("one-step")
}

/// The span of a day of [`DAYS`].
pub(super) fn span_of(day: f64) -> usize {
    let span = SPANS
        .iter()
        .position(|(_, [from, to])| (*from..*to).contains(&day));
    span.expect("each day is in a span")
}

fn sheet(
    family: Family,
    seed: u64,
    presses: usize,
    geometry: &Geometry,
    one_step: &Model,
) -> Result<OneSheet, Failure> {
    let mut simulated = Simulated::new(family, seed)?;
    let baseline = simulated.frame(0.0, None)?;
    let model = model(geometry, &baseline)?;
    let failed = |fault| Failure::of("the frame", &fault);
    let mut out = OneSheet {
        located: Vec::new(),
        misfit: model.fit().misfit,
        nominal_misfit: model.fit().nominal_misfit,
        unevenness: model.fit().unevenness,
        empty: Vec::new(),
    };
    for day in DAYS {
        let span = span_of(day);
        let empty = simulated.frame(86_400.0 * day, None)?;
        let relative = model.relative(&empty).map_err(failed)?;
        let assessed = model
            .assess(&relative.data, &relative.rows)
            .map_err(failed)?;
        out.empty.push(assessed.score);
        for (diameter, diameter_mm) in DIAMETERS_MM.into_iter().enumerate() {
            for _ in 0..presses {
                let place = simulated.place();
                let load = Load::disc(place, diameter_mm, 0.5);
                let frame = simulated.frame(86_400.0 * day, Some(load))?;
                for (locator, found) in locate(&model, geometry, one_step, &baseline, &frame)? {
                    out.located.push(Located {
                        span,
                        diameter,
                        locator,
                        error_mm: away_mm(found.0, place),
                        disc: found.1.map(|fit| (fit.accepted, covers(&fit, place))),
                    });
                }
            }
        }
    }
    Ok(out)
}

pub(super) type Found = ([f64; 2], Option<DiscFit>);

/// The position (m) found by each method; the corner of the sheet if a map shows no loss.
pub(super) fn locate(
    model: &DriftModel,
    geometry: &Geometry,
    one_step: &Model,
    baseline: &[Reading],
    frame: &[Reading],
) -> Result<Vec<(Locator, Found)>, Failure> {
    let mesh = &geometry.mesh;
    let (centroids, areas) = (mesh.region_centroids(), mesh.region_areas());
    let failed = |fault| Failure::of("the frame", &fault);
    let shipped = one_step.reconstruct(baseline, frame).attempt("one-step")?;
    let relative = model.relative(frame).map_err(failed)?;
    let projected = model
        .projected(&relative.data, &relative.rows)
        .and_then(|white| white.fit_disc(model))
        .map_err(failed)?;
    let assessed = model
        .assess(&relative.data, &relative.rows)
        .map_err(failed)?;
    let values = assessed
        .whitened
        .one_step(model, MAP_SIZE)
        .map_err(failed)?;
    let of_region = mesh.region().iter().map(|&t| values[t]).collect();
    let map = Map::relative(&shipped.mesh_hash, of_region, "evidence");
    let fit = assessed.whitened.fit_disc(model).map_err(failed)?;
    let found = |map: &Map| map.found(&centroids, &areas).unwrap_or([0.0; 2]);
    Ok(vec![
        (Locator::OneStep, (found(&shipped), None)),
        (
            Locator::Projection,
            (projected.disc.centre, Some(projected)),
        ),
        (Locator::EvidenceMap, (found(&map), None)),
        (Locator::EvidenceDisc, (fit.disc.centre, Some(fit))),
    ])
}

/// Whether the 95 % ellipse contains the truth (mm).
pub(super) fn covers(fit: &DiscFit, press_mm: [f64; 2]) -> bool {
    distance(fit, press_mm) <= CHI_95
}

/// Squared distance of the fitted centre from the truth (mm) in units of its covariance.
pub(super) fn distance(fit: &DiscFit, press_mm: [f64; 2]) -> f64 {
    let off = [0, 1].map(|axis| fit.disc.centre[axis] - 1e-3 * press_mm[axis]);
    let [[a, b], [_, d]] = fit.covariance;
    let determinant = a * d - b * b;
    (d * off[0] * off[0] - 2.0 * b * off[0] * off[1] + a * off[1] * off[1]) / determinant
}

/// The tables as text.
pub(super) fn text(rows: &[SingleRow], sheets: &[SheetRow]) -> String {
    let mut text = String::from(
        "drift           method                    mm days      presses  median mm   p95 mm  accepted  covered\n",
    );
    let share =
        |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{:.0} %", 100.0 * v));
    for row in rows {
        text += &format!(
            "{:<15} {:<22} {:>5} {:<9} {:>7} {:>10.2} {:>8.2} {:>9} {:>8}\n",
            row.family.name(),
            row.locator.name(),
            row.diameter_mm,
            row.days,
            row.presses,
            row.median_mm,
            row.p95_mm,
            share(row.accepted),
            share(row.covered)
        );
    }
    text += "\ndrift           sheets  misfit %   nominal %  uneven %  empty frames score > 45 score > 100\n";
    for row in sheets {
        text += &format!(
            "{:<15} {:>6} {:>9.2} {:>11.2} {:>9.2} {:>13} {:>10} {:>10}\n",
            row.family.name(),
            row.sheets,
            row.misfit_percent,
            row.nominal_misfit_percent,
            row.unevenness_percent,
            row.empty,
            row.above_45,
            row.above_100
        );
    }
    text
}
